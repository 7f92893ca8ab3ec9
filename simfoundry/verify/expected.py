"""The read-back that an engine should return for a scene, derived from the lowered scene and its robot models.

An engine reports a robot like an object, link by link. Only the quantities that the robot's model and the scene
determine for every target are compared: base pose, total mass, joint positions and joint limits.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from simfoundry.backends.convex_hulls import REPLACED, with_hulls
from simfoundry.backends.light_links import with_light_links
from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.backends.urdf.elements import capsule_parts
from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.scene.kinematics import excluded_link_pairs, link_poses, weld_groups
from simfoundry.scene.model import Collider, Joint, JointType, Link, Scene, SceneObject, pair_friction
from simfoundry.scene.object_shapes import geometry_bounds
from simfoundry.scene.robot import ModelFormat, NativeModel, Robot, mujoco_model
from simfoundry.verify import readback as rb
from simfoundry.verify.readback import JointReadback, LinkReadback, WorldReadback, numbers, pair_name, pose_numbers

# Targets that write a capsule as a cylinder and two spheres, which together have the same shape.
SPLIT_CAPSULES = ("urdf",)

# Targets in which the force limit of a drive is the effort limit of its joint.
_EFFORT_OF_DRIVES = ("urdf", "pybullet")

# Targets in which a joint has one axis, so that light links connect the axes of a joint with several.
_LIGHT_LINKS = ("urdf", "pybullet", "usd")

# Joint types that are not reported; a free joint is represented by the parent and pose of its link.
_NO_JOINT = (JointType.FIXED, JointType.FREE)


def expected_readback(scene: Scene, target: str) -> WorldReadback:
    """Return the expected read-back for ``scene`` in ``target``.

    It contains all pairs of colliders that have different friction coefficients. Colliders that the target writes as
    convex hulls are expected as such.
    """
    scene = with_hulls(scene, REPLACED.get(target, ()))
    links: dict[str, LinkReadback] = {}
    joints: dict[str, JointReadback] = {}
    if target in _LIGHT_LINKS:
        scene = with_light_links(scene)
    for item in scene.objects:
        X_OL = link_poses(item)
        for link in item.links:
            X_WL = item.X_WO @ X_OL[link.name]
            links[item.qualified(link.name)] = _link(X_WL, link, _held_by(item, link), target)
        joints |= {f"{item.name}.{j.name}": _joint(item, j, target) for j in item.joints if j.type not in _NO_JOINT}
    return WorldReadback(links, joints, numbers(scene.gravity), dict(_pairs(scene)), tuple(_silent(scene)))


def static_links(scene: Scene) -> set[str]:
    """Return the qualified names of links that can never move. The mass of these links has no effect."""
    return {item.qualified(link) for item in scene.objects for link in _held(item)}


def _held(item: SceneObject) -> set[str]:
    """Return the names of an object's links that are welded to the world."""
    return {link for link, first in weld_groups(item).items() if item.fixed and first == item.root.name}


def _held_by(item: SceneObject, link: Link) -> str:
    above = item.joints_above.get(link.name)
    if above is None:
        return rb.WORLD if item.fixed else rb.FREE
    return rb.FREE if above[0].type is JointType.FREE else item.qualified(above[0].parent)


def _link(X_WL: Pose, link: Link, held: str, target: str) -> LinkReadback:
    colliders = tuple(part for collider in link.colliders for part in _collider(collider, target))
    mass = (link.mass, numbers(link.com), numbers(link.inertia))
    return LinkReadback(pose_numbers(X_WL), *mass, held, colliders, link.gravity_compensation)


def _collider(collider: Collider, target: str) -> Iterator[rb.ColliderReadback]:
    surface = (collider.friction, collider.restitution, collider.torsional_friction, collider.rolling_friction)
    whole = [("", collider.geometry, IDENTITY)]
    for suffix, geometry, X_GP in capsule_parts(collider.geometry) if target in SPLIT_CAPSULES else whole:
        bounds = numbers(geometry_bounds(geometry, collider.X_LG @ X_GP))
        yield rb.ColliderReadback(collider.name + suffix, type(geometry).__name__.lower(), bounds, *surface)


def _joint(item: SceneObject, joint: Joint, target: str) -> JointReadback:
    limited = joint.limits is not None and joint.type is not JointType.CONTINUOUS
    mimic, drive, effort = joint.mimic, joint.drive, joint.effort
    if effort is None and drive is not None and target in _EFFORT_OF_DRIVES:
        effort = drive.force_limit
    return JointReadback(
        type="revolute" if joint.type is JointType.CONTINUOUS else joint.type.value,
        axis=numbers(joint.axis / np.linalg.norm(joint.axis)) if joint.has_axis else None,
        limits=numbers(joint.limits) if limited else (),
        damping=joint.damping,
        friction=joint.friction,
        armature=joint.armature,
        position=joint.position if joint.has_axis else numbers(joint.motion.q),
        follows=f"{item.name}.{mimic.joint}" if mimic is not None else "",
        law=(mimic.multiplier, mimic.offset) if mimic is not None else (),
        drive=(drive.stiffness, drive.damping, drive.target) if drive is not None else (),
        effort=() if drive is None or drive.force_limit is None else (drive.force_limit,),
        max_effort=() if effort is None else (effort,),
        max_velocity=() if joint.velocity is None else (joint.velocity,),
    )


def _silent(scene: Scene) -> Iterator[str]:
    """Yield the pairs of links whose collisions are disabled: pairs listed in the spec, plus neighboring links."""
    static = static_links(scene)
    felt = {o.qualified(k.name) for o in scene.objects for k in o.links if k.colliders}
    pairs = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in excluded_link_pairs(o)]
    for a, b in (*pairs, *scene.no_contact):
        if felt >= {a, b} and not static >= {a, b}:
            yield pair_name(a, b)


def _pairs(scene: Scene) -> Iterator[tuple[str, float]]:
    """Yield the name and the friction coefficient of each relevant pair of colliders.

    The colliders of such a pair belong to different objects, can touch, and have different friction coefficients.
    """
    excluded = {frozenset(pair) for pair in scene.no_contact}
    by_friction: dict[float, list[tuple[str, str, bool]]] = {}
    for item in scene.objects:
        held = _held(item)
        for link in item.links:
            for collider in link.colliders:
                entry = (f"{item.qualified(link.name)}.{collider.name}", item.name, link.name in held)
                by_friction.setdefault(collider.friction, []).append(entry)
    for (mu_a, ours), (mu_b, theirs) in combinations(by_friction.items(), 2):
        mu = pair_friction(mu_a, mu_b)
        for (a, owner_a, held_a), (b, owner_b, held_b) in product(ours, theirs):
            silent = excluded and frozenset((a.rpartition(".")[0], b.rpartition(".")[0])) in excluded
            if owner_a != owner_b and not (held_a and held_b) and not silent and not math.isnan(mu):
                yield pair_name(a, b), mu


# The robot model formats that each target accepts, in order of preference.
_READS = {"mjcf": (ModelFormat.MJCF, ModelFormat.URDF), "usd": (ModelFormat.USD, ModelFormat.MJCF, ModelFormat.URDF)}
_OTHERS = (ModelFormat.URDF, ModelFormat.MJCF)

_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class RobotReadback:
    """A robot, as reported by an engine. None means that a value is not reported.

    Attributes:
        pose: The pose of the base link in the world.
        mass: The total mass [kg].
        joints: The joints by name. Only the limits and the position of each joint are compared.
        actuators: The names of the motors.
    """

    pose: rb.Numbers | None
    mass: float | None
    joints: Mapping[str, JointReadback]
    actuators: tuple[str, ...] | None = None


def expected_robots(scene: Scene, target: str) -> dict[str, RobotReadback | None]:
    """Return the expected values for each robot in ``target``, or None for a robot without a readable model."""
    return {robot.name: _expected(robot, target) for robot in scene.robots}


def without_robots(facts: WorldReadback, names: Iterable[str]) -> tuple[WorldReadback, dict[str, RobotReadback]]:
    """Split a read-back into the data of all objects and the data of each robot that is present."""
    robots = [name for name in names if any(_of(link, name) for link in facts.links)]

    def is_ours(name: str) -> bool:
        return not any(_of(end, robot) for end in name.split("|") for robot in robots)

    ours = replace(
        facts,
        links={name: link for name, link in facts.links.items() if is_ours(name)},
        joints={name: joint for name, joint in facts.joints.items() if is_ours(name)},
        silent=None if facts.silent is None else tuple(filter(is_ours, facts.silent)),
        pairs=None if facts.pairs is None else {pair: mu for pair, mu in facts.pairs.items() if is_ours(pair)},
    )
    return ours, {name: _reported_robot(facts, name) for name in robots}


def _of(name: str, robot: str) -> bool:
    return name == robot or name.startswith(f"{robot}.")


def _reported_robot(facts: WorldReadback, robot: str) -> RobotReadback:
    links = {n: f for n, f in facts.links.items() if _of(n, robot)}
    # Some engines report no mass for a base that is welded to the world; its mass is then excluded from the comparison.
    masses = [f.mass for f in links.values() if f.mass is not None]
    joints = {n.removeprefix(f"{robot}."): f for n, f in facts.joints.items() if _of(n, robot)}
    actuators = None
    if facts.actuators is not None:
        actuators = tuple(sorted(a.removeprefix(f"{robot}.") for a in facts.actuators if _of(a, robot)))
    mass = sum(masses) if len(masses) == len(links) else None
    return RobotReadback(links[robot].pose if robot in links else None, mass, joints, actuators)


def _expected(robot: Robot, target: str) -> RobotReadback | None:
    native = robot.best(*_READS.get(target, _OTHERS))
    if native is None or native.format is ModelFormat.USD:
        return None
    if native.format is ModelFormat.URDF and target not in ("mjcf", "usd"):
        return _of_urdf(robot, native)
    source = native if target == "mjcf" else mujoco_model(robot)
    assert source is not None
    read = read_robot(robot, source, f"{robot.name}.")
    mass = float(read.model.body_mass.sum())
    if target == "mjcf":
        names = [read.model.actuator(k).name.removeprefix(read.prefix) for k in range(read.model.nu)]
        return RobotReadback(pose_numbers(robot.X_WB), mass, _joints(read, {}), tuple(sorted(names)))
    made = as_object(robot, read)
    driven = sorted(j.name for j in made.item.joints if j.drive is not None and j.mimic is None)
    return RobotReadback(pose_numbers(made.item.X_WO), mass, _joints(read, made.joints), tuple(driven))


def _joints(read: MujocoRobot, names: Mapping[str, str]) -> dict[str, JointReadback]:
    """Return the joints in the robot's file in their initial state. ``names`` maps joint names to converted names."""
    model, found = read.model, {}
    for k in range(model.njnt):
        name = model.joint(k).name.removeprefix(read.prefix)
        limits = numbers(model.jnt_range[k]) if model.jnt_limited[k] else ()
        position = float(read.qpos[model.jnt_qposadr[k]])
        found[names.get(name, name)] = JointReadback(limits=limits, position=position)
    return found


def _of_urdf(robot: Robot, native: NativeModel) -> RobotReadback:
    """Return the values specified in the URDF. Mimic joints have no motor."""
    root = ET.parse(native.file).getroot()
    mass = sum(float(m.get("value", "0")) for m in root.findall("link/inertial/mass"))
    moving = {str(j.get("name")): j for j in root.findall("joint") if j.get("type") in _MOVING}
    start, gripper = robot.start(native), native.gripper
    joints = {name: _urdf_joint(j, start.get(name, 0.0)) for name, j in moving.items()}
    led = {name for name, j in moving.items() if j.find("mimic") is not None} | set(gripper.follow if gripper else ())
    return RobotReadback(pose_numbers(robot.X_WB), mass, joints, tuple(sorted(joints.keys() - led)))


def _urdf_joint(joint: ET.Element, position: float) -> JointReadback:
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return JointReadback(limits=(), position=position)
    return JointReadback(limits=(float(limit.get("lower", "0")), float(limit.get("upper", "0"))), position=position)
