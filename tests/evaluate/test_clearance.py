"""Bounds on distances: a condition that they exclude is false in every state of a rollout."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.clearance import Clearances
from simfoundry.evaluate.task import Task
from simfoundry.predicates import Judge
from simfoundry.worlds.mujoco_world import MujocoWorld

CONDITIONS = (
    "Touching(arm, block)",
    "Touching(dish, arm)",
    "Touching(block, dish)",
    "OnTop(block, dish)",
    "OnTop(crumb, dish)",
    {"any": ("Touching(arm, block)", "Touching(block, dish)")},
)


def test_what_bounds_exclude_is_false(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    judge = Judge(push.scene)
    clearances, arm, excluded = Clearances(push.scene, judge), push_world.robot("arm"), dict.fromkeys(range(6), 0)
    push_world.reset(push_starts[0].state)
    touched = False
    for reach in np.linspace(0.0, 0.4, 40):  # past the block
        arm.set_targets({"turn": 0.0, "reach": float(reach)})
        push_world.step(33)
        state = push_world.state()
        for k, condition in enumerate(CONDITIONS):
            value = judge(condition, state).value
            assert not (value and clearances.excludes(condition, state)), condition
            excluded[k] += clearances.excludes(condition, state)
        touched = touched or judge(CONDITIONS[0], state).value
    assert touched and excluded[0] > 0 and excluded[2] > 30 and excluded[3] > 30 and excluded[4] == 0


@pytest.mark.parametrize("condition", ["Upright(block)", "At(block, 0.45, 0)", {"not": "Touching(block, dish)"}])
def test_other_conditions_are_left_to_the_judge(condition: object, push: Task, push_world: MujocoWorld) -> None:
    assert not Clearances(push.scene, Judge(push.scene)).excludes(condition, push_world.state())
