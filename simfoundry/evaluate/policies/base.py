"""The interface of policies, and their observations."""

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

Image = NDArray[np.uint8]
"""A color image, shape (height, width, 3)."""


class ActionSpace(StrEnum):
    """Meaning of the numbers of an action; protocols do not transmit it, so a policy's spec states it."""

    JOINT_POSITION = "joint_position"
    JOINT_VELOCITY = "joint_velocity"


@dataclass(frozen=True)
class ImageSize:
    """Size in pixels of an image requested by a policy."""

    width: int
    height: int


@dataclass(frozen=True, eq=False)
class RobotReading:
    """A robot's proprioception: ``joints`` [rad or m] of the arm in order, shape (n,); ``gripper`` 0 open to 1 closed.

    ``X_WH`` is the pose of its hand in the world, ``X_BH`` in its base.
    """

    joints: Array
    gripper: float
    X_WH: Pose
    X_BH: Pose


@dataclass(frozen=True, eq=False)
class Observation:
    """The input of a policy.

    ``time`` [s] since the start; ``robots`` that act, in the task's order; requested ``images`` by camera of the scene;
    ``state`` is the true state, for privileged policies such as the scripted expert.
    """

    time: float
    instruction: str
    robots: Mapping[str, RobotReading]
    images: Mapping[str, Image]
    state: SceneState


class Policy(Protocol):
    """A policy, which determines the robots' next actions.

    An action has, for each robot of the task in order, its arm's joints (positions [rad or m], or velocities [rad/s or
    m/s], by ``action_space``) and then its gripper, 0 open to 1 closed. ``name`` is that in reports; ``cameras`` are
    those of the scene that the policy uses, with their image sizes; nothing else is rendered.
    """

    name: str
    action_space: ActionSpace
    cameras: Mapping[str, ImageSize] = MappingProxyType({})

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout. All randomness of the policy must derive from ``seed``."""

    @abstractmethod
    def infer(self, observation: Observation) -> Array:
        """Return actions to apply before the next call, shape (horizon, numbers of an action)."""

    def close(self) -> None:
        """Release all resources."""
        return


class PolicyError(SimfoundryError):
    """A policy that cannot be queried or does not answer, so its performance is unknown; the message gives the
    remedy.
    """


class InvalidAnswerError(PolicyError):
    """A policy's answer that is an error or not an array of actions; the rollout counts as failed."""


def action_size(robots: Mapping[str, RobotReading | WorldRobot]) -> int:
    """Length of an action: for each robot its joints and its gripper."""
    return sum(len(robot.joints) + 1 for robot in robots.values())


def checked_actions(
    actions: object, robots: Mapping[str, RobotReading | WorldRobot], subject: str = "actions", single: bool = False
) -> Array:
    """Validate the answer of a policy as finite actions, shape (horizon, numbers of an action), or one if ``single``.

    Raises :class:`InvalidAnswerError`, whose message is about ``subject``.
    """
    size = action_size(robots)
    try:
        array = np.asarray(actions)
        if array.dtype.kind not in "fiubO":  # NumPy would convert complex numbers and text
            raise TypeError(f"an array of `{array.dtype}`")
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
