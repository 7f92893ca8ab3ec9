"""Keep a state that physics has reached as the new poses and joint positions of the document."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.drop import drop_onto
from simfoundry.scene.model import JointType, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.state import STILL, SceneState, pose_spec
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.yaml.write import to_data
from simfoundry.studio.acts.act import ActEdits, ActError, scene_edits
from simfoundry.studio.acts.joints import SetJoint, movable_joints
from simfoundry.studio.acts.placement import written_pose
from simfoundry.studio.reading import StudioScene

# Motion [m, rad] below which an object stays as it is written: engines let objects sink into their soft contacts by
# some tenths of a millimeter, which says nothing about the scene.
SUNK_M, SUNK_RAD = 5e-4, 2e-3


@dataclass(frozen=True, eq=False)
class KeepState:
    """Write the poses and joint positions of a state into the document.

    Attributes:
        state: The state.
        reason: What led to it, which names the step in the history.
    """

    state: SceneState
    reason: str = "settle"

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"{self.reason} and keep"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of all objects that have moved, each in the way in which the document states its pose."""
        if set(self.state.poses) != set(scene.objects):
            raise ActError("the objects of the document have changed since physics was started; start it again")
        moved = [item for item in scene.scene.objects if not item.fixed and self._has_moved(item)]
        placed: dict[str, SceneObject] = dict(scene.objects)
        placed |= {item.name: replace(item, X_WO=self.state.poses[item.name]) for item in moved}
        shapes = {**scene.draft.shapes}
        shapes |= {item.name: hulls(item, X_WO=placed[item.name].X_WO) for item in moved if item.name in shapes}
        values: dict[Any, dict[DataPath, Any]] = {}
        for item in moved:
            support = None
            if item.name in shapes:
                support = drop_onto(shapes[item.name], {n: each for n, each in shapes.items() if n != item.name})
            _add(values, written_pose(scene, item.name, placed[item.name].X_WO, placed, support))
        for name, joint in self._moved_joints(scene):
            _add(values, SetJoint(name, joint, self.state.joints[f"{name}.{joint}"]).edits(scene))
        for name, joint, motion in self._moved_motions(scene):
            _add(values, scene_edits(scene, {("objects", name, "joints", joint): motion}))
        return ActEdits(values)

    def _has_moved(self, item: SceneObject) -> bool:
        X_WO = self.state.poses[item.name]
        return float(np.abs(X_WO.p - item.X_WO.p).max()) > SUNK_M or X_WO.angle_to(item.X_WO) > SUNK_RAD

    def _moved_joints(self, scene: StudioScene) -> Iterator[tuple[str, str]]:
        """Yield the object and the name of each joint with a single axis that has moved."""
        for name, item in scene.objects.items():
            for joint in movable_joints(scene, name):
                position = self.state.joints.get(f"{item.name}.{joint.name}", joint.position)
                if abs(position - joint.position) > STILL:
                    yield name, joint.name

    def _moved_motions(self, scene: StudioScene) -> Iterator[tuple[str, str, Any]]:
        """Yield the object, the name and the new value of each ball or free joint that has moved."""
        for item in scene.scene.objects:
            for joint in item.joints:
                motion = self.state.motions.get(f"{item.name}.{joint.name}")
                if motion is not None and _differ(motion, joint.motion):
                    data = dict(to_data(pose_spec(motion)))
                    if joint.type is JointType.BALL:
                        data.pop("xyz", None)
                    yield item.name, joint.name, data


def _add(values: dict[Any, dict[DataPath, Any]], edits: ActEdits) -> None:
    for path, more in edits.values.items():
        values.setdefault(path, {}).update(more)


def _differ(a: Pose, b: Pose) -> bool:
    return float(np.linalg.norm(a.p - b.p)) > STILL or a.angle_to(b) > STILL
