"""The JSON files next to the URDFs.

``poses.json`` contains poses, and ``physics.json`` contains all other properties.
"""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.backends.artifact import json_text, rounded, rounded_list
from simfoundry.backends.robot_models.robot_object import RobotUrdf
from simfoundry.backends.urdf.elements import Split
from simfoundry.geometry.frames import Pose
from simfoundry.scene.kinematics import Tree, excluded_link_pairs, trees
from simfoundry.scene.model import Drive, Joint, JointType, Link, Mimic, Scene, SceneObject

# Position error [rad or m] at which a servo added to a robot's own URDF reaches its maximum force. At a reach of 0.8 m,
# 5 mrad correspond to 4 mm, the repeatability of arms of this size under load.
_SERVO_ERROR = 0.005

# Time in which an added servo corrects an error [s], which is slow enough for light links not to overshoot.
_SERVO_TIME = 0.05


def physics_manifest(scene: Scene, split: Split, robots: Mapping[str, RobotUrdf]) -> bytes:
    """Return ``physics.json``, which lists collision shapes with the same names and in the same order as the URDF.

    Converted robots are described in the same way as objects. For robots with their own URDF, only motors and mimic
    joints that are missing from the URDF are included.
    """
    own = {name: _robot(robot) for name, robot in robots.items() if robot.item is None}
    items = [*scene.objects, *(robot.item for robot in robots.values() if robot.item is not None)]
    data: dict[str, object] = {
        "gravity": rounded_list(scene.gravity),
        "objects": {tree.name: _physics(tree, split) for item in items for tree in trees(item)},
    }
    if excluded := excluded_between(scene):
        data["no_contact"] = excluded
    if own:
        data["robots"] = own
    return json_text(data)


def excluded_between(scene: Scene) -> list[list[list[str]]]:
    """Return the pairs of links in different bodies that do not collide.

    Each link is identified by two names, that of its body and that of the link.
    """
    parts = [tree for item in scene.objects for tree in trees(item)]
    home = {tree.owner.qualified(link.name): [tree.name, link.name] for tree in parts for link in tree.links}
    own = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in o.no_contact]
    pairs = ((home[a], home[b]) for a, b in (*own, *scene.no_contact))
    return [[a, b] for a, b in pairs if a[0] != b[0]]


def excluded_within(tree: Tree) -> list[list[str]]:
    """Return the pairs of links in the same body that do not collide."""
    names = {link.name for link in tree.links}
    return [list(pair) for pair in excluded_link_pairs(tree.owner) if names.issuperset(pair)]


def _physics(tree: Tree, split: Split) -> dict[str, object]:
    joints = {joint.name: _joint(joint) for joint in tree.joints if joint.type is not JointType.FIXED}
    links = {link.name: _surfaces(link, split) for link in tree.links}
    return {"links": links, "joints": joints, "silent": excluded_within(tree)}


def _joint(joint: Joint) -> dict[str, object]:
    passive = {"friction": rounded(joint.friction), "armature": rounded(joint.armature)}
    return passive | ({"drive": drive_data(joint.drive)} if joint.drive is not None else {})


def drive_data(drive: Drive) -> dict[str, float]:
    """Return the stiffness, damping and target of a drive, along with its ``force_limit`` if it has one.

    The force is ``stiffness * (target - position) - damping * velocity``.
    """
    gains = {"stiffness": drive.stiffness, "damping": drive.damping, "target": drive.target}
    limit = {} if drive.force_limit is None else {"force_limit": drive.force_limit}
    return {key: rounded(value) for key, value in (gains | limit).items()}


def mimic_data(leader: Mimic) -> dict[str, object]:
    """Return the name of the joint that a mimic joint follows, along with the ratio and the offset."""
    return {"joint": leader.joint, "multiplier": rounded(leader.multiplier), "offset": rounded(leader.offset)}


def pose_data(pose: Pose) -> dict[str, object]:
    """Return the position [m] and the wxyz quaternion of a pose."""
    return {"p": rounded_list(pose.p), "q_wxyz": rounded_list(pose.q)}


def _robot(robot: RobotUrdf) -> dict[str, object]:
    """Return the motors of a robot with its own URDF, in which the maximum forces are specified."""
    motors = {
        name: drive_data(Drive(force / _SERVO_ERROR, _SERVO_TIME * force / _SERVO_ERROR, robot.positions[name], force))
        for name, force in robot.efforts.items()
        if name not in robot.follow
    }
    return {"motors": motors, "follow": {name: mimic_data(leader) for name, leader in robot.follow.items()}}


def _surfaces(link: Link, split: Split) -> dict[str, dict[str, float]]:
    return {
        c.name + suffix: {"friction": rounded(c.friction), "restitution": rounded(c.restitution)}
        for c in link.colliders
        for suffix, _, _ in split(c.geometry)
    }


def placement(tree: Tree) -> dict[str, object]:
    """Return the placement of a part of an object.

    This consists of the pose, the fixed flag, the joint positions, and the limits at which the joints are closed.
    """
    closed = {j.name: j.closed for j in tree.joints if j.closed is not None}
    joints = {j.name: rounded(j.position) for j in tree.joints if j.has_axis}
    placed = {"fixed": tree.fixed, **pose_data(tree.X_WT), "joints": joints}
    return placed | ({"closed": closed} if closed else {})


def robot_placement(robot: RobotUrdf) -> dict[str, object]:
    """Return a robot's base pose and joint positions in the format used for fixed objects."""
    joints = {name: rounded(position) for name, position in robot.positions.items()}
    return {"urdf": robot.path, "category": "robot", "fixed": True, **pose_data(robot.X_WB), "joints": joints}


def poses_entry(tree: Tree) -> dict[str, object]:
    """Return the ``poses.json`` entry for an object part, including the free joint of a freely moving part."""
    entry = {"urdf": f"{tree.name}.urdf"} | semantics(tree.owner) | placement(tree)
    joint = tree.free_joint
    if joint is None:
        return entry
    zero, motion = ([*rounded_list(X.p), *rounded_list(X.q)] for X in (joint.X_PC, joint.motion))
    free = {"object": tree.owner.name, "joint": joint.name, "parent": joint.parent, "zero": zero, "motion": motion}
    return entry | {"free": free}


def semantics(item: SceneObject) -> dict[str, object]:
    """Return the category of an object and its labels, if any."""
    return {"category": item.category} | ({"labels": list(item.labels)} if item.labels else {})
