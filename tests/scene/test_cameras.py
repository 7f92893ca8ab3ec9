"""Cameras by field of view, and cameras that look at objects, links and robots by name."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import simfoundry as sf
from simfoundry.geometry.frames import Array
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Camera, Scene
from simfoundry.spec.diagnostics import SpecError

CABINET = """\
simfoundry: asset/1
name: cabinet
links:
  body: {mass: 5, parts: {box: {shape: {box: [0.4, 0.5, 0.6]}}}}
  door: {mass: 1, parts: {panel: {shape: {box: [0.02, 0.5, 0.6]}, pose: {xyz: [0, 0.25, 0]}}}}
joints:
  hinge: {type: revolute, parent: body, child: door, pose: {xyz: [-0.21, -0.25, 0]}, limits_deg: [0, 90]}
"""
SCENE = """\
simfoundry: scene/1
name: shelf
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.1]}, mass: 20, pose: {xyz: [0.5, 0, -0.05]}}
  mug: {shape: {box: [0.1, 0.1, 0.2]}, mass: 0.2, place: {on: desk, xy: [0.4, 0.2]}}
  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [3, 0, 0.3]}, joints: {hinge: {deg: 90}}}
robots:
  arm: {model: franka_panda, pose: {xyz: [-1, 0, 0.2]}, joints: home}
cameras:
  to_mug: {size: [640, 480], fov_deg: 60, pose: {xyz: [0, -1, 1], look_at: mug}}
  to_door: {size: [640, 480], fov_deg: 60, pose: {xyz: [0, -1, 1], look_at: cabinet.door}}
  to_arm: {size: [640, 480], fov_deg: 60, pose: {xyz: [0, -1, 1], look_at: arm}}
  on_door: {size: [640, 480], fov_deg: 60, mount: cabinet.door, pose: {xyz: [0, 0, 1], look_at: mug}}
"""


def lowered(folder: Path, text: str = SCENE) -> Scene:
    (folder / "cabinet.asset.yaml").write_text(CABINET)
    (folder / "a.scene.yaml").write_text(text)
    return lower_file(folder / "a.scene.yaml")


def misses(camera: Camera, point: Array | list[float]) -> float:
    """The distance [px] between the center of the image and the picture of a point in front of the camera."""
    x, y, z = camera.X_WC.inverse().apply(np.asarray(point, dtype=np.float64))
    assert z > 0
    return float(np.hypot(camera.fx * x / z, camera.fy * y / z))


def test_a_camera_looks_at_the_center_of_what_it_names(tmp_path: Path) -> None:
    cameras = {c.name: c for c in lowered(tmp_path).cameras}
    assert misses(cameras["to_mug"], [0.4, 0.2, 0.1001]) < 1e-6  # placed 0.1 mm above the desk
    # The open door sticks out of the cabinet along -x.
    assert misses(cameras["to_door"], [3 - 0.21 - 0.25, -0.25, 0.3]) < 1e-6
    assert misses(cameras["to_arm"], [-1, 0, 0.2]) < 1e-6


def test_a_mounted_camera_looks_at_the_object_from_its_link(tmp_path: Path) -> None:
    scene = lowered(tmp_path)
    (mounted,) = scene.mounted
    cabinet = scene.object("cabinet")
    X_WL = cabinet.X_WO @ link_poses(cabinet)["door"]
    x, y, z = (X_WL @ mounted.camera.X_WC).inverse().apply(np.array([0.4, 0.2, 0.1001]))
    assert z > 1 and np.hypot(x, y) < 1e-6


def test_the_field_of_view_is_that_of_mujoco(tmp_path: Path) -> None:
    (tmp_path / "cabinet.asset.yaml").write_text(CABINET)
    (tmp_path / "a.scene.yaml").write_text(SCENE)
    sf.load(tmp_path / "a.scene.yaml").compile("mjcf", out=tmp_path / "build")
    model = mujoco.MjModel.from_xml_path(str(next((tmp_path / "build").rglob("scene.xml"))))
    k = model.camera("to_mug").id
    focal, sensor = model.cam_intrinsic[k][1], model.cam_sensorsize[k][1]
    assert np.degrees(2 * np.arctan(sensor / 2 / focal)) == pytest.approx(60, abs=1e-4)


def test_the_viewpoint_may_look_at_a_placed_object(tmp_path: Path) -> None:
    """Left of the mug, seen from the negative y axis, is toward negative x."""
    text = SCENE.replace("name: shelf", "name: shelf\nviewpoint: to_mug").replace("[0, -1, 1]", "[0.4, -1, 1]")
    beside = "  cup: {shape: {box: [0.1, 0.1, 0.2]}, mass: 0.2, place: {on: desk, left_of: mug}}\n"
    cup = lowered(tmp_path, text.replace("  cabinet:", f"{beside}  cabinet:")).object("cup")
    assert cup.X_WO.p == pytest.approx([0.27, 0.2, 0.1001], abs=1e-4)


def test_the_viewpoint_cannot_look_at_what_it_places(tmp_path: Path) -> None:
    text = SCENE.replace("name: shelf", "name: shelf\nviewpoint: to_mug")
    text = text.replace("{on: desk, xy: [0.4, 0.2]}", "{on: desk, left_of: cabinet}")
    with pytest.raises(SpecError, match="depends on the viewpoint"):
        lowered(tmp_path, text)


def test_a_camera_inside_its_target_has_no_direction(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="at the center of `desk`"):
        lowered(tmp_path, SCENE.replace("xyz: [0, -1, 1], look_at: mug", "xyz: [0.5, 0, -0.05], look_at: desk"))


def test_hexadecimal_colors_are_srgb(tmp_path: Path) -> None:
    text = SCENE.replace("mass: 0.2, place", 'mass: 0.2, color: "#C8a07080", place')
    (visual,) = lowered(tmp_path, text).object("mug").root.visuals
    assert visual.rgba * 255 == pytest.approx([0xC8, 0xA0, 0x70, 0x80], abs=1e-3)


def test_a_viewpoint_inside_its_target_is_reported(tmp_path: Path) -> None:
    text = SCENE.replace("name: shelf", "name: shelf\nviewpoint: to_mug")
    with pytest.raises(SpecError, match=r"a\.scene\.yaml:3:.*at the center of `desk`"):
        lowered(tmp_path, text.replace("xyz: [0, -1, 1], look_at: mug", "xyz: [0.5, 0, -0.05], look_at: desk"))
