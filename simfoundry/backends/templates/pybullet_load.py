"""Load this world: ``load()`` returns PyBullet body ids by name of object or robot; ``python load.py`` opens the viewer."""

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
    pybullet.URDF_USE_INERTIA_FROM_FILE  # else Bullet recomputes it from the collision shapes
    | pybullet.URDF_USE_IMPLICIT_CYLINDER  # else a cylinder becomes a polyhedron
    | pybullet.URDF_MAINTAIN_LINK_ORDER
)

GEAR_ERP, GEAR_FORCE = 0.2, 200.0  # share of an error mended a step; greatest force of a gear [N m or N]


def load(client: int | None = None) -> dict[str, int]:
    """Load every object and robot; without a client, into the open default connection or a new one without a window."""
    if client is None:
        client = 0 if pybullet.isConnected() else pybullet.connect(pybullet.DIRECT)
    world = json.loads((HERE / "world.json").read_text(encoding="utf-8"))
    pybullet.setGravity(*world["gravity"], physicsClientId=client)
    pybullet.setTimeStep(world["timestep"], physicsClientId=client)
    bodies = {name: load_object(client, item) for name, item in world["objects"].items()}
    return bodies | {name: load_robot(client, item) for name, item in world.get("robots", {}).items()}


def load_object(client: int, item: dict[str, Any]) -> int:
    """Load one object of ``world.json`` in its pose, with its materials and joint positions."""
    body: int = pybullet.loadURDF(
        str(HERE / item["urdf"]), useFixedBase=item["fixed"], flags=FLAGS, physicsClientId=client
    )
    place(client, body, item["p"], item["q_wxyz"])
    base = pybullet.getBodyInfo(body, physicsClientId=client)[0].decode()
    set_surface(client, body, -1, item["links"][base])
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        joint, link = info[1].decode(), info[12].decode()
        set_surface(client, body, index, item["links"][link])
        if joint in item["joints"]:
            set_joint(client, body, index, item, joint)
    return body


def load_robot(client: int, item: dict[str, Any]) -> int:
    """Load one robot of ``world.json``: at its place, its motors holding its joints, its fingers moving together."""
    body: int = pybullet.loadURDF(str(HERE / item["urdf"]), useFixedBase=True, flags=FLAGS, physicsClientId=client)
    place(client, body, item["p"], item["q_wxyz"])
    joints: dict[str, int] = {}
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        joints[info[1].decode()] = index
        pybullet.changeDynamics(body, index, linearDamping=0, angularDamping=0, physicsClientId=client)
        if info[12].decode() in item["links"]:
            set_surface(client, body, index, item["links"][info[12].decode()])
    for name, position in item["joints"].items():
        pybullet.resetJointState(body, joints[name], position, 0.0, physicsClientId=client)
        motor = item["motors"].get(name, {"target": 0.0, "force": 0.0})
        mode = pybullet.POSITION_CONTROL if name in item["motors"] else pybullet.VELOCITY_CONTROL
        drive(client, body, joints[name], mode, motor)
    for name, leader in item["follow"].items():
        gear(client, body, joints[leader["joint"]], joints[name], leader)
    return body


def drive(client: int, body: int, index: int, mode: int, motor: dict[str, float]) -> None:
    """Let a joint's motor hold a position, or leave the joint free."""
    if mode == pybullet.POSITION_CONTROL:
        pybullet.setJointMotorControl2(
            body, index, mode, targetPosition=motor["target"], force=motor["force"], physicsClientId=client
        )
    else:
        pybullet.setJointMotorControl2(body, index, mode, targetVelocity=0, force=0, physicsClientId=client)


def gear(client: int, body: int, leader: int, follower: int, law: dict[str, Any]) -> None:
    """Let a joint follow another: Bullet's gear keeps ``follower = -ratio * leader``."""
    origin = [0, 0, 0]
    constraint = pybullet.createConstraint(
        body, leader, body, follower, pybullet.JOINT_GEAR, [1, 0, 0], origin, origin, physicsClientId=client
    )
    pybullet.changeConstraint(
        constraint,
        gearRatio=-law["multiplier"],
        relativePositionTarget=law["offset"],
        erp=GEAR_ERP,
        maxForce=GEAR_FORCE,
        physicsClientId=client,
    )


def place(client: int, body: int, p: list[float], q_wxyz: list[float]) -> None:
    """Put the link frame of the base at a world pose. Bullet's own pose of a base is that of its inertial frame."""
    inertial = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[3:5]
    w, x, y, z = q_wxyz
    pose = pybullet.multiplyTransforms(p, [x, y, z, w], *inertial)
    pybullet.resetBasePositionAndOrientation(body, *pose, physicsClientId=client)
    pybullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=client)


def set_surface(client: int, body: int, index: int, link: dict[str, float]) -> None:
    """Set what contacts of a link feel, and take away the drag of the air that Bullet adds."""
    pybullet.changeDynamics(
        body,
        index,
        lateralFriction=link["lateral_friction"],
        restitution=link["restitution"],
        rollingFriction=0,
        spinningFriction=0,
        linearDamping=0,
        angularDamping=0,
        physicsClientId=client,
    )


def set_joint(client: int, body: int, index: int, item: dict[str, Any], joint: str) -> None:
    """Set position and damping of a joint; the motor that Bullet puts in every joint becomes its Coulomb friction."""
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


def has_display() -> bool:
    """Whether a window can open here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Open the viewer, or say what was loaded where there is no display."""
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
