"""The interface of policies, and their observations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import SceneState

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
    m/s], by ``action_space``) and then its gripper, 0 open to 1 closed.
    """

    @property
    def name(self) -> str:
        """Name in reports."""
        ...

    @property
    def action_space(self) -> ActionSpace:
        """Meaning of the arm's numbers."""
        ...

    @property
    def cameras(self) -> Mapping[str, ImageSize]:
        """Cameras of the scene that the policy uses, with their image sizes; nothing else is rendered."""
        ...

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout. All randomness of the policy must derive from ``seed``."""
        ...

    def infer(self, observation: Observation) -> Array:
        """Return actions to apply before the next call, shape (horizon, numbers of an action)."""
        ...

    def close(self) -> None:
        """Release all resources."""
        ...


class PolicyError(SimfoundryError):
    """A policy that cannot be queried or does not answer, so its performance is unknown; the message gives the
    remedy.
    """


class InvalidAnswerError(PolicyError):
    """A policy's answer that is an error or not an array of actions; the rollout counts as failed."""
