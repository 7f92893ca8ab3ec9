"""A robot in a compiled scene comes back as that robot, with its base, its posture and the camera on its hand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from simfoundry.backends import compile_scene
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import import_file
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.models.robot_file import OWN_ROBOTS
from tests.corpora.roundtrip import MAINS, trip_by_scene

JOINTS = [f"joint{k}" for k in range(1, 7)]
ROW = '<body name="part{k}" pos="0 0 0.1"><joint name="joint{k}" axis="{axis}" range="-2 2" damping="0.5"/>'
PART = ROW + '<geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02" mass="0.5"/>'
PARTS = "".join(PART.format(k=k, axis="0 1 0" if k % 2 else "0 0 1") for k in range(1, 7)) + "</body>" * 6
SERVOS = "".join(f'<position joint="{name}" kp="50"/>' for name in JOINTS)
MODEL = (
    '<mujoco model="mini"><compiler angle="radian"/><worldbody><body name="foot">'
    f'<geom type="cylinder" size="0.05 0.05" mass="2"/>{PARTS}</body></worldbody><actuator>{SERVOS}</actuator></mujoco>'
)
HAND = "{link: part6, pose: {xyz: [0, 0, 0.1]}}"
KNOWN = f"mjcf:\n  file: mini.xml\n  joints: [{', '.join(JOINTS)}]\n  links: {{hand: {HAND}}}\n"

SCENE = """\
simfoundry: scene/1
name: cell
materials: {wood: {density: 700, friction: 0.5}}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, material: wood, pose: {xyz: [0.4, 0, -0.02]}}
  cube: {shape: {box: [0.05, 0.05, 0.05]}, material: wood, pose: {xyz: [0.4, 0, 0.025]}}
robots:
  arm:
    model: yam
    pose: {xyz: [0, 0.1, 0], yaw_deg: 30}
    joints: {joint1: 0.25, joint2: -0.5, joint3: 0, joint4: 0, joint5: 0, joint6: 0}
cameras:
  over: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [0.4, 0, 1], look_at: [0.4, 0.001, 0]}}
  wrist: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [0.05, 0, 0], look_at: [0.1, 0, 0.3]}, mount: arm.hand}
"""


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """A scene with a robot of two joints that stands for a known one."""
    (tmp_path / "mini.xml").write_text(MODEL)
    (tmp_path / "yam.yaml").write_text(KNOWN)
    monkeypatch.setenv(OWN_ROBOTS, str(tmp_path))
    (tmp_path / "cell.scene.yaml").write_text(SCENE)
    return lower_file(tmp_path / "cell.scene.yaml")


def test_mjcf_gives_the_robot_and_its_camera_back(cell: Scene, tmp_path: Path) -> None:
    assert [m.link for m in cell.mounted] == ["hand"]
    assert trip_by_scene(cell, "mjcf", tmp_path) == ([], [])


def test_urdf_gives_the_robot_back(cell: Scene, tmp_path: Path) -> None:
    said, unsaid = trip_by_scene(cell, "urdf", tmp_path)
    assert not unsaid
    assert "robots" not in {d.feature for d in said}


@pytest.mark.parametrize("words", ["{", '{"model": "nobody"}', '{"model": 3}', "[]"])
def test_words_that_were_edited_into_nonsense_are_refused(cell: Scene, tmp_path: Path, words: str) -> None:
    compile_scene(cell, "urdf").write(tmp_path / "build")
    poses = tmp_path / "build" / MAINS["urdf"]
    data = json.loads(poses.read_text())
    data["arm"]["robot"] = json.loads(words) if words != "{" else "{"
    poses.write_text(json.dumps(data))
    with pytest.raises(ImportRefusedError, match="arm"):
        import_file(poses, tmp_path / "back.scene.yaml")


def test_a_camera_on_a_robot_is_a_loss_of_urdf(cell: Scene) -> None:
    losses = compile_scene(cell, "urdf").losses
    assert {loss.feature for loss in losses if loss.path == "wrist"} == {"mounted_cameras"}


def test_scenes_share_a_robot_until_its_model_changes(cell: Scene, tmp_path: Path) -> None:
    path = tmp_path / "cell.scene.yaml"
    assert lower_file(path).robots[0] is cell.robots[0]
    (tmp_path / "mini.xml").write_text(MODEL.replace('mass="2"', 'mass="3"'))
    changed = lower_file(path).robots[0]
    assert changed is not cell.robots[0]
    path.write_text(SCENE.replace("yaw_deg: 30", "yaw_deg: 31"))
    assert lower_file(path).robots[0] is not changed
