"""Conditions at the start of a scene: the predicates judge them, and say nothing of what a draft does not know."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.lint.draft import StartJudge
from simfoundry.spec.models.predicate import PREDICATES, parse_call
from tests.lint.scenes import BOWL, draft, found, written

CUP = "shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2"
SCENE = f"""
    plate: {{shape: {{cylinder: {{radius: 0.1, height: 0.02}}}}, mass: 0.4, pose: {{xyz: [0.4, 0.2, 0.01]}}}}
    cup: {{{CUP}, pose: {{xyz: [0.4, 0.2, 0.07]}}}}
    mug: {{{CUP}, pose: {{xyz: [0.4, -0.2, 0.05]}}}}
    lying: {{{CUP}, pose: {{xyz: [0, -0.2, 0.04], rpy_deg: [90, 0, 0]}}}}
    leaning: {{{CUP}, pose: {{xyz: [0, 0.5, 0.06], rpy_deg: [10, 0, 0]}}}}
    bowl: {{{BOWL}, mass: 0.3, pose: {{xyz: [-0.4, 0, 0]}}}}
    ball: {{shape: {{sphere: 0.03}}, mass: 0.1, pose: {{xyz: [-0.4, 0, 0.035]}}}}
    pea: {{shape: {{sphere: 0.005}}, mass: 0.01, place: {{inside: bowl, local_xy: [0.03, 0]}}}}
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
    "OnTop(cup, desk)": FALSE,
    "OnTop(mug, plate)": FALSE,
    "OnTop(plate, cup)": FALSE,
    "OnTop(ball, bowl)": TRUE,
    "OnTop(ball, desk)": FALSE,
    "OnTop(pea, bowl)": TRUE,
    "OnTop(chest.tray, chest)": OPEN,
    "Inside(ball, bowl)": TRUE,
    "Inside(pea, bowl)": TRUE,
    "Inside(cup, bowl)": FALSE,
    "Inside(pea, plate)": FALSE,
    "Inside(bowl, ball)": FALSE,
    "Inside(cup, desk)": FALSE,
    "Under(plate, cup)": TRUE,
    "Under(cup, plate)": FALSE,
    "Under(mug, cup)": FALSE,
    "Above(cup, plate)": TRUE,
    "Above(ball, bowl)": TRUE,
    "Above(mug, plate)": FALSE,
    "NextTo(cup, mug)": FALSE,
    "NextTo(cup, plate)": FALSE,
    "Touching(cup, mug)": FALSE,
    "Touching(egg, plate)": TRUE,
    "Touching(cup, plate)": TRUE,
    "Touching(cup, arm)": OPEN,
    "LeftOf(cup, mug)": TRUE,
    "LeftOf(mug, cup)": FALSE,
    "RightOf(mug, cup)": TRUE,
    "Behind(cup, bowl)": TRUE,
    "InFrontOf(cup, bowl)": FALSE,
    "LeftOf(cup, plate)": FALSE,
    "At(cup, 0.4, 0.2)": TRUE,
    "At(cup, 0.4, 0.2, 0.07)": TRUE,
    "At(cup, 0.4, 0.2, 0.3)": FALSE,
    "At(cup, 0.4, 0.25)": FALSE,
    "At(cup, 0.4, -0.2)": FALSE,
    "Upright(cup)": TRUE,
    "Upright(leaning)": FALSE,
    "Upright(lying)": FALSE,
    "Open(chest.slide)": FALSE,
    "Closed(chest.slide)": TRUE,
    "Open(chest.flap)": TRUE,
    "Closed(chest.flap)": FALSE,
    "Open(chest.turn)": OPEN,
    "Closed(chest)": FALSE,
    "Open(chest)": FALSE,
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
    judge = StartJudge(draft(scene))
    got = {text: judge.value(text) for text in EXPECTED}
    assert got == EXPECTED
    assert {parse_call(text).predicate for text in EXPECTED} == set(PREDICATES.built_in)


def test_every_certain_verdict_says_why(scene: Path) -> None:
    judge = StartJudge(draft(scene))
    for text, value in EXPECTED.items():
        assert value is None or judge.explanation(text)


CONDITIONS: list[tuple[object, bool | None]] = [
    ({"all": ["Upright(cup)", "OnTop(cup, plate)"]}, TRUE),
    ({"all": ["Upright(cup)", "OnTop(cup, desk)"]}, FALSE),
    ({"all": ["Upright(leaning)", "Upright(lying)"]}, FALSE),
    ({"any": ["Upright(leaning)", "Upright(cup)"]}, TRUE),
    ({"any": ["Upright(lying)", "Open(chest.turn)"]}, OPEN),
    ({"any": ["Upright(lying)", "Grasped(cup)"]}, FALSE),
    ({"not": "Upright(lying)"}, TRUE),
    ({"not": "Upright(cup)"}, FALSE),
    ({"not": "Open(chest.turn)"}, OPEN),
    ({"all": []}, OPEN),
    ({"all": [{"any": ["Lifted(cup)", {"not": "Lifted(cup)"}]}, "Released(cup)"]}, TRUE),
]


@pytest.mark.parametrize(("condition", "expected"), CONDITIONS)
def test_conditions_have_three_values(condition: object, expected: bool | None, scene: Path) -> None:
    assert StartJudge(draft(scene)).value(condition) is expected


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
    judge = StartJudge(draft(written(tmp_path, things, viewpoint + more)))
    assert judge.value("LeftOf(a, b)") is left
    assert judge.value("RightOf(a, b)") is not left


def test_a_relation_is_reported_where_it_is_written(tmp_path: Path) -> None:
    path = written(tmp_path, SCENE.split("\n", 5)[1] + "\n", "relations:\n  - OnTop(plate, desk)\n  - Upright(plate)\n")
    assert found(path) == []
    path = written(tmp_path, f"cup: {{{CUP}, pose: {{xyz: [0, 0, 0.05]}}}}", "relations: [Inside(cup, desk)]\n")
    ((code, message),) = found(path)
    assert code == "SF406"
    assert message.startswith("`Inside(cup, desk)` does not hold: `desk` has no cavity")
