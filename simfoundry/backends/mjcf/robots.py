"""Robots and mounted cameras in MJCF. Each robot's own model is placed below a body named after the robot.

The scene's options override those in the robot's file. Robot contacts use the values in the robot's file, except that
the finger contacts are stiffer.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.losses import Loss, approximate
from simfoundry.backends.mjcf.bodies import Assets, pose_attributes
from simfoundry.backends.mjcf.surroundings import add_camera
from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, body_name, read_robot, xml
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import ModelFormat, Robot, mujoco_model

# The sections of a robot's file that are merged into the scene in addition to bodies and defaults.
_SECTIONS = ("extension", "asset", "contact", "deformable", "tendon", "equality", "actuator", "sensor")

# MuJoCo's default impedance for joint friction, restored for robots because the scene's default is stiffer.
_JOINT_FRICTION = "0.9 0.95 0.001 0.5 2"

# The weight of a finger geom's stiffness in a contact; all other geoms have weight 1.
_FINGERS = "1000"

# Time constant of the finger contacts in time steps, which is the minimum that MuJoCo accepts.
_FIRM = 2


def add_robot(root: ET.Element, robot: Robot, assets: Assets, timestep: float) -> MujocoRobot | None:
    """Add a robot with every element defined in its file, or return None if it has no model that MuJoCo can read.

    The finger contacts are made as stiff as possible for a time step of ``timestep`` [s].
    """
    native = mujoco_model(robot)
    if native is None:
        return None
    read = read_robot(robot, native, f"{robot.name}.")
    source = ET.fromstring(xml(read))
    world = root.find("worldbody")
    assert world is not None
    base = ET.SubElement(world, "body", {"name": robot.name} | pose_attributes(robot.X_WB))
    base.extend(source.findall("worldbody/*"))
    _write_exactly(base, read)
    _firm_fingers(base, read, timestep)
    _add_defaults(root, source, robot.name)
    for tag in _SECTIONS:
        _section(root, tag).extend(source.findall(f"{tag}/*"))
    for name, frame in native.links.items():
        site = {"name": f"{robot.name}.{name}", "group": "5", "size": "0.005"} | pose_attributes(frame.X_LF)
        body = body_name(read, name)
        ET.SubElement(next(b for b in base.iter("body") if b.get("name") == body), "site", site)
    assets.files.update(read.files)
    return read


def _firm_fingers(base: ET.Element, read: MujocoRobot, timestep: float) -> None:
    """Make the finger contacts stiff so that a grasped object follows the fingers closely.

    The constraint solver uses the servo damping at the beginning of a step, but the integrator uses the damping at the
    end. Whenever the arm jerks, the difference acts on a grasped object and makes it creep by an amount proportional to
    the time constant of the contact. Over a motion of 10 cm, a marker in the hand crept by 8 mm at MuJoCo's default of
    20 ms, but by only 2 mm at 4 ms. The weight lets the fingers' stiffness dominate the contact; the contact friction
    is still the larger of the two values.
    """
    gripper = read.native.gripper
    if gripper is None:
        return
    moving = {read.prefix + name for name in (*gripper.joints, *gripper.follow)}
    for body in base.iter("body"):
        if any(joint.get("name") in moving for joint in body.findall("joint")):
            for geom in body.iter("geom"):
                geom.set("solref", f"{number(_FIRM * timestep)} 1")
                geom.set("solmix", _FINGERS)


def _write_exactly(base: ET.Element, read: MujocoRobot) -> None:
    """Write poses, masses and limits with full precision, because MuJoCo's own writer keeps only six digits."""
    model = read.model
    for body in base.iterfind(".//body"):
        k = model.body(body.get("name")).id
        for name, value, usual in (("pos", model.body_pos[k], "0 0 0"), ("quat", model.body_quat[k], "1 0 0 0")):
            body.attrib.pop(name, None)
            if numbers(value) != usual:
                body.set(name, numbers(value))
        inertial = body.find("inertial")
        if inertial is not None:
            inertial.attrib.clear()
            inertial.set("pos", numbers(model.body_ipos[k]))
            inertial.set("quat", numbers(model.body_iquat[k]))
            inertial.set("mass", number(model.body_mass[k]))
            inertial.set("diaginertia", numbers(model.body_inertia[k]))
        for joint in body.findall("joint"):
            if joint.get("range") is not None and joint.get("name"):
                joint.set("range", numbers(model.jnt_range[model.joint(joint.get("name")).id]))


def _section(root: ET.Element, tag: str) -> ET.Element:
    found = root.find(tag)
    return ET.SubElement(root, tag) if found is None else found


def _add_defaults(root: ET.Element, source: ET.Element, name: str) -> None:
    """Add the robot's default classes below a class that resets the scene's joint defaults."""
    materials = [material.get("name", "") for material in source.findall("asset/material")]
    for group in source.findall("default/default"):
        joint = group.find("joint")
        if joint is None:
            joint = ET.Element("joint")
            group.insert(0, joint)
        joint.set("solimpfriction", joint.get("solimpfriction", _JOINT_FRICTION))
        for default in group.iter("default"):
            within = default.get("class", "").startswith
            for user in default.findall("*[@material]"):  # MuJoCo prefixes all other names, but not these
                short = user.attrib["material"]
                full = (m for m in materials if m.endswith(f".{short}") and within(m.removesuffix(short)))
                user.set("material", max(full, key=len, default=short))
        _section(root, "default").append(group)
    # A joint without a class would inherit the scene's defaults; a body's `childclass` applies to the joints below it.
    classified = [joint for body in source.findall("worldbody//body[@childclass]") for joint in body.iter("joint")]
    for joint in source.findall("worldbody//joint"):
        if joint.get("class") is None and joint not in classified:
            joint.set("class", f"{name}.main")


def add_mounted_cameras(world: ET.Element, scene: Scene) -> None:
    """Add each mounted camera to the body of its link, except cameras on robots that were not written."""
    robots = {robot.name: robot for robot in scene.robots}
    for mounted in scene.mounted:
        robot, camera, name = robots.get(mounted.carrier), mounted.camera, mounted.carrier
        native = None if robot is None else mujoco_model(robot)
        if robot is None:
            name = scene.object(name).qualified(mounted.link or scene.object(name).root.name)
        elif native is None:
            continue
        elif mounted.link:
            frame = native.frame(mounted.link)
            name, camera = f"{name}.{frame.link}", replace(camera, X_WC=frame.X_LF @ camera.X_WC)
        body = next((b for b in world.iter("body") if b.get("name") == name), None)
        if body is None:
            raise RobotModelError(f"camera `{camera.name}` is mounted on `{name}`, which does not exist")
        add_camera(body, camera)


def robot_losses(robot: Robot, read: MujocoRobot, timestep: float) -> Iterator[Loss]:
    """Yield a robot's losses in MuJoCo for a time step of ``timestep`` [s]."""
    if read.native.format is ModelFormat.URDF:
        reason = "The robot has no MJCF, so MuJoCo reads its URDF and uses the convex hulls of the meshes as colliders."
        yield approximate("robots", robot.name, reason)
    if read.servos:
        reason = "The model has no actuators, so a stiff, critically damped position servo is added to each joint."
        yield approximate("robot_motors", robot.name, reason)
    reason = "The robot keeps the friction in its file; in contacts with the scene, MuJoCo uses the larger friction."
    yield approximate("robot_contacts", robot.name, reason)
    if read.native.gripper is not None:
        firm = 1000 * _FIRM * timestep
        reason = (
            f"The contacts of its fingers have a time constant of {firm:g} ms instead of the value in its file; "
            "at MuJoCo's default of 20 ms, a grasped object creeps."
        )
        yield approximate("robot_contacts", robot.name, reason, firm, "ms")
