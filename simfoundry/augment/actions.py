"""Conversion of joint targets to the action space of the demonstrations, action by action."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simfoundry.data.action_conversion import arm_values
from simfoundry.data.attempt import ENGINE
from simfoundry.evaluate.actions import action_limits, normalized
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array
from simfoundry.robots.arm import Arm
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.worlds import open_world


class CommandConverter:
    """Converts the joint targets and gripper commands of successive actions."""

    def __init__(self, task: Task, arms: Mapping[str, Arm], space: ActionSpace, hz: float) -> None:
        self._arms, self._space, self._hz = arms, space, hz
        self._before: dict[str, Array] = {}
        self._limits = _limits(task, space) if space.normalized else None

    def begin(self, q: Mapping[str, Array]) -> None:
        """Start from the joint positions of each robot [rad or m]."""
        self._before = dict(q)

    def action(self, q: Mapping[str, Array], grippers: Mapping[str, float]) -> Array:
        """Return the action that moves the joint targets to ``q`` [rad or m], shape (action size,)."""
        parts = []
        for name, arm in self._arms.items():
            rows = np.array([self._before[name], q[name]])
            parts.append(np.append(arm_values(arm, rows, self._space, self._hz)[0], grippers[name]))
        self._before = dict(q)
        values = np.concatenate(parts)
        return values if self._limits is None else np.clip(normalized(values, self._limits), -1.0, 1.0)


def _limits(task: Task, space: ActionSpace) -> Array:
    world = open_world(task.scene, ENGINE)
    try:
        return action_limits(space, world.scene, {name: world.robot(name) for name in task.robots})
    finally:
        world.close()
