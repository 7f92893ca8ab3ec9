"""The motion of the links of an object by one of its joints."""

from __future__ import annotations

from dataclasses import dataclass

from simfoundry.evaluate.expert.worker import FailedError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, SceneObject
from simfoundry.scene.state import SceneState


def joint_of(item: SceneObject, name: str) -> Joint:
    """Return the joint with the given name, or the joint that moves the link with that name.

    If the name is empty, the first movable joint of the object is returned.
    """
    for joint in item.joints:
        if joint.has_axis and name in ("", joint.name, joint.child):
            return joint
    raise FailedError(f"{item.name} has no movable joint {name}")


@dataclass(frozen=True, eq=False)
class DrivenJoint:
    """A joint of an object in a given state, and the motions of the links that it moves."""

    item: SceneObject
    state: SceneState
    joint: Joint

    @property
    def ends(self) -> tuple[float, float]:
        """The closed position and the fully open position of the joint [rad or m].

        The closed position is closer to zero.
        """
        if self.joint.limits is None:
            raise FailedError(f"joint {self.joint.name} has no limits, so it cannot be opened or closed")
        low, high = self.joint.limits
        return (low, high) if abs(low) <= abs(high) else (high, low)

    @property
    def now(self) -> float:
        """The current position of the joint [rad or m]."""
        return self.state.joints[f"{self.item.name}.{self.joint.name}"]

    def motion(self, then: float) -> Pose:
        """Return the motion of the joint's child link in the world when the joint moves to ``then`` [rad or m]."""
        X_WO, joints = self.state.poses[self.item.name], self.state.of_object(self.item)
        X_OC, X_OD = (link_poses(self.item, {**joints, self.joint.name: q})[self.joint.child] for q in (self.now, then))
        return X_WO @ X_OD @ X_OC.inverse() @ X_WO.inverse()

    @property
    def axis(self) -> tuple[Array, Array]:
        """A point on the axis of the joint [m] and the direction of the axis in the world, each of shape (3,)."""
        X_OC = link_poses(self.item, self.state.of_object(self.item))[self.joint.child]
        X_WC = self.state.poses[self.item.name] @ X_OC
        return X_WC.p, X_WC.rotation @ self.joint.axis
