"""Conversion of recorded actions to another action space, through the joint targets that they led to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simfoundry.data.demonstrations import Demonstration
from simfoundry.data.trajectory import Trajectory, TrajectorySampler
from simfoundry.evaluate.actions import action_limits, normalized, rotation_numbers
from simfoundry.evaluate.policies.open_loop import ReplayPolicy
from simfoundry.evaluate.rollouts.control import FARTHEST
from simfoundry.evaluate.rollouts.rollout import rollout
from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm
from simfoundry.spec.models.signals import ActionKind, ActionSpace, HandFrame


@dataclass(frozen=True, eq=False)
class ConvertedActions:
    """The actions of a demonstration in an action space.

    Attributes:
        values: The actions, float64, shape (T, action size).
        loss: The reason why the robots would receive different targets, as a clause, or an empty string if they receive
            the same, apart from rounding.
    """

    values: Array
    loss: str = ""


@dataclass(frozen=True)
class ReplayError:
    """The difference between a demonstration and a rollout of its converted actions, from the same initial state.

    Attributes:
        hand_m: The largest distance between the hands at the same time [m].
        hand_rad: The largest angle between the hands at the same time [rad].
        success: True if the rollout reached the goal as well.
        is_identical: True if the joints move in the same way to the last bit, as long as the demonstration lasts.
    """

    hand_m: float
    hand_rad: float
    success: bool
    is_identical: bool


def arm_values(arm: Arm, targets: Array, space: ActionSpace, hz: float) -> Array:
    """Return the arm values of actions that move the joint targets of an arm, before normalization.

    Args:
        arm: The arm.
        targets: The joint targets before the first action and after each action [rad or m], shape (T + 1, n).
        space: The action space.
        hz: The number of actions per second [Hz].

    Returns:
        The values, shape (T, arm size).
    """
    match space.kind:
        case ActionKind.JOINT_POSITION:
            return targets[1:]
        case ActionKind.JOINT_DELTA:
            return np.asarray(np.diff(targets, axis=0))
        case ActionKind.JOINT_VELOCITY:
            return np.asarray(np.diff(targets, axis=0) * hz)
        case ActionKind.HAND_POSE | ActionKind.HAND_DELTA:
            return _hand_values(arm, targets, space)


def _hand_values(arm: Arm, targets: Array, space: ActionSpace) -> Array:
    poses = [arm.hand(q) for q in targets]
    X_WB = arm.robot.X_WB
    rows = []
    for before, after in pairwise(poses):
        if space.kind is ActionKind.HAND_POSE:
            pose = X_WB.inverse() @ after if space.frame is HandFrame.BASE else after
            rows.append(np.concatenate([pose.p, rotation_numbers(pose.q, space.rotation)]))
            continue
        axes: Mapping[HandFrame, Pose] = {
            HandFrame.BASE: X_WB,
            HandFrame.WORLD: Pose.of(),
            HandFrame.HAND: before,
        }
        R_FW = Pose.of(q=axes[space.frame].q).inverse()
        turn = R_FW @ Pose.of(q=after.q) @ Pose.of(q=before.q).inverse() @ R_FW.inverse()
        rows.append(np.concatenate([R_FW.apply(after.p - before.p), rotation_numbers(turn.q, space.rotation)]))
    return np.array(rows)


class ActionConverter:
    """Converts the actions of trajectories of one task to an action space."""

    def __init__(self, sampler: TrajectorySampler, space: ActionSpace) -> None:
        self._sampler, self.space = sampler, space
        self._arms: dict[str, Arm] = {}
        self._limits: Array | None = None

    def convert(self, trajectory: Trajectory) -> ConvertedActions:
        """Return the actions of a trajectory, one for each frame."""
        if trajectory.recorded is not None and trajectory.recorded_space == self.space:
            return ConvertedActions(trajectory.recorded)
        columns = []
        for name in trajectory.robots:
            values = arm_values(self._arm(name), trajectory.targets[name], self.space, trajectory.hz)
            columns += [values, trajectory.grippers[name][:, None]]
        values = np.concatenate(columns, axis=1) if columns else np.zeros((trajectory.length, 0))
        loss = self._loss(trajectory)
        if self.space.normalized:
            values = normalized(values, self._action_limits())
            excess = float(np.abs(values).max(initial=0.0)) - 1.0
            if excess > 0:
                loss = f"actions exceed the limits by up to {excess:.1%} and are clipped"
            values = np.clip(values, -1.0, 1.0)
        return ConvertedActions(values, loss)

    def hand_targets(self, trajectory: Trajectory) -> dict[str, list[Pose]]:
        """Return the pose X_WT of each hand if its joints were at their targets, in T + 1 rows as in ``targets``."""
        return {name: [self.hand(name, q) for q in rows] for name, rows in trajectory.targets.items()}

    def hand(self, robot: str, q: Array) -> Pose:
        """Return the pose X_WH of a robot's hand at joint positions ``q`` [rad or m]."""
        return self._arm(robot).hand(q)

    def replay_error(self, demonstration: Demonstration, actions: Array, hz: float) -> ReplayError:
        """Execute converted actions, and compare what happens with the demonstration."""
        task = self._sampler.task
        policy = ReplayPolicy(actions, self.space, "converted actions", hz)
        done = rollout(task, demonstration.start, policy, self._sampler.world, trace=True)
        distance, angle = 0.0, 0.0
        for k, (_, robots) in enumerate(done.trace[: demonstration.steps + 1]):
            for name, reading in robots.items():
                numbers = demonstration.states[f"{name}/hand"][k]
                distance = max(distance, float(np.linalg.norm(reading.X_WH.p - numbers[:3])))
                angle = max(angle, reading.X_WH.angle_to(Pose.of(numbers[:3], numbers[3:])))
        states = [robots for _, robots in done.trace[: demonstration.steps + 1]]
        same = all(
            np.array_equal(demonstration.states[f"{name}/joints"], [robots[name].joints for robots in states])
            for name in task.robots
        )
        return ReplayError(distance, angle, done.success, same)

    def _loss(self, trajectory: Trajectory) -> str:
        """Return why the targets differ from the recorded ones, or an empty string."""
        if not trajectory.is_held:
            what = "moved" if trajectory.recorded_space.kind is ActionKind.JOINT_VELOCITY else "changed"
            return f"the targets {what} within frames of {1 / trajectory.hz:.3g} s, of which only the last is kept"
        match self.space.kind:
            case ActionKind.JOINT_POSITION:
                return ""
            case ActionKind.JOINT_DELTA:
                far = max(
                    float(np.abs(rows[1:] - trajectory.observations[f"{name}/joints"][:-1]).max(initial=0.0))
                    for name, rows in trajectory.targets.items()
                )
                return f"targets are up to {far:.2g} from their joints, but stay within {FARTHEST}" * (far > FARTHEST)
            case ActionKind.JOINT_VELOCITY:
                return "targets move gradually within a frame instead of at its start"
            case _:
                return "joint targets are found by inverse kinematics, which may choose another posture of the arm"

    def _arm(self, name: str) -> Arm:
        if name not in self._arms:
            self._arms[name] = Arm(self._sampler.task.scene.robot(name))
        return self._arms[name]

    def _action_limits(self) -> Array:
        if self._limits is None:
            world = self._sampler.world
            robots = {name: world.robot(name) for name in self._sampler.task.robots}
            self._limits = action_limits(self.space, world.scene, robots)
        return self._limits
