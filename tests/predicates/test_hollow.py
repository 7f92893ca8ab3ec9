"""Hollow things: inside is in the cavity, not in the box around it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.predicates import PredicateError
from tests.conftest import REPOSITORY
from tests.predicates.conftest import Setting, changed, posed

Found = Callable[[str], Setting]


def judged(one: Setting, condition: str, joints: dict[str, float] | None = None, **poses: Pose) -> bool:
    verdict = one.judge(condition, changed(one.start, joints, poses=poses))
    assert verdict.value is (verdict.margin > 0)
    assert verdict.why
    return verdict.value


def about(one: Setting, carrier: str) -> Callable[..., Pose]:
    """Poses in the frame of a thing."""
    return lambda *pose: one.start.poses[carrier] @ posed(*pose)


LEAN = math.radians(80)
MARKER = {
    "standing": ((0.012, 0, 0.075, 0, LEAN, 0), True),
    "upright, sticking out": ((0, 0, 0.078, 0, math.pi / 2, 0), True),
    "beside": ((0.08, 0, 0.005), False),
    "leaning against it": ((0.075, 0, 0.06, 0, math.radians(110), 0), False),
    "across the rim": ((0, 0, 0.0955), False),
    "above": ((0, 0, 0.2, 0, math.pi / 2, 0), False),
    "below": ((0, 0, -0.1, 0, math.pi / 2, 0), False),
}  # fmt: skip


@pytest.mark.parametrize("where", MARKER)
@pytest.mark.parametrize(
    "cup", [posed(0.5, 0.1, 0), posed(0.4, -0.2, 0.3, 0.4, -0.3, 2.0)], ids=["standing", "leaning"]
)
def test_marker_in_cup(setting: Found, where: str, cup: Pose) -> None:
    pose, expected = MARKER[where]
    one = setting("marker_in_cup")
    assert judged(one, "Inside(marker, cup)", cup=cup, marker=cup @ posed(*pose)) is expected


BALL = {
    "at the bottom": ((0, 0, 0.042), True),
    "on the rim": ((0.075, 0, 0.1), False),
    "beside": ((0.13, 0, 0.034), False),
    "above": ((0, 0, 0.15), False),
    "below": ((0, 0, -0.05), False),
}


@pytest.mark.parametrize("where", BALL)
def test_ball_in_bowl(bowl: Setting, where: str) -> None:
    pose, expected = BALL[where]
    assert judged(bowl, "Inside(ball, bowl)", ball=about(bowl, "bowl")(*pose)) is expected


def test_ball_under_a_bowl_turned_over(bowl: Setting) -> None:
    turned = posed(0.2, 0.1, 0.1, math.pi, 0, 0)
    assert judged(bowl, "Inside(ball, bowl)", bowl=turned, ball=turned @ posed(0, 0, 0.05)) is False


CUP_IN_DRAWER = {
    "in it": ((0.02, 0, 0.125), True),
    "above it": ((0.02, 0, 0.3), False),
    "on the cabinet": ((0.02, 0, 0.2), False),
    "below it": ((0.02, 0, 0.02), False),
}


@pytest.mark.parametrize("out", [0.0, 0.15])
@pytest.mark.parametrize("where", CUP_IN_DRAWER)
def test_thing_in_drawer(setting: Found, where: str, out: float) -> None:
    """A marker lies in the drawer, however far that is open."""
    pose, expected = CUP_IN_DRAWER[where]
    one = setting("store_marker")
    marker = one.start.poses["cabinet"] @ posed(out + pose[0], pose[1], pose[2], 0, 0, math.pi / 2)
    assert judged(one, "Inside(marker, cabinet.drawer)", {"cabinet.drawer": out}, marker=marker) is expected


def test_thing_stays_where_the_drawer_was(setting: Found) -> None:
    one = setting("store_marker")
    marker = one.start.poses["cabinet"] @ posed(-0.06, 0, 0.125, 0, 0, math.pi / 2)
    assert judged(one, "Inside(marker, cabinet.drawer)", marker=marker)
    assert not judged(one, "Inside(marker, cabinet.drawer)", {"cabinet.drawer": 0.15}, marker=marker)


CUP_IN_BIN = {"in it": (0.02, True), "above": (0.25, False), "on the lid": (0.21, False), "below": (-0.15, False)}


@pytest.mark.parametrize("lid", [0.0, math.radians(100)])
@pytest.mark.parametrize("where", CUP_IN_BIN)
def test_cup_in_lidded_bin(setting: Found, where: str, lid: float) -> None:
    z, expected = CUP_IN_BIN[where]
    one = setting("throw_away_trash")
    cup = about(one, "trash_can")(0.005, 0, z)
    assert judged(one, "Inside(cup, trash_can)", {"trash_can.lid": lid}, cup=cup) is expected


def test_cup_in_bowl(setting: Found) -> None:
    one = setting("cup_in_bowl")
    at = about(one, "bowl")
    assert judged(one, "Inside(cup, bowl)", cup=at(0, 0, 0.008)) is True
    assert judged(one, "Inside(cup, bowl)", cup=at(0.12, 0, 0)) is False


def test_a_solid_thing_has_no_inside(boxes: Setting) -> None:
    with pytest.raises(PredicateError, match="`b` has no cavity"):
        boxes.judge("Inside(a, b)", boxes.start)


def test_the_cavity_of_a_turned_mesh_frame_is_found(setting: Found) -> None:
    """A container whose frame lies on its side, as y-up meshes have it, still opens where it opens."""
    from dataclasses import replace

    from simfoundry.geometry.cavity import cavity
    from simfoundry.predicates.judging.bodies import Bodies

    cup = setting("marker_in_cup").scene.object("cup")
    link = cup.root
    turn = posed(0, 0, 0, math.pi / 2)
    turned = replace(link, colliders=tuple(replace(c, X_LG=turn @ c.X_LG) for c in link.colliders))
    scene = replace(setting("marker_in_cup").scene, objects=(replace(cup, links=(turned,)),))
    form = Bodies(scene)["cup"].forms[0]
    assert form is not None
    hole = cavity(form)
    assert hole is not None
    straight = cavity(Bodies(setting("marker_in_cup").scene)["cup"].forms[0])  # type: ignore[arg-type]
    assert straight is not None
    assert np.allclose(straight.up, [0, 0, 1])
    assert hole.deep == pytest.approx(0.087, abs=0.012) or hole.deep > 0
    inside = hole.at(turn.apply(np.array([[0.0, 0.0, 0.05]])))
    assert inside[0] > 0.01


def test_the_cavity_of_a_mug_does_not_reach_into_its_handle() -> None:
    """The space between wall and grip is open on both sides; the cavity is that of the vessel, to a cell."""
    from simfoundry.cousins.recipe.library import lowered
    from simfoundry.geometry.cavity import cavity
    from simfoundry.geometry.frames import frozen_array
    from simfoundry.predicates.judging.bodies import Bodies
    from simfoundry.scene.model import Scene

    mug = lowered(REPOSITORY / "specs" / "assets" / "mug.asset.yaml")
    form = Bodies(Scene("mug", frozen_array([0.0, 0.0, -9.81]), (mug,)))[mug.name].forms[0]
    assert form is not None
    hole = cavity(form)
    assert hole is not None
    assert np.abs(hole.middle[:2]).max() < hole.cell  # the handle points to +x
    assert hole.deep == pytest.approx(0.087, abs=2 * hole.cell)
    in_loop, in_mug = hole.at(np.array([[0.0515, 0.0, 0.05], [0.0, 0.0, 0.05]]))
    assert in_loop < 0 < in_mug
