"""Every threshold of docs/predicates.md, crossed from both sides by a tenth of a millimeter, a degree or a per cent."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from simfoundry.predicates.holding import RISE
from simfoundry.predicates.judging import thresholds as at
from simfoundry.predicates.pose import AT_DISTANCE, OPEN_SHARE, UPRIGHT_DEG
from simfoundry.predicates.relative import NEAR_SHARE
from tests.predicates.conftest import Setting, changed, posed

STEP = 1e-4

BESIDE = 0.07
"""Where ``a`` and ``b`` touch side by side: half of each along x."""


def crosses(value: Callable[[float], bool], threshold: float, step: float, below: bool) -> None:
    """``value`` is ``below`` under the threshold, and not over it."""
    assert value(threshold - step) is below
    assert value(threshold + step) is (not below)


def test_touching_ends_one_millimeter_apart(boxes: Setting) -> None:
    crosses(lambda gap: boxes.margin("Touching(a, b)", a=posed(BESIDE + gap, 0, 0.03)) > 0, at.TOUCH, STEP, True)


def test_resting_ends_where_touching_does(boxes: Setting) -> None:
    crosses(lambda gap: boxes.margin("OnTop(a, b)", a=posed(0.01, 0.01, 0.06 + gap)) > 0, at.TOUCH, STEP, True)


def test_what_rests_has_its_middle_over_the_other(boxes: Setting) -> None:
    crosses(lambda x: boxes.margin("OnTop(a, b)", a=posed(x, 0.01, 0.06)) > 0, 0.05, STEP, True)


def test_what_carries_pushes_up(boxes: Setting) -> None:
    """A box that leans against the edge of another rests on it until the edge pushes it more to the side than up.

    Friction of 0.5 turns the push up by half of its angle.
    """

    def rests(lean_deg: float) -> bool:
        lean = math.radians(lean_deg)  # the edge of `b` at (0.05, 0, 0.05) is under the middle of a face of `a`
        x, z = 0.05 - 1e-4 + 0.01 * math.sin(lean), 0.05 + 0.01 * math.cos(lean)
        return (
            boxes.margin("OnTop(a, b)", a=posed(x - 0.016 * math.cos(lean), 0, z + 0.016 * math.sin(lean), 0, lean)) > 0
        )

    crosses(rests, at.SUPPORT_DEG + math.degrees(math.atan(0.5)) / 2, 2.0, True)


@pytest.mark.parametrize("condition", ["OnTop(a, b)", "Released(a)"])
def test_what_moves_is_not_settled(boxes: Setting, condition: str) -> None:
    def holds(speed: float) -> bool:
        return boxes.judge(condition, changed(boxes.start, a=posed(0, 0, 0.06), speeds={"a": speed})).value

    crosses(holds, at.SETTLED, STEP, True)


def test_what_moves_is_not_inside(setting: Callable[[str], Setting]) -> None:
    cups = setting("cup_in_bowl")
    x, y, z = cups.start.poses["bowl"].p

    def inside(speed: float) -> bool:
        state = changed(cups.start, cup=posed(x, y, z + 0.01), speeds={"cup": speed})
        return cups.judge("Inside(cup, bowl)", state).value

    crosses(inside, at.SETTLED, STEP, True)


def test_half_of_the_volume_is_inside(setting: Callable[[str], Setting]) -> None:
    """An upright marker of even thickness leaves a cup when its middle passes the rim."""
    cups = setting("marker_in_cup")
    x, y, z = cups.start.poses["cup"].p
    rim = z + 0.095

    def inside(over: float) -> bool:
        return cups.margin("Inside(marker, cup)", marker=posed(x, y, rim + over, 0, math.pi / 2)) > 0

    crosses(inside, 0.0, 0.004, True)


def test_a_cavity_that_faces_down_holds_nothing(setting: Callable[[str], Setting]) -> None:
    cups = setting("marker_in_cup")

    def inside(turned_deg: float) -> bool:
        cup = posed(0.5, 0, 0.3, math.radians(turned_deg), 0, 0.4)
        return cups.margin("Inside(marker, cup)", cup=cup, marker=cup @ posed(0, 0, 0.05, 0, math.pi / 2)) > 0

    crosses(inside, at.OPENING_DEG, 0.1, True)


def test_side_by_side_ends_at_a_share_of_the_sizes(boxes: Setting) -> None:
    near = NEAR_SHARE * ((0.04 + 0.06 + 0.02) / 3 + (0.1 + 0.08 + 0.05) / 3)
    crosses(lambda gap: boxes.margin("NextTo(a, b)", a=posed(BESIDE + gap, 0, 0.01)) > 0, near, STEP, True)


def test_side_by_side_shares_a_height(boxes: Setting) -> None:
    crosses(lambda z: boxes.margin("NextTo(a, b)", a=posed(BESIDE + 0.01, 0, 0.01 + z)) > 0, 0.05, STEP, True)


def test_side_by_side_is_not_over(boxes: Setting) -> None:
    crosses(lambda x: boxes.margin("NextTo(a, b)", a=posed(x, 0, 0.03)) > 0, 0.05, STEP, False)


@pytest.mark.parametrize(("condition", "x", "y"), [
    ("LeftOf(a, b)", 0, 1), ("RightOf(a, b)", 0, -1), ("Behind(a, b)", 1, 0), ("InFrontOf(a, b)", -1, 0),
])  # fmt: skip
def test_sides_begin_beyond_the_edge(boxes: Setting, condition: str, x: int, y: int) -> None:
    edge = 0.05 if x else 0.04
    crosses(lambda d: boxes.margin(condition, a=posed(x * d, y * d, 0.2)) > 0, edge, STEP, False)


def test_above_and_under_begin_where_the_plumb_line_meets_the_other(boxes: Setting) -> None:
    crosses(lambda z: boxes.margin("Above(a, b)", a=posed(0, 0, z)) > 0, 0.04, STEP, False)
    crosses(lambda z: boxes.margin("Under(a, b)", a=posed(0, 0, z)) > 0, 0.01, STEP, True)
    crosses(lambda x: boxes.margin("Above(a, b)", a=posed(x, 0, 0.3)) > 0, 0.05, STEP, True)
    crosses(lambda y: boxes.margin("Under(a, b)", a=posed(0, y, -0.3)) > 0, 0.04, STEP, True)


def test_at_ends_two_centimeters_away(boxes: Setting) -> None:
    crosses(lambda d: boxes.margin("At(a, 0.1, 0.2)", a=posed(0.1 + d, 0.2, 0.5)) > 0, AT_DISTANCE, STEP, True)
    crosses(lambda d: boxes.margin("At(a, 0.1, 0.2, 0.3)", a=posed(0.1, 0.2, 0.3 - d)) > 0, AT_DISTANCE, STEP, True)


def test_upright_ends_at_ten_degrees(boxes: Setting) -> None:
    leaning = lambda deg: boxes.margin("Upright(a)", a=posed(0, 0, 0.1, math.radians(deg), 0, 0.7)) > 0  # noqa: E731
    crosses(leaning, UPRIGHT_DEG, 0.01, True)


def test_lifted_begins_two_centimeters_higher(boxes: Setting) -> None:
    crosses(lambda rise: boxes.margin("Lifted(a)", a=posed(0.3, 0.1, 0.01 + rise)) > 0, RISE, STEP, False)


def test_what_stands_on_another_thing_is_not_lifted(boxes: Setting) -> None:
    crosses(lambda gap: boxes.margin("Lifted(a)", a=posed(0, 0, 0.06 + gap)) > 0, at.TOUCH, STEP, False)


@pytest.mark.parametrize(("name", "joint", "reach"), [
    ("store_marker", "cabinet.drawer", 0.16), ("throw_away_trash", "trash_can.lid", math.radians(105)),
])  # fmt: skip
def test_open_begins_at_a_tenth_of_the_range(
    setting: Callable[[str], Setting], name: str, joint: str, reach: float
) -> None:
    one = setting(name)

    def holds(condition: str) -> Callable[[float], bool]:
        return lambda share: one.judge(condition, changed(one.start, {joint: share * reach})).value

    crosses(holds(f"Open({joint})"), OPEN_SHARE, 1e-3, False)
    crosses(holds(f"Closed({joint})"), OPEN_SHARE, 1e-3, True)


def test_of_a_cabinet_every_drawer_counts(setting: Callable[[str], Setting]) -> None:
    one = setting("store_marker")
    half = changed(one.start, {"cabinet.drawer": 0.1})
    assert [one.judge(c, half).value for c in ("Open(cabinet)", "Closed(cabinet)")] == [False, False]
    both = changed(one.start, {"cabinet.drawer": 0.1, "cabinet.bottom_drawer": 0.1})
    assert [one.judge(c, both).value for c in ("Open(cabinet)", "Closed(cabinet)")] == [True, False]
