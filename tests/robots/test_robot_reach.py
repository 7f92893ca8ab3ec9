"""Whether an arm gets down to things: inverse kinematics of the project's own arm, which is always here."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from simfoundry.robots.reach import ArmReach
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene

SCENE = """\
simfoundry: scene/1
name: reach
objects:
  desk: {fixed: true, shape: {box: [2, 2, 0.04]}, pose: {xyz: [0, 0, -0.02]}}
robots:
  arm: {model: demo_arm, pose: {xyz: [0.1, 0, 0], yaw_deg: 40}}
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    file = tmp_path_factory.mktemp("reach") / "reach.scene.yaml"
    file.write_text(SCENE)
    return lower_file(file)


@pytest.mark.parametrize(("away", "reached"), [(0.15, False), (0.32, True), (0.55, True), (0.78, True), (0.9, False)])
@pytest.mark.parametrize("side_deg", [0.0, 130.0])
def test_an_arm_reaches_down_to_a_ring_around_it(scene: Scene, away: float, reached: bool, side_deg: float) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    angle = np.radians(side_deg)
    middle = np.array([0.1 + away * np.cos(angle), away * np.sin(angle), 0.02])
    found = ArmReach(scene, ("arm",))(middle - 0.02, middle + 0.02)
    assert (found.checked, found.reached, found.robot) == (True, reached, "arm")
    assert found.away == pytest.approx(away, abs=1e-9)


def test_what_cannot_be_checked_is_said(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    here = np.array([0.5, 0.0, 0.0])
    found = ArmReach(scene, ("other",))(here, here + 0.04)
    assert not found.checked and found.why == "no model of other is installed; run `simfoundry doctor` for instructions"
    monkeypatch.setitem(sys.modules, "mink", None)
    found = ArmReach(scene, ("arm",))(here, here + 0.04)
    assert found.why == "inverse kinematics needs mink; install with `pip install 'simfoundry[expert]'`"
