"""The time-varying state of a scene (object poses and joint positions), which is read from and written to documents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from simfoundry.geometry.frames import Pose, quat_from_rpy, rpy_from_quat
from simfoundry.scene.model import Joint, JointType, Scene, SceneObject
from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import SceneSpec


@dataclass(frozen=True, eq=False)
class SceneState:
    """The state of a scene at one point in time.

    Attributes:
        poses: The pose ``X_WO`` of each object, keyed by object name.
        joints: The positions of single-axis joints [rad or m], keyed by ``object.joint``.
        motions: The motions of ball and free joints, keyed by ``object.joint``. A motion is the pose of the child's
            frame relative to its pose at position zero. For a ball joint, it has no translation.
        robots: The joint positions of each robot [rad or m], keyed by the joint names of the object that
            :mod:`simfoundry.backends.robot_models.robot_object` creates from the robot. If empty, the positions in the
            scene are used.
        speeds: The speed of the fastest point on each object [m/s]. Objects without an entry are at rest.
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
        """Return a state that contains immutable copies of the mappings."""
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
        positions = {name: joint.position for name, joint in joints.items() if joint.has_axis}
        motions = {name: joint.motion for name, joint in joints.items() if _is_free(joint)}
        return cls.of({o.name: o.X_WO for o in scene.objects}, positions, motions)

    def of_object(self, item: SceneObject) -> dict[str, float | Pose]:
        """Return the positions and motions of an object's joints, keyed by joint name.

        Missing values are taken from the scene.
        """
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
    """Return a copy of an object with its pose and joint positions taken from a state. Other variants are omitted."""
    at, joints = state.of_object(item), []
    for joint in item.joints:
        to = at.get(joint.name, joint.position)
        joints.append(replace(joint, motion=to) if isinstance(to, Pose) else replace(joint, position=to))
    return replace(item, X_WO=state.poses[item.name], joints=tuple(joints), variants=())


# Maximum tilt of a body that is written as upright; it moves the rim of a 20 cm plate by less than 0.1 mm.
UPRIGHT_DEG = 0.05

# Maximum motion at which a joint keeps the position in the document [rad or m].
STILL = 1e-4


def pose(spec: PoseSpec) -> Pose:
    """Convert a pose in a document to a rigid transform."""
    if spec.quat_wxyz is not None:
        return Pose.of(spec.xyz, spec.quat_wxyz)
    if spec.rpy_deg is None and spec.yaw_deg is None:
        return Pose.of(spec.xyz)
    roll, pitch, yaw = spec.rpy_deg or (0.0, 0.0, spec.yaw_deg or 0.0)
    return Pose.of(spec.xyz, quat_from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw)))


def pose_spec(X_WO: Pose) -> FramedPose:
    """Convert a pose to a form that is easy to read.

    The position is rounded to 0.1 mm. The rotation is specified by yaw if the pose is upright, and otherwise by roll,
    pitch and yaw.
    """
    x, y, z = (round(float(v), 4) + 0.0 for v in X_WO.p)
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, float(X_WO.rotation[2, 2])))))
    if tilt >= UPRIGHT_DEG:
        return FramedPose(xyz=(x, y, z), rpy_deg=_rpy_deg(X_WO))
    yaw = _rpy_deg(X_WO)[2]
    return FramedPose(xyz=(x, y, z), yaw_deg=yaw) if yaw else FramedPose(xyz=(x, y, z))


def _rpy_deg(pose: Pose) -> tuple[float, float, float]:
    """Return the roll, pitch and yaw of a pose in degrees, rounded to two decimals."""
    roll, pitch, yaw = (round(math.degrees(v), 2) + 0.0 for v in rpy_from_quat(pose.q))
    return roll, pitch, yaw


def with_state(spec: SceneSpec, scene: Scene, state: SceneState) -> SceneSpec:
    """Return the spec for ``scene`` with the state applied.

    The poses of free objects and the positions of joints that moved are taken from ``state``.
    """
    moved = with_poses(spec, state.poses)
    objects = dict(moved.objects)
    for item in scene.objects:
        joints = dict(objects[item.name].joints)
        for joint in item.joints:
            motion = state.motions.get(f"{item.name}.{joint.name}", joint.motion)
            if joint.mimic is not None:
                continue  # its leader determines its position
            if float(np.linalg.norm(motion.p - joint.motion.p)) > STILL or motion.angle_to(joint.motion) > STILL:
                is_ball = joint.type is JointType.BALL
                joints[joint.name] = PoseSpec(rpy_deg=_rpy_deg(motion)) if is_ball else pose_spec(motion)
            position = state.joints.get(f"{item.name}.{joint.name}", joint.position)
            if abs(position - joint.position) > STILL:
                low, high = joint.limits or (-math.inf, math.inf)  # engines enforce limits softly
                joints[joint.name] = min(max(round(position, 4) + 0.0, low), high)
        if joints != objects[item.name].joints:
            objects[item.name] = objects[item.name].model_copy(update={"joints": joints})
    return moved.model_copy(update={"objects": objects})


def with_poses(spec: SceneSpec, poses: Mapping[str, Pose]) -> SceneSpec:
    """Return the spec with new poses for objects that are not fixed. They replace the previous poses and placements."""
    objects = dict(spec.objects)
    for name, item in spec.objects.items():
        if name in poses and not item.fixed:
            objects[name] = item.model_copy(update={"pose": pose_spec(poses[name]), "place": None})
    return spec.model_copy(update={"objects": objects})
