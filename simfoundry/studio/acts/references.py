"""References to an object by its name, and the edits that remove them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.predicate import ExpressionError, parse_call
from simfoundry.studio.acts.act import resolved_path
from simfoundry.studio.reading import StudioScene


def references(scene: StudioScene, name: str) -> tuple[DataPath, ...]:
    """Return the paths of the values and keys that refer to an object in the scene and in the task."""
    found = []
    for loaded in (scene.loaded, *((scene.root,) if scene.task is not None else ())):
        assert loaded.document is not None
        found += [path for path in _mentions(loaded.document.data, name, ()) if path != ("objects", name)]
    return tuple(found)


def _mentions(data: Any, name: str, path: DataPath) -> Iterator[DataPath]:
    if isinstance(data, dict):
        for key, value in data.items():
            if key == name and path[:1] != ("objects",):
                yield (*path, key)
            yield from _mentions(value, name, (*path, str(key)))
    elif isinstance(data, tuple):
        for k, value in enumerate(data):
            yield from _mentions(value, name, (*path, str(k)))
    elif isinstance(data, str) and names_object(data, name) and path[-1:] != ("category",):
        yield path


def names_object(text: str, name: str) -> bool:
    """Return True if a text is the name of an object or of a part of it, or a predicate with such an argument."""
    if text.partition(".")[0] == name:
        return True
    try:
        return any(arg.partition(".")[0] == name for arg in parse_call(text).args)
    except ExpressionError:
        return False


def without_object(scene: StudioScene, name: str) -> dict[Path, dict[DataPath, Any]]:
    """Return the edits that remove an object, and what cannot stay without it.

    These are relations, excluded contacts, and the object's entries in the start and the reset of the task. Its uses in
    goals, cameras and recipes are left to the person, to whom they are reported as errors.
    """
    edits: dict[DataPath, Any] = {("objects", name): ABSENT}
    spec = scene.spec
    relations = tuple(text for text in spec.relations if not names_object(text, name))
    if len(relations) != len(spec.relations):
        edits["relations",] = relations or ABSENT
    pairs = tuple(pair for pair in spec.no_contact if not any(part.partition(".")[0] == name for part in pair))
    if len(pairs) != len(spec.no_contact):
        edits["no_contact",] = pairs or ABSENT
    found = {resolved_path(scene.loaded.path): edits}
    if scene.task is not None:
        task: dict[DataPath, Any] = {
            ("start", key, name): ABSENT
            for key in ("place", "pose", "joints")
            if name in getattr(scene.task.start, key)
        }
        if name in scene.task.reset.objects:
            task["reset", "objects", name] = ABSENT
        if task:
            found[resolved_path(scene.root.path)] = task
    return found
