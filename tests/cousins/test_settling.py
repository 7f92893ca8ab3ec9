"""Settling: things that sleep would stay as they are awake, what falls is seen, and the same state gives the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.cousins.checks import examine, kept_relations
from simfoundry.cousins.layout import NOTHING, Layout, propose, scatter
from simfoundry.cousins.settling import settle_layout
from simfoundry.cousins.twin import Twin, bare
from simfoundry.cousins.views import best_view, share_in_view
from simfoundry.scene.frames import Pose, look_at, quat_from_rpy
from simfoundry.scene.model import Camera
from simfoundry.spec.cousins import SceneAxis
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import simulate
from tests.conftest import REPOSITORY


def moved(name: str, X_WO: Pose) -> Layout:
    return Layout("", (), {name: X_WO})


@pytest.fixture(scope="module")
def cluttered() -> Twin:
    return Twin.load(REPOSITORY / "specs" / "scenes" / "cluttered.scene.yaml")


def test_accepted_layouts_stay_for_two_seconds_awake(cluttered: Twin) -> None:
    names = ("orange_cup", "red_bottle", "baseball", "burger", "black_marker", "mug")
    asked = SceneAxis(anchor="bowl", objects=dict.fromkeys(names, ("LeftOf", "NextTo", "Behind")), gap=(0.01, 0.3))
    accepted = 0
    with MujocoWorld(bare(cluttered.scene)) as world:
        for k in range(5):
            layout = propose(cluttered, asked, np.random.default_rng([4, k]))
            assert isinstance(layout, Layout)
            result = examine(cluttered, layout)
            if result.accepted:
                accepted += 1
                for motion in simulate(world, 2.0, result.state):
                    assert motion.moved < 0.001, motion
                assert max((c.depth for c in world.contacts()), default=0.0) < 0.001
    assert accepted >= 3


def test_the_twin_as_it_is_passes(table: Twin) -> None:
    result = examine(table, NOTHING)
    assert result.accepted and not result.poses
    assert result.state.poses["post"].p == pytest.approx(table.state.poses["post"].p, abs=2e-5)


def test_what_leans_floats_or_overlaps_is_rejected(table: Twin) -> None:
    leaning = moved("can", Pose.of((0.0, -0.2, 0.07), quat_from_rpy(0.5, 0, 0)))
    assert {r.code for r in examine(table, leaning).reasons} & {"tilted", "moved", "restless"}
    floating = moved("can", Pose.of((0.0, -0.2, 0.15)))
    assert "moved" in {r.code for r in examine(table, floating).reasons}
    deep = moved("can", Pose.of((0.0, 0.05, 0.05)))
    reasons = examine(table, deep).reasons
    assert {r.code for r in reasons} & {"penetrates", "moved"} and all(r.text and r.to_json() for r in reasons)


def test_relations_of_what_did_not_move_and_of_riders_are_kept(table: Twin) -> None:
    assert table.relations == ("OnTop(post, table)", "OnTop(chip, brick)", "OnTop(can, table)")
    assert kept_relations(table, ("brick", "chip")) == table.relations
    assert kept_relations(table, ("can",)) == ("OnTop(post, table)", "OnTop(chip, brick)")
    assert kept_relations(table, ("chip",)) == ("OnTop(post, table)", "OnTop(can, table)")


def test_shares_in_view() -> None:
    camera = Camera("eye", 100, 100, 200.0, 200.0, 49.5, 49.5, look_at(np.array([-1.0, 0, 0.5]), np.zeros(3)))
    corners = np.array([[x, y, 0.0] for x in (-0.01, 0.01) for y in (-0.01, 0.01)])
    assert share_in_view(camera, corners) == 1.0
    assert share_in_view(camera, corners + [0, 0.5, 0]) == 0.0
    assert share_in_view(camera, corners - [3, 0, 0]) == 0.0  # behind
    half = np.concatenate([corners, corners + [0, 5, 0]])
    assert best_view((camera,), half) == ("eye", 0.5)


def test_settling_is_the_same_each_time(table: Twin) -> None:
    state = table.posed({"can": Pose.of((0.1, -0.2, 0.052))})
    ends = [settle_layout(table.world, state).state.poses["can"] for _ in range(2)]
    assert ends[0].p.tolist() == ends[1].p.tolist() and ends[0].q.tolist() == ends[1].q.tolist()


def test_what_is_absent_is_in_nobodys_way(table: Twin) -> None:
    brick = replace(table.scene.object("brick"), name="more", X_WO=Pose.of((0.0, -0.2, 0.05)))
    twin = table.extended([brick])
    result = examine(twin, moved("can", Pose.of((0.0, -0.2, 0.0501))))  # where the absent one would be
    assert result.accepted and result.state.poses["more"].p.tolist() == twin.state.poses["more"].p.tolist()
    there = Layout("", (), {"can": Pose.of((0.0, -0.2, 0.0501)), "more": Pose.of((0.0, -0.2, 0.0151))})
    assert not examine(twin, there).accepted
    both = scatter(twin, ["more"], np.random.default_rng(0))
    assert isinstance(both, Layout) and examine(twin, both).accepted


def test_what_is_not_there_yet_is_far_from_everything(table: Twin) -> None:
    """A world begins with all things where the twin has them: a crowd at one point would be thousands of contacts."""
    more = table.extended([replace(table.scene.object("can"), name=f"can_{k}") for k in range(40)])
    again = more.extended([replace(table.scene.object("can"), name="one_more")])
    for twin in (more, again):
        with MujocoWorld(bare(twin.scene)) as world:
            assert not [c for c in world.contacts() if twin.absent & {c.a, c.b}]
    assert len({tuple(again.state.poses[name].p) for name in again.absent}) == 41
