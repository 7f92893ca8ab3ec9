"""Close the silhouettes of objects over pixels that the cut left out: lost readings, and the bottoms of bowls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.regions import Labels
from simfoundry.geometry.frames import Array

MEASURED = 0.1  # share of a hole's pixels with depth from which on its depth decides what it shows
INSIDE = 0.7  # of a hole's points over the object's footprint
WALL = 0.012  # [m] above the support
CELL = 0.002  # [m]
OPEN = 0.2  # of an object's pixels that the bottom of a container shows at least
BOUNDED = 0.6  # of the measured surroundings of a bottom that are its object
SURROUNDED = 14  # of 16 directions in which there is a wall
Mask = NDArray[np.bool_]


def close_silhouettes(labels: Labels, depth: Array, points_W: Array, radius: int) -> Labels:
    """Give each object the unlabeled pixels that are its own: those without depth in gaps up to ``radius`` [px] wide
    to either side, and those it encloses, except where one sees the support through it.
    """
    out = _without_gaps(labels, ~np.isfinite(depth), radius)
    for k in range(1, int(labels.max()) + 1):
        out[_bottom(out == k, (out == 0) & np.isfinite(depth), points_W)] = k
        mask = out == k
        for hole in _holes(mask, out):
            if _is_own(hole, mask, points_W):
                out[hole] = k
    return out


def _without_gaps(labels: Labels, lost: Mask, radius: int) -> Labels:
    """Close each object over ``lost`` pixels; where two objects claim one, the lower number has it."""
    import cv2

    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    out = labels.copy()
    for k in range(1, int(labels.max()) + 1):
        closed = cv2.morphologyEx(np.pad(labels == k, radius).astype(np.uint8), cv2.MORPH_CLOSE, disk)
        out[(closed[radius:-radius, radius:-radius] > 0) & lost & (out == 0)] = k
    return out


def _bottom(mask: Mask, free: Mask, points_W: Array) -> Mask:
    """The ``free`` pixels that lie within the footprint of an object whose wall surrounds them: the inside of a bowl.

    The near wall of a bowl is often a rim too thin to be measured all along, so that no pixels of it enclose these.
    """
    import cv2

    nothing = np.zeros(mask.shape, bool)
    wall = points_W[mask & (points_W[..., 2] > WALL)][:, :2]
    if len(wall) < 50 or np.nanquantile(points_W[..., 2][mask], 0.02) > WALL or not _is_round(wall):
        return nothing
    # The footprint drawn as a plan of 2 mm cells, drawn in by as much as a wall is thick.
    corner = wall.min(axis=0) - 0.01
    size = (np.ceil((np.ptp(wall, axis=0) + 0.02) / CELL).astype(int) + 1).tolist()
    hull = cv2.convexHull(np.round((wall - corner) / CELL).astype(np.int32))
    plan = cv2.fillConvexPoly(np.zeros((size[1], size[0]), np.uint8), hull, 1)
    plan = cv2.erode(plan, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
    cells = np.round((np.nan_to_num(points_W[..., :2], nan=-1e6) - corner) / CELL)
    inside = free & (cells >= 0).all(-1) & (cells[..., 0] < size[0]) & (cells[..., 1] < size[1])
    inside[inside] = plan[cells[inside][:, 1].astype(int), cells[inside][:, 0].astype(int)] > 0
    inside = _bounded(inside & (points_W[..., 2] < WALL), mask, free)
    xy = points_W[inside][:, :2]
    if len(xy) < OPEN * mask.sum():
        return nothing
    turn = np.arctan2(*(wall - np.median(xy, axis=0)).T[::-1])
    sectors = np.bincount(np.floor((turn + np.pi) / (2 * np.pi) * 15.999).astype(int), minlength=16)
    return inside if int((sectors > 5).sum()) >= SURROUNDED else nothing


def _bounded(area: Mask, mask: Mask, free: Mask) -> Mask:
    """The connected parts of ``area`` whose surroundings, as far as measured, belong to ``mask`` for the most part.

    The support under the overhang of a bowl lies within its footprint as well, but has more support before it.
    """
    import cv2

    kernel = np.ones((3, 3), np.uint8)
    gap = max(5, round(float(np.sqrt(area.sum())) / 10))  # where the rim was not measured
    apart = cv2.morphologyEx(area.astype(np.uint8), cv2.MORPH_OPEN, np.ones((gap, gap), np.uint8))
    count, parts = cv2.connectedComponents(apart, connectivity=4)
    out = np.zeros(area.shape, bool)
    for i in range(1, count):
        part = cv2.dilate((parts == i).astype(np.uint8), kernel, iterations=2) > 0
        rim = (cv2.dilate(part.astype(np.uint8), kernel, iterations=2) > 0) & ~part
        own, other = int((rim & mask).sum()), int((rim & free).sum())
        if own > BOUNDED * (own + other):
            out |= part & area
    return out


def _is_round(xy: Array) -> bool:
    """Test whether positions [m], shape (n, 2), fill at least as much of their bounding circle as a square does."""
    import cv2

    hull = cv2.convexHull((xy * 1000).astype(np.float32))
    _, radius = cv2.minEnclosingCircle(hull)
    return float(cv2.contourArea(hull)) > 0.6 * np.pi * radius**2


def _holes(mask: Mask, labels: Labels) -> list[Mask]:
    """The connected unlabeled areas that ``mask`` encloses."""
    import cv2
    from scipy.ndimage import binary_fill_holes

    empty = (binary_fill_holes(mask) & (labels == 0)).astype(np.uint8)
    count, numbers = cv2.connectedComponents(empty, connectivity=4)
    return [np.asarray(numbers == i) for i in range(1, count)]


def _is_own(hole: Mask, mask: Mask, points_W: Array) -> bool:
    """Test whether ``hole`` shows a surface over the footprint of the object: the bottom of a bowl, not a table.

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
    inside = [
        cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in seen[:: max(1, len(seen) // 100)]
    ]
    return float(np.mean(inside)) > INSIDE
