"""Check datasets: profiles, formats, cameras, and the recipe of the pictures."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.checker import Checker
from simfoundry.spec.check.documents import check_views
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.cousins import CousinsSpec
from simfoundry.spec.models.dataset import DatasetSpec
from simfoundry.spec.models.dataset_profile import find_profile
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec

# The index in a folder of demonstrations, and its maximum size to read [bytes]; one of a few tasks takes 10 kB.
INDEX, MAX_BYTES = "demonstrations.json", 2**24


def check_dataset(c: Checker, spec: DatasetSpec) -> None:
    """Check a dataset. Demonstrations that have not been recorded yet are not an error."""
    try:
        profile = find_profile(spec.profile, c.loaded.path.parent)
    except SimfoundryError as error:
        c.add("SF106", ("profile",), str(error))
    else:
        for section, keys in (("state", spec.state or {}), ("cameras", spec.cameras or {})):
            for key in keys:
                if key in profile.actions:
                    message = f"`{key}` is the key of the actions in profile `{spec.profile}`"
                    c.add("SF104", (section, key), message, "choose another key")
    _formats(c, spec)
    check_views(c, spec.cameras or {}, "the dataset")
    _cameras(c, spec)
    _pictures(c, spec)


def _formats(c: Checker, spec: DatasetSpec) -> None:
    if spec.formats:
        formats = import_module("simfoundry.data.dataset.formats").FORMATS  # most documents leave it to the profile
        for k, name in enumerate(spec.formats):
            c.name(name, formats.names(), ("formats", k), "dataset format")


def _cameras(c: Checker, spec: DatasetSpec) -> None:
    """Check that the scenes of demonstrations that have been recorded have the cameras."""
    if not spec.cameras:
        return
    for name, source in spec.sources.items():
        if source.demonstrations is None:
            continue
        for task in _tasks(c.loaded.path.parent / source.demonstrations):
            scene = _scene(c, task, ("sources", name, "demonstrations"))
            if scene is None:
                continue
            for key, view in spec.cameras.items():
                c.name(view.camera, scene.cameras, ("cameras", key, "camera"), f"camera of scene `{scene.name}`")
            return  # one message for each camera is enough


def _tasks(folder: Path) -> Iterator[Path]:
    """Yield the documents of the tasks in a folder of demonstrations, which may be missing or damaged."""
    path = folder / INDEX
    try:
        if path.stat().st_size > MAX_BYTES:
            return
        index = json.loads(path.read_text(encoding="utf-8"))
        for facts in index.get("tasks", [index]):
            yield folder / str(facts.get("document", index.get("document")))
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return


def _scene(c: Checker, task: Path, path: tuple[str, ...]) -> SceneSpec | None:
    """Return the scene of a task, or None if it cannot be used here."""
    if not task.is_file() or not task.resolve().is_relative_to(c.loaded.root):
        return None
    reference = Path(os.path.relpath(task.resolve(), c.loaded.path.resolve().parent)).as_posix()
    used = c.use(reference, path, ("task/1",), (".task.yaml", ".yaml"))
    if used is None or not isinstance(used.spec, TaskSpec):
        return None
    scene = used.used(used.spec.scene)
    return scene.spec if scene is not None and isinstance(scene.spec, SceneSpec) else None


def _pictures(c: Checker, spec: DatasetSpec) -> None:
    """Check that the recipe of the pictures changes nothing else."""
    if spec.pictures is None:
        return
    path = ("pictures", "recipe")
    recipe = c.use(spec.pictures.recipe, path, ("cousins/1",), (".cousins.yaml", ".yaml"))
    if recipe is None or not isinstance(recipe.spec, CousinsSpec):
        return
    if spec.pictures.split is not None:
        c.name(spec.pictures.split, recipe.spec.splits, ("pictures", "split"), "split of the recipe")
    for axis in ("scene", "object", "distractors", "task"):
        if getattr(recipe.spec, axis) is not None:
            hint = "use a recipe that has only `vary`"
            c.add(
                "SF107", path, f"`{spec.pictures.recipe}` has the axis `{axis}`, which changes more than pictures", hint
            )
            return
    entry = next(_physical_entries(recipe, recipe.spec), None)
    if entry is not None:
        message = f"`{entry}` in `{spec.pictures.recipe}` changes more than pictures, so it cannot be applied on replay"
        hint = "vary only cameras, lights, colors, textures, backgrounds and instructions, or record its cousins"
        c.add("SF107", path, message, hint)


def _physical_entries(recipe: Loaded, spec: CousinsSpec) -> Iterator[str]:
    """Yield the entries of a recipe's `vary` on which the physics depends."""
    from simfoundry.spec.check.varied_fields import FieldFinder  # only for datasets whose pictures vary
    from simfoundry.spec.check.vary import varied_values

    twin = recipe.used(spec.twin)
    scene = twin.used(twin.spec.scene) if twin is not None and isinstance(twin.spec, TaskSpec) else twin
    if scene is not None and isinstance(scene.spec, SceneSpec):
        for value in varied_values(spec, FieldFinder(scene, twin), recipe)[0]:
            if value.field.effect == "physics":
                yield value.entry
