"""Predicates on a sketch: true and false only where every reading agrees."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.lint.verdicts import judge, verdict
from simfoundry.spec.models.expressions import parse_call
from simfoundry.spec.models.predicate import PREDICATES
from tests.lint.scenes import BOWL, drawn, found, written

CUP = "shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2"
SCENE = f"""
    plate: {{shape: {{cylinder: {{radius: 0.1, height: 0.02}}}}, mass: 0.4, pose: {{xyz: [0.4, 0.2, 0.01]}}}}
    cup: {{{CUP}, pose: {{xyz: [0.4, 0.2, 0.07]}}}}
    mug: {{{CUP}, pose: {{xyz: [0.4, -0.2, 0.05]}}}}
    lying: {{{CUP}, pose: {{xyz: [0, -0.2, 0.04], rpy_deg: [90, 0, 0]}}}}
    leaning: {{{CUP}, pose: {{xyz: [0, 0.5, 0.06], rpy_deg: [10, 0, 0]}}}}
    bowl: {{{BOWL}, mass: 0.3, pose: {{xyz: [-0.4, 0, 0]}}}}
    ball: {{shape: {{sphere: 0.03}}, mass: 0.1, pose: {{xyz: [-0.4, 0, 0.035]}}}}
    pea: {{shape: {{sphere: 0.005}}, mass: 0.01, place: {{inside: mug}}}}
    egg: {{shape: {{sphere: 0.02}}, mass: 0.01, place: {{on: plate, xy: [0.4, 0.27]}}}}
    chest: {{asset: chest.asset.yaml, pose: {{xyz: [0.6, 0.6, 0.1]}}, joints: {{slide: 0.02, flap: {{deg: 30}}}}}}
"""
CHEST = """simfoundry: asset/1
name: chest
links:
  body: {parts: {box: {shape: {box: [0.2, 0.2, 0.2]}}}, mass: 3}
  tray: {parts: {box: {shape: {box: [0.1, 0.1, 0.02]}}}, mass: 1}
  door: {parts: {box: {shape: {box: [0.1, 0.02, 0.1]}}}, mass: 1}
  knob: {parts: {box: {shape: {sphere: 0.01}}}, mass: 0.1}
joints:
  slide: {type: prismatic, parent: body, child: tray, limits: [0, 0.3]}
  flap: {type: revolute, parent: body, child: door, limits_deg: [-90, 0.0]}
  turn: {type: continuous, parent: body, child: knob}
""".replace("0.0]", "90]")

TRUE, FALSE, OPEN = True, False, None
EXPECTED: dict[str, bool | None] = {
    "OnTop(cup, plate)": TRUE,
    "OnTop(mug, desk)": TRUE,
    "OnTop(egg, plate)": TRUE,
    "OnTop(cup, desk)": OPEN,  # 2 cm above it, on a plate
    "OnTop(mug, plate)": FALSE,
    "OnTop(plate, cup)": FALSE,
    "OnTop(ball, bowl)": OPEN,  # in it rather than on it
    "OnTop(ball, desk)": OPEN,
    "OnTop(pea, mug)": OPEN,
    "OnTop(chest.tray, chest)": OPEN,
    "Inside(ball, bowl)": TRUE,
    "Inside(pea, mug)": TRUE,
    "Inside(cup, bowl)": FALSE,
    "Inside(pea, bowl)": FALSE,
    "Inside(bowl, ball)": OPEN,
    "Inside(cup, desk)": FALSE,
    "Under(plate, cup)": TRUE,
    "Under(cup, plate)": FALSE,
    "Under(mug, cup)": FALSE,
    "Above(cup, plate)": TRUE,
    "Above(ball, bowl)": OPEN,
    "Above(mug, plate)": FALSE,
    "NextTo(cup, mug)": FALSE,
    "NextTo(cup, plate)": OPEN,
    "Touching(cup, mug)": FALSE,
    "Touching(egg, plate)": TRUE,
    "Touching(cup, plate)": OPEN,
    "Touching(cup, arm)": OPEN,
    "LeftOf(cup, mug)": TRUE,
    "LeftOf(mug, cup)": FALSE,
    "RightOf(mug, cup)": TRUE,
    "Behind(cup, bowl)": TRUE,
    "InFrontOf(cup, bowl)": FALSE,
    "LeftOf(cup, plate)": OPEN,  # one above the other
    "At(cup, 0.4, 0.2)": TRUE,
    "At(cup, 0.4, 0.2, 0.07)": TRUE,
    "At(cup, 0.4, 0.2, 0.3)": FALSE,
    "At(cup, 0.4, 0.25)": OPEN,
    "At(cup, 0.4, -0.2)": FALSE,
    "Upright(cup)": TRUE,
    "Upright(leaning)": OPEN,
    "Upright(lying)": FALSE,
    "Open(chest.slide)": OPEN,  # 7 % of its way
    "Closed(chest.slide)": OPEN,
    "Open(chest.flap)": TRUE,
    "Closed(chest.flap)": FALSE,
    "Open(chest.turn)": OPEN,
    "Closed(chest)": FALSE,
    "Open(chest)": OPEN,
    "Grasped(cup)": FALSE,
    "Grasped(cup, arm)": FALSE,
    "Lifted(cup)": FALSE,
    "Released(cup)": TRUE,
}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "chest.asset.yaml").write_text(CHEST)
    return written(tmp_path, SCENE, "robots: {arm: {model: franka_robotiq, pose: {xyz: [-1, 0, 0]}}}\n")


def test_each_predicate_is_judged_as_far_as_it_can_be(scene: Path) -> None:
    sketch = drawn(scene)
    got = {text: verdict(parse_call(text), sketch).value for text in EXPECTED}
    assert got == EXPECTED
    assert {parse_call(text).predicate for text in EXPECTED} == set(PREDICATES.built_in)


def test_every_certain_verdict_says_why(scene: Path) -> None:
    sketch = drawn(scene)
    for text, value in EXPECTED.items():
        why = verdict(parse_call(text), sketch).why
        assert (why == "") == (value is None)
        assert value is None or parse_call(text).args[0].partition(".")[0] in why


CONDITIONS: list[tuple[object, bool | None]] = [
    ({"all": ["Upright(cup)", "OnTop(cup, plate)"]}, TRUE),
    ({"all": ["Upright(cup)", "OnTop(cup, desk)"]}, OPEN),
    ({"all": ["Upright(leaning)", "Upright(lying)"]}, FALSE),
    ({"any": ["Upright(leaning)", "Upright(cup)"]}, TRUE),
    ({"any": ["Upright(leaning)", "Upright(lying)"]}, OPEN),
    ({"any": ["Upright(lying)", "Grasped(cup)"]}, FALSE),
    ({"not": "Upright(lying)"}, TRUE),
    ({"not": "Upright(cup)"}, FALSE),
    ({"not": "Upright(leaning)"}, OPEN),
    ({"all": []}, OPEN),
    ({"all": [{"any": ["Lifted(cup)", {"not": "Lifted(cup)"}]}, "Released(cup)"]}, TRUE),
]


@pytest.mark.parametrize(("condition", "expected"), CONDITIONS)
def test_conditions_have_three_values(condition: object, expected: bool | None, scene: Path) -> None:
    assert judge(condition, drawn(scene)).value is expected


@pytest.mark.parametrize(
    ("viewpoint", "left"),
    [
        ("", True),
        ("viewpoint: east\n", False),
        ("viewpoint: above\n", True),
        ("viewpoint: arm\n", False),
    ],
)
def test_left_is_that_of_the_viewpoint(viewpoint: str, left: bool, tmp_path: Path) -> None:
    more = (
        "robots: {arm: {model: franka_robotiq, pose: {xyz: [1, 0, 0], yaw_deg: 180}}}\n"
        "cameras:\n"
        "  east: {size: [64, 48], fx: 20, fy: 20, pose: {xyz: [2, 0, 1], look_at: [0, 0, 0]}}\n"
        "  above: {size: [64, 48], fx: 20, fy: 20, pose: {xyz: [0, 0, 2], quat_wxyz: [0, 0.70711, -0.70711, 0]}}\n"
    )
    things = f"a: {{{CUP}, pose: {{xyz: [0, 0.2, 0.05]}}}}\nb: {{{CUP}, pose: {{xyz: [0, -0.2, 0.05]}}}}"
    sketch = drawn(written(tmp_path, things, viewpoint + more))
    assert verdict(parse_call("LeftOf(a, b)"), sketch).value is left
    assert verdict(parse_call("RightOf(a, b)"), sketch).value is not left


def test_a_relation_is_reported_where_it_is_written(tmp_path: Path) -> None:
    path = written(tmp_path, SCENE.split("\n", 5)[1] + "\n", "relations:\n  - OnTop(plate, desk)\n  - Upright(plate)\n")
    assert found(path) == []
    path = written(tmp_path, f"cup: {{{CUP}, pose: {{xyz: [0, 0, 0.05]}}}}", "relations: [Inside(cup, desk)]\n")
    ((code, message),) = found(path)
    assert code == "SF406"
    assert message == "`Inside(cup, desk)` does not hold: the middle of `cup` is 5.0 cm outside of `desk`"
