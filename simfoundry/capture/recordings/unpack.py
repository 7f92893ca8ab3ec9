"""Unpack frames of a recording into a capture, which people can look at and edit."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.foreign import RECORDINGS
from simfoundry.capture.frame import FARTHEST, NEAREST
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
    times = recording.times_s
    chosen = sorted({int(k) for k in np.linspace(0, len(times) - 1, min(FRAMES, len(times))).round()})
    shots: dict[str, Shot] = {}
    folder.parent.mkdir(parents=True, exist_ok=True)
    with scratch(folder.parent, folder.name) as staging:
        for done, frame in enumerate(recording.frames(chosen)):
            progress(f"frame {done + 1} of {len(chosen)}", done / len(chosen))
            name = f"f{done:02d}"
            shots[name] = _write_frame(frame, staging, name)
        description = f"{len(shots)} of {len(times)} frames of the recording {path.name}."
        name = plain_name(path.stem) or "recording"
        spec = CaptureSpec(simfoundry="capture/1", name=name, description=description, frames=shots)
        write_file(staging / "capture.yaml", to_yaml(spec).encode())
        write_file(staging / SOURCE, (json.dumps(source, indent=2) + "\n").encode())
        replace_folder(staging, folder)
    return folder


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
    counts = np.where((frame.depth >= NEAREST) & (frame.depth <= FARTHEST), frame.depth, 0.0) / DEPTH_SCALE
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
