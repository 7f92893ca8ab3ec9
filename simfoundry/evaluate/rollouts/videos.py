"""Pictures as a video that browsers play: VP8 in WebM, written by OpenCV, which brings the encoder along."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Image, ImageSize

HEIGHT, WIDEST = 240, 640
"""Pixels of a video's height, and of a camera's width at most: 25 rollouts of a page stay below 10 MB, and pictures
of no more than 640 pixels are drawn quickly."""


def whole_picture(width: int, height: int) -> ImageSize:
    """The size in which a video shows all that a camera of ``width`` x ``height`` pixels sees; even, for VP8."""
    scale = min(HEIGHT / height, WIDEST / width)
    return ImageSize(*(max(2, 2 * round(side * scale / 2)) for side in (width, height)))


def side_by_side(pictures: Sequence[Image]) -> Image:
    """The pictures of several cameras in one, black where one is lower than the others."""
    highest = max(len(picture) for picture in pictures)
    even = [np.pad(p, ((0, highest - len(p)), (0, 0), (0, 0))) for p in pictures]
    return np.asarray(np.concatenate(even, axis=1), np.uint8)


def write_video(path: Path, frames: Sequence[Image], rate: float) -> None:
    """Write pictures of one size at ``rate`` [1/s] as ``path``, which ends with ``.webm``, in one step."""
    import cv2

    if not frames:
        raise ValueError("a video needs pictures")
    height, width = frames[0].shape[:2]
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, staging = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=".webm", dir=path.parent)
    os.close(handle)
    try:
        with _quiet():
            writer = cv2.VideoWriter(staging, cv2.VideoWriter_fourcc(*"VP80"), rate, (width, height))  # type: ignore[attr-defined]
            if not writer.isOpened():
                raise SimfoundryError("this OpenCV cannot write VP8; run without videos (--no-video)")
            for frame in frames:
                writer.write(frame[:, :, ::-1].copy())
            writer.release()
        Path(staging).chmod(0o644)
        os.replace(staging, path)
    finally:
        Path(staging).unlink(missing_ok=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the encoder's remarks on standard error, which no setting of OpenCV stops."""
    kept = os.dup(2)
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)
