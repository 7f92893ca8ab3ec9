"""Folders of other data sets are captures; pictures, videos and recordings say what they lack."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from simfoundry.capture.frames.foreign import FRAMES_MAX
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.lower import pose
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.capture import CaptureSpec
from tests.capture import captures
from tests.cli.command import run

K = [150, 0, 79.5, 0, 150, 59.5, 0, 0, 1]
X_WC = Pose.of([0.1, -0.2, 0.3], quat_from_rpy(0.3, -0.4, 1.1))


def images(folder: Path, color: str, depth: str, unit: float = 0.001) -> None:
    for file in (folder / color, folder / depth):
        file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(captures.color()).save(folder / color)
    Image.fromarray(np.rint(captures.plane() / unit).astype(np.uint16)).save(folder / depth)


def check(folder: Path, name: str) -> CaptureSpec:
    """The capture in a folder has one frame with the known depth, camera and pose."""
    loaded = open_capture(folder)
    assert isinstance(loaded.spec, CaptureSpec) and not (folder / "capture.yaml").exists()
    frame = load_frame(loaded, name)
    assert np.nanmax(np.abs(frame.depth - captures.plane())) < 0.001 and frame.K.ravel().tolist() == K
    stated = loaded.spec.frames[name].pose
    assert stated is not None and np.abs(pose(stated).matrix - X_WC.matrix).max() < 1e-4
    return loaded.spec


def matrix_text(matrix: NDArray[Any]) -> str:
    return "\n".join(" ".join(f"{v:.8f}" for v in row) for row in matrix)


def test_a_scene_of_bop(tmp_path: Path) -> None:
    images(tmp_path, "rgb/000007.png", "depth/000007.png", unit=0.0001)
    X_CW = X_WC.inverse().matrix
    camera = {"cam_K": K, "depth_scale": 0.1, "cam_R_w2c": X_CW[:3, :3].ravel().tolist()}
    camera |= {"cam_t_w2c": (1000 * X_CW[:3, 3]).tolist()}
    (tmp_path / "scene_camera.json").write_text(json.dumps({"7": camera, "8": camera}))
    assert list(check(tmp_path, "f000007").frames) == ["f000007"], "8 has no images"


def test_a_folder_like_those_of_scannet(tmp_path: Path) -> None:
    images(tmp_path, "color/0.jpg", "depth/0.png")
    images(tmp_path, "color/10.jpg", "depth/10.png")
    for kind in ("color", "depth"):
        file = tmp_path / "intrinsic" / f"intrinsic_{kind}.txt"
        file.parent.mkdir(exist_ok=True)
        whole = np.eye(4)
        whole[:3, :3] = np.reshape(K, (3, 3))
        file.write_text(matrix_text(whole))
    (tmp_path / "pose").mkdir()
    (tmp_path / "pose" / "0.txt").write_text(matrix_text(X_WC.matrix))
    (tmp_path / "pose" / "10.txt").write_text(matrix_text(np.full((4, 4), -np.inf)))
    spec = check(tmp_path, "f0")
    assert list(spec.frames) == ["f0", "f10"] and spec.frames["f10"].pose is None, "tracking was lost"


def test_frames_of_7_scenes(tmp_path: Path) -> None:
    for k in range(FRAMES_MAX + 6):
        for suffix in ("color.png", "depth.png"):
            (tmp_path / f"frame-{k:06}.{suffix}").touch()
    images(tmp_path, "frame-000000.color.png", "frame-000000.depth.png")
    (tmp_path / "frame-000000.pose.txt").write_text(matrix_text(X_WC.matrix))
    (tmp_path / "camera-intrinsics.txt").write_text(matrix_text(np.reshape(K, (3, 3))))
    assert len(check(tmp_path, "frame_000000").frames) == FRAMES_MAX


def test_the_cameras_of_the_kinect_are_registered(tmp_path: Path) -> None:
    """7-Scenes states the depth camera and its pose; the color camera has a wider view from 2.5 cm beside it."""
    images(tmp_path, "frame-000000.color.png", "frame-000000.depth.png")
    (tmp_path / "frame-000000.pose.txt").write_text(matrix_text(X_WC.matrix))
    loaded = open_capture(tmp_path)  # 7-Scenes itself has no file with the intrinsics
    (tmp_path / "camera-intrinsics.txt").write_text("585 0 320\n0 585 240\n0 0 1\n")
    assert open_capture(tmp_path).spec == loaded.spec
    assert isinstance(loaded.spec, CaptureSpec)
    shot = loaded.spec.frames["frame_000000"]
    assert (shot.camera.fx, shot.camera.cx) == (525, 320) and shot.depth is not None and shot.depth.camera is not None
    assert shot.depth.camera.fx == 585 and shot.depth.pose is not None and shot.pose is not None
    assert np.abs((pose(shot.pose) @ pose(shot.depth.pose)).matrix - X_WC.matrix).max() < 2e-4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "scene_camera.json could not be read"),
        ("[]", "does not contain cameras by image"),
        ('{"0": {"cam_K": [1, 2]}}', "has no valid camera for the image 0"),
        ('{"0": {"cam_K": [0, 0, 0, 0, 0, 0, 0, 0, 1]}}', "does not contain the intrinsics of a camera"),
        ("{}", "contains no frame with both a color and a depth image"),
        ('{"0": {"cam_K": [9, 0, 8, 0, 9, 6, 0, 0, 1], "depth_scale": -1}}', "has no valid camera for the image 0"),
        ('{"0": {"cam_K": [9, 0, 8, 0, 9, 6, 0, 0, 1], "depth_scale": "x"}}', "has no valid camera for the image 0"),
    ],
)
def test_damaged_folders_are_errors(tmp_path: Path, text: str, message: str) -> None:
    images(tmp_path, "rgb/000000.png", "depth/000000.png")
    (tmp_path / "scene_camera.json").write_text(text)
    with pytest.raises(SimfoundryError, match=message.replace(".", r"\.")):
        open_capture(tmp_path)


def test_a_folder_of_scenes_names_one_of_them(tmp_path: Path) -> None:
    (tmp_path / "000003").mkdir()
    (tmp_path / "000003" / "scene_camera.json").write_text("{}")
    done = run("capture", tmp_path, "-o", tmp_path / "out")
    assert done.code == 2 and f"simfoundry capture {tmp_path / '000003'}" in done.err


@pytest.mark.parametrize(
    ("name", "what", "hint"),
    [("a.png", "is a picture", "depth"), ("a.MP4", "is a video", "ffmpeg"), ("a.svo", "vendor's format", ".mcap")],
)
def test_what_is_no_capture_says_what_it_lacks(tmp_path: Path, name: str, what: str, hint: str) -> None:
    (tmp_path / name).write_bytes(b"\x89PNG")
    done = run("capture", tmp_path / name, "-o", tmp_path / "out")
    assert done.code == 2 and what in done.err and "the intrinsics of the camera" in done.err and hint in done.err
    with pytest.raises(SpecError, match="a capture needs, besides a color image, its depth"):
        open_capture(tmp_path / name)
