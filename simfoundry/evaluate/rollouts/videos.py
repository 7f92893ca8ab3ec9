"""Videos that web browsers can play.

The format is VP8 in WebM. The videos are written by OpenCV, which includes the encoder.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Image, ImageSize
from simfoundry.runtime.files import write_atomically
from simfoundry.runtime.native_output import quiet_native_output

# The height of a video and the maximum width per camera [px]. At this size, a page with 25 rollouts stays below 10 MB,
# and images of up to 640 pixels render quickly.
HEIGHT, WIDEST = 240, 640


def whole_picture(width: int, height: int) -> ImageSize:
    """Return the size of a video that shows the full view of a camera.

    Both side lengths are even, as VP8 requires.
    """
    scale = min(HEIGHT / height, WIDEST / width)
    return ImageSize(*(max(2, 2 * round(side * scale / 2)) for side in (width, height)))


def side_by_side(pictures: Sequence[Image]) -> Image:
    """Place the images of several cameras side by side. Images are padded with black to the same height."""
    highest = max(len(picture) for picture in pictures)
    even = [np.pad(p, ((0, highest - len(p)), (0, 0), (0, 0))) for p in pictures]
    return np.asarray(np.concatenate(even, axis=1), np.uint8)


def write_video(path: Path, frames: Sequence[Image], rate: float) -> None:
    """Write images of equal size to a video file atomically.

    Args:
        path: The output file, whose name must end with ``.webm``.
        frames: The images.
        rate: The frame rate [1/s].
    """
    import cv2

    if not frames:
        raise ValueError("a video needs at least one image")
    height, width = frames[0].shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        staging = Path(folder) / path.name
        with quiet_native_output():  # OpenCV has no setting for the encoder's messages
            writer = cv2.VideoWriter(str(staging), cv2.VideoWriter_fourcc(*"VP80"), rate, (width, height))  # type: ignore[attr-defined]
            if not writer.isOpened():
                raise SimfoundryError("the installed OpenCV cannot encode VP8; run without videos (--no-video)")
            for frame in frames:
                writer.write(frame[:, :, ::-1].copy())
            writer.release()
        write_atomically(path, staging.read_bytes())
