"""What carries what, what is under and over what, and what is open: placements that were judged wrongly once."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.predicates import Judge, StateBatch
from simfoundry.scene.lower import lower_file
from simfoundry.scene.state import SceneState
from tests.predicates.conftest import Setting, changed, posed

STOOL = """\
simfoundry: asset/1
name: stool
links:
  base:
    density: 600
    parts:
      seat: {shape: {box: [0.3, 0.3, 0.02]}, pose: {xyz: [0, 0, 0.24]}}
      leg_1: {shape: {box: [0.02, 0.02, 0.23]}, pose: {xyz: [0.13, 0.13, 0.115]}}
      leg_2: {shape: {box: [0.02, 0.02, 0.23]}, pose: {xyz: [-0.13, 0.13, 0.115]}}
      leg_3: {shape: {box: [0.02, 0.02, 0.23]}, pose: {xyz: [0.13, -0.13, 0.115]}}
      leg_4: {shape: {box: [0.02, 0.02, 0.23]}, pose: {xyz: [-0.13, -0.13, 0.115]}}
"""
FRAME = """\
simfoundry: asset/1
name: frame
links:
  base:
    density: 600
    parts:
      left: {shape: {box: [0.02, 0.1, 0.03]}, pose: {xyz: [0, 0.032, 0.015], yaw_deg: 90}}
      right: {shape: {box: [0.02, 0.1, 0.03]}, pose: {xyz: [0, -0.032, 0.015], yaw_deg: 90}}
      front: {shape: {box: [0.02, 0.1, 0.03]}, pose: {xyz: [0.032, 0, 0.015]}}
      back: {shape: {box: [0.02, 0.1, 0.03]}, pose: {xyz: [-0.032, 0, 0.015]}}
"""
FUNNEL = """\
simfoundry: asset/1
name: funnel
links:
  base:
    density: 600
    parts:
      left: {shape: {box: [0.1, 0.1, 0.01]}, pose: {xyz: [0, 0.035, 0.05], rpy_deg: [60, 0, 0]}}
      right: {shape: {box: [0.1, 0.1, 0.01]}, pose: {xyz: [0, -0.035, 0.05], rpy_deg: [-60, 0, 0]}}
"""
RACK = """\
simfoundry: asset/1
name: rack
links:
  base:
    density: 600
    parts:
      wall: {shape: {box: [0.02, 0.3, 0.3]}, pose: {xyz: [-0.01, 0, 0.15]}}
      peg: {shape: {box: [0.1, 0.01, 0.01]}, pose: {xyz: [0.05, 0, 0.25]}}
"""
SHELF = """\
simfoundry: asset/1
name: shelf
links:
  base:
    density: 600
    parts:
      left: {shape: {box: [0.24, 0.012, 0.4]}, pose: {xyz: [0, 0.194, 0.2]}}
      right: {shape: {box: [0.24, 0.012, 0.4]}, pose: {xyz: [0, -0.194, 0.2]}}
      bottom: {shape: {box: [0.24, 0.376, 0.012]}, pose: {xyz: [0, 0, 0.006]}}
      middle: {shape: {box: [0.24, 0.376, 0.012]}, pose: {xyz: [0, 0, 0.2]}}
      top: {shape: {box: [0.24, 0.376, 0.012]}, pose: {xyz: [0, 0, 0.394]}}
      back: {shape: {box: [0.012, 0.376, 0.4]}, pose: {xyz: [-0.114, 0, 0.2]}}
"""
RACK_OPEN = "\n".join(line for line in SHELF.splitlines() if "back:" not in line)
DOORS = """\
simfoundry: asset/1
name: doors
links:
  body: {density: 600, parts: {board: {shape: {box: [0.02, 0.6, 0.3]}, pose: {xyz: [0, 0, 0.15]}}}}
  flap: {density: 600, parts: {board: {shape: {box: [0.02, 0.2, 0.2]}, pose: {xyz: [0, 0.1, 0]}}}}
  tray: {density: 600, parts: {board: {shape: {box: [0.2, 0.2, 0.02]}}}}
joints:
  swing: {type: revolute, parent: body, child: flap, pose: {xyz: [0.1, 0, 0.15]}, limits_deg: [-90, 90]}
  slide: {type: prismatic, parent: body, child: tray, pose: {xyz: [0.3, 0, 0.4]}, axis: [1, 0, 0], limits: [0, 0.2],
    closed: upper}
"""
CUP = "lathe: {profile: [[0, 0], [0.035, 0], [0.04, 0.09], [0.037, 0.09], [0.032, 0.004], [0, 0.004]]}"
SCENE = f"""\
simfoundry: scene/1
name: support
materials: {{wood: {{density: 500}}}}
objects:
  desk: {{fixed: true, shape: {{box: [4, 2, 0.04]}}, material: wood, pose: {{xyz: [0, 0, -0.02]}}}}
  stool: {{asset: stool.asset.yaml, pose: {{xyz: [-1, 0, 0], yaw_deg: 20}}}}
  tower: {{shape: {{box: [0.05, 0.05, 0.228]}}, material: wood, pose: {{xyz: [-1, 0.02, 0.114]}}}}
  frame: {{asset: frame.asset.yaml, pose: {{xyz: [-0.5, 0, 0]}}}}
  mat: {{shape: {{box: [0.042, 0.042, 0.01]}}, material: wood, pose: {{xyz: [-0.5, 0, 0.005]}}}}
  cube: {{shape: {{box: [0.04, 0.04, 0.04]}}, material: wood, pose: {{xyz: [-0.5, 0, 0.03]}}}}
  coaster: {{shape: {{cylinder: {{radius: 0.03, height: 0.02}}}}, material: wood, pose: {{xyz: [0, 0, 0.01]}}}}
  ball: {{shape: {{sphere: 0.031}}, material: wood, pose: {{xyz: [0, 0, 0.051]}}}}
  cup: {{shape: {{{CUP}}}, material: wood, pose: {{xyz: [0, 0, 0.09], rpy_deg: [180, 0, 0]}}}}
  funnel: {{asset: funnel.asset.yaml, pose: {{xyz: [0.5, 0, 0]}}}}
  pearl: {{shape: {{sphere: 0.03}}, material: wood, pose: {{xyz: [0.5, 0, 0.0595]}}}}
  rack: {{asset: rack.asset.yaml, fixed: true, pose: {{xyz: [1, 0, 0]}}}}
  ring: {{asset: frame.asset.yaml, pose: {{xyz: [1.05, 0, 0.233], rpy_deg: [0, 90, 0]}}}}
  shelf: {{asset: shelf.asset.yaml, pose: {{xyz: [0, 0.6, 0]}}}}
  cubby: {{asset: cubby.asset.yaml, pose: {{xyz: [0, -0.6, 0]}}}}
  die: {{shape: {{box: [0.03, 0.03, 0.03]}}, material: wood, pose: {{xyz: [1.5, 0.6, 0.015]}}}}
  doors: {{asset: doors.asset.yaml, fixed: true, pose: {{xyz: [1.5, 0, 0]}}}}
"""


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> Setting:
    """Things that others carry, each beside a thing that does not."""
    folder = tmp_path_factory.mktemp("support")
    for name, text in (("stool", STOOL), ("frame", FRAME), ("funnel", FUNNEL), ("rack", RACK), ("doors", DOORS),
                       ("shelf", SHELF), ("cubby", RACK_OPEN)):  # fmt: skip
        (folder / f"{name}.asset.yaml").write_text(text)
    file: Path = folder / "support.scene.yaml"
    file.write_text(SCENE)
    return Setting(lower_file(file))


@pytest.mark.parametrize(("condition", "expected"), [
    ("OnTop(tower, stool)", False), ("OnTop(tower, desk)", True),  # 2 mm below the seat
    ("OnTop(cube, frame)", False), ("OnTop(cube, mat)", True), ("OnTop(mat, frame)", False),  # 1 mm from each side
    ("OnTop(ball, cup)", False), ("OnTop(ball, coaster)", True), ("OnTop(cup, desk)", True),  # under a cup
    ("OnTop(pearl, funnel)", True),  # no wall alone pushes it up, both do
    ("OnTop(ring, rack)", True), ("OnTop(rack, ring)", False),  # hangs on a peg, lower than all of that
    ("Under(tower, stool)", True), ("Above(tower, stool)", False), ("Under(stool, tower)", False),
    ("Under(ball, cup)", True), ("Under(coaster, cup)", True), ("Above(cup, coaster)", True),
    ("Under(cube, frame)", False), ("Above(cube, frame)", False), ("Above(cup, ball)", True),
    ("Above(tower, desk)", True), ("Under(desk, coaster)", True), ("Under(desk, tower)", False),
])  # fmt: skip
def test_what_carries_and_what_is_under(placed: Setting, condition: str, expected: bool) -> None:
    verdict = placed.judge(condition, placed.start)
    assert verdict.value is expected, verdict.why


def test_the_plumb_line_passes_through_the_middle_of_the_upright_bounding_box(placed: Setting) -> None:
    """As in BEHAVIOR: the middle of a tilted rack's own box is 16 mm farther along x, beyond the die above it."""
    state = changed(placed.start, rack=posed(0, 3, 0, 0, math.pi / 4), die=posed(0.112, 3, 0.6))
    assert placed.judge("Under(rack, die)", state).value
    shifted = changed(state, die=posed(0.112 + 0.025, 3, 0.6))  # over the middle of the rack's own box alone
    assert not placed.judge("Under(rack, die)", shifted).value


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("shelf", ["shelf", "cubby"], ids=["with a back", "without one"])
@pytest.mark.parametrize(("x", "z", "expected"), [
    (-0.08, 0.027, True), (0.0, 0.221, True), (0.06, 0.221, True), (0.1, 0.027, True),  # as far as the front edge
    (0.15, 0.027, False), (0.0, 0.415, False), (0.2, 0.015, False),  # before it, on top, on the desk
])  # fmt: skip
def test_a_shelf_holds_things_as_far_as_its_front(
    placed: Setting, shelf: str, yaw: float, x: float, z: float, expected: bool
) -> None:
    at = posed(0, 0.6, 0.1, 0, 0, yaw)
    verdict = placed.judge(
        f"Inside(die, {shelf})", changed(placed.start, poses={shelf: at, "die": at @ posed(x, 0.1, z)})
    )
    assert verdict.value is expected, verdict.why


@pytest.mark.parametrize(("pitch", "expected"), [(0.0, True), (-math.pi / 2, True), (math.pi / 2, False)])
def test_a_shelf_on_its_face_holds_nothing(placed: Setting, pitch: float, expected: bool) -> None:
    """As it stands and on its back it does; its front is to +x."""
    at = posed(0, 0.6, 0.5, 0, pitch)
    verdict = placed.judge("Inside(die, shelf)", changed(placed.start, shelf=at, die=at @ posed(0.04, 0.1, 0.1)))
    assert verdict.value is expected, verdict.why


def test_what_rests_on_two_rests_on_both(placed: Setting) -> None:
    """A tower lies across a coaster and a mat, its middle over neither; without one of them it would fall."""
    across = changed(placed.start, coaster=posed(0.5, 0.5, 0.01), mat=posed(0.68, 0.5, 0.015),
                     tower=posed(0.59, 0.5, 0.045, 0, math.pi / 2))  # fmt: skip
    assert [placed.judge(f"OnTop(tower, {b})", across).value for b in ("coaster", "mat")] == [True, True]
    alone = changed(across, mat=posed(0.9, 0.5, 0.015))
    assert not placed.judge("OnTop(tower, coaster)", alone).value


def test_what_a_thing_carries_does_not_hold_it_down(bowl: Setting) -> None:
    """A bowl is lifted with the ball in it; not where the ball holds it up, nor where another thing touches it."""
    raised = changed(bowl.start, bowl=posed(0.1, 0.05, 0.1), ball=posed(0.1, 0.05, 0.14))
    assert bowl.judge("Touching(ball, bowl)", raised).value
    assert bowl.judge("Lifted(bowl)", raised).value
    assert not bowl.judge("Lifted(ball)", raised).value
    above = changed(bowl.start, bowl=posed(0.1, 0.05, 0.1), ball=posed(0.1, 0.05, 0.066))
    assert bowl.judge("Touching(ball, bowl)", above).value
    assert not bowl.judge("Lifted(bowl)", above).value


@pytest.mark.parametrize(
    ("position_deg", "is_open"), [(0, False), (17.9, False), (-17.9, False), (18.1, True), (-18.1, True)]
)
def test_a_flap_that_swings_both_ways_opens_by_a_share_of_its_whole_range(
    placed: Setting, position_deg: float, is_open: bool
) -> None:
    state = changed(placed.start, {"doors.swing": math.radians(position_deg)})
    verdict = placed.judge("Open(doors.swing)", state)
    assert verdict.value is is_open
    assert f"{abs(position_deg) / 180:.1%}" in verdict.why
    assert placed.judge("Closed(doors.swing)", state).value is not is_open


@pytest.mark.parametrize(("position", "is_open"), [(0.2, False), (0.181, False), (0.179, True), (0.0, True)])
def test_a_joint_may_be_closed_at_its_upper_limit(placed: Setting, position: float, is_open: bool) -> None:
    state = changed(placed.start, {"doors.slide": position})
    assert placed.judge("Open(doors.slide)", state).value is is_open
    assert placed.judge("Closed(doors.slide)", state).value is not is_open


def test_at_the_threshold_a_joint_is_closed(setting: Callable[[str], Setting]) -> None:
    one = setting("store_marker")
    state = changed(one.start, {"cabinet.drawer": 0.016})  # a tenth of 0.16 m, to the bit
    values = [one.judge(f"{name}(cabinet.drawer)", state) for name in ("Open", "Closed")]
    assert [v.value for v in values] == [False, True]
    assert values[1].margin > 0


def test_the_same_of_many_states_at_once(placed: Setting) -> None:
    """States judged at once take the quick ways; those of :func:`test_what_carries_and_what_is_under` the exact one."""
    batch = StateBatch.of(placed.scene, [placed.start] * 20)
    judge = Judge(placed.scene)
    for condition in ("OnTop(tower, stool)", "OnTop(cube, frame)", "OnTop(pearl, funnel)", "OnTop(ring, rack)",
                      "OnTop(tower, desk)", "OnTop(cup, desk)", "OnTop(ball, cup)", "Under(ball, cup)"):  # fmt: skip
        one = placed.judge(condition, SceneState.initial(placed.scene))
        assert judge.batch(condition, batch)[0].tolist() == [one.value] * 20, condition
