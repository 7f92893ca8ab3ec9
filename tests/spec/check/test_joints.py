"""Positions, targets and pairs without contact, held against the joints and links that there are."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.load import load
from tests.scene.test_joints import ASSET, SCENE


def found(folder: Path, right: str = "", wrong: str = "") -> list[tuple[str, str]]:
    """Code and message of what is found in the scene, where ``right`` is replaced by ``wrong`` in either document."""
    assert not right or (right in SCENE) != (right in ASSET), right
    (folder / "lamp.asset.yaml").write_text(ASSET.replace(right, wrong) if right else ASSET)
    (folder / "room.scene.yaml").write_text(SCENE.replace(right, wrong) if right else SCENE)
    findings = load(folder / "room.scene.yaml").all_findings()
    return [(d.code, d.message) for d in findings if d.code < "SF4"]


def test_the_documents_are_sound(tmp_path: Path) -> None:
    assert found(tmp_path) == []


# Slips by the text in which they are made, each with its code and the start of its message.
SLIPS: dict[str, list[tuple[str, str, str]]] = {
    "neck: {deg: 30}": [
        ("neck: {deg: 70}", "SF205", "`neck` at 70 deg is outside its limits"),
        ("neck: {yaw_deg: 30}", "SF103", "`neck` is a revolute joint: its position is a single number"),
        ("left_hinge: 0.1", "SF205", "`left_hinge` follows `right_hinge`"),
    ],
    "multiplier: -0.5": [
        ("multiplier: -2", "SF205", "`right_hinge` at -60 deg is outside its limits, -40 to 40 deg"),
    ],
    "shoulder: {rpy_deg: [20, -10, 30]}": [
        ("shoulder: 0.3", "SF103", "`shoulder` is a ball joint: its position cannot be"),
        ("shoulder: {xyz: [0, 0, 1]}", "SF205", "`shoulder` is a ball joint and cannot"),
    ],
    "rests: {xyz: [0.1, 0, 0.05], yaw_deg: 40}": [
        ("rests: {deg: 40}", "SF103", "`rests` is a free joint: its position"),
        ("rests: {xyz: [0.1, 0]}", "SF105", "values are missing"),
    ],
    "force_limit: 2}": [
        ("force_limit: 2, target: 1.1}", "SF205", "the target of `neck` at 63.0254 deg is outside its limits"),
    ],
    "[cup, lamp.shade]": [
        ("[cup, lamp.shad]", "SF201", "no link or joint of `lamp` is called `shad`"),
        ("[cup, cup]", "SF212", "`cup` is paired with itself"),
        ("[lamp.right, lamp.left]", "SF212", "the pair `lamp.left` and `lamp.right` is listed twice"),
        ("[cup]", "SF105", "values are missing: the list has only 1"),
    ],
    "[[shade, foot]]": [
        ("[[shade, foot], [foot, shade]]", "SF212", "the pair `foot` and `shade` is listed twice"),
    ],
    "mimic: {joint: neck,": [
        ("mimic: {joint: shoulder,", "SF211", "`shoulder` is a ball joint, which has no single position"),
        ("mimic: {joint: left_hinge,", "SF211", "`left_hinge` follows itself through other joints"),
    ],
}


@pytest.mark.parametrize(("right", "slip"), [(right, slip) for right, slips in SLIPS.items() for slip in slips])
def test_what_is_wrong_is_found(tmp_path: Path, right: str, slip: tuple[str, str, str]) -> None:
    wrong, code, words = slip
    findings = found(tmp_path, right, wrong)
    assert [c for c, m in findings if m.startswith(words)] == [code], findings
