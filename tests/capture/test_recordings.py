"""Recordings of depth cameras become captures with the true cameras, offsets, poses and depth."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("lzfse", reason="the extra `sensors` is not installed")
pytest.importorskip("mcap_ros2", reason="the extra `sensors` is not installed")
pytest.importorskip("rosbags", reason="the extra `sensors` is not installed")
pytest.importorskip("OpenEXR", reason="the extra `sensors` is not installed")

from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.capture.recordings.record3d import raw_size
from simfoundry.capture.recordings.recording import RecordingError
from simfoundry.capture.recordings.unpack import is_recording, open_recording, unpack_recording
from simfoundry.errors import OutputError
from simfoundry.scene.lower import pose
from simfoundry.spec.models.capture import CaptureSpec
from tests.capture import captures, recordings
from tests.cli.command import run

WRITERS: dict[str, Callable[[Path], Path]] = {
    "a.r3d": recordings.write_r3d,
    "a.bag": recordings.write_realsense_bag,
    "a.mcap": recordings.write_mcap,
}


def matrix(values: tuple[float, ...]) -> np.ndarray:
    return np.reshape(values, (3, 3))


@pytest.mark.parametrize("name", WRITERS)
def test_frames_have_the_recorded_cameras_poses_and_depth(tmp_path: Path, name: str) -> None:
    recording = open_recording(WRITERS[name](tmp_path / name))
    assert np.allclose(recording.times_s, [0.0, 1 / 30, 2 / 30], atol=0.001)
    first, last = recording.frames([0, 2])
    true = recordings.depth_mm() / 1000
    known = np.isfinite(last.depth)
    assert np.abs(last.depth - true)[known].max() < 1e-6 and not known[:4, :6].any()
    lost = 15 if name == "a.r3d" else 0  # readings that ARKit doubts
    assert known.sum() == true.size - 24 - lost and (not known[-3:, -5:].any() if lost else known[-1, -1])
    assert np.abs(last.color.astype(int) - captures.color()).max() <= (6 if name == "a.r3d" else 0)  # JPEG
    assert np.allclose(last.K, matrix(recordings.K))
    X = last.X_color_depth
    if name == "a.r3d":  # one camera, whose depth has fewer pixels; the corners of both images coincide
        assert X.is_identity and np.allclose(last.K_depth, matrix((75, 0, 39.5, 0, 75, 29.5, 0, 0, 1)))
    else:
        assert np.allclose(last.K_depth, matrix(recordings.K_DEPTH))
        assert np.allclose(X.matrix, recordings.X_COLOR_DEPTH.matrix, atol=1e-9)
    if name == "a.bag":
        assert last.X_WC is None, "RealSense's recordings have no poses"
        return
    for frame, true_pose in ((first, recordings.POSES[0]), (last, recordings.POSES[2])):
        assert frame.X_WC is not None and np.allclose(frame.X_WC.matrix, true_pose.matrix, atol=1e-9)


def test_compressed_images_and_a_camera_without_poses(tmp_path: Path) -> None:
    recording = open_recording(recordings.write_mcap(tmp_path / "a.mcap", compressed=True, moving=False))
    (frame,) = recording.frames([1])
    assert np.nanmax(np.abs(frame.depth - recordings.depth_mm() / 1000)) < 1e-6 and frame.X_WC is None
    assert np.array_equal(frame.color, captures.color()[..., ::-1])
    assert np.allclose(frame.X_color_depth.matrix, recordings.X_COLOR_DEPTH.matrix, atol=1e-9)


def test_other_units_and_offsets_of_realsense(tmp_path: Path) -> None:
    fine = recordings.write_realsense_bag(tmp_path / "fine.bag", unit=0.0001)
    (frame,) = open_recording(fine).frames([0])
    assert np.nanmax(np.abs(frame.depth - recordings.depth_mm() / 1000)) < 1e-6
    file = recordings.write_realsense_bag(tmp_path / "none.bag", offset=False)
    with pytest.raises(RecordingError, match="does not state where its depth camera"):
        open_recording(file)


def test_a_recording_is_unpacked_once_and_edits_stay(tmp_path: Path) -> None:
    file, folder = recordings.write_mcap(tmp_path / "My desk.mcap"), tmp_path / "out_capture"
    assert is_recording(file) and unpack_recording(file, folder) == folder
    loaded = open_capture(folder)
    assert isinstance(loaded.spec, CaptureSpec) and loaded.spec.name == "my_desk" and len(loaded.spec.frames) == 3
    stated = loaded.spec.frames["f02"].pose
    assert stated is not None and np.abs(pose(stated).matrix - recordings.POSES[2].matrix).max() < 1e-4
    frame = load_frame(loaded, "f01")  # registered to the color image, from 3 cm beside it
    assert frame.depth.shape == (120, 160) and np.isfinite(frame.depth[20:100, 20:140]).mean() > 0.95
    u, v = 80.0, 60.0
    ray = np.array([(u - 79.5) / 150, (v - 59.5) / 150, 1.0])
    X = recordings.X_COLOR_DEPTH
    normal, point = X.rotation @ [0, -np.tan(0.9), -1.0], X.apply(np.array([[0, 0, 0.8]]))[0]
    assert abs(frame.depth[60, 80] - normal @ point / (normal @ ray)) < 0.01
    text = (folder / "capture.yaml").read_text()
    (folder / "capture.yaml").write_text(f"{text}# mine\n")
    unpack_recording(file, folder)
    assert (folder / "capture.yaml").read_text().endswith("# mine\n")
    recordings.write_mcap(file, compressed=True)
    with pytest.raises(OutputError, match="was unpacked from another recording"):
        unpack_recording(file, folder)
    unpack_recording(file, folder, force=True)
    assert not (folder / "capture.yaml").read_text().endswith("# mine\n")
    (folder / "recording.json").unlink()
    with pytest.raises(OutputError, match="was not unpacked from a recording"):
        unpack_recording(file, folder, force=True)


def test_poses_that_a_recording_does_not_state_are_estimated(tmp_path: Path) -> None:
    """The recorded camera sees a bare plane, along which it could move unnoticed: only the first pose is known."""
    folder = unpack_recording(recordings.write_realsense_bag(tmp_path / "a.bag"), tmp_path / "out")
    loaded = open_capture(folder)
    assert isinstance(loaded.spec, CaptureSpec) and "poses were estimated" in (loaded.spec.description or "")
    poses = [shot.pose for shot in loaded.spec.frames.values()]
    assert poses[1:] == [None, None] and poses[0] is not None
    assert np.abs(pose(poses[0]).matrix - recordings.X_COLOR_DEPTH.inverse().matrix).max() < 1e-3


def test_a_bag_of_ros_2_is_a_folder(tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from simfoundry.capture.recordings.ros_files import open_bag

    store = get_typestore(Stores.ROS2_JAZZY)
    text = store.types["std_msgs/msg/String"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/word", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 7, store.serialize_cdr(text("hello"), "std_msgs/msg/String"))
    assert is_recording(tmp_path / "bag")
    with open_bag(tmp_path / "bag") as bag:
        assert [(m.topic, m.time_ns, m.decode().data) for m in bag.messages(["/word"])] == [("/word", 7, "hello")]
    (database,) = (tmp_path / "bag").glob("*.db3")
    with open_bag(database) as bag:
        assert bag.types == {"/word": "std_msgs/msg/String"}
    with pytest.raises(RecordingError, match=r"contains no depth images.*/word \(std_msgs/msg/String\)"):
        open_recording(tmp_path / "bag")


def test_what_is_no_recording_is_one_sentence(tmp_path: Path) -> None:
    for suffix, writer in ((".r3d", recordings.write_r3d), (".bag", recordings.write_realsense_bag),
                           (".mcap", recordings.write_mcap)):  # fmt: skip
        whole = writer(tmp_path / f"whole{suffix}").read_bytes()
        for k, data in enumerate((b"", b"\x00" * 500, whole[: len(whole) // 2], whole[:-40], whole[::-1])):
            file = tmp_path / f"bad{k}{suffix}"
            file.write_bytes(data)
            done = run("capture", file, "-o", tmp_path / "out")
            assert done.code == 2 and "Traceback" not in done.err, (suffix, k, done)
            assert str(file) in done.err and len(done.err.strip().splitlines()) <= 2, done.err
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize(
    ("changes", "depth", "message"),
    [
        ({"dw": 10**9, "dh": 10**9}, None, "which no camera takes"),
        ({"dw": 81}, None, "is damaged"),
        ({"K": [1, 2]}, None, "is damaged"),
        ({"K": "x", "w": "y"}, None, "is damaged"),
        ({"perFrameIntrinsicCoeffs": [[1], [2], [3]]}, None, "is damaged"),
        ({}, b"bvx-" + struct.pack("<I", 4_000_000_000), "larger than 200 MB|damaged|cut off"),
        ({}, b"bvxn" + struct.pack("<2I", 4_000_000_000, 9) + b"123456789bvx$", "larger than 200 MB"),
        ({}, b"bvx2" + bytes(60), "damaged"),
    ],
)
def test_damaged_recordings_of_record3d(
    tmp_path: Path, changes: dict[str, Any], depth: bytes | None, message: str
) -> None:
    file = recordings.write_r3d(tmp_path / "a.r3d", changes, depth)
    with pytest.raises(RecordingError, match=message):
        list(open_recording(file).frames([0]))


def test_older_recordings_of_record3d_state_less(tmp_path: Path) -> None:
    changes = {"w": None, "h": None, "poses": [[0, 0, 0, 0, 1, 2, 3]] * 3, "frameTimestamps": [5.0, 5.5, 6.5]}
    recording = open_recording(recordings.write_r3d(tmp_path / "a.r3d", changes))
    (frame,) = recording.frames([1])
    assert (
        list(recording.times_s) == [0.0, 0.5, 1.5] and frame.X_WC is None and np.allclose(frame.K, matrix(recordings.K))
    )


def test_the_size_of_compressed_data_is_known_before_it_is_decompressed() -> None:
    import lzfse

    random = np.random.default_rng(0)
    smooth = np.linspace(0, 2, 50_000).astype("f4").tobytes()
    for data in (b"", b"a" * 10, bytes(3_000_000), smooth, random.bytes(1000), random.normal(size=9000).tobytes()):
        assert raw_size(lzfse.compress(data)) == len(data)


# -- OpenEXR ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channels", "dtype"),
    [
        (["Z"], "f4"),
        (["R", "G", "B"], "f2"),
        (["View.Depth.Z", "View.Combined.R"], "f4"),
        (["distance"], "f4"),
    ],
)
def test_depth_in_exr(tmp_path: Path, channels: list[str], dtype: str) -> None:
    import OpenEXR

    folder = captures.write(tmp_path / "a")
    true = captures.plane().astype(dtype)
    planes = {name: true if k == 0 or len(channels) == 3 else true * 0 for k, name in enumerate(channels)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, planes) as image:
        image.write(str(folder / "depth.exr"))
    captures.edit(folder, "depth.png", "depth.exr")
    captures.edit(folder, "0.001", "1.0")
    error = np.nanmax(np.abs(load_frame(open_capture(folder)).depth - captures.plane()))
    assert error < (0.002 if dtype == "f2" else 1e-6)


def test_a_damaged_exr_is_one_sentence(tmp_path: Path) -> None:
    folder = captures.write(tmp_path / "a")
    (folder / "depth.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(100))
    captures.edit(folder, "depth.png", "depth.exr")
    done = run("capture", folder, "-o", tmp_path / "out")
    assert done.code == 2 and "depth.exr could not be read as an image" in done.err and "Traceback" not in done.err
