"""The end of the demo: an arm beside a scene does a small task, in documents and pictures that anybody can look at."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.errors import OutputError
from simfoundry.evaluate.demo import PICTURES, SIZE, demonstrate
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.project import MARKER

SCENE = """\
simfoundry: scene/1
name: tray
materials:
  wood: {density: 500, friction: 0.6}
objects:
  desk: {fixed: true, shape: {box: [1.2, 1, 0.04]}, material: wood, pose: {xyz: [0.2, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, material: wood, place: {on: desk, xy: [0.1, 0.1], yaw_deg: 20}}
  crate: {shape: {box: [0.2, 0.15, 0.12]}, material: wood, place: {on: desk, xy: [0.1, -0.2]}}
cameras:
  view: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-0.8, 0, 0.7], look_at: [0.1, 0, 0]}}
relations: [OnTop(cube, desk)]
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "scene" / "tray.scene.yaml"
    file.parent.mkdir()
    file.write_text(SCENE)
    return file


def test_an_arm_puts_one_thing_on_another_and_leaves_documents_and_pictures(scene: Path, tmp_path: Path) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    from PIL import Image

    out = tmp_path / "arm"
    done = demonstrate(scene, out)
    assert (done.instruction, done.success, done.reason) == ("Put the cube on the crate.", True, "")
    assert 2.0 < done.seconds < 20.0
    report = json.loads((out / "report.json").read_text())
    assert {key: report[key] for key in done.to_json()} == done.to_json()
    assert done.task is not None and load(done.task).all_findings() == []
    setting = load(out / "arm.scene.yaml").spec
    assert isinstance(setting, SceneSpec)
    arm = setting.robots["arm"]
    assert arm.model == "demo_arm" and arm.pose.xyz[0] > 0.4  # opposite the camera, and on the desk
    assert arm.pose.yaw_deg is not None and abs(arm.pose.yaw_deg) > 150
    assert done.strip is not None
    strip = np.asarray(Image.open(done.strip))
    assert strip.shape[1] > PICTURES * SIZE[0] and strip.std() > 20
    (out / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match=r"contains files that were not generated there \(mine.txt\)"):
        demonstrate(scene, out)
    (out / "mine.txt").unlink()
    done.task.write_text(done.task.read_text().replace("Put the", "Lay the"))
    with pytest.raises(OutputError, match=r"were edited since they were generated \(arm.task.yaml\)"):
        demonstrate(scene, out)


def test_without_the_expert_the_demo_says_what_to_install(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mink", None)
    done = demonstrate(scene, tmp_path / "arm")
    assert not done.success and done.task is None and not (tmp_path / "arm").exists()
    assert done.reason == "its inverse kinematics requires mink; install with `pip install 'simfoundry[expert]'`"


def test_where_nothing_can_be_grasped_the_arm_does_nothing(scene: Path, tmp_path: Path) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    scene.write_text(SCENE.replace("box: [0.04, 0.04, 0.04]", "box: [0.2, 0.2, 0.2]"))
    done = demonstrate(scene, tmp_path / "arm")
    assert done.reason == "no object in the scene is small enough for the arm to grasp and place" and done.strip is None
    assert (tmp_path / MARKER).is_file()
