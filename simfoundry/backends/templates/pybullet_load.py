"""Load this world: ``load()`` returns PyBullet body ids by object name; ``python load.py`` opens the viewer."""

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


def load(client: int | None = None) -> dict[str, int]:
    """Load every object; without a client, into the open default connection or a new one without a window."""
    if client is None:
        client = 0 if pybullet.isConnected() else pybullet.connect(pybullet.DIRECT)
    world = json.loads((HERE / "world.json").read_text(encoding="utf-8"))
    pybullet.setGravity(*world["gravity"], physicsClientId=client)
    pybullet.setTimeStep(world["timestep"], physicsClientId=client)
    if "background" in world:
        flags = pybullet.URDF_IGNORE_COLLISION_SHAPES
        pybullet.loadURDF(str(HERE / world["background"]), useFixedBase=True, flags=flags, physicsClientId=client)
    return {name: load_object(client, item) for name, item in world["objects"].items()}


def picture(client: int, camera: str) -> tuple[Any, ...]:
    """What a camera of the scene sees under its lights, as ``getCameraImage`` returns it: width, height, rgba, ..."""
    world = json.loads((HERE / "world.json").read_text(encoding="utf-8"))
    view = world["cameras"][camera]
    size, matrices = (view["width"], view["height"]), (view["view"], view["projection"])
    shot: tuple[Any, ...] = pybullet.getCameraImage(
        *size, *matrices, **world["lighting"], renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client
    )
    return shot


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
