"""A small capture folder to spoil in one way at a time: a picture of a plane with a block on it, seen from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

WIDTH, HEIGHT, FOCAL = 160, 120, 150.0

DOCUMENT = """\
simfoundry: capture/1
name: desk
frames:
  view:
    color: color.png
    depth:
      image: depth.png
      scale: 0.001
    camera: {fx: 150, fy: 150, cx: 79.5, cy: 59.5}
"""


def plane(distance: float = 0.8, pitch: float = 0.9) -> NDArray[np.float64]:
    """Depth [m] of a plane that the optical axis meets at ``distance``, tilted by ``pitch`` [rad] from facing it."""
    v = (np.arange(HEIGHT) - (HEIGHT - 1) / 2) / FOCAL
    depth = distance / (1.0 + np.tan(pitch) * v)
    return np.repeat(np.asarray(depth)[:, None], WIDTH, axis=1)


def color() -> NDArray[np.uint8]:
    """A picture that is not the same upside down or mirrored."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([u, v, 255 - u], axis=-1).astype(np.uint8)


def write(folder: Path, document: str = DOCUMENT, depth: NDArray[np.float64] | None = None) -> Path:
    """Write a capture with depth [m] in millimeters."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.yaml").write_text(document, encoding="utf-8")
    Image.fromarray(color()).save(folder / "color.png")
    Image.fromarray(np.rint((plane() if depth is None else depth) * 1000).astype(np.uint16)).save(folder / "depth.png")
    return folder


def edit(folder: Path, old: str, new: str) -> None:
    """Change the capture document."""
    file = folder / "capture.yaml"
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")


def cut(file: Path, share: float = 0.5) -> None:
    """Cut a file off."""
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
