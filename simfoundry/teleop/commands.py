"""Commands: the common language of all devices."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from simfoundry.geometry.frames import Array, Pose


class Control(StrEnum):
    """A request of the person about the attempt rather than about the robots."""

    SAVE = "save"
    """Keep the rollout as a demonstration, after it has succeeded."""
    DISCARD = "discard"
    """Give up the attempt, and go on with the next initial state."""
    RETRY = "retry"
    """Repeat the attempt from the same initial state."""
    PAUSE = "pause"
    """Pause the rollout, or resume it."""
    MARK = "mark"
    """Mark the present moment as the end of a sub-task."""
    QUIT = "quit"
    """End the session."""


@dataclass(frozen=True, eq=False)
class HandTwist:
    """A velocity of a hand, which lasts until the next one.

    Attributes:
        robot: The robot, or an empty string for the active one.
        linear: Velocity of the hand's origin in the axes of the operator [m/s], shape (3,): forward, left, up.
        angular: Angular velocity about these axes [rad/s], shape (3,).
    """

    robot: str
    linear: Array
    angular: Array


@dataclass(frozen=True, eq=False)
class HandTarget:
    """A pose that a hand is to reach, ``X_WH`` in the world. None holds the hand where it is."""

    robot: str
    X_WH: Pose | None


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """A pose of a tracked controller, whose motion moves the hand while the clutch is pressed.

    Attributes:
        robot: The robot, or an empty string for the active one.
        X_OC: The pose of the controller in the frame of the operator: x forward, y left, z up [m].
        is_engaged: Whether the clutch is pressed.
    """

    robot: str
    X_OC: Pose
    is_engaged: bool


@dataclass(frozen=True, eq=False)
class JointTargets:
    """Positions [rad or m] that the joints of an arm are to reach, in the order from the base, shape (joints,)."""

    robot: str
    positions: Array


@dataclass(frozen=True)
class GripperTarget:
    """A target of a gripper, from 0 (open) to 1 (closed). None toggles it."""

    robot: str
    value: float | None


@dataclass(frozen=True)
class SwitchArm:
    """A request to move the next robot of the task from now on."""


@dataclass(frozen=True)
class ControlPress:
    """A press of a button that controls the attempt."""

    control: Control


Command = HandTwist | HandTarget | TrackedPose | JointTargets | GripperTarget | SwitchArm | ControlPress
