"""A scene in PyBullet, without a window."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import math
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

import numpy as np

from simfoundry.backends.pybullet import camera_arguments, compile_pybullet, lighting_arguments
from simfoundry.errors import MissingEngineError
from simfoundry.geometry.frames import Pose, from_xyzw, frozen_array, to_xyzw
from simfoundry.scene.kinematics import Tree, free_motions, link_poses, trees
from simfoundry.scene.model import JointType, Scene
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import CONTACT_GAP, Contact, Image, Judging, complete_state
from simfoundry.worlds.doctor import PYBULLET_REMEDY
from simfoundry.worlds.mounted import camera_of
from simfoundry.worlds.pybullet_robot import PybulletRobotHandle
from simfoundry.worlds.robot import WorldRobot
from simfoundry.worlds.robot_state import check_robots, engine_positions, positions_of, urdf_rows
from simfoundry.worlds.speed import reach

BASE = -1
"""PyBullet's index of the root link; any other link has the index of its parent joint."""


class PybulletWorld(Judging):
    """A :class:`~simfoundry.worlds.World` for PyBullet; ``client`` and ``bodies`` (ids by object) are PyBullet's own.

    The world is created from a build by the same ``load.py`` that users get.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.client = -1
        with quiet_native_output():
            self._bullet = _import_pybullet()
            self.client = self._bullet.connect(self._bullet.DIRECT)
            with tempfile.TemporaryDirectory(prefix="simfoundry-") as temporary:
                folder = Path(temporary) / "world"
                compile_pybullet(scene).write(folder)
                self._loader = _import_file(folder / "load.py")
                every: dict[str, int] = self._loader.load(self.client)
                facts = json.loads((folder / "world.json").read_text(encoding="utf-8")).get("robots", {})
        self._trees = {tree.name: tree for item in scene.objects for tree in trees(item)}
        self.bodies: dict[str, int] = {name: every[name] for name in self._trees}
        hold, press = partial(self._loader.hold, self.client), partial(self._loader.press, self.client)
        self._robots = {n: PybulletRobotHandle(self._call, hold, press, n, every[n], facts[n]) for n in facts}
        self._objects = {self.bodies[name]: tree.owner.name for name, tree in self._trees.items()}
        self._objects |= {every[name]: name for name in facts}
        self._bodies = {body: name for name, body in self.bodies.items()}
        self._links: dict[str, tuple[int, int]] = {}
        self._joints: dict[str, tuple[int, int]] = {}
        for tree in self._trees.values():
            self._index_names(tree)
        self._arms = {name: urdf_rows(scene.robot(name), handle.moving) for name, handle in self._robots.items()}
        self._reach = {item.name: reach(item) for item in scene.objects if item.joints or not item.fixed}
        self._X_OI = {name: self._inertial_pose(body, BASE) for name, body in self.bodies.items()}
        self._fresh: int = self._call("saveState")
        """Bullet's saved state before the first step, including contacts and the solver's warm-start data."""
        self.reset()

    def _index_names(self, tree: Tree) -> None:
        item, body = tree.owner, self.bodies[tree.name]
        self._links[tree.name] = (body, BASE)
        for index in range(self._call("getNumJoints", body)):
            info = self._call("getJointInfo", body, index)
            self._links[item.qualified(info[12].decode())] = (body, index)
            if info[2] != self._bullet.JOINT_FIXED:
                self._joints[f"{item.name}.{info[1].decode()}"] = (body, index)

    def _call(self, function: str, *args: object, **options: object) -> Any:
        return getattr(self._bullet, function)(*args, physicsClientId=self.client, **options)

    def _inertial_pose(self, body: int, index: int) -> Pose:
        """Return the pose of a link's inertial frame in its link frame."""
        p, q = self._call("getDynamicsInfo", body, index)[3:5]
        return Pose.of(p, from_xyzw(q))

    @property
    def timestep(self) -> float:
        """Time step [s]."""
        return float(self._call("getPhysicsEngineParameters")["fixedTimeStep"])

    def reset(self, state: SceneState | None = None) -> None:
        """Set ``state`` with zero velocities; without one, the state that the scene describes."""
        full = complete_state(self.scene, state)
        check_robots(self.scene, self._arms, state)
        self._call("restoreState", self._fresh)
        for name, pose in full.poses.items():
            self._put(name, pose)
        for name, position in full.joints.items():
            self._call("resetJointState", *self._joints[name], position, 0.0)
        for tree in self._trees.values():
            item = tree.owner
            for joint in tree.joints:
                if joint.type is JointType.BALL:
                    q = to_xyzw(full.motions[f"{item.name}.{joint.name}"].q).tolist()
                    self._call("resetJointStateMultiDof", *self._joints[f"{item.name}.{joint.name}"], q, [0, 0, 0])
            if tree.free_joint is not None:
                X_OL = link_poses(item, full.of_object(item))
                self._put(tree.name, full.poses[item.name] @ X_OL[tree.root.name])
        for name, robot in self._robots.items():
            robot.reset(engine_positions(self._arms[name], full.robots.get(name, {})))

    def _put(self, name: str, pose: Pose) -> None:
        """Set the world pose of a body's base, with zero velocities."""
        X_WI = pose @ self._X_OI[name]
        self._call("resetBasePositionAndOrientation", self.bodies[name], X_WI.p.tolist(), to_xyzw(X_WI.q).tolist())
        self._call("resetBaseVelocity", self.bodies[name], [0, 0, 0], [0, 0, 0])

    def robot(self, name: str) -> WorldRobot:
        """Return the robot called ``name``; raise a KeyError with the valid names if there is none."""
        if name not in self._robots:
            raise KeyError(f"no robot {name!r}; there are: {', '.join(self._robots) or 'none'}")
        return self._robots[name]

    def step(self, n: int = 1) -> None:
        """Advance by ``n`` time steps."""
        for _ in range(n):
            for robot in self._robots.values():
                robot.press()
            self._call("stepSimulation")

    def halt(self) -> None:
        """Set all velocities to zero; poses and positions are unchanged."""
        for body in self.bodies.values():
            self._call("resetBaseVelocity", body, [0, 0, 0], [0, 0, 0])
        for name, at in self._joints.items():
            if self._is_ball(name):
                self._call("resetJointStateMultiDof", *at, self._call("getJointStateMultiDof", *at)[0], [0, 0, 0])
            else:
                self._call("resetJointState", *at, self._call("getJointState", *at)[0], 0.0)
        for robot in self._robots.values():
            robot.halt()

    def state(self) -> SceneState:
        """Return the poses and speeds of all objects and the positions of all joints, including robots."""
        poses = {item.name: self._link_pose(self.bodies[item.name], BASE) for item in self.scene.objects}
        joints: dict[str, float] = {}
        motions: dict[str, Pose] = {}
        for name, at in self._joints.items():
            if self._is_ball(name):
                motions[name] = Pose.of(q=from_xyzw(self._call("getJointStateMultiDof", *at)[0]))
            else:
                joints[name] = float(self._call("getJointState", *at)[0])
        for item in self.scene.objects:
            free = [joint for joint in item.joints if joint.type is JointType.FREE]
            if free:
                X_OW, positions = poses[item.name].inverse(), SceneState(poses, joints, motions).of_object(item)
                X_OT = {j.child: X_OW @ self._link_pose(self.bodies[item.qualified(j.child)], BASE) for j in free}
                found = free_motions(item, positions, X_OT)
                motions |= {f"{item.name}.{name}": motion for name, motion in found.items()}
        robots = {n: positions_of(self._arms[n], r.model_positions()) for n, r in self._robots.items() if self._arms[n]}
        return SceneState.of(poses, joints, motions, robots, self._speeds())

    def _speeds(self) -> dict[str, float]:
        """Return an upper bound on the speed of the fastest point of each movable object [m/s]."""
        speeds = dict.fromkeys(self._reach, 0.0)
        for name, tree in self._trees.items():
            if not tree.fixed:
                v, w = self._call("getBaseVelocity", self.bodies[name])
                own = tree.owner.name
                speeds[own] = max(speeds[own], math.hypot(*v) + math.hypot(*w) * self._reach[own])
        for name, at in self._joints.items():
            own = name.partition(".")[0]
            if self._is_ball(name):
                speeds[own] += math.hypot(*self._call("getJointStateMultiDof", *at)[1]) * 2 * self._reach[own]
            else:
                slides = self._call("getJointInfo", *at)[2] == self._bullet.JOINT_PRISMATIC
                speeds[own] += abs(self._call("getJointState", *at)[1]) * (1.0 if slides else 2 * self._reach[own])
        return speeds

    def _is_ball(self, name: str) -> bool:
        body, index = self._joints[name]
        return bool(self._call("getJointInfo", body, index)[2] == self._bullet.JOINT_SPHERICAL)

    def _link_pose(self, body: int, index: int) -> Pose:
        if index == BASE:
            p, q = self._call("getBasePositionAndOrientation", body)
            return Pose.of(p, from_xyzw(q)) @ self._X_OI[self._bodies[body]].inverse()
        # Bullet stores link frames in single precision; inertial frames, in double precision, give the same pose.
        p, q = self._call("getLinkState", body, index, computeForwardKinematics=True)[:2]
        return Pose.of(p, from_xyzw(q)) @ self._inertial_pose(body, index).inverse()

    def contacts(self) -> list[Contact]:
        """Return the current contacts between different objects."""
        self._call("performCollisionDetection")
        found = []
        for point in self._call("getContactPoints"):
            a, b, distance = self._objects[point[1]], self._objects[point[2]], float(point[8])
            if a != b and distance <= CONTACT_GAP:
                middle = (np.array(point[5]) + np.array(point[6])) / 2
                normal = -np.array(point[7])  # Bullet's normal points from b to a
                found.append(Contact(a, b, -distance, frozen_array(normal), frozen_array(middle)))
        return found

    def render(self, camera: str, width: int, height: int) -> Image:
        """Render a camera of the scene with TinyRenderer: sRGB, uint8, shape (height, width, 3)."""
        view = camera_arguments(camera_of(self, camera, width, height))
        matrices = {"viewMatrix": view["view"], "projectionMatrix": view["projection"]}
        lighting = lighting_arguments(self.scene.lights)
        flags = {"renderer": self._bullet.ER_TINY_RENDERER, "flags": self._bullet.ER_NO_SEGMENTATION_MASK}
        shot = self._call("getCameraImage", width, height, **matrices, **lighting, **flags)
        return np.ascontiguousarray(np.asarray(shot[2], dtype=np.uint8).reshape(height, width, 4)[:, :, :3])

    def trouble(self) -> str:
        """Return the reason why the simulation since the last reset is invalid; empty if it is valid."""
        for name, body in self.bodies.items():
            p, q = self._call("getBasePositionAndOrientation", body)
            if not np.isfinite([*p, *q]).all():
                return f"the simulation diverged: PyBullet has no finite pose of `{name}`"
        return ""

    def close(self) -> None:
        """Disconnect; repeated calls have no effect."""
        if self.client >= 0 and self._bullet.isConnected(self.client):
            self._bullet.disconnect(self.client)
        self.client = -1

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


def _import_pybullet() -> ModuleType:
    try:
        import pybullet
    except ImportError as error:
        raise MissingEngineError(f"PyBullet is not installed; install with {PYBULLET_REMEDY}") from error
    module: ModuleType = pybullet
    return module


def _import_file(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("simfoundry_pybullet_world", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot import {path}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def quiet_native_output() -> Iterator[None]:
    """Discard the output of native code; PyBullet prints a greeting to stderr and warnings to stdout."""
    libc = ctypes.CDLL(None) if sys.platform != "win32" else ctypes.cdll.msvcrt
    _flush(libc)
    saved = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        _flush(libc)  # otherwise C's buffer would be printed later, to the restored streams
        os.dup2(saved[0], 1)
        os.dup2(saved[1], 2)
        for descriptor in (*saved, nowhere):
            os.close(descriptor)


def _flush(libc: ctypes.CDLL) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    libc.fflush(None)
