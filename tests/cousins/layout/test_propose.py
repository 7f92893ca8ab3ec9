"""Layouts: what is asked holds, each word comes up, a seed gives the same, what cannot be is said with numbers."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.cousins.layout.acceptance import examine
from simfoundry.cousins.layout.constraints import placement_constraints
from simfoundry.cousins.layout.propose import Layout, propose, scatter
from simfoundry.cousins.layout.supports import Support
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe.candidate import ImpossibleError, Rejected
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load
from simfoundry.spec.models.cousins import SceneAxis
from tests.conftest import REPOSITORY
from tests.cousins.conftest import twin_of

SIDES = ("LeftOf", "RightOf", "InFrontOf", "Behind", "NextTo")


def axis(anchor: str, together: int = 1, gap: tuple[float, float] = (0.02, 0.2), **objects: Any) -> SceneAxis:
    return SceneAxis.model_validate(
        {"anchor": anchor, "objects": objects, "relations_per_object": together, "gap": gap}
    )


def proposed(twin: Twin, asked: SceneAxis, k: int) -> Layout:
    found = propose(twin, asked, np.random.default_rng([0, k]))
    assert isinstance(found, Layout), found
    return found


def test_every_word_comes_up_holds_at_rest_and_is_where_it_says(table: Twin) -> None:
    words, toppled, hidden = set(), 0, 0
    asked = axis("post", brick=SIDES, can=(*SIDES, "OnTop"))
    for k in range(50):
        layout = proposed(table, asked, k)
        result = examine(table, layout)
        if {reason.code for reason in result.reasons} == {"out_of_view"}:  # a thing behind another
            hidden += 1
            continue
        if not result.accepted:  # a can on the edge of the post falls off
            assert "OnTop(can, post)" in layout.asked, result.reasons
            toppled += 1
            continue
        words |= set(layout.asked)
        p = {name: pose.p - table.state.poses["post"].p for name, pose in result.state.poses.items()}
        for text in layout.asked:
            word, name = text.split("(")[0], text.split("(")[1].split(",")[0]
            x, y, z = p[name]
            far = {"LeftOf": y, "RightOf": -y, "Behind": x, "InFrontOf": -x, "OnTop": z}.get(word, 1.0)
            assert far > 0.05 - 1e-3
        assert abs(p["chip"][2] - (0.035 - 0.05)) < 1e-3  # it rides along
    assert toppled < 10 and 0 < hidden < 20
    assert words == {f"{w}(brick, post)" for w in SIDES} | {f"{w}(can, post)" for w in (*SIDES, "OnTop")}


def test_several_words_hold_at_once(table: Twin) -> None:
    for k in range(10):
        layout = proposed(table, axis("post", 2, brick=("LeftOf", "InFrontOf", "RightOf")), k)
        assert len(layout.asked) == 2 and "InFrontOf(brick, post)" in layout.asked
        assert examine(table, layout).accepted


def test_the_same_seed_gives_the_same_layout_whatever_came_before(table: Twin) -> None:
    asked = axis("post", brick=SIDES, can=SIDES)
    first = [proposed(table, asked, k) for k in range(4)]
    again = {k: proposed(table, asked, k) for k in (3, 1, 0, 2)}
    for k, layout in enumerate(first):
        assert {n: (x.p.tolist(), x.q.tolist()) for n, x in layout.poses.items()} == {
            n: (x.p.tolist(), x.q.tolist()) for n, x in again[k].poses.items()
        }
        states = [examine(table, one).state.poses for one in (layout, again[k])]
        assert all(states[0][n].p.tolist() == states[1][n].p.tolist() for n in layout.poses)


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        (axis("pots", brick=("LeftOf",)), "the anchor `pots` does not exist; did you mean `post`?"),
        (axis("post", brick=("Inside",)), "Inside(brick, post) can never hold: `post` has no cavity"),
        (axis("post", table=("LeftOf",)), "`table` is fixed to the world, so it cannot move"),
        (axis("chip", brick=("LeftOf",)), "`brick` supports the anchor `chip`, so it cannot move around it"),
        (axis("post", brick=("LeftOf",), gap=(2.0, 3.0)), "placed on `table` left of `post` with the minimum gap"),
        (axis("post", brick=("LeftOf",), gap=(0.5, 0.6)), "the largest possible gap is 0.3"),
        (axis("post", brick=("NextTo",), gap=(0.6, 0.7)), "`table` with the minimum gap of 0.6 m from `post`"),
        (axis("post", 2, brick=("LeftOf", "RightOf")), "`brick` cannot satisfy 2 of LeftOf, RightOf at once"),
        (axis("post", 2, brick=("LeftOf", "OnTop")), "`brick` cannot satisfy 2 of LeftOf, OnTop at once"),
        (axis("post", post=("LeftOf",)), "`post` is the anchor"),
        (axis("can", post=("LeftOf",)), "`post` cannot be left of `can`, because `table` extends only 0.050 m beyond"),
    ],
)
def test_what_can_never_be_is_said_before_anything_is_tried(table: Twin, asked: SceneAxis, text: str) -> None:
    with pytest.raises(ImpossibleError) as caught:
        propose(table, asked, np.random.default_rng(0))
    assert text in str(caught.value)


def test_no_room_is_rejected_with_numbers(table: Twin) -> None:
    asked = axis("can", brick=("NextTo",), gap=(0.06, 0.08))  # so far apart is not next to
    found = propose(table, asked, np.random.default_rng(0))
    assert isinstance(found, Rejected)
    (reason,) = found.reasons
    assert reason.code == "no_room" and "`brick` is 0.04 m wide" in reason.text and reason.numbers["tries"] >= 4096


def test_a_goal_that_is_true_already_is_no_cousin(cup_in_bowl: Twin) -> None:
    asked = axis("bowl", cup=("Inside",))
    results = [examine(cup_in_bowl, proposed(cup_in_bowl, asked, k)) for k in range(3)]
    assert {reason.code for result in results for reason in result.reasons} == {"goal_true"}


SHELF = """\
simfoundry: asset/1
name: shelf
materials: {wood: {density: 600, friction: 0.5}}
links:
  body:
    material: wood
    parts:
      bottom: {shape: {box: [0.3, 0.6, 0.018]}, pose: {xyz: [0, 0, 0.009]}}
      middle: {shape: {box: [0.3, 0.564, 0.018]}, pose: {xyz: [0, 0, 0.259]}}
      back: {shape: {box: [0.018, 0.6, 0.5]}, pose: {xyz: [0.141, 0, 0.268]}}
      left: {shape: {box: [0.3, 0.018, 0.5]}, pose: {xyz: [0, 0.291, 0.268]}}
      right: {shape: {box: [0.3, 0.018, 0.5]}, pose: {xyz: [0, -0.291, 0.268]}}
"""
"""Open in front (-x) and at the top: two boards between side panels 18 mm wide."""

CELL = """\
simfoundry: scene/1
name: cell
materials: {wood: {density: 600, friction: 0.5}}
objects:
  floor: {fixed: true, shape: {box: [4, 4, 0.02]}, material: wood, pose: {xyz: [0, 0, -0.71]}}
  table: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  side_table: {fixed: true, shape: {box: [0.5, 0.5, 0.04]}, material: wood, pose: {xyz: [0, 0.8, -0.1]}}
  shelf: {asset: shelf.asset.yaml, fixed: true, pose: {xyz: [0.2, -0.8, -0.3]}}
  post: {shape: {box: [0.1, 0.1, 0.1]}, material: wood, pose: {xyz: [0, 0, 0.05]}}
  tin: {shape: {cylinder: {radius: 0.03, height: 0.08}}, material: wood, pose: {xyz: [0.2, 0.2, 0.04]}}
  cube: {shape: {box: [0.03, 0.03, 0.03]}, material: wood, pose: {xyz: [-0.2, 0.2, 0.015]}}
"""


def is_over(place: Support, p: np.ndarray) -> bool:
    """Whether a point is above a level."""
    return bool(p[2] > place.height and place.holds(p[None, :2], np.ones(1, complex), np.zeros((2, 1)))[0])


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Twin:
    """Two tables and a shelf in a room."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / "shelf.asset.yaml").write_text(SHELF)
    return twin_of(CELL, folder)


def test_every_free_level_is_a_place_but_the_floor_and_edges(cell: Twin) -> None:
    assert [place.name for place in cell.places] == ["table", "side_table", "shelf", "shelf"]
    assert [place.height for place in cell.places] == pytest.approx([0.0, -0.08, -0.3 + 0.018, -0.3 + 0.268])


def test_distractors_go_wherever_there_is_room(cell: Twin) -> None:
    seen = Counter[tuple[str, int]]()
    for k in range(40):
        layout = scatter(cell, ["tin", "cube"], np.random.default_rng([3, k]))
        assert isinstance(layout, Layout)
        for pose in layout.poses.values():
            below = [place for place in cell.places if is_over(place, pose.p)]
            on = max(below, key=lambda place: place.height)
            seen[on.name, round(100 * on.height)] += 1
        assert examine(cell, layout).accepted
    areas = {(p.name, round(100 * p.height)): p.area for p in cell.places}
    for place, area in areas.items():
        assert seen[place] == pytest.approx(80 * area / sum(areas.values()), abs=14), seen


def test_on_a_shelf_means_on_any_of_its_boards_and_on_no_edge(cell: Twin) -> None:
    heights, fell = Counter[int](), 0
    for k in range(30):
        result = examine(cell, proposed(cell, axis("shelf", cube=("OnTop",)), k))
        if result.accepted:
            heights[round(100 * (result.state.poses["cube"].p[2] - 0.015 + 0.3))] += 1
        fell += not result.accepted  # from the front edge of a board
    assert fell <= 3 and set(heights) == {2, 27} and min(heights.values()) >= 8, heights


def test_nothing_stands_where_the_base_of_a_robot_is_whose_model_is_not_there(tmp_path: Path) -> None:
    robot = "robots: {arm: {model: {mjcf: menagerie:no_such_robot/arm.xml}, pose: {xyz: [0.1, -0.1, 0]}}}\n"
    small = (
        CELL.replace("[0.8, 0.6, 0.04]", "[0.5, 0.5, 0.04]")
        .replace("shelf: {", "# shelf: {")
        .replace("side_table: {", "# {")
    )
    twin = twin_of(small + robot, tmp_path)
    assert not twin.scene.robots and len(twin.places) == 1
    for k in range(20):
        layout = scatter(twin, ["cube"], np.random.default_rng([5, k]))
        assert isinstance(layout, Layout)
        assert math.dist(layout.poses["cube"].p[:2], (0.1, -0.1)) > 0.155 + 0.015


@pytest.mark.parametrize(
    ("thing", "anchor", "possible"),
    [
        ("bowl", "cup", False),
        ("brown_box", "bowl", False),
        ("cup", "bowl", True),
        ("marker", "cup", True),
        ("bowl", "brown_box", True),
    ],
)
def test_what_is_too_large_for_a_cavity_is_known_before_it_is_tried(thing: str, anchor: str, possible: bool) -> None:
    text = "simfoundry: scene/1\nname: pair\nobjects:\n"
    text += "  desk: {fixed: true, shape: {box: [2, 2, 0.04]}, pose: {xyz: [0, 0, -0.02]}}\n"
    for name, asset, x in (("thing", thing, -0.5), ("anchor", anchor, 0.5)):
        text += f"  {name}: {{asset: assets/{asset}.asset.yaml, place: {{on: desk, xy: [{x}, 0]}}}}\n"
    twin = Twin.of(lower(load(REPOSITORY / "specs" / "pair.scene.yaml", text=text)))
    if possible:
        placement_constraints(twin, axis("anchor", thing=("Inside",)))
        return
    with pytest.raises(ImpossibleError, match=r"`thing` \(.* cm\) cannot be inside `anchor`, whose cavity is"):
        placement_constraints(twin, axis("anchor", thing=("Inside",)))
