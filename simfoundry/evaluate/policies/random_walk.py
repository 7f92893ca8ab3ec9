"""A policy that moves at random, as a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, Observation
from simfoundry.geometry.frames import Array

STEP = 0.1
"""Maximum joint motion per step in either direction [rad or m]: 1.5 rad/s at 15 Hz."""
HORIZON = 8
"""Number of actions per query, as for the paper's policies."""


class RandomPolicy:
    """A random walk of the joints from their present positions, with steps up to ``STEP``; the gripper toggles
    occasionally.
    """

    name = "random"
    action_space = ActionSpace.JOINT_POSITION
    cameras: Mapping[str, ImageSize] = MappingProxyType({})

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout; equal seeds give equal walks."""
        self._rng = np.random.default_rng(seed)

    def infer(self, observation: Observation) -> Array:
        """Return joint positions, shape (HORIZON, numbers of an action)."""
        columns: list[Array] = []
        for robot in observation.robots.values():
            steps = self._rng.uniform(-STEP, STEP, (HORIZON, len(robot.joints)))
            columns.append(np.asarray(robot.joints) + np.cumsum(steps, axis=0))
            columns.append(np.full((HORIZON, 1), float(self._rng.integers(2))))
        return np.concatenate(columns, axis=1) if columns else np.zeros((HORIZON, 0))

    def close(self) -> None:
        """Do nothing: there are no resources to release."""
