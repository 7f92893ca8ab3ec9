"""Single lengths in millimeters, and large documents in which nothing is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.load import load

SCENE = """\
simfoundry: scene/1
name: desk
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.1]}, pose: {xyz: [0.4, 0, -0.05]}}
  cup: {shape: {sphere: 0.04}, density: 900, pose: {xyz: [0.4, 0.1, 0.04]}}
robots:
  arm: {model: franka_panda, pose: {xyz: [0, 0.1, 0]}}
cameras:
  front: {size: [64, 48], fov_deg: 60, pose: {xyz: [1.2, 0.1, 0.5], look_at: [0.4, 0, 0]}}
  wrist: {size: [64, 48], fov_deg: 60, mount: arm.hand, pose: {xyz: [0.07, 0, 0.02], look_at: [0, 0, 0.2]}}
"""
ASSET = """\
simfoundry: asset/1
name: pot
links:
  body:
    density: 900
    parts:
      wall: {shape: {cylinder: {radius: 0.1, height: 0.12}}}
      grip: {shape: {capsule: {radius: 0.006, height: 0.05}}, pose: {xyz: [0.11, 0, 0.05]}}
  lid: {density: 900, parts: {lid: {shape: {cylinder: {radius: 0.1, height: 0.01}}}}}
joints:
  turn: {type: continuous, parent: body, child: lid, pose: {xyz: [0, 0, 0.07]}}
"""


def codes(folder: Path, text: str) -> list[tuple[str, str]]:
    kind = "scene" if "scene/1" in text else "asset"
    path = folder / f"a.{kind}.yaml"
    path.write_text(text)
    return [(d.code, d.word) for d in load(path, folder).all_findings()]


@pytest.mark.parametrize("text", [SCENE, ASSET])
def test_as_it_is_nothing_stands_out(text: str, tmp_path: Path) -> None:
    assert codes(tmp_path, text) == []


@pytest.mark.parametrize(
    ("text", "old", "new", "code"),
    [
        (SCENE, "[0.4, 0, -0.05]", "[400, 0, -50]", "SF439"),
        (SCENE, "[0, 0.1, 0]", "[0, 100, 0]", "SF439"),
        (SCENE, "[1.2, 0.1, 0.5]", "[1200, 100, 500]", "SF439"),
        (SCENE, "[0.07, 0, 0.02]", "[70, 0, 20]", "SF439"),
        (SCENE, "0.04}, density", "40}, density", "SF402"),
        (ASSET, "0.006", "6", "SF439"),
        (ASSET, "[0.11, 0, 0.05]", "[110, 0, 50]", "SF439"),
        (ASSET, "[0, 0, 0.07]", "[0, 0, 70]", "SF439"),
    ],
)
def test_one_length_in_millimeters_stands_out(text: str, old: str, new: str, code: str, tmp_path: Path) -> None:
    assert code in [found for found, _ in codes(tmp_path, text.replace(old, new, 1))]


def test_large_scenes_and_long_rails_are_plausible(tmp_path: Path) -> None:
    hall = SCENE.replace("[0.4, 0, -0.05]", "[30, 0, -0.05]").replace("[0, 0.1, 0]", "[60, 0, 0]")
    assert codes(tmp_path, hall) == []
    rail = ASSET.replace("cylinder: {radius: 0.1, height: 0.12}", "box: [8, 0.05, 0.05]")
    assert codes(tmp_path, "".join(line for line in rail.splitlines(True) if "grip" not in line)) == []
