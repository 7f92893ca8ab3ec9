"""The objects that a robot can take, and the reasons why it cannot take others."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.ideas import Affordances
from simfoundry.cousins.tasks.trial import put
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.grasp_width import grasp_width
from simfoundry.scene.object_shapes import solid
from tests.cousins.tasks.rooms import CASE, rooms


def test_what_can_be_taken_is_measured(setting: TaskContext) -> None:
    there = Affordances.of(setting)
    assert there.things == ("bowl", "ball", "block")
    assert there.containers == ("bowl", "cabinet.drawer", "cabinet.bottom_drawer")
    assert there.joints == ("cabinet.drawer", "cabinet.bottom_drawer")


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("wide", "too_wide", "12"),
        ("heavy", "too_heavy", "3.77 kg, but the robot can only lift 2 kg"),
        ("far", "out_of_reach", "1.20 m from `arm`, which reaches 0.855 m"),
        ("desk", "fixed", "fixed"),
    ],
)
def test_what_cannot_be_taken_says_why(setting: TaskContext, name: str, code: str, said: str) -> None:
    reasons = setting.cannot_take(name)
    assert [r.code for r in reasons] == [code]
    assert said in reasons[0].text


def test_fingers_measure_a_ball_at_its_equator_and_a_bowl_at_its_wall(setting: TaskContext) -> None:
    def width(name: str) -> float:
        return grasp_width(solid(setting.twin.item_at(name, setting.twin.state.poses[name])))

    assert width("ball") == pytest.approx(0.067, abs=0.002)
    assert width("block") == pytest.approx(0.03, abs=0.002)
    assert width("wide") == pytest.approx(0.12, abs=0.003)
    assert 0.004 < width("bowl") < 0.02


def test_what_is_shut_in_cannot_be_taken(tmp_path: Path) -> None:
    for shut, codes in ((False, []), (True, ["covered"])):
        front = "      front: {shape: {box: [0.008, 0.5, 0.4575]}, pose: {xyz: [-0.096, 0, 0.22875]}}\n" * shut
        setting = rooms(tmp_path, CASE.format(middle=0.22) + front)
        inside = put(setting, "cup", Pose.of((0.62, 0.0, 0.228)), setting.twin.state)
        assert [r.code for r in setting.cannot_hold("cup", inside)] == codes
