"""Forward kinematics of an object: the poses of its links at given joint positions."""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.scene.model import Joint, JointType, SceneObject


def joint_transform(joint: Joint, position: float | Pose) -> Pose:
    """Pose of the child link in its own zero-position frame at ``position``: [rad or m], or a ball or free motion."""
    if isinstance(position, Pose):
        return position
    match joint.type:
        case JointType.PRISMATIC:
            return Pose.of(joint.axis * position)
        case JointType.REVOLUTE | JointType.CONTINUOUS:
            return Pose.about(joint.axis, position)
    return IDENTITY


def link_poses(item: SceneObject, joints: Mapping[str, float | Pose] | None = None) -> dict[str, Pose]:
    """Pose ``X_OL`` of every link in the object's frame.

    ``joints`` overrides positions [rad or m], and motions of ball and free joints, by joint name.
    """
    poses = {item.root.name: IDENTITY}
    by_child = {joint.child: joint for joint in item.joints}
    for link in item.links[1:]:
        joint = by_child[link.name]
        position: float | Pose = joint.position if joint.has_axis else joint.motion
        if joints is not None:
            position = joints.get(joint.name, position)
        poses[link.name] = poses[joint.parent] @ joint.X_PC @ joint_transform(joint, position)
    return poses
