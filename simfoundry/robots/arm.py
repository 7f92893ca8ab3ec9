"""A robot arm with its gripper, including inverse kinematics with rigid fingers and the gap between the fingers.

The fingers are measured by casting rays at the model.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, read_robot
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.scene.robot import Gripper, Robot, mujoco_model

if TYPE_CHECKING:
    import mujoco

# Number of gripper positions at which the fingers are measured.
SHARES = 21

# Spacing of the rays along the hand, and maximum distance of a ray from the hand frame [m].
STEP, DEEPEST = 0.001, 0.3

# Distance beyond which a ray hit is not a finger [m].
WIDEST = 0.12

# The pads cover the depths at which the gap exceeds its minimum by at most this distance [m].
PAD = 0.002

# The geom group that rays ignore, and a mask of the groups that they can hit, which contain moving collision geoms.
HIDDEN = 5
FINGERS = np.array([1, 0, 0, 0, 0, 0], np.uint8)


@dataclass(frozen=True, eq=False)
class Jaws:
    """The finger geometry at several gripper positions, in a hand frame in which the fingers close along y.

    Attributes:
        share: The gripper positions, from 0 (open) to 1 (closed), shape (k,).
        width: The gap between the pads [m], shape (k,).
        low: The z coordinate in the hand frame at which the pads start [m], shape (k,).
        tip: The z coordinate in the hand frame at which the pads end [m], shape (k,).
    """

    share: Array
    width: Array
    low: Array
    tip: Array

    @property
    def opening(self) -> float:
        """The maximum gap between the pads [m]."""
        return float(self.width.max())

    def at_width(self, width: float) -> tuple[float, float, float]:
        """Return the finger geometry at a gap of ``width`` [m].

        Returns:
            The gripper position, and the z coordinates at which the pads start and end [m].
        """
        order = np.argsort(self.width)
        columns = (self.share, self.low, self.tip)
        share, low, tip = (float(np.interp(width, self.width[order], column[order])) for column in columns)
        return share, low, tip


@lru_cache(maxsize=8)
def jaws(robot: Robot) -> Jaws | None:
    """Measure the fingers of a robot.

    Returns:
        The finger geometry, or None if the robot has no gripper or its fingers do not face each other along y.
    """
    native = mujoco_model(robot)
    if native is None or native.gripper is None:
        return None
    read = read_robot(robot, native, f"{robot.name}.")
    share = np.linspace(0.0, 1.0, SHARES)
    posed = [_posed(read, native.gripper, float(s)) for s in share]
    frame = native.frame("hand")
    body = read.model.body(read.prefix + frame.link).id
    X_WH = Pose.of(posed[0].xpos[body], posed[0].xquat[body]) @ frame.X_LF
    model, felt = copy.copy(read.model), (read.model.geom_contype != 0) | (read.model.geom_conaffinity != 0)
    moving = np.linalg.norm(posed[0].geom_xpos - posed[-1].geom_xpos, axis=1) > STEP
    model.geom_group[:] = np.where(felt & moving, 0, HIDDEN)
    found = [
        (s, *row) for s, data in zip(share, posed, strict=True) if (row := _measure(model, data, X_WH)) is not None
    ]
    return Jaws(*(frozen_array(column) for column in zip(*found, strict=True))) if len(found) >= 2 else None


def _posed(read: MujocoRobot, gripper: Gripper, share: float) -> mujoco.MjData:
    import mujoco

    data = mujoco.MjData(read.model)
    data.qpos[:] = read.qpos
    for name, position in gripper.positions(share).items():
        data.qpos[read.model.joint(read.prefix + name).qposadr[0]] = position
    mujoco.mj_kinematics(read.model, data)
    return data


def _measure(model: mujoco.MjModel, data: mujoco.MjData, X_WH: Pose) -> tuple[float, float, float] | None:
    """Return the gap between the pads and the z coordinates of their ends [m], or None if no ray hits two fingers."""
    import mujoco

    depth, hit = np.arange(0.0, DEEPEST, STEP), np.zeros(1, np.int32)
    free = np.zeros(len(depth))  # the gap between the fingers at each depth of the hand, or inf if a finger is not hit
    for k, z in enumerate(depth):
        start = X_WH.apply(np.array([0.0, 0.0, z]))
        for sign in (1.0, -1.0):
            far = mujoco.mj_ray(model, data, start, sign * X_WH.rotation[:, 1], FINGERS, 1, -1, hit)
            free[k] += far if 0 <= far < WIDEST else np.inf
    met = np.isfinite(free)
    if not met.any():
        return None
    width = float(free[met].min())
    flat = np.flatnonzero(met & (free <= width + PAD))
    breaks = np.flatnonzero(np.diff(flat) > 1)
    foremost = flat[breaks[-1] + 1 :] if len(breaks) else flat
    return max(width, 0.0), float(depth[foremost[0]]), float(depth[foremost[-1]])


# Position tolerance of a solution [m].
NEAR = 5e-4

# Orientation tolerance of a solution [rad].
TURNED = 4e-3

# Maximum number of iterations of a solve, which is rarely reached: most solves converge or stall earlier.
ITERATIONS = 40

# Distance beyond the length of the arm up to which solutions are searched for [m]; ten times the position tolerance.
BEYOND = 10 * NEAR

# Margin between solutions and the joint limits [rad or m].
SLACK = 0.02

# Number of iterations without progress after which a solve is aborted.
STUCK = 4

# Number of additional random initial configurations to try.
SEEDS = 3


class Arm:
    """The arm of a robot.

    A configuration ``q`` contains the positions of the arm's joints [rad or m] in the scene's order, shape (n,).
    """

    def __init__(self, robot: Robot) -> None:
        native = mujoco_model(robot)
        if native is None:
            raise RobotModelError(f"robot `{robot.name}` has no model for MuJoCo, which inverse kinematics requires")
        self.robot = robot
        self.read: MujocoRobot = read_robot(robot, native, f"{robot.name}.")
        named = tuple(f"{robot.name}.{joint}" for joint in native.joints.values())
        self.joints: tuple[str, ...] = named or tuple(joint.name for joint in self.read.spec.joints)
        self.model = _rigid(self.read, self.joints)
        frame = native.frame("hand")
        self._body, self._X_LH = self.model.body(f"{robot.name}.{frame.link}"), frame.X_LF
        self._order = [int(self.model.joint(name).qposadr[0]) for name in self.joints]
        self.home = np.array([self.read.qpos[self.read.model.joint(name).qposadr[0]] for name in self.joints])
        limits = np.array([self.model.jnt_range[self.model.joint(name).id] for name in self.joints])
        self.low, self.high = limits[:, 0] + SLACK, limits[:, 1] - SLACK

    @cached_property
    def _ik(self) -> tuple[Any, Any, Any]:
        """Mink's configuration of the rigid model, the frame task for the hand link, and the joint limits."""
        import mink

        task = mink.FrameTask(self._body.name, "body", position_cost=1.0, orientation_cost=0.3, lm_damping=1e-4)
        return mink.Configuration(self.model), task, mink.ConfigurationLimit(self.model)

    @cached_property
    def _longest(self) -> tuple[Array, Array, float]:
        """A point on the base, a point on the hand link, and the maximum distance between them [m].

        A point on the axis of a hinge is fixed in both links, so the distance between points on consecutive axes never
        changes. The bound is the length of the shortest path over such points: the anchor of each joint, and the points
        on its axis that are closest to the anchors of its neighbors.
        """
        import mujoco

        data, model = mujoco.MjData(self.model), self.model
        mujoco.mj_kinematics(model, data)
        joints, body = list[int](), self._body.id
        while body:
            joints[:0] = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
            body = int(model.body_parentid[body])
        if not joints or any(model.jnt_type[k] != mujoco.mjtJoint.mjJNT_HINGE for k in joints):
            return np.zeros(3), np.zeros(3), np.inf
        anchors, axes = data.xanchor[joints], data.xaxis[joints]
        numbers = np.arange(len(joints))
        beside = anchors[np.clip(numbers[:, None] + (0, -1, 1), 0, len(joints) - 1)] - anchors[:, None]
        points = anchors[:, None] + np.einsum("nij,nj->ni", beside, axes)[..., None] * axes[:, None]
        length, start = np.zeros(3), points[0]
        for before, after in pairwise(points):
            whole = length[:, None] + np.linalg.norm(before[:, None] - after, axis=2)
            best = whole.argmin(axis=0)
            length, start = whole[best, range(3)], start[best]
        end = int(length.argmin())
        X_BL = Pose.of(data.xpos[self._body.id], data.xquat[self._body.id])
        return start[end], X_BL.inverse().apply(points[-1, end]), float(length[end])

    def is_too_short(self, X_WH: Pose, slack: float = 0.0) -> bool:
        """Return True if the arm is too short to bring the hand within ``slack`` [m] of a pose.

        If the result is False, it is still possible that the hand cannot reach the pose.
        """
        start, end, longest = self._longest
        X_BL = self.robot.X_WB.inverse() @ X_WH @ self._X_LH.inverse()
        return float(np.linalg.norm(X_BL.apply(end) - start)) > longest + BEYOND + slack

    def _posed(self, q: Array) -> Any:
        """Return Mink's configuration with the joints at ``q``."""
        configuration = self._ik[0]
        full = np.array(configuration.q)
        full[self._order] = q
        configuration.update(full)
        return configuration

    @cached_property
    def _data(self) -> mujoco.MjData:
        """The state of the rigid model for forward kinematics."""
        import mujoco

        return mujoco.MjData(self.model)

    def hand(self, q: Array) -> Pose:
        """Return the pose of the hand in the world at configuration ``q``."""
        import mujoco

        data, link = self._data, self._body.id
        data.qpos[self._order] = q
        mujoco.mj_kinematics(self.model, data)
        return self.robot.X_WB @ Pose.of(data.xpos[link], data.xquat[link]) @ self._X_LH

    def solve(self, X_WH: Pose, near: Array) -> Array | None:
        """Return a configuration in which the hand is at ``X_WH``, or None if none is found.

        The search starts at the configuration ``near``.
        """
        if self.is_too_short(X_WH):
            return None
        q, found = self.approach(X_WH, near)
        return q if found else None

    def approach(self, X_WH: Pose, near: Array, gap: float = NEAR, turn: float = TURNED) -> tuple[Array, bool]:
        """Return the configuration found from ``near`` in which the hand is closest to ``X_WH``.

        Args:
            X_WH: The pose of the hand in the world.
            near: The configuration at which the search starts.
            gap: The position tolerance [m].
            turn: The orientation tolerance [rad].

        Returns:
            The configuration, and True if the hand is within both tolerances of the pose.
        """
        import mink

        X_BL = self.robot.X_WB.inverse() @ X_WH @ self._X_LH.inverse()
        _, task, limit = self._ik
        task.set_target(mink.SE3(wxyz_xyz=np.concatenate([X_BL.q, X_BL.p])))
        q = np.clip(near, self.low, self.high)
        configuration = self._posed(q)
        closest, least = q, np.inf
        best, since = np.inf, 0
        for _ in range(ITERATIONS):
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < gap and np.linalg.norm(error[3:]) < turn:
                return q, True
            size = float(np.linalg.norm(error))
            if size < least:
                closest, least = q, size
            best, since = (size, 0) if size < 0.9 * best else (best, since + 1)
            if since >= STUCK:
                break
            try:
                velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=1e-4, limits=[limit])
            except mink.NoSolutionFound:
                break
            step = velocity[self._order]
            step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-9))
            q = np.clip(q + step, self.low, self.high)
            configuration = self._posed(q)
        return closest, False

    def solve_any(self, X_WH: Pose, near: Array, rng: np.random.Generator) -> Array | None:
        """Solve like :meth:`solve`, with additional attempts if this fails.

        They start from the home configuration and from random configurations near it.
        """

        def starts() -> Iterator[Array]:
            yield from (near, self.home)
            for _ in range(SEEDS):
                spread = rng.uniform(-0.6, 0.6, len(near)) * np.minimum(1.0, self.high - self.low)
                yield np.clip(self.home + spread, self.low, self.high)

        return next((found for start in starts() if (found := self.solve(X_WH, start)) is not None), None)


def _rigid(read: MujocoRobot, joints: tuple[str, ...]) -> mujoco.MjModel:
    """Return a model of the robot in which only the arm joints can move."""
    spec = read.spec.copy()
    for items in (spec.actuators, spec.sensors, spec.equalities, spec.tendons, spec.keys):
        for item in list(items):
            spec.delete(item)
    for joint in list(spec.joints):
        if joint.name not in joints:
            spec.delete(joint)
    return spec.compile()
