"""The PyBullet world, which runs without a window."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.pybullet import FAR, NEAR, camera_arguments, compile_pybullet, lighting_arguments
from simfoundry.errors import MissingEngineError
from simfoundry.geometry.frames import Array, Pose, from_xyzw, frozen_array, to_xyzw
from simfoundry.render.backdrop import splat_backdrop
from simfoundry.runtime.native_output import quiet_native_output
from simfoundry.runtime.plugins import import_file
from simfoundry.scene.kinematics import free_motions, link_poses, trees
from simfoundry.scene.model import JointType, Scene
from simfoundry.scene.robot import Gripper
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import (
    CONTACT_GAP,
    ClosedWorldError,
    Contact,
    Image,
    World,
    WorldRobot,
    camera_of,
    complete_state,
    instances,
    reach,
)
from simfoundry.worlds.doctor import PYBULLET_REMEDY
from simfoundry.worlds.robot_state import check_robots, engine_positions, positions_of, unknown_joint, urdf_rows

# PyBullet's index for the root link; any other link has the index of its parent joint.
BASE = -1


class PybulletWorld(World):
    """A world in PyBullet. ``client`` and ``bodies`` contain PyBullet's ids.

    The world is created from a build, using the same ``load.py`` that is provided to users.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.client = -1
        try:
            with quiet_native_output():  # PyBullet prints a banner to stderr and warnings to stdout
                import pybullet
        except ImportError as error:
            raise MissingEngineError(f"PyBullet is not installed; install with {PYBULLET_REMEDY}") from error
        self._bullet = pybullet
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as temporary:
            folder = Path(temporary) / "world"
            compile_pybullet(scene).write(folder)
            self._loader = import_file(folder / "load.py")
            with quiet_native_output():
                self.client = self._bullet.connect(self._bullet.DIRECT)
                every: dict[str, int] = self._loader.load(self.client)
            facts = json.loads((folder / "world.json").read_text(encoding="utf-8")).get("robots", {})
        self._trees = {tree.name: tree for item in scene.objects for tree in trees(item)}
        self.bodies: dict[str, int] = {name: every[name] for name in self._trees}
        self._robots = {n: PybulletRobotHandle(self._call, self._command, n, every[n], facts[n]) for n in facts}
        self._objects = {self.bodies[name]: tree.owner.name for name, tree in self._trees.items()}
        self._objects |= {every[name]: name for name in facts}
        self._joints: dict[str, tuple[int, int]] = {}
        self._links = {name: (body, BASE) for name, body in self.bodies.items()}
        self._pushes: list[tuple[tuple[int, int], Array, Array]] = []
        for name, tree in self._trees.items():
            for index in range(self._call("getNumJoints", self.bodies[name])):
                info = self._call("getJointInfo", self.bodies[name], index)
                self._links[f"{tree.owner.name}.{info[12].decode()}"] = (self.bodies[name], index)
                if info[2] != self._bullet.JOINT_FIXED:
                    self._joints[f"{tree.owner.name}.{info[1].decode()}"] = (self.bodies[name], index)
        self._arms = {name: urdf_rows(scene.robot(name), handle.moving) for name, handle in self._robots.items()}
        self._reach = {item.name: reach(item) for item in scene.objects if item.joints or not item.fixed}
        inertial = {name: self._call("getDynamicsInfo", body, BASE)[3:5] for name, body in self.bodies.items()}
        self._X_OI = {name: Pose.of(p, from_xyzw(q)) for name, (p, q) in inertial.items()}
        self._fresh: int = self._call("saveState")
        """Bullet's state before the first step, including contacts and the solver's warm-start data."""
        self.reset()

    def _call(self, function: str, *args: object, **options: object) -> Any:
        return getattr(self._bullet, function)(*args, physicsClientId=self._open_client, **options)

    def _command(self, function: str, *args: object) -> None:
        getattr(self._loader, function)(self._open_client, *args)

    @property
    def _open_client(self) -> int:
        if self.client < 0:
            raise ClosedWorldError(self.scene)
        return self.client

    def _base_pose(self, name: str) -> Pose:
        p, q = self._call("getBasePositionAndOrientation", self.bodies[name])
        return Pose.of(p, from_xyzw(q)) @ self._X_OI[name].inverse()

    @property
    def timestep(self) -> float:
        """The time step [s]."""
        return float(self._call("getPhysicsEngineParameters")["fixedTimeStep"])

    def reset(self, state: SceneState | None = None) -> None:
        """Reset to ``state``, or to the scene's initial state, with zero velocities."""
        full = complete_state(self.scene, state)
        check_robots(self.scene, self._arms, state)
        self._call("restoreState", self._fresh)
        self._pushes.clear()
        for name, pose in full.poses.items():
            self._put(name, pose)
        for name, position in full.joints.items():
            self._call("resetJointState", *self._joints[name], position, 0.0)
        for tree in self._trees.values():
            item = tree.owner
            for name in (f"{item.name}.{joint.name}" for joint in tree.joints if joint.type is JointType.BALL):
                q = to_xyzw(full.motions[name].q).tolist()
                self._call("resetJointStateMultiDof", *self._joints[name], q, [0, 0, 0])
            if tree.free_joint is not None:
                X_OL = link_poses(item, full.of_object(item))
                self._put(tree.name, full.poses[item.name] @ X_OL[tree.root.name])
        for name, robot in self._robots.items():
            robot.reset(engine_positions(self._arms[name], full.robots.get(name, {})))

    def _put(self, name: str, pose: Pose) -> None:
        """Set the world pose of a body's base, and set its velocity to zero."""
        X_WI = pose @ self._X_OI[name]
        self._call("resetBasePositionAndOrientation", self.bodies[name], X_WI.p.tolist(), to_xyzw(X_WI.q).tolist())
        self._call("resetBaseVelocity", self.bodies[name], [0, 0, 0], [0, 0, 0])

    def robot(self, name: str) -> WorldRobot:
        """Return the robot called ``name``.

        Raises:
            KeyError: If there is no such robot. The message lists the valid names.
        """
        if name not in self._robots:
            raise KeyError(f"no robot {name!r}; available robots: {', '.join(self._robots) or 'none'}")
        return self._robots[name]

    def step(self, n: int = 1) -> None:
        """Advance the simulation by ``n`` time steps."""
        for _ in range(n):
            for robot in self._robots.values():
                robot.press()
            for at, force, point in self._pushes:
                self._call("applyExternalForce", *at, force.tolist(), point.tolist(), self._bullet.WORLD_FRAME)
            self._call("stepSimulation")
        if n > 0:
            self._pushes.clear()

    def push(self, link: str, force: Array, point: Array) -> None:
        """Apply a force during the next call of :meth:`step`."""
        self._pushes.append((self._links[link], force, point))

    def halt(self) -> None:
        """Set all velocities to zero without changing poses or positions."""
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
        """Return the poses and speeds of all objects and the positions of all joints, including robot joints."""
        poses = {item.name: self._base_pose(item.name) for item in self.scene.objects}
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
                X_OT = {j.child: X_OW @ self._base_pose(item.qualified(j.child)) for j in free}
                found = free_motions(item, positions, X_OT)
                motions |= {f"{item.name}.{name}": motion for name, motion in found.items()}
        robots = {n: positions_of(self._arms[n], r.model_positions()) for n, r in self._robots.items() if self._arms[n]}
        return SceneState.of(poses, joints, motions, robots, self._speeds())

    def _speeds(self) -> dict[str, float]:
        """Return an upper bound on the speed [m/s] of each movable object's fastest point."""
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

    def contacts(self) -> list[Contact]:
        """Return the current contacts between different objects and robots."""
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
        """Render the view from a camera with TinyRenderer.

        Returns:
            An sRGB image, uint8, shape (height, width, 3).
        """
        backdrop = splat_backdrop(self.scene, camera_of(self, camera, width, height))
        image, depth, bodies = self._shot(camera, width, height, bodies=backdrop is not None)
        return image if backdrop is None else backdrop.over(image, np.where(bodies >= 0, depth, np.inf))

    def depth_and_mask(self, camera: str, width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return the depth [m] and the visible instance at each pixel, both of shape (height, width)."""
        _, depth, bodies = self._shot(camera, width, height)
        order = {name: k + 1 for k, name in enumerate(instances(self.scene))}
        mask = np.zeros((height, width), dtype=np.int32)
        for body, name in self._objects.items():
            mask[bodies == body] = order[name]
        return np.where(mask > 0, depth, 0).astype(np.float32), mask

    def _shot(self, camera: str, width: int, height: int, bodies: bool = True) -> tuple[Image, Array, Array]:
        """Return the image, the depth along the optical axis [m], and the body at each pixel, or -1."""
        flags = 0 if bodies else self._bullet.ER_NO_SEGMENTATION_MASK
        view = camera_arguments(camera_of(self, camera, width, height))
        matrices = {"viewMatrix": view["view"], "projectionMatrix": view["projection"]}
        lighting = lighting_arguments(self.scene.lights)
        options = {"renderer": self._bullet.ER_TINY_RENDERER, "flags": flags}
        shot = self._call("getCameraImage", width, height, **matrices, **lighting, **options)
        rgba, near, body = (np.asarray(values).reshape(height, width, -1) for values in shot[2:5])
        depth = NEAR * FAR / (FAR - (FAR - NEAR) * near[..., 0].astype(np.float64))
        return np.ascontiguousarray(rgba[..., :3], dtype=np.uint8), depth, body[..., 0]

    def trouble(self) -> str:
        """Return the reason why the simulation since the last reset is invalid, or an empty string if it is valid."""
        for name, body in self.bodies.items():
            p, q = self._call("getBasePositionAndOrientation", body)
            if not np.isfinite([*p, *q]).all():
                return f"the simulation diverged: the pose of `{name}` in PyBullet is not finite"
        return ""

    def close(self) -> None:
        """Disconnect from PyBullet. Repeated calls have no effect."""
        if self.client >= 0 and self._bullet.isConnected(self.client):
            self._bullet.disconnect(self.client)
        self.client = -1


# A function that calls a function of PyBullet or of the loader by name for one client.
Call = Callable[..., Any]


class PybulletRobotHandle(WorldRobot):
    """A robot in PyBullet, whose targets are set in its position motors.

    ``facts`` is the robot's entry in ``world.json``.
    """

    def __init__(self, call: Call, command: Call, name: str, body: int, facts: Mapping[str, Any]) -> None:
        self._call, self._command, self._name, self._body, self._facts = call, command, name, body, facts
        self._targets = {joint: motor["target"] for joint, motor in facts["motors"].items()}
        self._servos = [joint for joint, motor in facts["motors"].items() if "stiffness" in motor]
        infos = [call("getJointInfo", body, k) for k in range(call("getNumJoints", body))]
        self._index = {info[1].decode(): k for k, info in enumerate(infos)}
        self._limits = {info[1].decode(): (float(info[8]), float(info[9])) for info in infos}
        self._links = {info[12].decode(): k for k, info in enumerate(infos)}
        self._links[call("getBodyInfo", body)[0].decode()] = -1
        self._gripper = Gripper({}, {n: tuple(pair) for n, pair in facts["gripper"].items()}, facts["follow"])

    @property
    def joints(self) -> tuple[str, ...]:
        """The ordered names of the arm's joints, as used in the scene."""
        return tuple(self._facts["arm"])

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""
        return {name: self._position(joint) for name, joint in self._facts["arm"].items()}

    def _position(self, joint: str) -> float:
        return float(self._call("getJointState", self._body, self._index[joint])[0])

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the position limits of the arm's joints [rad or m], which are infinite for joints without limits."""
        found = {name: self._limits[joint] for name, joint in self._facts["arm"].items()}
        return {name: pair if pair[0] <= pair[1] else (-math.inf, math.inf) for name, pair in found.items()}

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set the target positions of arm joints [rad or m].

        Raises:
            KeyError: If a joint is unknown.
        """
        for name, target in targets.items():
            if name not in self._facts["arm"]:
                raise unknown_joint(self._name, name, self.joints)
            self._drive(self._facts["arm"][name], target)

    def _drive(self, joint: str, target: float) -> None:
        low, high = self._limits[joint]
        if low <= high:
            target = min(max(target, low), high)
        self._targets[joint] = target
        self._command("hold", self._body, self._index[joint], self._facts["motors"][joint], target)

    def press(self) -> None:
        """Limit the force of each gripper servo to that of a spring. Call this method before every step."""
        for joint in self._servos:
            motor = self._facts["motors"][joint]
            self._command("press", self._body, self._index[joint], motor, self._targets[joint])

    def gripper(self) -> float:
        """Return how far the gripper is closed, from 0 (open) to 1 (closed)."""
        if not self._gripper.joints:
            return 0.0
        return self._gripper.closed(self._position(next(iter(self._gripper.joints))))

    def set_gripper(self, closed: float) -> None:
        """Set the gripper target, from 0 (open) to 1 (closed)."""
        share = min(max(closed, 0.0), 1.0)
        for joint, (start, end) in self._gripper.joints.items():
            if joint in self._facts["motors"]:
                self._drive(joint, start + share * (end - start))

    def frame(self, name: str) -> Pose:
        """Return the world pose of a frame, or of a link given by its name in the model.

        Raises:
            KeyError: If the link does not exist. The message lists the valid names.
        """
        known = self._facts["frames"].get(name)
        link = known["link"] if known is not None else name
        if link not in self._links:
            raise KeyError(f"robot {self._name!r} has no link {link!r}; available links: {', '.join(self._links)}")
        X_LF = Pose.of(known["p"], known["q_wxyz"]) if known is not None else Pose.of()
        index = self._links[link]
        if index == BASE:
            p, q = self._call("getBasePositionAndOrientation", self._body)
        else:
            p, q = self._call("getLinkState", self._body, index, computeForwardKinematics=True)[:2]
        inertial = self._call("getDynamicsInfo", self._body, index)[3:5]
        X_LI = Pose.of(inertial[0], from_xyzw(inertial[1]))
        return Pose.of(p, from_xyzw(q)) @ X_LI.inverse() @ X_LF

    @property
    def moving(self) -> tuple[str, ...]:
        """The names of all movable joints in the model."""
        return tuple(self._facts["joints"])

    def model_positions(self) -> dict[str, float]:
        """Return the positions of all movable joints [rad or m], keyed by their names in the model."""
        names = self.moving
        states = self._call("getJointStates", self._body, [self._index[name] for name in names])
        return {name: float(state[0]) for name, state in zip(names, states, strict=True)}

    def reset(self, positions: Mapping[str, float] | None = None) -> None:
        """Reset the joint positions, with zero velocity.

        The positions are those in the scene, unless ``positions`` [rad or m] specifies them by their names in the
        model. The motors hold these positions, and mimic joints are set from their leaders.
        """
        given = dict(positions or {})
        for joint, follow in self._gripper.follow.items():
            if follow["joint"] in given:  # type: ignore[index]
                given.setdefault(joint, follow["multiplier"] * given[follow["joint"]] + follow["offset"])  # type: ignore[index]
        for name, position in self._facts["joints"].items():
            self._call("resetJointState", self._body, self._index[name], given.get(name, position), 0.0)
        for name, motor in self._facts["motors"].items():
            self._drive(name, given.get(name, motor["target"]))

    def halt(self) -> None:
        """Set the velocities of the robot's joints to zero."""
        for name in self._facts["joints"]:
            self._call("resetJointState", self._body, self._index[name], self._position(name), 0.0)
