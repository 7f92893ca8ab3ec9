"""The PyBullet session, which reads back a PyBullet build that its own ``load.py`` loaded."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pybullet

from simfoundry.geometry.frames import Pose, from_xyzw
from simfoundry.verify import readback as rb

BASE = -1
"""PyBullet's index for the root link. Any other link has the index of its parent joint."""

_NUDGE = 0.005
"""Displacement of joints for detecting their motors [rad or m]."""

_TYPES = {pybullet.JOINT_PRISMATIC: "prismatic", pybullet.JOINT_REVOLUTE: "revolute",
          pybullet.JOINT_SPHERICAL: "ball"}  # fmt: skip
_KINDS = {pybullet.GEOM_BOX: "box", pybullet.GEOM_SPHERE: "sphere", pybullet.GEOM_CYLINDER: "cylinder",
          pybullet.GEOM_CAPSULE: "capsule", pybullet.GEOM_MESH: "mesh"}  # fmt: skip


_UNLIMITED = 1e6
"""Effort and velocity that the URDF states for joints without these limits, because it requires a number."""


def _limit(value: float) -> rb.Numbers:
    return (float(value),) if 0 < value < _UNLIMITED else ()


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the build in ``folder``, which is opened by its loader."""
    client = pybullet.connect(pybullet.DIRECT)
    bodies = loader.load(client)
    world = json.loads((folder / "world.json").read_text(encoding="utf-8"))
    return PybulletSession(client, bodies, rb.numbers(world["gravity"]), list(world.get("robots", ())))


class PybulletSession(rb.Session):
    """A PyBullet client with its bodies by object name. ``robots`` contains the names of bodies that are robots."""

    def __init__(self, client: int, bodies: dict[str, int], gravity: tuple[float, ...], robots: list[str]) -> None:
        self.client, self.bodies = client, bodies
        self._gravity, self._robots = gravity, robots
        self.timestep = float(self._call("getPhysicsEngineParameters")["fixedTimeStep"])
        self._links: dict[str, tuple[int, int]] = {}
        self._joints: dict[str, tuple[int, int]] = {}
        for name, body in bodies.items():
            self._links[name] = (body, BASE)
            owner = name.partition(".")[0]  # freely moving parts, such as `pot.lid`, are separate bodies
            for index in range(self._call("getNumJoints", body)):
                info = self._call("getJointInfo", body, index)
                self._links[f"{owner}.{info[12].decode()}"] = (body, index)
                if info[2] != pybullet.JOINT_FIXED:
                    self._joints[f"{owner}.{info[1].decode()}"] = (body, index)

    def _call(self, function: str, *args: object, **options: object) -> Any:
        return getattr(pybullet, function)(*args, physicsClientId=self.client, **options)

    def step(self) -> None:
        """Advance the simulation by one step."""
        self._call("stepSimulation")

    def moment(self, time: float) -> rb.Moment:
        """Return the base poses and the joint positions."""
        poses = {name: rb.pose_numbers(self._pose(body, BASE)) for name, body in self.bodies.items()}
        single = {name: at for name, at in self._joints.items() if self._call("getJointInfo", *at)[3] >= 0}
        joints = {name: float(self._call("getJointState", *at)[0]) for name, at in single.items()}
        return rb.Moment(time, poses, joints)

    def read(self) -> rb.WorldReadback:
        """Return the links, the joints and the gravity.

        PyBullet does not report gravity, so it is read from ``world.json``.
        """
        links = {name: self._link(*at) for name, at in self._links.items()}
        joints = {name: self._joint(*at) for name, at in self._joints.items()}
        return rb.WorldReadback(links, joints, self._gravity, actuators=tuple(self._motors()))

    def close(self) -> None:
        """Disconnect from PyBullet."""
        pybullet.disconnect(self.client)

    def _motors(self) -> Iterator[str]:
        """Yield the robot joints that move back when displaced, because Bullet has no other way to detect motors."""
        state = self._call("saveState")
        driven = {n: at for n, at in self._joints.items() if n.partition(".")[0] in self._robots}
        for body, index in driven.values():
            position = float(self._call("getJointState", body, index)[0])
            self._call("resetJointState", body, index, position + _NUDGE)
        self.step()
        yield from (n for n, at in driven.items() if abs(self._call("getJointState", *at)[3]) > 0)
        self._call("restoreState", stateId=state)
        self._call("removeState", state)

    def _held(self, body: int, index: int) -> str:
        """Return the parent of a link. A base without mass is static."""
        if index == BASE:
            return rb.FREE if self._call("getDynamicsInfo", body, BASE)[0] else rb.WORLD
        parent = int(self._call("getJointInfo", body, index)[16])
        return next(name for name, at in self._links.items() if at == (body, parent))

    def _inertial(self, body: int, index: int) -> Pose:
        p, q = self._call("getDynamicsInfo", body, index)[3:5]
        return Pose.of(p, from_xyzw(q))

    def _pose(self, body: int, index: int) -> Pose:
        # Bullet stores link frames in single precision, but inertial frames, which give the same pose, in double.
        if index == BASE:
            p, q = self._call("getBasePositionAndOrientation", body)
        else:
            p, q = self._call("getLinkState", body, index, computeForwardKinematics=True)[:2]
        return Pose.of(p, from_xyzw(q)) @ self._inertial(body, index).inverse()

    def _link(self, body: int, index: int) -> rb.LinkReadback:
        """Return the values of a link.

        The mass of a root welded to the world is omitted, because Bullet does not store it.
        """
        info = self._call("getDynamicsInfo", body, index)
        mass, friction, moments, restitution = float(info[0]), float(info[1]), np.array(info[2]), float(info[5])
        X_LI = self._inertial(body, index)
        shapes = self._call("getCollisionShapeData", body, index)
        surface = (friction**2, restitution**2)
        return rb.LinkReadback(
            pose=rb.pose_numbers(self._pose(body, index)),
            mass=mass or None,
            com=rb.numbers(X_LI.p),
            inertia=rb.numbers(X_LI.rotation @ np.diag(moments) @ X_LI.rotation.T) if mass else None,
            held=self._held(body, index),
            colliders=tuple(self._collider(shape, X_LI, surface, k, len(shapes)) for k, shape in enumerate(shapes)),
        )

    def _collider(
        self, shape: tuple[Any, ...], X_LI: Pose, surface: tuple[float, float], index: int, count: int
    ) -> rb.ColliderReadback:
        kind = _KINDS.get(shape[2], "other")
        X_LG = X_LI @ Pose.of(shape[5], from_xyzw(shape[6]))
        x, y, z = shape[3]
        if kind == "mesh":
            # Bullet returns the vertices of the same shape for all shapes in a link, in the inertial frame.
            vertices = self._call("getMeshData", shape[0], shape[1])[1] if count == 1 and index == 0 else ()
            bounds = rb.mesh_bounds(np.array(vertices), X_LI) if vertices else None
        else:
            size = {"box": (x, y, z), "sphere": (x,)}.get(kind, (y, x))
            bounds = rb.shape_bounds(kind, size, X_LG)
        return rb.ColliderReadback(None, kind, bounds, *surface)

    def _joint(self, body: int, index: int) -> rb.JointReadback:
        info = self._call("getJointInfo", body, index)
        low, high, ball = float(info[8]), float(info[9]), info[2] == pybullet.JOINT_SPHERICAL
        return rb.JointReadback(
            type=_TYPES.get(info[2], "other"),
            axis=None if ball else rb.numbers(self._inertial(body, index).rotation @ np.array(info[13])),
            limits=(low, high) if low <= high and not ball else (),
            damping=float(info[6]),
            friction=float(info[7]),
            max_effort=_limit(info[10]),
            max_velocity=_limit(info[11]),
            position=self._turned(body, index) if ball else float(self._call("getJointState", body, index)[0]),
        )

    def _turned(self, body: int, index: int) -> tuple[float, ...]:
        """Return the quaternion of a ball joint, which Bullet stores with w last."""
        return rb.numbers(from_xyzw(self._call("getJointStateMultiDof", body, index)[0]))
