"""Time-varying state of a scene: poses of objects and positions of joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Joint, JointType, Scene, SceneObject


@dataclass(frozen=True, eq=False)
class SceneState:
    """Poses ``X_WO`` of the objects by name, and joint states by ``object.joint``.

    ``joints`` are the positions [rad or m] of joints with one axis; ``motions`` are the motions of ball and free
    joints: the pose of the child's frame relative to its frame at position zero. A ball joint's motion has no
    translation.

    ``robots`` are the joint positions of each robot [rad or m], by the joint names of the object that
    :mod:`simfoundry.backends.robot_models.robot_object` makes of it; empty for the positions in the scene. ``speeds``
    [m/s] are those of the fastest point of each object; objects without an entry are at rest.
    """

    poses: Mapping[str, Pose]
    joints: Mapping[str, float]
    motions: Mapping[str, Pose] = field(default_factory=lambda: MappingProxyType({}))
    robots: Mapping[str, Mapping[str, float]] = field(default_factory=lambda: MappingProxyType({}))
    speeds: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def of(
        cls,
        poses: Mapping[str, Pose],
        joints: Mapping[str, float],
        motions: Mapping[str, Pose] | None = None,
        robots: Mapping[str, Mapping[str, float]] | None = None,
        speeds: Mapping[str, float] | None = None,
    ) -> SceneState:
        """Freeze the mappings."""
        return cls(
            MappingProxyType(dict(poses)),
            MappingProxyType(dict(joints)),
            MappingProxyType(dict(motions or {})),
            MappingProxyType({name: MappingProxyType(dict(joints)) for name, joints in (robots or {}).items()}),
            MappingProxyType(dict(speeds or {})),
        )

    @classmethod
    def initial(cls, scene: Scene) -> SceneState:
        """Return the initial state of the scene."""
        joints = {f"{o.name}.{j.name}": j for o in scene.objects for j in o.joints}
        return cls.of(
            {o.name: o.X_WO for o in scene.objects},
            {name: joint.position for name, joint in joints.items() if joint.has_axis},
            {name: joint.motion for name, joint in joints.items() if _is_free(joint)},
        )

    def of_object(self, item: SceneObject) -> dict[str, float | Pose]:
        """Positions and motions of the joints of one object, by their own names; defaults come from the scene."""
        found: dict[str, float | Pose] = {}
        for joint in item.joints:
            name = f"{item.name}.{joint.name}"
            if joint.has_axis:
                found[joint.name] = self.joints.get(name, joint.position)
            elif _is_free(joint):
                found[joint.name] = self.motions.get(name, joint.motion)
        return found


def _is_free(joint: Joint) -> bool:
    return joint.type in (JointType.BALL, JointType.FREE)


def object_at(item: SceneObject, state: SceneState) -> SceneObject:
    """Return an object at its pose and joint positions in a state, without its other variants."""
    at = state.of_object(item)
    joints = tuple(_moved(joint, at.get(joint.name)) for joint in item.joints)
    return replace(item, X_WO=state.poses[item.name], joints=joints, variants=())


def _moved(joint: Joint, to: float | Pose | None) -> Joint:
    """Return a joint with a new position or motion; None keeps it."""
    if to is None:
        return joint
    return replace(joint, motion=to) if isinstance(to, Pose) else replace(joint, position=to)
