"""Remove objects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.state import pose_spec
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.yaml.write import to_data
from simfoundry.studio.acts.act import ActEdits, require_object
from simfoundry.studio.acts.carry import rest_below
from simfoundry.studio.acts.placement import pose_source, written_pose
from simfoundry.studio.acts.references import without_object
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class RemoveObject:
    """Remove an object, the relations that name it, and its entries in the task. What stands on it falls."""

    name: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"remove {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits that remove it."""
        require_object(scene, self.name)
        values: dict[Any, dict[DataPath, Any]] = {}
        for path, edits in without_object(scene, self.name).items():
            values.setdefault(path, {}).update(edits)
        left = {name: item for name, item in scene.objects.items() if name != self.name}
        for name in _placed_on(scene, self.name):
            shape = scene.draft.shapes.get(name)
            rest = rest_below(scene, shape, {self.name, name}) if shape is not None else None
            X_WO = scene.objects[name].X_WO
            if rest is not None:
                X_WO = Pose.of(X_WO.p + np.array([0.0, 0.0, rest.lift]), X_WO.q)
            source = pose_source(scene, name)
            moved = replace(scene.objects[name], X_WO=X_WO)
            if rest is None or source.key == "pose":
                found = source.edits(scene, name, "pose", to_data(pose_spec(X_WO)))
            else:
                found = written_pose(scene, name, X_WO, {**left, name: moved}, rest)
            for path, changes in found.values.items():
                values.setdefault(path, {}).update(changes)
        return ActEdits(values)


def _placed_on(scene: StudioScene, name: str) -> Iterator[str]:
    """Yield the objects whose place or frame refers to an object."""
    for other, spec in scene.draft.spec.objects.items():
        place = spec.place
        named = [spec.pose.frame] if place is None else [
            place.on, place.inside, place.frame, place.left_of, place.right_of, place.in_front_of, place.behind
        ]  # fmt: skip
        if other != name and any(each is not None and each.partition(".")[0] == name for each in named):
            yield other
