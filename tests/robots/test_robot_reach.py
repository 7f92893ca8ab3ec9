"""Whether an arm gets down to things: inverse kinematics of the project's own arm, which is always here."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.robots.arm import Arm
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


def test_no_configuration_is_beyond_the_length_of_the_arm(scene: Scene) -> None:
    arm = Arm(scene.robot("arm"))
    rng = np.random.default_rng(0)
    for q in rng.uniform(arm.low, arm.high, (300, len(arm.low))):
        assert not arm.is_too_short(arm.hand(q))
    away = arm.robot.X_WB.p + np.array([1.2, 0.0, 0.3])
    assert arm.is_too_short(Pose.of(away, (0.0, 1.0, 0.0, 0.0)))


@pytest.mark.parametrize("slack", [0.0, 0.03])
def test_arms_are_too_short_only_where_inverse_kinematics_fails_too(scene: Scene, slack: float) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    reach, said = ArmReach(scene, ("arm",)), []
    for away in np.arange(0.6, 1.1, 0.05):
        middle = np.array([0.1 + away, 0.0, 0.02])
        said.append(reach.is_too_short(middle - 0.02, middle + 0.02, slack))
        assert not (said[-1] and reach(middle - 0.02 - slack, middle + 0.02 - slack).reached)
    assert said == sorted(said) and not said[0] and said[-1]
