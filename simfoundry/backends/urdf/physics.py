"""``physics.json``: what URDF has no place for and its simulators can hold, as gravity, surfaces and motors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from simfoundry.backends.artifact import json_text, rounded
from simfoundry.backends.robot_models.robot_urdf import RobotUrdf
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Geometry
from simfoundry.scene.model import Drive, Joint, JointType, Link, Scene
from simfoundry.scene.touching import silent_pairs
from simfoundry.scene.trees import Tree, trees


class Split(Protocol):
    """Splits a geometry into the parts that are written, each with a suffix for its name."""

    def __call__(self, geometry: Geometry, /) -> Iterator[tuple[str, Geometry, Pose]]:
        """The parts in the order of the file."""
        ...


SERVO_ERROR = 0.005
"""A servo that we add to a joint of a robot's own URDF gives all its force at this error [rad or m]."""

SERVO_TIME = 0.05
"""Within which it closes an error [s]: what its links weigh is too little to let it overshoot."""


def physics_manifest(scene: Scene, split: Split, robots: Iterable[tuple[str, RobotUrdf]] = ()) -> bytes:
    """The file; collision shapes go by the names and in the order of the URDF.

    ``robots`` are by name. One that was converted is told like an object; of one with a URDF of its own there is
    nothing to add but motors, and which joints follow others beyond what the URDF says.
    """
    own = {name: robot for name, robot in robots if robot.item is None}
    items = [*scene.objects, *(robot.item for _, robot in robots if robot.item is not None)]
    data: dict[str, object] = {
        "gravity": [rounded(v) for v in scene.gravity],
        "objects": {tree.name: _object(tree, split) for item in items for tree in trees(item)},
    }
    parts = [tree for item in scene.objects for tree in trees(item)]
    if between := silent_between(scene, parts):
        data["no_contact"] = between
    if own:
        data["robots"] = {name: _robot(robot) for name, robot in own.items()}
    return json_text(data)


def silent_between(scene: Scene, parts: Iterable[Tree]) -> list[list[list[str]]]:
    """Pairs of links of different bodies that do not touch, each link as its body and its own name."""
    home = {tree.owner.qualified(link.name): [tree.name, link.name] for tree in parts for link in tree.links}
    own = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in o.no_contact]
    pairs = ((home[a], home[b]) for a, b in (*own, *scene.no_contact))
    return [[a, b] for a, b in pairs if a[0] != b[0]]


def _object(tree: Tree, split: Split) -> dict[str, object]:
    """What one URDF lacks: an object, or a part of one that moves freely."""
    joints = {joint.name: _joint(joint) for joint in tree.joints if joint.type is not JointType.FIXED}
    links = {link.name: _surfaces(link, split) for link in tree.links}
    silent = [list(pair) for pair in silent_pairs(tree.owner) if links.keys() >= set(pair)]
    return {"links": links, "joints": joints, "silent": silent}


def _joint(joint: Joint) -> dict[str, object]:
    rest = {"friction": rounded(joint.friction), "armature": rounded(joint.armature)}
    return rest | ({"drive": _drive(joint.drive)} if joint.drive is not None else {})


def _drive(drive: Drive) -> dict[str, float]:
    """A motor: ``stiffness * (target - position) - damping * velocity``, up to ``force_limit`` where there is one."""
    gains = {"stiffness": drive.stiffness, "damping": drive.damping, "target": drive.target}
    limit = {} if drive.force_limit is None else {"force_limit": drive.force_limit}
    return {key: rounded(value) for key, value in (gains | limit).items()}


def _robot(robot: RobotUrdf) -> dict[str, object]:
    """A robot with a URDF of its own, which says how strong its motors are and no more."""
    motors = {
        name: _drive(Drive(force / SERVO_ERROR, SERVO_TIME * force / SERVO_ERROR, robot.positions[name], force))
        for name, force in robot.efforts.items()
        if name not in robot.follow
    }
    follow = {
        name: {"joint": leader.joint, "multiplier": rounded(leader.multiplier), "offset": rounded(leader.offset)}
        for name, leader in robot.follow.items()
    }
    return {"motors": motors, "follow": follow}


def _surfaces(link: Link, split: Split) -> dict[str, dict[str, float]]:
    return {
        collider.name + suffix: {
            "friction": rounded(collider.friction),
            "restitution": rounded(collider.restitution),
        }
        for collider in link.colliders
        for suffix, _, _ in split(collider.geometry)
    }
