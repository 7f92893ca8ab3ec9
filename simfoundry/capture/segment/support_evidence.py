"""Measure the evidence that a plane supports objects: what stands on it, without walls and tables."""

from __future__ import annotations

import numpy as np

from simfoundry.capture.segment.masks import SQUARE, Mask, components
from simfoundry.geometry.frames import Array

TALLEST = 0.35  # [m] maximum height of points that count as objects on a plane; tables are higher above the floor
LOW_SHARE = 0.7  # minimum fraction of a surface's pixels below TALLEST that makes it an object instead of a wall
WIDE, FLAT = 0.7, 0.06  # [m] minimum width of a wall, as a monitor is narrower, and half its depth in plan, with noise
STEP = 0.03  # [m] depth difference of neighbors that belong to two surfaces, at the coarse resolution of a survey


def carried_pixels(depth: Array, raised: Mask, points_W: Array) -> int:
    """Return the number of pixels of objects that stand on a plane.

    A surface that continues far above the plane, such as a table on the floor, is not an object, and neither is a wall
    at the end of the floor. ``raised`` marks the pixels above the plane's surface.
    """
    import cv2

    near = np.where(raised, depth, 0.0).astype(np.float32)
    connected = raised & (cv2.dilate(near, SQUARE) - near < STEP)  # a farther surface ends at a nearer one
    parts, areas = components(connected)
    low = raised & (points_W[..., 2] < TALLEST)
    lows = np.bincount(parts[connected & low], minlength=len(areas))
    objects = lows > LOW_SHARE * areas
    objects[0] = True  # pixels along steps
    xy = points_W[low & objects[parts]][:, :2]
    return len(xy) - int(_on_wall(xy).sum()) if len(xy) else 0


def _on_wall(xy: Array) -> Mask:
    """Return a mask of the points [m], shape (n, 2), on the longest line in plan, if it is a wall's."""
    rng = np.random.default_rng(0)
    sample = xy[rng.integers(len(xy), size=min(len(xy), 800))]
    a, b = (sample[rng.integers(len(sample), size=150)] for _ in range(2))
    along = b - a
    length = np.linalg.norm(along, axis=1)
    a, along = a[length > 0.1], along[length > 0.1] / length[length > 0.1, None]
    if not len(a):
        return np.zeros(len(xy), np.bool_)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    off = np.abs(np.einsum("nkd,kd->nk", sample[:, None] - a, across))
    best = int(np.argmax((off < FLAT).sum(axis=0)))
    on = np.abs((xy - a[best]) @ across[best]) < FLAT
    cells = np.unique(np.floor((xy[on] - a[best]) @ along[best] / FLAT))
    return on if len(cells) * FLAT > WIDE and len(cells) > 0.8 * np.ptp(cells) else np.zeros(len(xy), np.bool_)
