"""Expected read-back of robots: base, mass, joints and motors, derived from the robot's own model.

An engine reports a robot like an object, link by link. The comparison uses only quantities that the robot's model and
the scene determine for every target: base pose, total mass, joint positions and joint limits.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import ModelFormat, NativeModel, Robot, mujoco_model
from simfoundry.verify.readback import JointReadback, Numbers, WorldReadback, numbers, pose_numbers

_READS = {"mjcf": (ModelFormat.MJCF, ModelFormat.URDF), "usd": (ModelFormat.USD, ModelFormat.MJCF, ModelFormat.URDF)}
_OTHERS = (ModelFormat.URDF, ModelFormat.MJCF)
"""The robot formats that each target accepts, in order of preference."""

_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class RobotReadback:
    """A robot: the ``pose`` of its base link in the world, the total ``mass`` [kg], its joints by their own names, of
    which limits and position are compared, and its ``actuators``; None means not reported."""

    pose: Numbers | None
    mass: float | None
    joints: Mapping[str, JointReadback]
    actuators: tuple[str, ...] | None = None


def expected_robots(scene: Scene, target: str) -> dict[str, RobotReadback | None]:
    """Return the expected values of each robot in ``target``; None if it has no model that can be read."""
    return {robot.name: _expected(robot, target) for robot in scene.robots}


def without_robots(facts: WorldReadback, names: Iterable[str]) -> tuple[WorldReadback, dict[str, RobotReadback]]:
    """Split a read-back into that of the objects and that of the robots present."""
    robots = [name for name in names if any(_of(link, name) for link in facts.links)]
    ours = {
        "links": {n: f for n, f in facts.links.items() if not any(_of(n, r) for r in robots)},
        "joints": {n: f for n, f in facts.joints.items() if not any(_of(n, r) for r in robots)},
        "silent": _apart(facts.silent, robots),
        "pairs": _pairs(facts.pairs, robots),
    }
    return replace(facts, **ours), {name: _told(facts, name) for name in robots}  # type: ignore[arg-type]


def _of(name: str, robot: str) -> bool:
    return name == robot or name.startswith(f"{robot}.")


def _apart(pairs: tuple[str, ...] | None, robots: list[str]) -> tuple[str, ...] | None:
    if pairs is None:
        return None
    return tuple(p for p in pairs if not any(_of(end, r) for end in p.split("|") for r in robots))


def _pairs(pairs: Mapping[str, float] | None, robots: list[str]) -> dict[str, float] | None:
    """Return the pairs without those of robots, whose surfaces are defined in their own files."""
    if pairs is None:
        return None
    return {p: mu for p, mu in pairs.items() if not any(_of(end, r) for r in robots for end in p.split("|"))}


def _told(facts: WorldReadback, robot: str) -> RobotReadback:
    links = {n: f for n, f in facts.links.items() if _of(n, robot)}
    # Some engines report no mass for a base welded to the world; the mass of the rest is then compared without it.
    masses = [f.mass for f in links.values() if f.mass is not None]
    joints = {n.removeprefix(f"{robot}."): f for n, f in facts.joints.items() if _of(n, robot)}
    actuators = None
    if facts.actuators is not None:
        actuators = tuple(sorted(a.removeprefix(f"{robot}.") for a in facts.actuators if _of(a, robot)))
    base = links.get(robot)
    whole = len(masses) == len(links)
    return RobotReadback(base.pose if base else None, sum(masses) if whole else None, joints, actuators)


def _expected(robot: Robot, target: str) -> RobotReadback | None:
    native = robot.best(*_READS.get(target, _OTHERS))
    if native is None or native.format is ModelFormat.USD:
        return None
    if target == "mjcf":
        read = read_robot(robot, native, f"{robot.name}.")
        joints = _joints(read, {})
        names = [read.model.actuator(k).name.removeprefix(read.prefix) for k in range(read.model.nu)]
        return RobotReadback(pose_numbers(robot.X_WB), float(read.model.body_mass.sum()), joints, tuple(sorted(names)))
    if native.format is ModelFormat.URDF and target != "usd":
        return _of_urdf(robot, native)
    source = mujoco_model(robot)
    assert source is not None
    read = read_robot(robot, source, f"{robot.name}.")
    made = as_object(robot, read)
    driven = sorted(j.name for j in made.item.joints if j.drive is not None and j.mimic is None)
    return RobotReadback(pose_numbers(made.item.X_WO), float(read.model.body_mass.sum()), _joints(read, made.joints),
                      tuple(driven))  # fmt: skip


def _joints(read: MujocoRobot, names: Mapping[str, str]) -> dict[str, JointReadback]:
    """Return the joints as MuJoCo reads the robot's file, in the initial state; ``names`` are those of a conversion."""
    model, found = read.model, {}
    for k in range(model.njnt):
        name = model.joint(k).name.removeprefix(read.prefix)
        limits = numbers(model.jnt_range[k]) if model.jnt_limited[k] else ()
        position = float(read.qpos[model.jnt_qposadr[k]])
        found[names.get(name, name)] = JointReadback(limits=limits, position=position)
    return found


def _of_urdf(robot: Robot, native: NativeModel) -> RobotReadback:
    """Return the values stated by the URDF itself; mimic joints have no motor."""
    root = ET.parse(native.file).getroot()
    mass = sum(float(m.get("value", "0")) for m in root.findall("link/inertial/mass"))
    moving = [j for j in root.findall("joint") if j.get("type") in _MOVING]
    start, gripper = robot.start(native), native.gripper
    joints = {str(j.get("name")): _urdf_joint(j, start.get(str(j.get("name")), 0.0)) for j in moving}
    led = {str(j.get("name")) for j in moving if j.find("mimic") is not None} | set(gripper.follow if gripper else ())
    return RobotReadback(pose_numbers(robot.X_WB), mass, joints, tuple(sorted(joints.keys() - led)))


def _urdf_joint(joint: ET.Element, position: float) -> JointReadback:
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return JointReadback(limits=(), position=position)
    return JointReadback(limits=(float(limit.get("lower", "0")), float(limit.get("upper", "0"))), position=position)
