"""Inverse kinematics of a robot arm with its gripper as one rigid body."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, read_robot
from simfoundry.geometry.frames import Array, Pose, to_xyzw  # noqa: F401
from simfoundry.scene.robot import Robot, mujoco_model

if TYPE_CHECKING:
    import mujoco

NEAR = 5e-4
"""Position tolerance of a solution [m]."""

TURNED = 4e-3
"""Orientation tolerance of a solution [rad]."""

ITERATIONS = 40
SLACK = 0.02
"""Margin between solutions and the joint limits [rad or m]."""

STUCK = 4
"""Number of iterations without progress after which a solve is stopped."""

SEEDS = 3
"""Number of additional start configurations if the solve from the current one fails."""


class Arm:
    """The arm of a robot. Configurations ``q`` list its joints in the scene's order [rad or m], shape (n,)."""

    def __init__(self, robot: Robot) -> None:
        native = mujoco_model(robot)
        if native is None:
            raise RobotModelError(f"robot `{robot.name}` has no model that MuJoCo reads, so no arm can be solved")
        self.robot = robot
        self.read: MujocoRobot = read_robot(robot, native, f"{robot.name}.")
        own = [j.name for j in self.read.spec.joints]
        named = [f"{robot.name}.{joint}" for joint in native.joints.values()]
        self.joints: tuple[str, ...] = tuple(named) or tuple(own)
        self.model = _rigid(self.read, self.joints)
        frame = native.frame("hand")
        self._body, self._X_LH = f"{robot.name}.{frame.link}", frame.X_LF
        self._order = [int(self.model.joint(name).qposadr[0]) for name in self.joints]
        start = self.read.model
        self.home = np.array([self.read.qpos[start.joint(name).qposadr[0]] for name in self.joints])
        limits = np.array([self.model.jnt_range[self.model.joint(name).id] for name in self.joints])
        self.low, self.high = limits[:, 0] + SLACK, limits[:, 1] - SLACK

    @cached_property
    def _solver(self) -> _Solver:
        return _Solver(self.model, self._body, self._order, self.low, self.high)

    def hand(self, q: Array) -> Pose:
        """Return the pose of the hand in the world at configuration ``q``."""
        return self.robot.X_WB @ self._solver.body(q) @ self._X_LH

    def solve(self, X_WH: Pose, near: Array) -> Array | None:
        """Solve for a configuration with the hand at ``X_WH``, starting from ``near``; return None if none is found."""
        return self._solver.solve(self.robot.X_WB.inverse() @ X_WH @ self._X_LH.inverse(), near)

    def solve_any(self, X_WH: Pose, near: Array, rng: np.random.Generator) -> Array | None:
        """Solve as :meth:`solve` does; if that fails, from the home configuration and random ones around it."""
        target = self.robot.X_WB.inverse() @ X_WH @ self._X_LH.inverse()
        found = self._solver.solve(target, near)
        if found is None:
            found = self._solver.solve(target, self.home)
        for _ in range(SEEDS):
            if found is not None:
                break
            spread = rng.uniform(-0.6, 0.6, len(near)) * np.minimum(1.0, self.high - self.low)
            found = self._solver.solve(target, np.clip(self.home + spread, self.low, self.high))
        return found


class _Solver:
    """Mink on the rigid model: a task for one frame, and a weak posture task toward the start configuration."""

    def __init__(self, model: mujoco.MjModel, body: str, order: list[int], low: Array, high: Array) -> None:
        import mink

        self._mink = mink
        self._order, self._low, self._high, self._name = order, low, high, body
        self._configuration = mink.Configuration(model)
        self._frame = mink.FrameTask(body, "body", position_cost=1.0, orientation_cost=0.3, lm_damping=1e-4)
        self._limit = mink.ConfigurationLimit(model)
        self._id = model.body(body).id

    def body(self, q: Array) -> Pose:
        self._update(q)
        data = self._configuration.data
        return Pose.of(data.xpos[self._id], data.xquat[self._id])

    def _update(self, q: Array) -> None:
        full = np.array(self._configuration.q)
        full[self._order] = q
        self._configuration.update(full)

    def solve(self, X_BF: Pose, near: Array) -> Array | None:
        mink = self._mink
        self._frame.set_target(mink.SE3(wxyz_xyz=np.concatenate([X_BF.q, X_BF.p])))
        q = np.clip(near, self._low, self._high)
        self._update(q)
        best, since = np.inf, 0
        for _ in range(ITERATIONS):
            error = self._frame.compute_error(self._configuration)
            if np.linalg.norm(error[:3]) < NEAR and np.linalg.norm(error[3:]) < TURNED:
                return q
            size = float(np.linalg.norm(error))
            best, since = (size, 0) if size < 0.9 * best else (best, since + 1)
            if since >= STUCK:
                return None
            try:
                velocity = mink.solve_ik(
                    self._configuration, [self._frame], 1.0, "daqp", damping=1e-4, limits=[self._limit]
                )
            except mink.NoSolutionFound:
                return None
            step = velocity[self._order]
            step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-9))
            q = np.clip(q + step, self._low, self._high)
            self._update(q)
        return None


def _rigid(read: MujocoRobot, joints: tuple[str, ...]) -> mujoco.MjModel:
    """Return the robot's model with only the arm's joints."""
    spec = read.spec.copy()
    for items in (spec.actuators, spec.sensors, spec.equalities, spec.tendons, spec.keys):
        for item in list(items):
            spec.delete(item)
    for joint in list(spec.joints):
        if joint.name not in joints:
            spec.delete(joint)
    return spec.compile()
