"""Settling: things that sleep would stay as they are awake, what falls is seen, and the same state gives the same."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simfoundry.cousins.layout.acceptance import examine, kept_relations, settle_layout
from simfoundry.cousins.layout.propose import NOTHING, Layout, propose, scatter
from simfoundry.cousins.layout.twin import Twin, bare
from simfoundry.cousins.layout.views import VisibleSurface, best_view, visible_share
from simfoundry.geometry.frames import Pose, look_at, quat_from_rpy
from simfoundry.scene.model import Camera
from simfoundry.spec.models.cousins import SceneAxis
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import simulate
from tests.conftest import REPOSITORY
from tests.scenes import box, pose, solid


def moved(name: str, X_WO: Pose) -> Layout:
    return Layout((), {name: X_WO})


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
    assert result.accepted
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


EYE = Camera("eye", 100, 100, 200.0, 200.0, 49.5, 49.5, look_at(np.array([-1.0, 0, 0.5]), np.zeros(3)))


def block(size: tuple[float, float, float], x: float = 0.0, y: float = 0.0, z: float = 0.0) -> VisibleSurface:
    """The surface of a box in the world."""
    return VisibleSurface.of(solid("block", box(*size), pose(0, 0, 0))).at(pose(x, y, z))


def test_shares_in_the_picture() -> None:
    tile = (0.02, 0.02, 0.001)
    assert visible_share(EYE, block(tile), []) == 1.0
    assert visible_share(EYE, block(tile, y=0.5), []) == 0.0
    assert visible_share(EYE, block(tile, x=-3), []) == 0.0, "it is behind the camera"
    edge = 50 / 200 * math.hypot(1, 0.5)  # m from the middle of the picture to its side, at the depth of the origin
    assert visible_share(EYE, block((0.02, 0.02, 0.02), y=edge), []) == pytest.approx(0.5, abs=0.1)


def test_what_stands_before_a_thing_hides_it() -> None:
    tile, wall = block((0.02, 0.02, 0.02), z=0.01), (0.01, 0.2, 0.2)
    assert visible_share(EYE, tile, [block(wall, -0.1, 0, 0.1)]) == 0.0
    assert visible_share(EYE, tile, [block(wall, 0.1, 0, 0.1)]) == 1.0, "what stands behind hides nothing"
    assert visible_share(EYE, tile, [block(wall, -0.1, 0.1, 0.1)]) == pytest.approx(0.5, abs=0.1)
    assert visible_share(EYE, tile, [block(wall, -2.1, 0, 0.1)]) == 1.0, "nor does what is behind the camera"
    assert visible_share(EYE, tile, [block((9, 9, 0.02), z=-0.01)]) == 1.0, "nor what reaches under the camera"
    assert visible_share(EYE, tile, [block((0.1, 9, 9), x=-0.5)]) == 0.0, "but a wall that goes on behind it does"
    away = replace(EYE, name="away", X_WC=look_at(np.array([1.0, 0, 0.5]), np.zeros(3)))
    surfaces = {"tile": tile, "wall": block(wall, -0.1, 0, 0.1)}
    assert best_view((EYE, away), "tile", surfaces) == ("away", 1.0)


def test_a_hidden_thing_is_no_cousin(table: Twin) -> None:
    hidden = moved("chip", Pose.of((0.13, 0.0, 0.005)))
    assert [r.code for r in examine(table, hidden).reasons] == ["out_of_view"], "the post stands before it"
    aside = moved("chip", Pose.of((0.2, -0.2, 0.005)))
    assert examine(table, aside).reasons == ()


def test_settling_is_the_same_each_time(table: Twin) -> None:
    state = table.posed({"can": Pose.of((0.1, -0.2, 0.052))})
    ends = [settle_layout(table.world, state).state.poses["can"] for _ in range(2)]
    assert ends[0].p.tolist() == ends[1].p.tolist() and ends[0].q.tolist() == ends[1].q.tolist()


def test_what_is_absent_is_in_nobodys_way(table: Twin) -> None:
    brick = replace(table.scene.object("brick"), name="more", X_WO=Pose.of((0.0, -0.2, 0.05)))
    twin = table.extended([brick])
    result = examine(twin, moved("can", Pose.of((0.0, -0.2, 0.0501))))  # where the absent one would be
    assert result.accepted and result.state.poses["more"].p.tolist() == twin.state.poses["more"].p.tolist()
    there = Layout((), {"can": Pose.of((0.0, -0.2, 0.0501)), "more": Pose.of((0.0, -0.2, 0.0151))})
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
