"""Joint positions that bring a hand to a place, found numerically on the robot's own tree of links."""

from __future__ import annotations

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import read_robot
from simfoundry.backends.robot_models.robot_object import RobotObject, as_object
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.robot import Robot, mujoco_model
from simfoundry.worlds.base import World

DOWN = Pose.of(q=(0.0, 1.0, 0.0, 0.0))
"""A hand that points down, its x axis along the world's."""


class Reach:
    """The kinematics of a robot's hand."""

    def __init__(self, robot: Robot) -> None:
        native = mujoco_model(robot)
        assert native is not None
        self.native = native
        self.made: RobotObject = as_object(robot, read_robot(robot, native, f"{robot.name}."))

    def hand(self, positions: dict[str, float]) -> Pose:
        """Pose of the hand in the world at arm positions by the scene's names."""
        item, frame = self.made.item, self.native.frame("hand")
        joints = {self.made.joints[self.native.joints[name]]: value for name, value in positions.items()}
        return item.X_WO @ link_poses(item, joints)[self.made.links[frame.link]] @ frame.X_LF

    def solve(self, start: dict[str, float], p: Array) -> dict[str, float]:
        """Positions at which the hand is at ``p`` and points down, by damped least squares from ``start``."""
        goal, q = Pose.of(p, DOWN.q), dict(start)
        for _ in range(60):
            error = _twist(goal, self.hand(q))
            if np.linalg.norm(error) < 1e-9:
                return q
            jacobian = np.column_stack([_twist(self.hand({**q, n: q[n] + 1e-6}), self.hand(q)) / 1e-6 for n in q])
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), error)
            q = {n: v + float(d) for (n, v), d in zip(q.items(), np.clip(step, -0.3, 0.3), strict=True)}
        raise AssertionError(f"no way to {p}")


def _twist(goal: Pose, at: Pose) -> Array:
    """What moves ``at`` onto ``goal``: a translation and a rotation vector in the world, shape (6,)."""
    turn = (Pose.of(q=goal.q) @ Pose.of(q=at.q).inverse()).q
    return np.concatenate([goal.p - at.p, 2 * turn[1:]])


def move(world: World, targets: dict[str, float], seconds: float) -> None:
    """Move the arm to ``targets`` along a straight line in joint space, with new targets 15 times a second."""
    arm = world.robot("arm")
    start, ticks = arm.positions(), round(seconds * 15)
    for k in range(1, ticks + 1):
        arm.set_targets({n: start[n] + k / ticks * (targets[n] - start[n]) for n in targets})
        world.step(round(1 / 15 / world.timestep))


def grasp_and_lift(world: World, grasp: float, rise: float, share: float = 1.0) -> tuple[Array, dict[str, float]]:
    """Take the cube at ``grasp`` [m] over it and lift it by ``rise`` [m]: where it is then, and the last targets.

    The gripper closes by ``share``, or as far as it can.
    """
    arm, reach = world.robot("arm"), Reach(world.scene.robot("arm"))
    above = reach.solve(arm.positions(), np.array([0.5, 0.0, grasp + 0.15]))
    at = reach.solve(above, np.array([0.5, 0.0, grasp]))
    up = reach.solve(at, np.array([0.5, 0.0, grasp + rise]))
    arm.set_gripper(0.0)
    move(world, above, 1.5)
    move(world, at, 1.0)
    arm.set_gripper(share)
    world.step(round(0.7 / world.timestep))
    move(world, up, 1.0)
    world.step(round(0.5 / world.timestep))
    return world.state().poses["cube"].p, up
