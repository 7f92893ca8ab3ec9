"""The frames of a recording, and what all formats of recordings share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose

# Maximum number of pixels of a recorded image; an 8K video has 33 million.
PIXELS_MAX = 40_000_000


class RecordingError(SimfoundryError):
    """A recording that cannot be read."""


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """A color image of a recording and the depth image that was taken at the same time.

    Attributes:
        time_s: Time since the first frame [s].
        color: RGB image, shape (h, w, 3).
        depth: Depth along the optical axis of the depth camera [m], shape (h', w'); NaN where there is none.
        K: Intrinsic matrix of the color camera [px], shape (3, 3).
        K_depth: Intrinsic matrix of the depth camera [px], shape (3, 3).
        X_color_depth: Pose of the depth camera in the color camera's frame (x right, y down, z forward).
        distortion: Coefficients of the color camera's lens in OpenCV's order.
        X_WC: Pose of the color camera in a frame that does not move, or None if the recording does not state it.
    """

    time_s: float
    color: NDArray[np.uint8]
    depth: Array
    K: Array
    K_depth: Array
    X_color_depth: Pose
    distortion: tuple[float, ...] = ()
    X_WC: Pose | None = None


class DepthRecording(Protocol):
    """An opened recording.

    Attributes:
        times_s: Times of the frames since the first one [s], in ascending order.
    """

    times_s: Sequence[float]

    def frames(self, chosen: Sequence[int]) -> Iterator[RecordedFrame]:
        """Yield the frames with these ascending indices.

        Raises:
            RecordingError: A frame is damaged.
        """
        ...


def checked_size(width: int, height: int, file: Path) -> None:
    """Ensure that an image has a plausible size.

    Raises:
        RecordingError: It has not.
    """
    if not (0 < width <= 100_000 and 0 < height <= 100_000 and width * height <= PIXELS_MAX):
        raise RecordingError(f"{file} contains an image of {width} x {height} pixels, which no camera takes")


def decoded_image(data: bytes, file: Path, mode: str = "RGB") -> NDArray[np.uint8]:
    """Decode a JPEG or PNG file in memory, as RGB by default. An empty ``mode`` keeps the pixels as they are stored.

    Raises:
        RecordingError: It is damaged or too large.
    """
    import io

    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as image:
            checked_size(image.width, image.height, file)
            return np.array(image.convert(mode) if mode and image.mode != mode else image)
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split())[:120]
        raise RecordingError(f"{file} contains an image that cannot be decoded: {reason}") from None


def scaled_intrinsics(K: Array, scale: tuple[float, float]) -> Array:
    """Return the intrinsic matrix [px] of an image that is resized by ``scale`` in x and in y.

    The center of the first pixel is at (0, 0), so that its corner, at (-0.5, -0.5), is what does not move.
    """
    out = np.array(K, dtype=np.float64)
    for row, factor in enumerate(scale):
        out[row, row] *= factor
        out[row, 2] = (K[row, 2] + 0.5) * factor - 0.5
    return out
