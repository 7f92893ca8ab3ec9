"""The interface that all policies implement, and the observations that policies receive."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import SceneState

if TYPE_CHECKING:
    from simfoundry.worlds.base import WorldRobot

# A color image, shape (height, width, 3).
Image = NDArray[np.uint8]


class ActionSpace(StrEnum):
    """The meaning of the numbers in an action.

    Protocols do not transmit this information, so each policy has to declare it.
    """

    JOINT_POSITION = "joint_position"
    JOINT_VELOCITY = "joint_velocity"


@dataclass(frozen=True)
class ImageSize:
    """The size of an image that a policy requests [px]."""

    width: int
    height: int


@dataclass(frozen=True, eq=False)
class RobotReading:
    """The proprioceptive state of a robot.

    Attributes:
        joints: The positions of the arm's joints in order [rad or m], shape (n,).
        gripper: The position of the gripper, from 0 (open) to 1 (closed).
        X_WH: The pose of the hand in the world.
        X_BH: The pose of the hand in the robot's base frame.
    """

    joints: Array
    gripper: float
    X_WH: Pose
    X_BH: Pose


@dataclass(frozen=True, eq=False)
class Observation:
    """The input of a policy.

    Attributes:
        time: The time since the start of the rollout [s].
        instruction: The instruction of the task.
        robots: The readings of the robots that act, in the order of the task.
        images: The requested images, keyed by the name of the camera in the scene.
        state: The true state, for privileged policies such as the scripted expert.
    """

    time: float
    instruction: str
    robots: Mapping[str, RobotReading]
    images: Mapping[str, Image]
    state: SceneState


class Policy(Protocol):
    """A policy, which determines the next actions of the robots.

    An action lists the values for each robot, in the order of the task: the arm's joint values, followed by the gripper
    position from 0 (open) to 1 (closed). The joint values are positions [rad or m] or velocities [rad/s or m/s],
    depending on ``action_space``. ``name`` is used in reports. ``cameras`` maps the cameras that the policy uses to the
    size of their images. No other cameras are rendered.
    """

    name: str
    action_space: ActionSpace
    cameras: Mapping[str, ImageSize] = MappingProxyType({})

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout.

        All randomness in the policy must derive from ``seed``.
        """

    @abstractmethod
    def infer(self, observation: Observation) -> Array:
        """Return the actions to apply before the next call, as an array of shape (horizon, action size)."""

    def close(self) -> None:
        """Release all resources."""
        return


class PolicyError(SimfoundryError):
    """An error raised if a policy cannot be queried or does not respond.

    The performance of the policy then remains unknown. The message explains how to fix the problem.
    """


class InvalidAnswerError(PolicyError):
    """An error raised if a policy does not return a valid array of actions.

    The rollout then fails.
    """


def action_size(robots: Mapping[str, RobotReading | WorldRobot]) -> int:
    """Return the length of an action, which consists of the joint values and the gripper position of each robot."""
    return sum(len(robot.joints) + 1 for robot in robots.values())


def checked_actions(
    actions: object, robots: Mapping[str, RobotReading | WorldRobot], subject: str = "actions", single: bool = False
) -> Array:
    """Validate the response from a policy and return it as an array of finite actions.

    Args:
        actions: The response, which may be any object.
        robots: The robots to be controlled.
        subject: A description of the response for error messages.
        single: If true, a single action is expected instead of a sequence of actions.

    Returns:
        The actions, as an array of shape (horizon, action size), or (action size,) if ``single`` is set.

    Raises:
        InvalidAnswerError: If the response is not such an array.
    """
    size = action_size(robots)
    try:
        array = np.asarray(actions)
        if array.dtype.kind not in "fiubO":  # NumPy would convert complex numbers and text
            raise TypeError(f"it is an array of `{array.dtype}`")
        array = np.array(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        message = f"{subject} must be an array of numbers, got {type(actions).__name__}: {error}"
        raise InvalidAnswerError(message) from None
    if array.ndim != (1 if single else 2) or array.shape[-1] != size or not len(array):
        shape = f"({size},)" if single else f"(horizon, {size})"
        words = " + ".join(f"{len(r.joints)} joints and the gripper of `{n}`" for n, r in robots.items())
        raise InvalidAnswerError(f"{subject} must have shape {shape}, for {words}; got {array.shape}")
    for *row, column in np.argwhere(~np.isfinite(array)).tolist():
        at = f"number {column}" + "".join(f" of action {k}" for k in row)
        raise InvalidAnswerError(f"{subject} must be finite; {at} is {array[*row, column]}")
    return array
