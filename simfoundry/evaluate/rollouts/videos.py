"""Videos for web browsers: VP8 in WebM, written by OpenCV, which includes the encoder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Image, ImageSize
from simfoundry.runtime.files import write_atomically

HEIGHT, WIDEST = 240, 640
"""Height of a video, and maximum width per camera [px]: a page with 25 rollouts stays below 10 MB, and images of up to
640 pixels render quickly.
"""


def whole_picture(width: int, height: int) -> ImageSize:
    """Return the size of a video that shows the full view of a ``width`` x ``height`` camera; even, for VP8."""
    scale = min(HEIGHT / height, WIDEST / width)
    return ImageSize(*(max(2, 2 * round(side * scale / 2)) for side in (width, height)))


def side_by_side(pictures: Sequence[Image]) -> Image:
    """Join the images of several cameras side by side, padded with black to equal height."""
    highest = max(len(picture) for picture in pictures)
    even = [np.pad(p, ((0, highest - len(p)), (0, 0), (0, 0))) for p in pictures]
    return np.asarray(np.concatenate(even, axis=1), np.uint8)


def write_video(path: Path, frames: Sequence[Image], rate: float) -> None:
    """Write images of one size as a video at ``rate`` [1/s] to ``path``, which must end with ``.webm``; the write is
    atomic.
    """
    import cv2

    if not frames:
        raise ValueError("a video needs at least one image")
    height, width = frames[0].shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        staging = Path(folder) / path.name
        with _quiet():
            writer = cv2.VideoWriter(str(staging), cv2.VideoWriter_fourcc(*"VP80"), rate, (width, height))  # type: ignore[attr-defined]
            if not writer.isOpened():
                raise SimfoundryError("this OpenCV cannot write VP8; run without videos (--no-video)")
            for frame in frames:
                writer.write(frame[:, :, ::-1].copy())
            writer.release()
        write_atomically(path, staging.read_bytes())


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the encoder's messages on standard error, for which OpenCV has no setting."""
    kept = os.dup(2)
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)
