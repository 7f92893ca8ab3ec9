"""Robots in PyBullet: URDFs, and the motors, surfaces and frames that ``world.json`` adds to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.backends.artifact import rounded
from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.backends.pybullet.surfaces import robot_friction
from simfoundry.backends.robot_models.robot_urdf import RobotUrdf, Write, robot_urdf, without_model
from simfoundry.backends.urdf.manifests import mimic_data, pose_data
from simfoundry.geometry.frames import frozen_array
from simfoundry.scene.model import JointType, Scene, SceneObject

GRASP_ITERATIONS = 200
"""Solver iterations per step for scenes with robots. With Bullet's default of 50, a marker between the pads of a 2F-85
creeps by up to 2 cm and rotates during a motion; with 200 it creeps by 5 mm, with 500 by 2 mm in three times the
time."""

_GRIPS = {
    False: "It has the friction of its file, which Bullet multiplies with the square roots of the scene's.",
    True: "It grips as in MuJoCo, which uses the larger friction; if the scene's differ, with a value between them.",
}
_MOTORS = {
    False: "Bullet's motors hold their joints with full force, regardless of the gains in the robot's file.",
    True: "An arm lags according to its gains but does not sag; rotor inertias are added to the links as disks.",
}
"""The losses of a robot's surfaces and motors; the key is true if the robot was converted from its MJCF."""


def bullet_robots(scene: Scene, write: Write) -> tuple[dict[str, RobotUrdf], list[Loss]]:
    """Return the robots of a scene as URDFs by name, and the losses of robots and mounted cameras."""
    robots, losses = {}, []
    for robot in scene.robots:
        found = robot_urdf(robot, write)
        if found is None:
            losses.append(without_model(robot.name))
            continue
        robots[robot.name] = found
        converted = found.item is not None
        losses += [*found.losses, approximate("robot_contacts", robot.name, _GRIPS[converted])]
        losses.append(approximate("robot_motors", robot.name, _MOTORS[converted]))
    for mounted in scene.mounted:
        reason = f"It is mounted on `{mounted.carrier}`, and cameras in PyBullet's files are static."
        losses.append(drop("mounted_cameras", mounted.camera.name, reason))
    return robots, losses


def robot_entry(robot: RobotUrdf, scene: Scene, timestep: float) -> dict[str, object]:
    """Return the entry of a robot in ``world.json``: its pose, motors and mimic joints."""
    motors = {
        name: {"target": rounded(position), "force": rounded(robot.efforts[name])} | _servo(robot, name, timestep)
        for name, position in robot.positions.items()
        if name in robot.efforts and name not in robot.follow
    }
    links = robot.item.links if robot.item is not None else ()
    return {
        "urdf": robot.path,
        **pose_data(robot.X_WB),
        "joints": {name: rounded(position) for name, position in robot.positions.items()},
        "motors": motors,
        "follow": {name: mimic_data(leader) for name, leader in robot.follow.items()},
        "links": {k.name: {"lateral_friction": rounded(robot_friction(k, scene)), "restitution": 0.0} for k in links},
        "arm": dict(robot.joints),
        "gripper": {name: [rounded(v) for v in pair] for name, pair in robot.gripper.items()},
        "frames": {name: {"link": frame.link, **pose_data(frame.X_LF)} for name, frame in robot.frames.items()},
    }


def _servo(robot: RobotUrdf, joint: str, timestep: float) -> dict[str, float]:
    """Return the gains of a servo for Bullet, whose motors are velocity constraints; empty if they are unknown.

    A spring and damper move a light joint at ``stiffness * error / damping``. Bullet's motor moves it by ``gain *
    error`` in a step of ``timestep`` [s], with any force that this requires. Gripper joints keep their stiffness,
    because the loader's ``press`` bounds their force with it. Arm joints do not sag, so this bound would only make them
    oscillate.
    """
    if joint not in robot.servos:
        return {}
    stiffness, damping = robot.servos[joint]
    lag = {"gain": rounded(min(stiffness * timestep / damping, 1.0))} if damping > 0 else {}
    firm = {"stiffness": rounded(stiffness)} if joint in robot.gripper else {}
    return lag | firm


def with_rotors(item: SceneObject) -> SceneObject:
    """Return the object with the armature of each rotating joint added to the inertia of the link below it.

    Geared motors contribute most of the inertia of a finger, up to a thousand times that of its links. Bullet resolves
    contacts by a few dozen impulses per step, each proportional to the inertia it acts on; bare fingers, 1e-5 kg m^2,
    would press with a hundredth of their motor's force. A rotor is added as a thin disk, with half its inertia about
    the transverse axes, because Bullet treats a physically impossible inertia as zero.
    """
    rotors = {
        joint.child: joint.armature / 2 * (np.eye(3) + np.outer(joint.axis, joint.axis))
        for joint in item.joints
        if joint.armature > 0 and joint.type in (JointType.REVOLUTE, JointType.CONTINUOUS)
    }
    links = (
        replace(link, inertia=frozen_array(link.inertia + rotors[link.name])) if link.name in rotors else link
        for link in item.links
    )
    return replace(item, links=tuple(links))
