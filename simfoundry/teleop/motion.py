"""Motions of one arm: they turn the latest commands into the arm values of the next action."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from simfoundry.evaluate.actions import rotation_numbers, rotation_quat
from simfoundry.evaluate.policies.base import RobotReading
from simfoundry.evaluate.rollouts.control import HAND_AHEAD, HAND_TURN
from simfoundry.geometry.frames import Array, Pose
from simfoundry.spec.models.signals import (
    MAX_ROTATION,
    MAX_TRANSLATION,
    MAX_VELOCITY,
    ActionKind,
    ActionSpace,
    RotationForm,
)
from simfoundry.teleop.commands import Command, HandTarget, HandTwist, JointTargets, TrackedPose

# Largest speed at which a hand follows a pose [m/s, rad/s]: twice what people use at a table, so that a jump of a
# device becomes a motion.
HAND_SPEED, HAND_TURN_SPEED = 1.0, 3.0

# Speed at which a robot approaches its leader when an attempt begins [rad/s or m/s], and the distance at which it has
# reached it [rad or m].
ALIGN_SPEED, ALIGNED = 0.5, 0.05


class ArmMotion(ABC):
    """The motion of an arm between two attempts' beginnings."""

    @abstractmethod
    def begin(self, reading: RobotReading) -> None:
        """Begin an attempt, in which the arm stays where it is until there are commands."""

    @abstractmethod
    def accept(self, command: Command) -> None:
        """Take in a command for this arm. Commands of other kinds are ignored."""

    @abstractmethod
    def next(self, reading: RobotReading) -> Array:
        """Return the arm values of the next action."""


class TwistMotion(ArmMotion):
    """Motion at a velocity: changes of the hand's pose along the axes of the world.

    If a velocity lasts for less than an action, such as that of a key that is only tapped, it counts for one action.
    """

    def __init__(self, period: float, R_WO: Array) -> None:
        """Move for actions of a duration [s], with velocities in axes that ``R_WO`` rotates to those of the world."""
        self._period, self._R_WO = period, R_WO
        self._twist = self._peak = np.zeros(6)

    def begin(self, reading: RobotReading) -> None:
        """Keep the velocity, because a key may be held while the attempt begins."""

    def accept(self, command: Command) -> None:
        """Take in a velocity."""
        if isinstance(command, HandTwist):
            self._twist = np.concatenate([self._R_WO @ command.linear, self._R_WO @ command.angular])
            if self._twist.any() or not self._peak.any():
                self._peak = self._twist

    def next(self, reading: RobotReading) -> Array:
        """Return the change of the pose."""
        values, self._peak = self._peak * self._period, self._twist
        return np.clip(values, [-MAX_TRANSLATION] * 3 + [-MAX_ROTATION] * 3, [MAX_TRANSLATION] * 3 + [MAX_ROTATION] * 3)


class PoseMotion(ArmMotion):
    """Motion toward a pose of the hand in the world, at a limited speed."""

    def __init__(self, period: float, R_WO: Array, scale: float) -> None:
        """Follow poses.

        Args:
            period: The duration of an action [s].
            R_WO: The rotation from the axes of the operator to those of the world.
            scale: Motion of the hand for each meter that a tracked controller moves.
        """
        self._period, self._X_WO, self._scale = period, Pose.from_matrix(R_WO), scale
        self._at: Pose = Pose.of()
        self._goal: Pose | None = None
        self._anchor: tuple[Pose, Pose] | None = None

    @property
    def goal(self) -> Pose:
        """The pose that the hand is to reach, ``X_WH``."""
        return self._at if self._goal is None else self._goal

    def begin(self, reading: RobotReading) -> None:
        """Hold the hand where it is. A clutch that is pressed starts from there."""
        self._at, self._goal, self._anchor = reading.X_WH, None, None

    def accept(self, command: Command) -> None:
        """Take in a pose of the hand or of a controller."""
        match command:
            case HandTarget(_, X_WH):
                self._goal = X_WH
            case TrackedPose(_, _, False):
                self._goal, self._anchor = None, None
            case TrackedPose(_, X_OC, True):
                if self._anchor is None:
                    self._anchor = X_OC, self._at
                X_OA, X_WH = self._anchor
                R_WO = Pose.of(q=self._X_WO.q)
                turn = R_WO @ Pose.of(q=X_OC.q) @ Pose.of(q=X_OA.q).inverse() @ R_WO.inverse()
                p = X_WH.p + self._scale * R_WO.apply(X_OC.p - X_OA.p)
                self._goal = Pose.of(p, (turn @ Pose.of(q=X_WH.q)).q)

    def next(self, reading: RobotReading) -> Array:
        """Return the next pose on the way."""
        if self._goal is not None:
            self._at = _toward(self._at, self._goal, HAND_SPEED * self._period, HAND_TURN_SPEED * self._period)
        self._at = _toward(reading.X_WH, self._at, HAND_AHEAD, HAND_TURN)  # an arm that is blocked does not wind up
        return np.concatenate([self._at.p, self._at.q])


class JointMotion(ArmMotion):
    """Motion toward the positions of a leader's joints, at a limited speed."""

    def __init__(self, period: float) -> None:
        """Move for actions of a duration [s]."""
        self._period = period
        self._at: Array = np.zeros(0)
        self._goal: Array | None = None
        self._is_aligned = False

    def begin(self, reading: RobotReading) -> None:
        """Hold the joints where they are, and approach the leader slowly."""
        self._at, self._is_aligned = np.array(reading.joints), False

    def accept(self, command: Command) -> None:
        """Take in the positions of a leader."""
        if isinstance(command, JointTargets):
            self._goal = command.positions

    def next(self, reading: RobotReading) -> Array:
        """Return the next positions on the way."""
        if self._goal is not None:
            step = (MAX_VELOCITY if self._is_aligned else ALIGN_SPEED) * self._period
            self._at = self._at + np.clip(self._goal - self._at, -step, step)
            self._is_aligned = self._is_aligned or bool((np.abs(self._goal - self._at) <= ALIGNED).all())
        return self._at


def _toward(start: Pose, end: Pose, distance: float, angle: float) -> Pose:
    """Return the pose on the way from one to another, after at most a distance [m] and an angle [rad]."""
    shift = end.p - start.p
    length = float(np.linalg.norm(shift))
    X_SE = Pose.of(q=start.q).inverse() @ Pose.of(q=end.q)
    turn = rotation_numbers(X_SE.q, RotationForm.ROTVEC)
    size = float(np.linalg.norm(turn))
    if length <= distance and size <= angle:
        return end
    p = start.p + shift * min(1.0, distance / max(length, distance))
    part = Pose.of(q=rotation_quat(turn * min(1.0, angle / max(size, angle)), RotationForm.ROTVEC))
    return Pose.of(p, (Pose.of(q=start.q) @ part).q)


def arm_motion(space: ActionSpace, period: float, R_WO: Array, scale: float) -> ArmMotion:
    """Return the motion for an action space that devices use."""
    match space.kind:
        case ActionKind.HAND_DELTA:
            return TwistMotion(period, R_WO)
        case ActionKind.HAND_POSE:
            return PoseMotion(period, R_WO, scale)
        case ActionKind.JOINT_POSITION:
            return JointMotion(period)
    raise ValueError(f"no device moves in `{space}`")
