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
"""A colour picture, shape (height, width, 3)."""


class ActionSpace(StrEnum):
    """Meaning of the numbers of an action; no protocol transmits it, so a policy's spec says it."""

    JOINT_POSITION = "joint_position"
    JOINT_VELOCITY = "joint_velocity"


@dataclass(frozen=True)
class ImageSize:
    """Pixels of a picture that a policy asks for."""

    width: int
    height: int


@dataclass(frozen=True, eq=False)
class RobotReading:
    """A robot's own senses: ``joints`` [rad or m] of the arm in order, shape (n,); ``gripper`` 0 open to 1 closed.

    ``X_WH`` is the pose of its hand in the world, ``X_BH`` in its base.
    """

    joints: Array
    gripper: float
    X_WH: Pose
    X_BH: Pose


@dataclass(frozen=True, eq=False)
class Observation:
    """The input of a policy that is asked for actions.

    ``time`` [s] since the start; ``robots`` those that act, in the task's order; ``images`` by the scene's cameras,
    those that the policy asked for; ``state`` the truth, for policies that may cheat, as the scripted expert.
    """

    time: float
    instruction: str
    robots: Mapping[str, RobotReading]
    images: Mapping[str, Image]
    state: SceneState


class Policy(Protocol):
    """Something that says what robots do next.

    An action has, for each robot of the task in order, its arm's joints (positions [rad or m], or velocities [rad/s or
    m/s], by ``action_space``) and then its gripper, 0 open to 1 closed.
    """

    @property
    def name(self) -> str:
        """The name in reports."""
        ...

    @property
    def action_space(self) -> ActionSpace:
        """The meaning of the arm's numbers."""
        ...

    @property
    def cameras(self) -> Mapping[str, ImageSize]:
        """The cameras of the scene that it wants to see through, and in what size; nothing else is rendered."""
        ...

    def reset(self, instruction: str, seed: int) -> None:
        """Begin a rollout. Whatever is random in the policy starts from ``seed``."""
        ...

    def infer(self, observation: Observation) -> Array:
        """Actions to carry out one after another before it is asked again, shape (horizon, numbers of an action)."""
        ...

    def close(self) -> None:
        """Let go of what it holds."""
        ...


class PolicyError(SimfoundryError):
    """A policy cannot be asked or does not answer: nothing is known of how well it acts. It says what to do."""


class InvalidAnswerError(PolicyError):
    """A policy answered with an error or with something that is not actions: what it was asked in has failed."""
