"""Read `.r3d` files of Record3D: a ZIP archive of JPEG images, LZFSE-compressed depth, and metadata in JSON."""

from __future__ import annotations

import json
import re
import struct
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.capture.recordings.recording import (
    RecordedFrame,
    RecordingError,
    checked_size,
    decoded_image,
    scaled_intrinsics,
)
from simfoundry.geometry.frames import Array, Pose, from_xyzw
from simfoundry.runtime.extras import install_line

# Maximum size of the metadata [bytes]; an hour at 60 frames per second takes 50 MB.
METADATA_MAX = 100_000_000

# Maximum size of a compressed image [bytes]; noise of 40 megapixels takes as much.
IMAGE_MAX = 200_000_000

# Sizes (width, height) of depth images by their number of pixels, for recordings that do not state them: of the LiDAR,
# and of the front camera. Both are upright.
SIZES = {256 * 192: (192, 256), 960 * 720: (720, 960), 640 * 480: (480, 640)}

# ARKit's confidence in a reading is 0, 1 or 2; those of 0 are at edges and on glass.
CONFIDENT = 1

# Turns the axes of ARKit's cameras (x right, y up, z backward) into those of ours (x right, y down, z forward).
_FLIP = Pose.of(q=(0.0, 1.0, 0.0, 0.0))


class Record3DRecording:
    """A recording of Record3D."""

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            self._archive = zipfile.ZipFile(file)
            self._metadata: dict[str, Any] = json.loads(self._member("metadata", METADATA_MAX))
            names = set(self._archive.namelist())
            numbers = (re.fullmatch(r"rgbd/([0-9]{1,9})\.depth", name) for name in names)
            depths = sorted(int(number[1]) for number in numbers if number is not None)
            self._numbers = [k for k in depths if f"rgbd/{k}.jpg" in names]
            stamps = self._metadata.get("frameTimestamps") or []
            period = 1.0 / float(self._metadata.get("fps") or 60)
            whole = len(stamps) > max(self._numbers, default=0)
            times = [float(stamps[k]) if whole else k * period for k in self._numbers]
        except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise RecordingError(f"{file} is not a recording of Record3D: {' '.join(str(error).split())}") from None
        if not self._numbers:
            raise RecordingError(f"{file} contains no frame with both a color and a depth image")
        self.times_s: Sequence[float] = [t - times[0] for t in times]

    def frames(self, chosen: Sequence[int]) -> Iterator[RecordedFrame]:
        """Yield the frames with these ascending indices."""
        try:
            for index in chosen:
                yield self._frame(index, self._numbers[index])
        except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError, IndexError) as error:
            raise RecordingError(f"{self.file} is damaged: {' '.join(str(error).split())}") from None

    def _frame(self, index: int, number: int) -> RecordedFrame:
        color = decoded_image(self._member(f"rgbd/{number}.jpg", IMAGE_MAX), self.file)
        depth = self._depth(number)
        height, width = color.shape[:2]
        size = self._metadata.get("w") or width, self._metadata.get("h") or height
        K = scaled_intrinsics(self._intrinsics(number), (width / float(size[0]), height / float(size[1])))
        K_depth = scaled_intrinsics(K, (depth.shape[1] / width, depth.shape[0] / height))
        return RecordedFrame(self.times_s[index], color, depth, K, K_depth, Pose.of(), X_WC=self._pose(number))

    def _depth(self, number: int) -> Array:
        """Return a depth image [m], without readings that the device itself doubts."""
        data = self._lzfse(f"rgbd/{number}.depth")
        width, height = self._metadata.get("dw"), self._metadata.get("dh")
        if not isinstance(width, int) or not isinstance(height, int):
            width, height = SIZES.get(len(data) // 4, (0, 0))
        checked_size(width, height, self.file)
        values = np.frombuffer(data, dtype="<f4").reshape(height, width).astype(np.float64)
        depth = np.where(np.isfinite(values) & (values > 0), values, np.nan)
        if f"rgbd/{number}.conf" in self._archive.namelist():
            doubts = np.frombuffer(self._lzfse(f"rgbd/{number}.conf"), dtype=np.uint8)
            if doubts.size == depth.size:
                depth[doubts.reshape(depth.shape) < CONFIDENT] = np.nan
        return depth

    def _intrinsics(self, number: int) -> Array:
        """Return the intrinsic matrix [px] for images of the size that the metadata states."""
        listed = self._metadata.get("perFrameIntrinsicCoeffs") or []
        if number < len(listed):
            fx, fy, cx, cy = (float(value) for value in listed[number][:4])
            return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        return np.array(self._metadata["K"], dtype=np.float64).reshape(3, 3).T  # by columns, as in Metal

    def _pose(self, number: int) -> Pose | None:
        """Return the pose of the camera in the frame in which ARKit tracks it, or None if it is missing or invalid."""
        poses = self._metadata.get("poses") or []
        values = np.array(poses[number] if number < len(poses) else [], dtype=np.float64)
        if values.shape != (7,) or not np.isfinite(values).all() or abs(np.linalg.norm(values[:4]) - 1) > 0.05:
            return None
        return Pose.of(values[4:], from_xyzw(values[:4])) @ _FLIP

    def _member(self, name: str, limit: int) -> bytes:
        """Return the content of a file in the archive."""
        with self._archive.open(name) as stream:  # KeyError if there is none
            data = stream.read(limit + 1)
        if len(data) > limit:
            raise ValueError(f"`{name}` is larger than {limit // 1_000_000} MB")
        return data

    def _lzfse(self, name: str) -> bytes:
        """Return the decompressed content of a file in the archive, or the content itself if it is not compressed."""
        data = self._member(name, IMAGE_MAX)
        if not data.startswith(b"bvx"):
            return data
        size = raw_size(data)
        if size > IMAGE_MAX:
            raise ValueError(f"`{name}` is larger than {IMAGE_MAX // 1_000_000} MB")
        try:
            import lzfse
        except ImportError:
            raise RecordingError(
                f"{self.file} needs a package that is not installed; run `{install_line('sensors')}`"
            ) from None
        try:
            return bytes(lzfse.decompress(data))
        except lzfse.error as error:
            raise ValueError(f"`{name}` cannot be decompressed: {error}") from None


def raw_size(data: bytes) -> int:
    """Return the size that LZFSE-compressed data states for its decompressed content [bytes].

    Raises:
        ValueError: The data is damaged, or contains blocks that encoders do not write.
    """
    total, at = 0, 0
    try:
        while (magic := data[at : at + 4]) != b"bvx$":
            (raw,) = struct.unpack_from("<I", data, at + 4)
            if magic == b"bvx-":  # stored
                length = 8 + raw
            elif magic == b"bvxn":  # LZVN
                length = 12 + struct.unpack_from("<I", data, at + 8)[0]
            elif magic == b"bvx2":  # LZFSE: the header's fields are packed into three numbers of 64 bits
                literals, matches, header = struct.unpack_from("<3Q", data, at + 8)
                length = (header & 0xFFFFFFFF) + (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF)
            else:
                raise ValueError("the LZFSE data is damaged")
            if length < 8:
                raise ValueError("the LZFSE data is damaged")
            total, at = total + raw, at + length
    except struct.error:
        raise ValueError("the LZFSE data is cut off") from None
    return total
