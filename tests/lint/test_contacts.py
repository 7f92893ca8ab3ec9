"""Things that overlap and things that nothing supports: what is reported, and above all what is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.lint.contacts import DEEP, HOVERING
from tests.lint.scenes import BOWL, codes, draft, found, written

CUP = "shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2"
BALL = "shape: {sphere: 0.03}, mass: 0.05"
BOX = "shape: {box: [0.1, 0.1, 0.1]}, mass: 0.3"
TUBE = "shape: {lathe: {profile: [[0, 0], [0.05, 0], [0.05, 0.2], [0.045, 0.2], [0.045, 0.01], [0, 0.01]]}}, mass: 0.3"

RESTING = {
    "a ball in a bowl": f"bowl: {{{BOWL}, mass: 0.3}}\nball: {{{BALL}, pose: {{xyz: [0, 0, 0.035]}}}}",
    "a bowl in a bowl": f"a: {{{BOWL}, mass: 0.3}}\nb: {{{BOWL}, mass: 0.3, pose: {{xyz: [0, 0, 0.012]}}}}",
    "a stick in a tube": f"""
        tube: {{{TUBE}}}
        stick: {{shape: {{cylinder: {{radius: 0.01, height: 0.3}}}}, mass: 0.1, pose: {{xyz: [0, 0, 0.1601]}}}}
    """,
    "a leaning board": f"""
        box: {{{BOX}, pose: {{xyz: [0, 0, 0.05]}}}}
        board: {{shape: {{box: [0.4, 0.1, 0.01]}}, mass: 1, pose: {{xyz: [-0.1386, 0, 0.0732], rpy_deg: [0, -20, 0]}}}}
    """,
    "a stack": "\n".join(
        f"b{k}: {{{BOX}, pose: {{xyz: [0, 0, {0.05 + 0.1 * k}], yaw_deg: {30 * k}}}}}" for k in range(6)
    ),
    "a thing over the edge": f"box: {{{BOX}, pose: {{xyz: [1.03, 0, 0.05]}}}}",
    "side by side": f"a: {{{BOX}, pose: {{xyz: [0, 0, 0.05]}}}}\nb: {{{BOX}, pose: {{xyz: [0.1, 0, 0.05]}}}}",
    "crossing fixtures": """
        post: {fixed: true, shape: {box: [0.1, 0.1, 2]}}
        rail: {fixed: true, shape: {box: [2, 0.1, 0.1]}, pose: {xyz: [0, 0, 0.5]}}
    """,
    "without contact": f"""
        glow: {{shape: {{sphere: 0.2}}, mass: 1, collision: none, pose: {{xyz: [0, 0, 0.5]}}}}
        box: {{{BOX}, pose: {{xyz: [0, 0, 0.05]}}}}
    """,
    "under a table": f"""
        floor: {{fixed: true, shape: {{box: [3, 3, 0.1]}}, pose: {{xyz: [0, 0, -1]}}}}
        box: {{{BOX}, pose: {{xyz: [0, 0, -0.9]}}}}
    """,
    "placed": f"bowl: {{{BOWL}, mass: 0.3, place: {{on: desk}}}}\nball: {{{BALL}, place: {{inside: bowl}}}}",
}


@pytest.mark.parametrize("name", RESTING)
def test_what_rests_is_clean(name: str, tmp_path: Path) -> None:
    assert found(written(tmp_path, RESTING[name])) == []


WRONG = {
    "sunk": (f"cup: {{{CUP}, pose: {{xyz: [0, 0, 0.047]}}}}", "SF410", "`cup` and `desk` overlap by 3.0 mm"),
    "through the rim": (
        f"bowl: {{{BOWL}, mass: 0.3}}\nbox: {{{BOX}, pose: {{xyz: [0.1, 0, 0.05]}}}}",
        "SF410",
        "`box` and `bowl` overlap by 3.0 cm",
    ),
    "in the wall of a tube": (
        f"tube: {{{TUBE}}}\nball: {{{BALL}, pose: {{xyz: [0.03, 0, 0.1]}}}}",
        "SF410",
        "`ball` and `tube` overlap by 1.5 cm",
    ),
    "hovering": (f"cup: {{{CUP}, pose: {{xyz: [0, 0, 0.056]}}}}", "SF411", "it falls 6.0 mm onto `desk`"),
    "beside": (f"cup: {{{CUP}, pose: {{xyz: [1.1, 0, 0.05]}}}}", "SF411", "there is nothing below it"),
    "below": (f"cup: {{{CUP}, pose: {{xyz: [0, 0, -1]}}}}", "SF411", "there is nothing below it"),
    "over a hollow": (
        f"bowl: {{{BOWL}, mass: 0.3}}\nball: {{{BALL}, pose: {{xyz: [0, 0, 0.06]}}}}",
        "SF411",
        "it falls 2.5 cm onto `bowl`",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(name: str, tmp_path: Path) -> None:
    objects, code, message = WRONG[name]
    ((got, text),) = found(written(tmp_path, objects))
    assert got == code
    assert message in text


def test_a_tower_falls_from_its_foot(tmp_path: Path) -> None:
    tower = "\n".join(f"b{k}: {{{BOX}, pose: {{xyz: [0, 0, {0.15 + 0.1 * k}]}}}}" for k in range(4))
    ((code, message),) = found(written(tmp_path, tower))
    assert (code, message) == ("SF411", "nothing supports `b0`: it falls 10.0 cm onto `desk`")


@pytest.mark.parametrize("gravity", ["[0, 0, 0]", "[0, 0, 9.81]", "[1, 0, -9.81]"])
def test_without_a_plain_down_nothing_falls(gravity: str, tmp_path: Path) -> None:
    hovering = f"cup: {{{CUP}, pose: {{xyz: [0, 0, 0.5]}}}}"
    assert codes(written(tmp_path, hovering)) == ["SF411"]
    assert codes(written(tmp_path, hovering, f"gravity: {gravity}\n")) == []


@pytest.mark.parametrize(("gap", "seen"), [(0.9 * HOVERING, False), (1.2 * HOVERING, True)])
@pytest.mark.parametrize("shape", [CUP, BALL, BOX, f"{BOWL}, mass: 0.3"])
def test_the_bar_for_hovering(shape: str, gap: float, seen: bool, tmp_path: Path) -> None:
    low = float(draft(written(tmp_path, f"it: {{{shape}}}")).bounds["it"][0][2])
    path = written(tmp_path, f"it: {{{shape}, pose: {{xyz: [0.1, 0.2, {gap - low}], yaw_deg: 20}}}}")
    assert codes(path) == (["SF411"] if seen else [])


@pytest.mark.parametrize(("depth", "seen"), [(0.8 * DEEP, False), (1.2 * DEEP, True)])
@pytest.mark.parametrize("shape", [CUP, BALL, BOX, f"{BOWL}, mass: 0.3"])
def test_the_bar_for_overlap(shape: str, depth: float, seen: bool, tmp_path: Path) -> None:
    low = float(draft(written(tmp_path, f"it: {{{shape}}}")).bounds["it"][0][2])
    path = written(tmp_path, f"it: {{{shape}, pose: {{xyz: [0.1, 0.2, {-depth - low}], yaw_deg: 20}}}}")
    assert codes(path) == (["SF410"] if seen else [])


def test_many_overlaps_are_not_all_told(tmp_path: Path) -> None:
    heap = "\n".join(f"b{k}: {{{BOX}, pose: {{xyz: [0, 0, {0.05 + k * 1e-4}]}}}}" for k in range(60))
    assert codes(written(tmp_path, heap)) == ["SF410"] * 200
