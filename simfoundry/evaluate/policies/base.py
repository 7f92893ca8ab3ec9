"""The interface that all policies implement, and the observations that policies receive."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace, ImageKind

# A color image, shape (height, width, 3).
Image = NDArray[np.uint8]


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
        robots: The readings of the robots that act, in the order of the task, with the latency and noise of the task.
        images: The requested color images, keyed by the name of the camera in the scene.
        depths: The requested depth images [m], float32, shape (height, width), 0 where nothing is visible.
        masks: The requested instance masks, int32, shape (height, width); values are explained by
            :func:`simfoundry.worlds.base.instances`.
        state: The true state, for privileged policies such as the scripted expert.
        sensed: The state with the latency and noise of the task, or None if it is the true state. Policies that are not
            privileged use it through :attr:`objects` and :attr:`joints`.
        true_robots: The true readings of the robots, for privileged policies, or None if they are those in ``robots``.
    """

    time: float
    instruction: str
    robots: Mapping[str, RobotReading]
    images: Mapping[str, Image]
    state: SceneState
    depths: Mapping[str, NDArray[np.float32]] = field(default_factory=lambda: MappingProxyType({}))
    masks: Mapping[str, NDArray[np.int32]] = field(default_factory=lambda: MappingProxyType({}))
    sensed: SceneState | None = None
    true_robots: Mapping[str, RobotReading] | None = None

    @property
    def objects(self) -> Mapping[str, Pose]:
        """The observed poses of the objects, keyed by name."""
        return (self.sensed or self.state).poses

    @property
    def joints(self) -> Mapping[str, float]:
        """The observed positions of the objects' joints [rad or m], keyed by ``object.joint``."""
        return (self.sensed or self.state).joints

    def privileged(self) -> Observation:
        """Return the observation with the true readings of the robots."""
        return self if self.true_robots is None else replace(self, robots=self.true_robots)


class Policy(Protocol):
    """A policy, which determines the next actions of the robots.

    :class:`~simfoundry.spec.models.signals.ActionSpace` describes the numbers in an action. ``control_hz`` is the
    number of actions per second [Hz], or None for the control frequency of the task. ``name`` is used in reports.
    ``cameras`` maps the cameras that the policy uses to the size of their images, and ``image_kinds`` lists the kinds
    of images of each of them. No other cameras are rendered. ``origin`` states where the actions of the present rollout
    come from, as plain data that is stored with a recorded attempt.
    """

    name: str
    action_space: ActionSpace
    control_hz: float | None = None
    image_kinds: tuple[ImageKind, ...] = (ImageKind.COLOR,)
    cameras: Mapping[str, ImageSize] = MappingProxyType({})
    origin: Mapping[str, Any] = MappingProxyType({})

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


class GaveUpError(PolicyError):
    """An error raised if a policy knows that it cannot succeed. The rollout then fails, with the message as reason."""
