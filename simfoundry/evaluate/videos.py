"""Pictures as a video that browsers play: VP8 in WebM, written by OpenCV, which brings the encoder along."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Image


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
