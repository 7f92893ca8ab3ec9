"""Scores: the same sign as the value, growing on the way to the goal, and composed by minimum and maximum."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from simfoundry.predicates import Judge, PredicateError
from simfoundry.predicates.judging.judge import score_of
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from tests.conftest import REPOSITORY

CALLS = (
    "OnTop(cup, bowl)",
    "OnTop(cup, desk)",
    "Inside(cup, bowl)",
    "Under(bowl, cup)",
    "Above(cup, bowl)",
    "NextTo(cup, bowl)",
    "Touching(cup, bowl)",
    "LeftOf(cup, bowl)",
    "InFrontOf(cup, bowl)",
    "At(cup, 0.45, 0)",
    "Upright(cup)",
    "Lifted(cup)",
    "Released(cup)",
)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return lower_file(REPOSITORY / "specs" / "scenes" / "cup_in_bowl.scene.yaml")


@pytest.fixture(scope="module")
def judge(scene: Scene) -> Judge:
    return Judge(scene)


def moved(scene: Scene, p: np.ndarray, q: np.ndarray | None = None, speed: float = 0.0) -> SceneState:
    state = SceneState.initial(scene)
    pose = replace(state.poses["cup"], p=p, **({} if q is None else {"q": q / np.linalg.norm(q)}))
    return SceneState.of({**state.poses, "cup": pose}, state.joints, state.motions, state.robots, {"cup": speed})


def random_states(scene: Scene, count: int) -> list[SceneState]:
    rng, bowl = np.random.default_rng(0), SceneState.initial(scene).poses["bowl"].p
    return [
        moved(scene, bowl + rng.normal(0, 0.1, 3) * [1, 1, 0.7], rng.normal(size=4), rng.choice([0.0, 0.3]))
        for _ in range(count)
    ] + [SceneState.initial(scene)]


def test_a_score_has_the_sign_of_the_value(scene: Scene, judge: Judge) -> None:
    for state in random_states(scene, 12):
        for call in CALLS:
            score, value = judge.score(call, state), judge(call, state).value
            assert -1 <= score <= 1 and (score > 0) == value, (call, score, value)


def test_scores_compose(scene: Scene, judge: Judge) -> None:
    calls = CALLS[:6]
    for state in random_states(scene, 4):
        each = [judge.score(call, state) for call in calls]
        assert judge.score({"all": list(calls)}, state) == min(each)
        assert judge.score({"any": list(calls)}, state) == max(each)
        assert judge.score({"not": calls[0]}, state) == -each[0]
        assert judge.score({"any": [{"all": [calls[0], calls[1]]}, {"not": calls[2]}]}, state) == max(
            min(each[:2]), -each[2]
        )
    with pytest.raises(PredicateError, match="without conditions"):
        judge.score({"all": []}, state)


@pytest.mark.parametrize("speed", [0.0, 0.2])
@pytest.mark.parametrize("goal", ["OnTop(cup, bowl)", "Inside(cup, bowl)", "Touching(cup, bowl)", "At(cup, 0.45, 0)"])
def test_the_score_grows_on_the_way(scene: Scene, judge: Judge, goal: str, speed: float) -> None:
    """A cup that flies to the bowl from afar gets nearer, also while it moves."""
    end = np.array([0.45, 0.0, 0.3]) if goal.startswith("At") else SceneState.initial(scene).poses["bowl"].p
    way = [end + np.array([-0.6, 0.3, 0.35]) * share for share in np.linspace(1.0, 0.2, 17)]
    scores = [judge.score(goal, moved(scene, p, speed=speed)) for p in way]
    assert all(a < b < 0 for a, b in pairwise(scores)), scores


def test_a_moving_object_is_judged_by_its_distance_too(scene: Scene, judge: Judge) -> None:
    bowl = SceneState.initial(scene).poses["bowl"].p
    near, far = (moved(scene, bowl + np.array([x, 0, 0.2]), speed=0.05) for x in (0.1, 0.5))
    assert judge("OnTop(cup, bowl)", near).margin == judge("OnTop(cup, bowl)", far).margin  # the speed hides it
    assert judge.score("OnTop(cup, bowl)", near) > judge.score("OnTop(cup, bowl)", far)


def test_a_drawer_is_scored_by_its_range() -> None:
    scene = lower_file(REPOSITORY / "specs" / "scenes" / "store_marker.scene.yaml")
    state, judge = SceneState.initial(scene), Judge(scene)
    limits = next(j.limits for j in scene.object("cabinet").joints if j.name == "drawer")
    assert limits is not None
    opened = [SceneState.of(state.poses, {**state.joints, "cabinet.drawer": at}) for at in np.linspace(*limits, 6)]
    scores = [judge.score("Open(cabinet.drawer)", one) for one in opened]
    assert all(a < b for a, b in pairwise(scores)) and scores[0] == pytest.approx(-0.1 / 0.6)
    assert [judge.score("Closed(cabinet.drawer)", one) for one in opened] == pytest.approx([-s for s in scores])


def test_scores_are_strictly_monotone_in_the_margin() -> None:
    margins = np.concatenate([[-np.inf], np.linspace(-2, 2, 401), [np.inf]])
    scores = score_of(margins, 0.1)
    assert (np.diff(scores) > 0).all() and scores[0] == -1 and scores[-1] == 1 and score_of(np.array([0.1]), 0.1) == 0.5
