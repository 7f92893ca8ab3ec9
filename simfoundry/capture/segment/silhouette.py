"""Close the silhouettes of objects over pixels that the cut left out: lost readings, and the bottoms of bowls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.regions import Labels
from simfoundry.scene.frames import Array

MEASURED = 0.1  # share of a hole's pixels with depth from which on its depth decides what it shows
INSIDE = 0.7  # of a hole's points over the object's footprint


def close_silhouettes(labels: Labels, depth: Array, points_W: Array, radius: int) -> Labels:
    """Give each object the unlabelled pixels that are its own: those without depth in gaps up to ``radius`` [px] wide
    to either side, and those it encloses, except where one sees the support through it.
    """
    out = _without_gaps(labels, ~np.isfinite(depth), radius)
    for k in range(1, int(labels.max()) + 1):
        mask = out == k
        for hole in _holes(mask, out):
            if _is_own(hole, mask, points_W):
                out[hole] = k
    return out


def _without_gaps(labels: Labels, lost: NDArray[np.bool_], radius: int) -> Labels:
    """Close each object over ``lost`` pixels; where two objects claim one, the lower number has it."""
    import cv2

    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    out = labels.copy()
    for k in range(1, int(labels.max()) + 1):
        closed = cv2.morphologyEx(np.pad(labels == k, radius).astype(np.uint8), cv2.MORPH_CLOSE, disk)
        out[(closed[radius:-radius, radius:-radius] > 0) & lost & (out == 0)] = k
    return out


def _holes(mask: NDArray[np.bool_], labels: Labels) -> list[NDArray[np.bool_]]:
    """The connected unlabelled areas that ``mask`` encloses."""
    import cv2
    from scipy.ndimage import binary_fill_holes

    empty = (binary_fill_holes(mask) & (labels == 0)).astype(np.uint8)
    count, numbers = cv2.connectedComponents(empty, connectivity=4)
    return [np.asarray(numbers == i) for i in range(1, count)]


def _is_own(hole: NDArray[np.bool_], mask: NDArray[np.bool_], points_W: Array) -> bool:
    """Whether what is seen in ``hole`` lies over the footprint of the object: the bottom of a bowl, not a table.

    The table seen through the handle of a mug lies behind the mug, outside of its footprint.
    """
    import cv2

    seen = points_W[hole]
    seen = seen[np.isfinite(seen[:, 2])][:, :2] * 1000
    if len(seen) < MEASURED * hole.sum():
        return True
    own = points_W[mask]
    own = own[np.isfinite(own[:, 2])][:, :2] * 1000
    hull = cv2.convexHull(own[:: max(1, len(own) // 1500)].astype(np.float32))
    inside = [cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in seen[:: max(1, len(seen) // 100)]]
    return float(np.mean(inside)) > INSIDE
