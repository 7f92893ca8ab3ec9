"""Set the positions of joints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from simfoundry.scene.model import Joint, JointType
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, scene_edits, task_edits
from simfoundry.studio.reading import StudioScene

# Decimals of a position in meters or radians, and in degrees: 0.1 mm and 0.01 deg, as for poses.
_DIGITS, _DEGREE_DIGITS = 4, 2


@dataclass(frozen=True)
class SetJoint:
    """Move a joint.

    Attributes:
        name: The object.
        joint: The joint, which has a single axis.
        position: The new position [rad or m], which is limited to what the joint allows.
    """

    name: str
    joint: str
    position: float

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"move {self.name}.{self.joint}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit of the position, in the start of the task if it states one, or in the scene."""
        joint = movable_joint(scene, self.name, self.joint)
        low, high = joint.limits or (-math.inf, math.inf)
        position = min(max(self.position, low), high)
        is_task = scene.task is not None and self.joint in scene.task.start.joints.get(self.name, {})
        path: DataPath = ("start", "joints", self.name) if is_task else ("objects", self.name, "joints")
        loaded = scene.root if is_task else scene.loaded
        assert loaded.document is not None
        old: Any = loaded.document.data
        for part in (*path, self.joint):
            old = old.get(part) if isinstance(old, dict) else None
        edits = {(*path, self.joint): _written(joint, position, old)}
        return task_edits(scene, edits) if is_task else scene_edits(scene, edits)


def movable_joint(scene: StudioScene, name: str, joint: str) -> Joint:
    """Return a joint with a single axis that follows no other.

    Raises:
        ActError: If there is no such joint.
    """
    require_object(scene, name)
    found = {j.name: j for j in movable_joints(scene, name)}
    if joint not in found:
        known = f"; it has {', '.join(found)}" if found else ""
        raise ActError(f"`{name}` has no joint `{joint}` that can be moved{known}")
    return found[joint]


def movable_joints(scene: StudioScene, name: str) -> tuple[Joint, ...]:
    """Return the joints of an object that have a single axis and follow no other."""
    return tuple(j for j in scene.objects[name].joints if j.has_axis and j.mimic is None)


def _written(joint: Joint, position: float, old: Any) -> Any:
    """Return a position as data: in degrees for a rotation, unless it was written in radians."""
    if joint.type is not JointType.PRISMATIC and (old is None or isinstance(old, dict)):
        return {"deg": round(math.degrees(position), _DEGREE_DIGITS) + 0.0}
    return round(position, _DIGITS) + 0.0
