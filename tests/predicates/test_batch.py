"""Many states at once are judged as each alone, and nothing changes where the whole scene is moved and turned."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.predicates import Judge, PredicateError
from tests.corpora.predicates import moved
from tests.predicates.conftest import Setting
from tests.predicates.random_states import CASES, Case, random_batch, scene, states

FIRST = [cases[0] for cases in CASES.values() if cases[0].b != "arm"]


@pytest.mark.parametrize("case", FIRST, ids=[case.condition.partition("(")[0] for case in FIRST])
def test_batches_and_moved_scenes_agree(case: Case) -> None:
    rng = np.random.default_rng(5)
    batch = random_batch(case, 40, rng)
    judge = Judge(scene(case.scene))
    values, margins = judge.batch(case.condition, batch)
    assert values.any()
    assert not values.all()
    assert np.array_equal(values, margins > 0)
    alone = [judge(case.condition, state) for state in states(batch)]
    assert [v.value for v in alone] == values.tolist()
    assert all(v.why for v in alone)
    other, condition, there = moved(case, batch, rng)
    assert np.array_equal(Judge(other).batch(condition, there)[0], values)


def test_conditions_that_are_judged_together_hold_as_each_alone() -> None:
    """Also joined ones, of which parts are left out where they decide nothing."""
    case = FIRST[0]
    batch, judge = random_batch(case, 40, np.random.default_rng(6)), Judge(scene(case.scene))
    upright = f"Upright({case.a})"
    joined: dict[str, object] = {
        "one": case.condition,
        "all": {"all": [case.condition, upright, {"not": case.condition}]},
        "any": {"any": [upright, {"all": [case.condition, {"not": upright}]}]},
    }
    found = judge.holds(joined, batch)
    for name, condition in joined.items():
        assert np.array_equal(found[name], judge.batch(condition, batch)[0]), name
    assert found["any"].any() and not found["all"].any()


def test_conditions_are_joined(boxes: Setting) -> None:
    judge, state = boxes.judge, boxes.start
    on, off = "OnTop(a, desk)", "OnTop(a, b)"
    assert judge({"all": [on, off]}, state).value is False
    assert judge({"any": [on, off]}, state).value is True
    assert judge({"not": off}, state).value is True
    assert judge({"not": on}, state).margin == -judge(on, state).margin
    assert judge({"all": [on, off]}, state).why == judge(off, state).why
    assert judge({"all": [on, {"not": off}]}, state).margin == pytest.approx(judge(on, state).margin)


@pytest.mark.parametrize("joined", ["all", "any"])
def test_an_empty_condition_is_refused(boxes: Setting, joined: str) -> None:
    """It would always hold, or never: the goal of a task that was forgotten."""
    with pytest.raises(PredicateError, match=f"`{joined}` without conditions"):
        boxes.judge({joined: []}, boxes.start)


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("OnTop(a, c)", "there is no `c` in this scene; available objects and robots: desk, a, b"),
        ("OnTop(a.lid, b)", "`a` has no link or joint `lid`; available links and joints: base"),
        ("Open(a)", "no joint of `a` has limits"),
        ("OnTop(a, a)", "refers to the same object twice"),
    ],
)
def test_what_cannot_be_judged_is_said(boxes: Setting, condition: str, message: str) -> None:
    with pytest.raises(PredicateError, match=message):
        boxes.judge(condition, boxes.start)
