"""Check captures: the image files that they refer to."""

from __future__ import annotations

from simfoundry.spec.check.checker import Checker
from simfoundry.spec.files import PICTURE_SUFFIXES
from simfoundry.spec.models.capture import CaptureSpec


def check_capture(c: Checker, spec: CaptureSpec) -> None:
    """Check a capture."""
    for name, shot in spec.frames.items():
        path = ("frames", name)
        c.file(shot.color, (*path, "color"), PICTURE_SUFFIXES)
        c.file(shot.depth.image, (*path, "depth", "image"), PICTURE_SUFFIXES)
        if shot.masks is not None:
            c.file(shot.masks.image, (*path, "masks", "image"), PICTURE_SUFFIXES)
    if spec.truth is not None:
        c.file(spec.truth, ("truth",), (".yaml",))
