"""Stated goals: accepted, refused with a reason, recognized as duplicates."""

from __future__ import annotations

import pytest

from simfoundry.cousins.tasks.acceptance import AcceptedTask, accept
from simfoundry.cousins.tasks.candidate_poses import meaning
from simfoundry.cousins.tasks.context import TaskContext


def why(setting: TaskContext, goal: object) -> tuple[str, str]:
    reasons = accept(goal, setting)
    return (reasons[0].code, reasons[0].text) if isinstance(reasons, tuple) else ("", "")


@pytest.mark.parametrize(
    ("goal", "code", "said"),
    [
        ("Inside(ball, bucket)", "unknown_name", "no object is called `bucket`"),
        ("Inside(ball, cabinet.door)", "unknown_name", "`cabinet` has no part `door`"),
        ("Boiled(ball)", "bad_goal", "`Boiled` is not a predicate"),
        ("Inside(ball)", "bad_goal", "takes 2 arguments"),
        ("Inside(ball, ball)", "bad_goal", "requires two different objects"),
        ({"all": []}, "bad_goal", "has 0"),
        ({"not": "OnTop(ball, bowl)"}, "already_true", "already holds"),
        ({"not": "OnTop(bowl, desk)"}, "no_change", "only requires predicates to be false"),
        ("OnTop(bowl, desk)", "already_true", "touches `desk`"),
        ("Closed(cabinet.drawer)", "already_true", "0.0%"),
        ("Inside(block, ball)", "impossible", "no cavity"),
        ("Inside(cabinet, bowl)", "too_heavy", "can only lift 2 kg"),
        ("OnTop(ball, block)", "impossible", "placements of `ball` (6.7 x 6.7 x 6.7 cm)"),
        ("Open(bowl)", "impossible", "bowl"),
        ("At(block, 1.3, 0)", "out_of_reach", "reaches 0.855 m"),
        ("Lifted(wide)", "too_wide", "fingers only open to"),
        ({"all": ["Inside(ball, bowl)", "OnTop(ball, cabinet)"]}, "impossible", "did not become true"),
    ],
)
def test_refused(setting: TaskContext, goal: object, code: str, said: str) -> None:
    found = why(setting, goal)
    assert found[0] == code, found
    assert said in found[1]


@pytest.mark.parametrize(
    "goal",
    [
        "RightOf(block, bowl)",
        "NextTo(ball, bowl)",
        "Lifted(ball)",
        {"any": ["OnTop(wide, bowl)", "OnTop(block, bowl)"]},
        {"all": ["Open(cabinet.drawer)", {"not": "Open(cabinet.bottom_drawer)"}]},
        {"all": ["Inside(ball, bowl)", "Released(ball)"]},
    ],
)
def test_accepted(setting: TaskContext, goal: object) -> None:
    assert isinstance(accept(goal, setting), AcceptedTask)


def test_a_duplicate_is_told_by_its_meaning(setting: TaskContext) -> None:
    first = AcceptedTask("first", {"all": ["Inside(ball, bowl)", "Released(ball)"]})
    refused = accept("In(ball, bowl)", setting, [first])
    assert isinstance(refused, tuple)
    (reason,) = refused
    assert (reason.code, reason.text) == ("duplicate", "it has the same goal as `first`")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Under(a, b)", "Above(b, a)"),
        ("RightOf(a, b)", "LeftOf(b, a)"),
        ("NextTo(a, b)", "NextTo(b, a)"),
        ({"all": ["Open(a)", "Inside(b, c)"]}, {"all": [{"all": ["Inside(b, c)"]}, "Open(a)", "Open(a)"]}),
        ({"not": {"not": "Open(a)"}}, "Open(a)"),
    ],
)
def test_one_meaning(one: object, other: object) -> None:
    assert meaning(one) == meaning(other)


def test_released_counts_where_nothing_else_says_it() -> None:
    assert meaning({"all": ["Lifted(a)", "Released(a)"]}) != meaning("Lifted(a)")
    assert meaning("Inside(a, b)") != meaning("Inside(b, a)")
