"""Unpack frames of a recording into a capture, which people can look at and edit."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import in_range
from simfoundry.capture.frames.foreign import RECORDINGS
from simfoundry.capture.recordings.odometry import DepthOdometry
from simfoundry.capture.recordings.record3d import Record3DRecording
from simfoundry.capture.recordings.recording import DepthRecording, RecordedFrame, RecordingError
from simfoundry.capture.recordings.ros import RosRecording
from simfoundry.errors import OutputError
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Array
from simfoundry.runtime.files import MARK, replace_folder, scratch, write_file
from simfoundry.scene.state import pose_spec
from simfoundry.spec.models.capture import CaptureSpec, DepthImage, Intrinsics, Shot
from simfoundry.spec.yaml.write import to_yaml

Progress = Callable[[str, float], None]

# Number of frames that are unpacked, evenly spread over the recording: fusion uses 17, and some are turned elsewhere.
FRAMES = 24

# Unit of unpacked depth images [m]; 16 bits then reach to 6.5 m, farther than any tabletop.
DEPTH_SCALE = 1e-4

# Rate at which frames without poses are registered [1/s], and their maximum number: each takes 0.1 s, and a person who
# films a table goes round it in half a minute.
TRACKED_HZ, TRACKED_MAX = 10.0, 300

# File in an unpacked capture that states where it comes from.
SOURCE = "recording.json"


def is_recording(path: Path) -> bool:
    """Return True if a path is a recording: a file with one of the known endings, or a bag folder of ROS 2."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and not (path / "capture.yaml").exists()
    return path.suffix.lower() in RECORDINGS


def unpack_recording(
    path: Path, folder: Path, force: bool = False, progress: Progress = lambda text, share: None
) -> Path:
    """Unpack a recording into the folder of a capture, unless this was done before, and return the folder.

    What a person changed in the folder since it was unpacked stays as it is. ``force`` discards it.

    Raises:
        RecordingError: The recording cannot be read.
        OutputError: The folder contains something else.
    """
    source = {"file": str(path.resolve()), "bytes": _size(path), "frames": FRAMES}
    if folder.exists():
        try:
            known = json.loads((folder / SOURCE).read_bytes())
        except (OSError, ValueError):
            raise OutputError(
                f"{path} would be unpacked into {folder}, which exists and was not unpacked from a recording; choose "
                "another output folder with -o"
            ) from None
        if known == source and (folder / "capture.yaml").is_file() and not force:
            return folder
        if not force:
            raise OutputError(
                f"{folder} was unpacked from another recording; choose another folder with -o, or use --force"
            )
    recording = open_recording(path)
    chosen = _evenly_spread(len(recording.times_s), FRAMES)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with scratch(folder.parent, folder.name) as staging:
        shots, is_tracked = _unpacked(recording, chosen, staging, progress)
        description = f"{len(shots)} of {len(recording.times_s)} frames of the recording {path.name}."
        if is_tracked:
            description += " The poses were estimated from the depth, as the recording states none."
        name = plain_name(path.stem) or "recording"
        spec = CaptureSpec(simfoundry="capture/1", name=name, description=description, frames=shots)
        write_file(staging / "capture.yaml", to_yaml(spec).encode())
        write_file(staging / SOURCE, (json.dumps(source, indent=2) + "\n").encode())
        replace_folder(staging, folder)
    return folder


def _evenly_spread(count: int, most: int) -> list[int]:
    """Return at most ``most`` indices below ``count``, evenly spread."""
    return sorted({int(k) for k in np.linspace(0, count - 1, min(most, count)).round()})


def _unpacked(
    recording: DepthRecording, chosen: Sequence[int], folder: Path, progress: Progress
) -> tuple[dict[str, Shot], bool]:
    """Write frames to a folder, and return their entries in the capture, and whether their poses had to be estimated.

    For an estimate, frames between them are registered as well, :data:`TRACKED_HZ` of them per second.
    """
    (first,) = recording.frames(chosen[:1])
    odometry = DepthOdometry() if first.X_WC is None and len(chosen) > 1 else None
    used = list(chosen)
    if odometry is not None:
        wanted = int(recording.times_s[-1] * TRACKED_HZ) + 1
        used = sorted({*chosen, *_evenly_spread(len(recording.times_s), min(wanted, TRACKED_MAX))})
    shots: dict[str, Shot] = {}
    for index, frame in zip(used, recording.frames(used), strict=True):
        progress(f"frame {index + 1}", index / len(recording.times_s))
        if odometry is not None:
            X_WD = odometry.track(frame.depth, frame.K_depth)
            frame = replace(frame, X_WC=None if X_WD is None else X_WD @ frame.X_color_depth.inverse())
        if index in chosen:
            name = f"f{len(shots):02d}"
            shots[name] = _write_frame(frame, folder, name)
    return shots, odometry is not None


def open_recording(path: Path) -> DepthRecording:
    """Open a recording.

    Raises:
        RecordingError: It cannot be read, or contains no frames with color and depth.
    """
    return Record3DRecording(path) if path.suffix.lower() == ".r3d" else RosRecording(path)


def _size(path: Path) -> int:
    """Return the size of a recording [bytes], which may be a folder."""
    try:
        return sum(p.stat().st_size for p in sorted(path.iterdir())) if path.is_dir() else path.stat().st_size
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from None


def _write_frame(frame: RecordedFrame, folder: Path, name: str) -> Shot:
    """Write the images of a frame, and return its entry in the capture."""
    counts = np.where(in_range(frame.depth), frame.depth, 0.0) / DEPTH_SCALE
    write_file(folder / f"{name}_color.png", _png(frame.color))
    write_file(folder / f"{name}_depth.png", _png(np.rint(counts).astype(np.uint16)))
    registered = frame.depth.shape == frame.color.shape[:2] and np.allclose(frame.K, frame.K_depth)
    registered = registered and frame.X_color_depth.is_identity
    depth = DepthImage(
        image=f"{name}_depth.png",
        scale=DEPTH_SCALE,
        camera=None if registered else intrinsics(frame.K_depth),
        pose=None if registered else pose_spec(frame.X_color_depth),
    )
    return Shot(
        color=f"{name}_color.png",
        depth=depth,
        camera=intrinsics(frame.K, frame.distortion),
        pose=None if frame.X_WC is None else pose_spec(frame.X_WC),
    )


def intrinsics(K: Array, distortion: Sequence[float] = ()) -> Intrinsics:
    """Return the intrinsics of a camera as they are written in a capture."""
    fx, fy, cx, cy = (round(float(K[at]), 4) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(float(f"{v:.8g}") for v in distortion))


def _png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode an image quickly, in the same bytes each time."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text("Software", MARK)
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG", compress_level=1, pnginfo=info)
    return stream.getvalue()
