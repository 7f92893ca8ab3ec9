"""Sensors: camera matrices, distorted images, stereo pairs, color alone, and several posed frames."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from simfoundry.capture.frame import Frame
from simfoundry.capture.frames.fused_depth import DepthView, fused_depth, without_edges
from simfoundry.capture.frames.fusion import fused_frames, load_fused_frame
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.capture.frames.sensors import undistorted
from simfoundry.capture.inputs import load_stage
from simfoundry.capture.recordings.odometry import depth_surface, refined_pose
from simfoundry.capture.stages.runner import StageRunner
from simfoundry.capture.stages.store import StageStore
from simfoundry.capture.synthesize import simulate_frame, write_capture
from simfoundry.geometry.frames import Pose, look_at
from simfoundry.models.setup import ModelSetup
from simfoundry.models.wire import Bundle
from simfoundry.render.raycast import raycast
from simfoundry.scene.lower import lower_file, pose
from simfoundry.scene.model import Scene
from simfoundry.scene.state import pose_spec
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.models.model_sources import ModelSource
from simfoundry.spec.yaml.write import to_yaml
from tests.capture import captures
from tests.capture.conftest import SCENE
from tests.models.stand_ins import Model, Result, serving

CAMERA = "camera: {fx: 150, fy: 150, cx: 79.5, cy: 59.5}"
K = np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]])
LENS = (-0.28, 0.09, 0.001, -0.002, 0.0)


def changed(folder: Path, old: str, new: str) -> Path:
    captures.write(folder)
    captures.edit(folder, old, new)
    return folder


def error_of(action: Callable[[], object]) -> str:
    with pytest.raises(SpecError) as caught:
        action()
    return "\n".join(f"{d.code} {d.line} {d.message}; {d.hint}" for d in caught.value.diagnostics)


# -- cameras ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "matrix", ["[150, 0, 79.5, 0, 150, 59.5, 0, 0, 1]", "[[150, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]"]
)
def test_a_camera_may_be_a_matrix(tmp_path: Path, matrix: str) -> None:
    folder = changed(tmp_path / "a", CAMERA, f"camera: {matrix}")
    assert np.array_equal(load_frame(open_capture(folder)).K, K)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ("[150, 0, 79.5]", "nine numbers"),
        ("[[150, 0], [79.5, 0], [150, 59.5, 0, 0, 1]]", "nine numbers"),
        ("[150, 0, 79.5, 0, 150, 59.5, 0, 0, x]", "nine numbers"),
        ("[150, 2, 79.5, 0, 150, 59.5, 0, 0, 1]", "without skew"),
        ("{K: [150, 0, 79.5, 0, 150, 59.5, 0, 0, 1]}", "without a key"),
        ("{fx: 150, fy: 150, cx: 79.5, cy: 59.5, distortion: [0.1, 0.2]}", "has 2 values; OpenCV knows 0, 4, 5"),
    ],
)
def test_a_wrong_camera_is_an_error(tmp_path: Path, matrix: str, message: str) -> None:
    folder = changed(tmp_path / "a", CAMERA, f"camera: {matrix}")
    assert message in error_of(lambda: load_frame(open_capture(folder)))


def distorted(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """An image as a camera with the lens would take it, by the inverse of the mapping that is tested."""
    import cv2

    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width]
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    x, y = (
        cv2.undistortPoints(pixels, K, np.array(LENS), P=K)
        .reshape(height, width, 2)
        .astype(np.float32)
        .transpose(2, 0, 1)
    )
    return np.asarray(cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def test_images_are_undistorted(tmp_path: Path) -> None:
    """A tilted plane, seen through a lens: its depth is that of the plane only after the correction."""
    true = captures.plane()
    camera = f"camera: {{fx: 150, fy: 150, cx: 79.5, cy: 59.5, distortion: {list(LENS)}}}"
    folder = captures.write(tmp_path / "a", depth=distorted(true))
    raw = load_frame(open_capture(folder)).depth
    captures.edit(folder, CAMERA, camera)
    frame = load_frame(open_capture(folder))
    inner = np.s_[8:-8, 8:-8]
    assert np.nanmax(np.abs(raw - true)[inner]) > 0.02
    assert np.nanmax(np.abs(frame.depth - true)[inner]) < 0.014  # 1.5 pixels at the far edge, each 9 mm deep
    assert np.nanmedian(np.abs(frame.depth - true)[inner]) < 0.002
    assert frame.color.shape == (120, 160, 3) and frame.color.dtype == np.uint8


def test_labels_and_holes_are_not_blended() -> None:
    labels = np.zeros((120, 160), np.int32)
    labels[40:80, 60:100] = 7
    assert set(np.unique(undistorted(labels, K, LENS))) == {0, 7}
    depth = np.full((120, 160), 0.8)
    depth[50:60, 70:80] = np.nan
    out = undistorted(depth, K, LENS)
    assert np.isnan(out[54, 75]) and np.nanmax(np.abs(out - 0.8)) < 1e-6 and out.dtype == np.float64
    assert undistorted(depth, K, (0.0, 0.0, 0.0, 0.0)) is depth


# -- stereo and color alone ---------------------------------------------------------------------------------------

STEREO = "stereo: {right: right.png, baseline: 0.06}"
DEPTH = "depth:\n      image: depth.png\n      scale: 0.001"


def stereo_pair(folder: Path, distance: float = 0.6) -> Path:
    """A textured wall at a distance."""
    changed(folder, DEPTH, STEREO)
    shift = round(150 * 0.06 / distance)
    wide = np.random.default_rng(0).integers(0, 255, (120, 160 + shift, 3)).astype(np.uint8)
    Image.fromarray(wide[:, :160]).save(folder / "color.png")
    Image.fromarray(wide[:, shift:]).save(folder / "right.png")
    return folder


def test_a_stereo_pair_gives_depth(tmp_path: Path) -> None:
    frame = load_frame(open_capture(stereo_pair(tmp_path / "a")))
    measured = frame.depth[np.isfinite(frame.depth)]
    assert len(measured) > 0.6 * frame.depth.size and np.abs(measured - 0.6).max() < 0.02


def test_a_stereo_model_that_fails_is_replaced_by_matching_and_asked_again(tmp_path: Path) -> None:
    loaded = open_capture(stereo_pair(tmp_path / "a"))
    assert isinstance(loaded.spec, CaptureSpec)
    frames, matched = loaded.spec.frames, load_frame(loaded).depth
    valid = np.ones(matched.shape, bool)

    def answer(request: Bundle) -> Result:
        assert not is_broken, f"out of memory for {request.head['task']}"
        depth = np.full(matched.shape, 0.6, np.float32)
        return Result({"disparity": (150 * 0.06 / depth).astype(np.float32), "depth": depth, "valid": valid})

    identity = {"name": "a wall", "version": "1", "licence": "MIT", "commercial": True}
    with serving(Model(identity, {"stereo": answer})) as url:
        setup = ModelSetup(tmp_path, {"stereo": (ModelSource(url=url), "a test")})

        def read() -> tuple[Frame, str]:
            runner = StageRunner(StageStore(tmp_path / "stages"))
            return load_stage(loaded, next(iter(frames)), runner, setup).value, runner.states["frames", ""]

        is_broken = True
        for _ in range(2):
            frame, state = read()
            assert [finding.code for finding in frame.findings] == ["SF640"] and state == "ran"
            assert np.array_equal(frame.depth, matched, equal_nan=True) and not frame.models
        is_broken = False
        for expected in ("ran", "cached"):
            frame, state = read()
            assert frame.findings == () and state == expected
            assert np.abs(frame.depth - 0.6).max() < 1e-6 and frame.models[0]["name"] == "a wall"


def test_what_is_wrong_with_a_stereo_pair(tmp_path: Path) -> None:
    folder = stereo_pair(tmp_path / "a")
    Image.new("RGB", (80, 60)).save(folder / "right.png")
    assert "right.png is 80 x 60, but color.png is 160 x 120" in error_of(lambda: load_frame(open_capture(folder)))
    for name in ("color.png", "right.png"):
        Image.new("RGB", (160, 120)).save(folder / name)
    assert "SF502 6 stereo matching found no depth" in error_of(lambda: load_frame(open_capture(folder)))
    (folder / "right.png").unlink()
    assert "right.png" in error_of(lambda: open_capture(folder))
    both = changed(tmp_path / "b", DEPTH, f"{DEPTH}\n    {STEREO}")
    assert "exclude each other" in error_of(lambda: open_capture(both))


def test_color_alone_says_what_is_missing(tmp_path: Path) -> None:
    message = error_of(lambda: load_frame(open_capture(changed(tmp_path / "a", DEPTH, "pose: {}"))))
    assert "SF502" in message and "the frame has neither `depth` nor `stereo`" in message
    assert "configure a model of the task `depth`" in message


# -- several frames -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    path = tmp_path_factory.mktemp("several") / "two.scene.yaml"
    path.write_text(SCENE)
    return lower_file(path)


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory, scene: Scene) -> Path:
    """A capture with six noisy frames of one scene."""
    folder = tmp_path_factory.mktemp("posed")
    shots = {}
    for k in range(6):
        position = np.array([-0.6 + 0.02 * k, 0.1 - 0.05 * k, 0.6 + 0.01 * k])
        camera = replace(scene.cameras[0], X_WC=look_at(position, np.array([0.02, 0, 0.02])))
        frame = replace(simulate_frame(raycast(scene, camera), np.random.default_rng(k)), instances=None)
        shot = write_capture(folder / f"f{k}", frame)
        assert shot.depth is not None
        depth = shot.depth.model_copy(update={"image": f"f{k}/{shot.depth.image}"})
        update = {"color": f"f{k}/{shot.color}", "depth": depth, "pose": pose_spec(camera.X_WC)}
        shots[f"f{k}"] = shot.model_copy(update=update)
    spec = CaptureSpec(simfoundry="capture/1", name="posed", frames=shots)
    (folder / "capture.yaml").write_text(to_yaml(spec))
    return folder


def test_several_frames_have_less_noise_and_fewer_holes(posed: Path, scene: Scene) -> None:
    loaded = open_capture(posed)
    one, all_six = load_frame(loaded, "f0"), load_fused_frame(loaded, "f0")
    true = raycast(
        scene, replace(scene.cameras[0], X_WC=look_at(np.array([-0.6, 0.1, 0.6]), np.array([0.02, 0, 0.02])))
    ).depth
    error_one, error_six = (np.abs(f.depth - true) for f in (one, all_six))
    both = np.isfinite(error_one)
    assert np.median(error_six[both]) < 0.8 * np.median(error_one[both])
    assert np.isfinite(all_six.depth).sum() > np.isfinite(one.depth).sum()
    assert np.nanquantile(error_six[~both], 0.9) < 0.01, "what fills the holes is true"
    assert all_six.findings == () and np.array_equal(all_six.color, one.color)


def test_a_frame_with_a_wrong_pose_is_left_out_and_reported(posed: Path, tmp_path: Path) -> None:
    shutil.copytree(posed, tmp_path / "a")
    loaded = open_capture(tmp_path / "a")
    assert isinstance(loaded.spec, CaptureSpec)
    shot = loaded.spec.frames["f3"]
    assert shot.pose is not None
    off = Pose.of([0.1, 0.0, 0.05])
    frames = {**loaded.spec.frames, "f3": shot.model_copy(update={"pose": pose_spec(off @ pose(shot.pose))})}
    (tmp_path / "a" / "capture.yaml").write_text(to_yaml(loaded.spec.model_copy(update={"frames": frames})))
    fused, good = load_fused_frame(open_capture(tmp_path / "a"), "f0"), load_fused_frame(open_capture(posed), "f0")
    (finding,) = fused.findings
    assert finding.code == "SF605" and "the frame `f3` was not used" in finding.message
    assert np.nanmedian(np.abs(fused.depth - good.depth)) < 0.001


def test_frames_without_a_pose_are_not_fused(posed: Path) -> None:
    loaded = open_capture(posed)
    assert isinstance(loaded.spec, CaptureSpec)
    assert fused_frames(loaded.spec, "f2") == ("f0", "f1", "f3", "f4", "f5")
    frames = {name: shot.model_copy(update={"pose": None}) for name, shot in loaded.spec.frames.items()}
    assert (
        fused_frames(loaded.spec.model_copy(update={"frames": {**frames, "f2": loaded.spec.frames["f2"]}}), "f2") == ()
    )
    many = {f"f{k}": loaded.spec.frames["f0"] for k in range(100)}
    assert len(set(fused_frames(loaded.spec.model_copy(update={"frames": many}), "f7"))) == 16


def plain_frame(depth: NDArray[np.float64]) -> Frame:
    return Frame(np.zeros((*depth.shape, 3), np.uint8), depth, np.array([[50.0, 0, 15.5], [0, 50, 15.5], [0, 0, 1]]))


def test_readings_of_one_surface_are_averaged_and_holes_filled() -> None:
    depth = np.full((32, 32), 0.800)
    depth[10, 10] = np.nan
    frame = plain_frame(depth)
    views = [DepthView(np.full((32, 32), z), frame.K, Pose.of()) for z in (0.804, 0.801, 2.0)]
    fused = fused_depth(frame, views)
    assert fused[5, 20] == pytest.approx((0.800 + 0.804 + 0.801) / 3)
    assert fused[10, 10] == pytest.approx(0.804), "the median of those that agree"
    assert np.isnan(fused_depth(frame, views[:1])[10, 10]), "one witness is not enough"
    assert fused_depth(frame, []) is depth


def test_a_hole_beside_an_object_is_not_filled_with_what_is_behind() -> None:
    """The other frames, whose readings beside edges were dropped, see only the wall in the object's blind rim."""
    depth, wall = np.full((32, 32), 1.0), np.full((32, 32), 1.0)
    depth[:, :12], depth[:, 12:15] = 0.7, np.nan
    depth[4, 28] = np.nan
    frame = plain_frame(depth)
    wall[:, :12] = np.nan
    fused = fused_depth(frame, [DepthView(wall, frame.K, Pose.of())] * 3)
    assert np.isnan(fused[:, 12:15]).all() and fused[4, 28] == pytest.approx(1.0)


def test_readings_beside_edges_are_dropped() -> None:
    depth = np.full((32, 32), 1.0)
    depth[:, :12] = 0.7
    depth += 0.004 * np.arange(32)[:, None]  # a slope is no edge
    kept = np.isfinite(without_edges(depth))
    assert not kept[:, 10:14].any() and kept[:, :10].all() and kept[:, 14:].all()


def test_stated_poses_are_refined_by_the_depth(posed: Path) -> None:
    """Poses that are off as a tracker's. The two small objects say little of a shift along the table."""
    loaded = open_capture(posed)
    assert isinstance(loaded.spec, CaptureSpec)
    reference, frames = load_frame(loaded, "f0"), loaded.spec.frames
    surface, first = depth_surface(reference.depth, reference.K), frames["f0"].pose
    assert first is not None
    corners = np.array([[x, y, 0.8] for x in (-0.2, 0.2) for y in (-0.15, 0.15)])
    before: list[NDArray[np.float64]] = []
    after: list[NDArray[np.float64]] = []
    for k in range(1, 6):
        other, stated = load_frame(loaded, f"f{k}"), frames[f"f{k}"].pose
        assert stated is not None
        true = pose(first).inverse() @ pose(stated)
        off = Pose.of([0.004, -0.002, 0.003]) @ true @ Pose.about(np.array([0.6, 0.0, 0.8]), np.radians(0.4))
        found = refined_pose(surface, depth_surface(other.depth, other.K), off)
        for errors, X in ((before, off), (after, found)):
            errors.append(np.abs(X.apply(corners) - true.apply(corners)).mean(axis=0))
    (x, y, z), (x_after, y_after, z_after) = np.mean(before, axis=0), np.mean(after, axis=0)
    assert z > 0.003 and z_after < 0.001, "the table shows the distance"
    assert x_after < x and y_after < y, "they say a little about the rest"
