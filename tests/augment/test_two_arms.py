"""Two arms: each has its own segments, and what both hold is moved by both in step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.api.augmentation import augment_plan
from simfoundry.api.demonstrations import record_plan
from simfoundry.augment.library import open_library
from simfoundry.data import attempt as attempts
from simfoundry.data.record import record
from simfoundry.evaluate.entries import Contender
from tests.augment.two_arms import write_pair


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two demonstrations, and two that were generated from them."""
    folder = tmp_path_factory.mktemp("pair")
    write_pair(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(Contender, "is_foreign", False)  # in this process, which is faster
        try:
            record(record_plan([Path("carry.task.yaml")], "python:tests.augment.two_arms:Carry", Path("demos"), 2))
            record(augment_plan(Path("demos"), (), Path("more"), 2))
        finally:
            attempts.close()
    return folder


@pytest.mark.slow  # 10 s
def test_hands_that_hold_the_same_object_move_in_step(pair: Path) -> None:
    found = sf.demonstrations(pair / "demos")
    segments = [one for one in open_library(pair / "demos").segments if one.demonstration == found[0].index]
    teams = {one.subgoal.name: one.robots for one in segments}
    both = ("left", "right")
    assert teams == {"left_grasps": ("left",), "right_grasps": ("right",), "bar_lifted": both, "bar_on_crate": both}
    lifted = next(one for one in segments if one.subgoal.name == "bar_lifted")
    assert lifted.is_joined and lifted.moment > lifted.first
    more = sf.demonstrations(pair / "more")
    assert len(more) == 2
    for demo in more:
        origin = {one["subgoal"]: one for one in demo.origin["segments"]}
        assert origin["bar_lifted"]["robots"] == ["left", "right"]
        used = {origin[name]["demonstration"] for name in ("left_grasps", "right_grasps", "bar_lifted")}
        assert len(used) == 1  # the lift continues both grasps
        hands = {name: demo.states[f"{name}/hand"][:, :3] for name in both}
        start, end = demo.subtasks["bar_lifted"], demo.subtasks["bar_on_crate"]
        assert start is not None and end is not None
        apart = np.linalg.norm(hands["left"] - hands["right"], axis=1)[start : end - 8]
        assert np.ptp(apart) < 0.01  # while they hold the bar
