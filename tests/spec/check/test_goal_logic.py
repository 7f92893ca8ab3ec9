"""Goals that are the same in every state, decided from their predicates alone."""

from __future__ import annotations

from typing import Any

import pytest

from simfoundry.spec.check.goal_logic import MAX_WRITTEN, verdict

A, B = "OnTop(a, b)", "Open(x.d)"

NEVER: list[Any] = [
    {"all": [A, {"not": A}]},
    {"all": [A, "OnTop(b, a)"]},
    {"all": [A, "On(b, a)"]},  # an alias
    {"all": ["Inside(a, b)", "Inside(b, c)", "Inside(c, a)"]},
    {"all": ["LeftOf(a, b)", "RightOf(a, b)"]},
    {"all": [B, {"any": ["Closed(x.d)", {"not": B}]}]},
    {"any": [{"all": [B, "Closed(x.d)"]}, {"all": ["Grasped(a)", "Released(a)"]}]},
    {"all": ["Grasped(a, arm)", "Inside(a, b)"]},
    {"not": {"any": [A, {"not": A}]}},
]
ALWAYS: list[Any] = [
    {"any": [A, {"not": A}]},
    {"not": {"all": [B, "Closed(x.d)"]}},
    {"any": [{"not": A}, {"not": "OnTop(b, a)"}]},
]
SENSIBLE: list[Any] = [
    A,
    {"not": A},
    {"all": [A, "OnTop(b, c)"]},
    {"all": ["Inside(a, b)", "Released(a)", "Upright(a)"]},
    {"all": ["LeftOf(a, b)", "RightOf(b, a)"]},
    {"all": [B, "Closed(y.d)"]},
    {"all": ["Grasped(a)", "Released(b)"]},
    {"all": ["OnTop(a, b)", "OnTop(b, c)", "OnTop(c, a)"]},  # three sticks can rest on each other
    {"not": {"any": [B, {"not": "Closed(x.d)"}]}},
    {"any": [A, B]},
    "NoPredicate(a)",
    {"all": []},
]


@pytest.mark.parametrize("goal", NEVER, ids=str)
def test_a_contradiction_can_never_hold(goal: Any) -> None:
    assert verdict(goal)[0] is False


@pytest.mark.parametrize("goal", ALWAYS, ids=str)
def test_some_goals_can_never_be_false(goal: Any) -> None:
    assert verdict(goal)[0] is True


@pytest.mark.parametrize("goal", SENSIBLE, ids=str)
def test_other_goals_depend_on_the_state(goal: Any) -> None:
    assert verdict(goal)[0] is None


def test_what_excludes_each_other_is_named() -> None:
    assert verdict({"all": ["Upright(a)", A, "OnTop(b, a)"]}) == (False, ("OnTop(a, b)", "OnTop(b, a)"))
    assert verdict({"all": [A, {"not": A}]}) == (False, (A,))


def test_a_goal_beyond_all_measure_is_left_alone() -> None:
    assert verdict({"all": [f"OnTop(a{k}, b)" for k in range(MAX_WRITTEN)] + [A, {"not": A}]}) == (None, ())
    assert verdict({"any": [{"not": A}, *(f"OnTop(a{k}, b)" for k in range(MAX_WRITTEN - 1))]}) == (None, ())
