"""Meshes of furniture whose pieces are not connected, so that no model is needed to divide them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

# A cabinet whose front faces -y: boxes by name, as sizes and centers [m]. The drawer is a front, a floor and a handle.
CABINET = {
    "left": ((0.02, 0.3, 0.4), (-0.29, 0, 0.2)),
    "right": ((0.02, 0.3, 0.4), (0.29, 0, 0.2)),
    "top": ((0.6, 0.3, 0.02), (0, 0, 0.411)),
    "back": ((0.55, 0.02, 0.38), (0, 0.139, 0.2)),
    "door": ((0.27, 0.018, 0.36), (-0.14, -0.14, 0.2)),
    "door_handle": ((0.012, 0.03, 0.1), (-0.02, -0.17, 0.2)),
    "drawer": ((0.27, 0.018, 0.16), (0.14, -0.14, 0.3)),
    "tray": ((0.25, 0.24, 0.01), (0.14, 0.0, 0.24)),
    "drawer_handle": ((0.1, 0.03, 0.012), (0.14, -0.17, 0.3)),
}


def write_cabinet(path: Path) -> Path:
    """Write the cabinet as a mesh with z up."""
    import trimesh

    scene = trimesh.Scene()
    for name, (size, center) in CABINET.items():
        box = trimesh.creation.box(size)
        box.apply_translation(center)
        scene.add_geometry(box, geom_name=name)
    scene.to_mesh().export(path)
    return path


def number_of(name: str, segments: list[tuple[np.ndarray, np.ndarray]]) -> int:
    """Return the number of the segment of a piece, given the lowest and highest coordinates of all, front at +x."""
    size, (x, y, _) = CABINET[name]
    for number, (low, high) in enumerate(segments, 1):
        same = np.allclose(np.sort(high - low), np.sort(size), atol=1e-6)
        if same and np.allclose((low + high)[:2] / 2, middle_of(x, y), atol=0.02):
            return number
    raise AssertionError(f"{name} is not among the segments")


def middle_of(x: float, y: float) -> tuple[float, float]:
    """Return the place in the object's frame, whose front is +x, of a place in the file, whose front is -y."""
    return -y - 0.0175, x  # the handles stand off the front by 3.5 cm, which moves the middle of the whole
