"""Duplicate objects, as copies of a `repeat` where it fits."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.object_shapes import hulls
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.flatten import own_data
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import to_data
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, scene_edits
from simfoundry.studio.acts.add import FREE_M
from simfoundry.studio.acts.carry import rest_below
from simfoundry.studio.acts.placement import written_pose
from simfoundry.studio.acts.references import references
from simfoundry.studio.reading import StudioScene

# Maximum number of copies at once; more are better written as a grid in the text.
MAX_NEW = 200


@dataclass(frozen=True)
class DuplicateObject:
    """Duplicate an object.

    A copy of a row becomes one more copy of it. Several copies become a `repeat` if nothing refers to the object by
    name; otherwise, and for one copy of an object, each copy is an entry of its own.

    Attributes:
        name: The object.
        count: The number of new copies.
        step: The distance [m] between copies along x and y; by default, next to each other along y.
    """

    name: str
    count: int = 1
    step: tuple[float, float] | None = None

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"duplicate {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits that add the copies."""
        require_object(scene, self.name)
        if not 1 <= self.count <= MAX_NEW:
            raise ActError(f"choose between 1 and {MAX_NEW} copies")
        longer = self._longer_row(scene)
        if longer is not None:
            return longer
        low, high = scene.draft.bounds.get(self.name, (np.zeros(3), np.zeros(3)))
        step = self.step or (0.0, round(float(high[1] - low[1]) + FREE_M, 2))
        entry = _entry(scene, self.name)
        if self.count > 1 and entry is not None and not references(scene, self.name):
            repeat = {"count": self.count + 1, "step": step if step[1] else step[0]}
            return scene_edits(scene, {("objects", self.name, "repeat"): repeat})
        data = dict(entry if entry is not None else _flat(scene, self.name))
        edits: dict[DataPath, Any] = {}
        item, taken = scene.objects[self.name], set(scene.spec.objects)
        for k in range(1, self.count + 1):
            new = _free_name(self.name, taken)
            taken.add(new)
            X_WO = Pose.of(item.X_WO.p + np.array([step[0] * k, step[1] * k, 0.0]), item.X_WO.q)
            edits["objects", new] = data | self._pose(scene, X_WO, data)
        return scene_edits(scene, {path: _without_pose(value) for path, value in edits.items()})

    def _pose(self, scene: StudioScene, X_WO: Pose, written: Mapping[str, Any]) -> dict[str, Any]:
        """Return the place or the pose of a copy, in the form of that of the object, which is ``written`` so."""
        placed = {**scene.objects, self.name: replace(scene.objects[self.name], X_WO=X_WO)}
        rest = rest_below(scene, hulls(scene.objects[self.name], X_WO=X_WO), {self.name})
        edits = written_pose(scene, self.name, X_WO, placed, rest)
        found: dict[str, Any] = {"place": ABSENT, "pose": ABSENT}
        for values in edits.values.values():
            for path, value in values.items():
                key = "place" if "place" in path else "pose"
                before = to_data(scene.spec.objects[self.name]).get(key)
                found[key] = own_data(written[key], before, value) if key in written else value
        return found

    def _longer_row(self, scene: StudioScene) -> ActEdits | None:
        """Return the edit that adds copies to the row that the object is one of, or None if it is not in a row."""
        reuse = scene.loaded.reuse
        group = next((each for each in reuse.groups.values() if each.has(self.name)), None) if reuse else None
        if group is None or reuse is None:
            return None
        entry = _written(scene, group.root)
        repeat = entry.get("repeat") if isinstance(entry, dict) else None
        if not isinstance(repeat, dict) or not isinstance(repeat.get("count"), int):
            return None
        # The entry is edited as it is written, because the copies are all that is left of it in the composed document.
        return scene_edits(scene, {("objects", group.root, "repeat", "count"): repeat["count"] + self.count})


def _written(scene: StudioScene, name: str) -> Any:
    """Return the entry of an object in the scene document itself, or None if it has none."""
    assert scene.loaded.source is not None
    data = parse(scene.loaded.source.text).data
    objects = data.get("objects") if isinstance(data, dict) else None
    return objects.get(name) if isinstance(objects, dict) else None


def _entry(scene: StudioScene, name: str) -> Mapping[str, Any] | None:
    """Return the whole entry of an object that the scene document itself defines, or None."""
    written = _written(scene, name)
    reuse = scene.loaded.reuse
    is_generated = reuse is not None and ("objects", name) in reuse.generated
    if not isinstance(written, dict) or is_generated or scene.loaded.bases:
        return None
    return written


def _flat(scene: StudioScene, name: str) -> Mapping[str, Any]:
    """Return the plain data of an object, with everything that it inherits."""
    return {key: value for key, value in to_data(scene.spec.objects[name]).items() if key not in ("like", "repeat")}


def _free_name(name: str, taken: set[str]) -> str:
    """Return a name such as ``mug_2`` that is not taken."""
    stem = re.sub(r"_[0-9]+\Z", "", name)
    return next(new for k in range(2, len(taken) + 3) if (new := f"{stem}_{k}") not in taken)


def _without_pose(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a copy without those that are absent."""
    return {key: value for key, value in data.items() if value is not ABSENT}
