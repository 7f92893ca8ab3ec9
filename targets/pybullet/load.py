"""Load this world into PyBullet.

``load()`` returns PyBullet body ids by name, and ``python load.py`` opens the viewer.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import pybullet

HERE = Path(__file__).resolve().parent
FLAGS = (
    pybullet.URDF_USE_INERTIA_FROM_FILE  # otherwise Bullet computes it from the collision shapes
    | pybullet.URDF_USE_IMPLICIT_CYLINDER  # otherwise a cylinder becomes a polyhedron
    | pybullet.URDF_MAINTAIN_LINK_ORDER
)
FAR = 1e9  # a practically unlimited force [N or N m]
GAIN = 0.1  # fraction of the position error that a motor corrects per step, which is Bullet's default
GEAR_ERP = (
    0.8  # fraction of the error between geared joints that is corrected per step; at 0.2, fingers yield by 2 degrees
)


def load(client: int | None = None) -> dict[str, int]:
    """Load all objects and robots into ``client``.

    The default is the open connection. If there is none, a new headless connection is opened.
    """
    if client is None:
        client = 0 if pybullet.isConnected() else pybullet.connect(pybullet.DIRECT)
    world = json.loads((HERE / "world.json").read_text(encoding="utf-8"))
    pybullet.setGravity(*world["gravity"], physicsClientId=client)
    pybullet.setTimeStep(world["timestep"], physicsClientId=client)
    if "solver_iterations" in world:  # with Bullet's default of 50, grasped objects creep
        pybullet.setPhysicsEngineParameter(numSolverIterations=world["solver_iterations"], physicsClientId=client)
    if "background" in world:
        flags = pybullet.URDF_IGNORE_COLLISION_SHAPES
        pybullet.loadURDF(str(HERE / world["background"]), useFixedBase=True, flags=flags, physicsClientId=client)
    bodies = {name: load_object(client, item) for name, item in world["objects"].items()}
    bodies |= {name: load_robot(client, item) for name, item in world.get("robots", {}).items()}
    for (name_a, link_a), (name_b, link_b) in world.get("no_contact", []):
        a, b = bodies[name_a], bodies[name_b]
        silence(client, a, link_index(client, a, link_a), b, link_index(client, b, link_b))
    return bodies


def picture(client: int, camera: str) -> tuple[Any, ...]:
    """Render a camera with the scene's lights.

    Returns:
        The result of ``getCameraImage``: the width, the height, the RGBA image and so on.
    """
    world = json.loads((HERE / "world.json").read_text(encoding="utf-8"))
    view = world["cameras"][camera]
    size, matrices = (view["width"], view["height"]), (view["view"], view["projection"])
    shot: tuple[Any, ...] = pybullet.getCameraImage(
        *size, *matrices, **world["lighting"], renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client
    )
    return shot


def load_object(client: int, item: dict[str, Any]) -> int:
    """Load one object from ``world.json`` at its pose, with its materials and joint positions."""
    flags = FLAGS | (pybullet.URDF_USE_SELF_COLLISION if item.get("self_collision") else 0)
    body: int = pybullet.loadURDF(
        str(HERE / item["urdf"]), useFixedBase=item["fixed"], flags=flags, physicsClientId=client
    )
    place(client, body, item["p"], item["q_wxyz"])
    base = pybullet.getBodyInfo(body, physicsClientId=client)[0].decode()
    set_surface(client, body, -1, item["links"][base])
    for index in range(joints(client, body)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        joint, link = info[1].decode(), info[12].decode()
        set_surface(client, body, index, item["links"][link])
        if joint in item["joints"]:
            set_joint(client, body, index, item, joint)
        elif joint in item.get("balls", {}):
            set_ball(client, body, index, item, joint)
    for joint, most in item.get("velocities", {}).items():
        index = joint_index(client, body, joint)
        pybullet.changeDynamics(body, index, maxJointVelocity=most, physicsClientId=client)
    for joint, mimic in item.get("mimics", {}).items():
        follow(client, body, joint_index(client, body, joint), joint_index(client, body, mimic["joint"]), mimic)
    for joint, drive in item.get("drives", {}).items():
        set_drive(client, body, joint_index(client, body, joint), drive)
    for a, b in item.get("no_contact", []):
        silence(client, body, link_index(client, body, a), body, link_index(client, body, b))
    return body


def load_robot(client: int, item: dict[str, Any]) -> int:
    """Load one robot from ``world.json`` at its pose, with coupled fingers, and with motors that hold its joints."""
    # Bullet must sort the links, because links that precede their parents in the file would have no pose otherwise.
    flags = FLAGS & ~pybullet.URDF_MAINTAIN_LINK_ORDER
    body: int = pybullet.loadURDF(str(HERE / item["urdf"]), useFixedBase=True, flags=flags, physicsClientId=client)
    place(client, body, item["p"], item["q_wxyz"])
    for index in range(joints(client, body)):
        link = pybullet.getJointInfo(body, index, physicsClientId=client)[12].decode()
        pybullet.changeDynamics(body, index, linearDamping=0, angularDamping=0, physicsClientId=client)
        if link in item["links"]:
            set_surface(client, body, index, item["links"][link])
    for joint, position in item["joints"].items():
        index = joint_index(client, body, joint)
        pybullet.resetJointState(body, index, position, 0.0, physicsClientId=client)
        if joint in item["motors"]:
            hold(client, body, index, item["motors"][joint])
        else:  # the joint is driven only by its leader, so disable Bullet's default motor
            pybullet.setJointMotorControl2(
                body, index, pybullet.VELOCITY_CONTROL, targetVelocity=0, force=0, physicsClientId=client
            )
    for joint, leader in item["follow"].items():
        follow(client, body, joint_index(client, body, joint), joint_index(client, body, leader["joint"]), leader)
    return body


def hold(client: int, body: int, index: int, motor: dict[str, float], target: float | None = None) -> None:
    """Move a joint to ``target``, or by default to the motor's target.

    The joint is held there with at most the force of the motor.
    """
    pybullet.setJointMotorControl2(
        body,
        index,
        pybullet.POSITION_CONTROL,
        targetPosition=motor["target"] if target is None else target,
        positionGain=motor.get("gain", GAIN),
        force=motor["force"],
        physicsClientId=client,
    )


def press(client: int, body: int, index: int, motor: dict[str, float], target: float) -> None:
    """Limit the force of a motor with a stiffness to that of a spring at the current error.

    Call this before every step. Otherwise, a gripper closes with its motor's full force, no matter how small the error.
    """
    error = abs(target - pybullet.getJointState(body, index, physicsClientId=client)[0])
    hold(client, body, index, {**motor, "force": min(motor["force"], motor["stiffness"] * error)}, target)


def joint_index(client: int, body: int, joint: str) -> int:
    """Return Bullet's index of the joint with the given name, which is also the index of its child link."""
    names = [pybullet.getJointInfo(body, k, physicsClientId=client)[1].decode() for k in range(joints(client, body))]
    return names.index(joint)


def link_index(client: int, body: int, link: str) -> int:
    """Return Bullet's index of the link with the given name, which is -1 for the base."""
    names = [pybullet.getJointInfo(body, k, physicsClientId=client)[12].decode() for k in range(joints(client, body))]
    return names.index(link) if link in names else -1


def joints(client: int, body: int) -> int:
    """Return the number of joints in a body."""
    count: int = pybullet.getNumJoints(body, physicsClientId=client)
    return count


def silence(client: int, body_a: int, link_a: int, body_b: int, link_b: int) -> None:
    """Disable collisions between two links."""
    pybullet.setCollisionFilterPair(body_a, body_b, link_a, link_b, enableCollision=0, physicsClientId=client)


def place(client: int, body: int, p: list[float], q_wxyz: list[float]) -> None:
    """Set the world pose of the base's link frame. Bullet's own base pose refers to the inertial frame."""
    inertial = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[3:5]
    w, x, y, z = q_wxyz
    pose = pybullet.multiplyTransforms(p, [x, y, z, w], *inertial)
    pybullet.resetBasePositionAndOrientation(body, *pose, physicsClientId=client)
    pybullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=client)


def set_surface(client: int, body: int, index: int, link: dict[str, float]) -> None:
    """Set the contact properties of a link, and disable the air drag that Bullet adds by default."""
    pybullet.changeDynamics(
        body,
        index,
        lateralFriction=link["lateral_friction"],
        restitution=link["restitution"],
        rollingFriction=link.get("rolling_friction", 0),
        spinningFriction=link.get("spinning_friction", 0),
        linearDamping=0,
        angularDamping=0,
        physicsClientId=client,
    )


def set_joint(client: int, body: int, index: int, item: dict[str, Any], joint: str) -> None:
    """Set a joint's position and damping, and model its Coulomb friction with Bullet's default motor."""
    pybullet.changeDynamics(body, index, jointDamping=item["joint_damping"][joint], physicsClientId=client)
    pybullet.resetJointState(body, index, item["joints"][joint], 0.0, physicsClientId=client)
    pybullet.setJointMotorControl2(
        body,
        index,
        pybullet.VELOCITY_CONTROL,
        targetVelocity=0,
        force=item["joint_friction"][joint],
        physicsClientId=client,
    )


def set_ball(client: int, body: int, index: int, item: dict[str, Any], joint: str) -> None:
    """Set a ball joint's rotation, damping and friction in the same way as :func:`set_joint`."""
    pybullet.changeDynamics(body, index, jointDamping=item["joint_damping"][joint], physicsClientId=client)
    w, x, y, z = item["balls"][joint]
    pybullet.resetJointStateMultiDof(body, index, [x, y, z, w], [0, 0, 0], physicsClientId=client)
    pybullet.setJointMotorControlMultiDof(
        body,
        index,
        pybullet.POSITION_CONTROL,
        targetPosition=[0, 0, 0, 1],
        positionGain=0,
        velocityGain=1,
        force=[item["joint_friction"][joint]] * 3,
        physicsClientId=client,
    )


def follow(client: int, body: int, follower: int, leader: int, mimic: dict[str, Any]) -> None:
    """Couple a joint to another joint with a gear constraint that has no backlash."""
    gear = pybullet.createConstraint(
        body, follower, body, leader, pybullet.JOINT_GEAR, [0, 0, 1], [0, 0, 0], [0, 0, 0], physicsClientId=client
    )
    pybullet.changeConstraint(
        gear,
        gearRatio=-mimic["multiplier"],
        relativePositionTarget=mimic["offset"],
        erp=GEAR_ERP,
        maxForce=FAR,
        physicsClientId=client,
    )


def set_drive(client: int, body: int, index: int, drive: dict[str, float], target: float | None = None) -> None:
    """Pull a joint toward ``target``, which is the drive's target by default.

    The motor acts like a spring and a damper with a force limit.
    """
    pybullet.setJointMotorControl2(
        body,
        index,
        pybullet.PD_CONTROL,
        targetPosition=drive["target"] if target is None else target,
        targetVelocity=0,
        positionGain=drive["stiffness"],
        velocityGain=drive["damping"],
        force=drive.get("force_limit", FAR),
        physicsClientId=client,
    )


def has_display() -> bool:
    """Return true if a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Open the viewer. Without a display, print a summary."""
    client = pybullet.connect(pybullet.GUI if has_display() else pybullet.DIRECT)
    bodies = load(client)
    if not has_display():
        print(f"loaded {HERE / 'world.json'}: {', '.join(bodies)}")
        return
    while pybullet.isConnected(client):
        pybullet.stepSimulation(physicsClientId=client)
        time.sleep(1 / 500)


if __name__ == "__main__":
    main()
