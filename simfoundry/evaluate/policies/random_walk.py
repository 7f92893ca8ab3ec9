"""A policy that moves at random: what any other must beat."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, Observation
from simfoundry.geometry.frames import Array

STEP = 0.1
"""Largest move of a joint in one step, either way [rad or m]: 1.5 rad/s at 15 Hz."""
HORIZON = 8
"""Steps until it is asked again, as the policies of the paper."""


class RandomPolicy:
    """Joints walk at random from where they are, each step up to ``STEP``; the gripper opens or closes now and then."""

    name = "random"
    action_space = ActionSpace.JOINT_POSITION
    cameras: Mapping[str, ImageSize] = MappingProxyType({})

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def reset(self, instruction: str, seed: int) -> None:
        """Begin a rollout: the same seed, the same walk."""
        self._rng = np.random.default_rng(seed)

    def infer(self, observation: Observation) -> Array:
        """Joint positions, shape (HORIZON, numbers of an action)."""
        columns: list[Array] = []
        for robot in observation.robots.values():
            steps = self._rng.uniform(-STEP, STEP, (HORIZON, len(robot.joints)))
            columns.append(np.asarray(robot.joints) + np.cumsum(steps, axis=0))
            columns.append(np.full((HORIZON, 1), float(self._rng.integers(2))))
        return np.concatenate(columns, axis=1) if columns else np.zeros((HORIZON, 0))

    def close(self) -> None:
        """Nothing is held."""
