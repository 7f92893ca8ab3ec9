"""Extend object silhouettes to pixels that the segmentation missed.

These are pixels without depth and the bottoms of bowls.
"""

from __future__ import annotations

import numpy as np

from simfoundry.capture.segment import masks
from simfoundry.capture.segment.masks import Labels, Mask, Plan, grown
from simfoundry.geometry.frames import Array

MEASURED = 0.1  # minimum fraction of a hole's pixels with depth for the depth to be conclusive
INSIDE = 0.7  # minimum fraction of a hole's points that must be over the object's footprint
WALL = 0.012  # [m] minimum height of a wall above the support
CELL = 0.002  # [m] cell size of the footprint plan
OPEN = 0.2  # minimum area of a container's visible bottom, as a fraction of the object's pixels
BOUNDED = 0.6  # minimum fraction of a bottom's measured surroundings that belongs to the object
SURROUNDED = 14  # minimum number of directions, out of 16, in which there is a wall


def close_silhouettes(labels: Labels, depth: Array, points_W: Array, radius: int) -> Labels:
    """Assign unlabeled pixels to the objects to which they belong.

    An object receives pixels without depth in gaps up to twice ``radius`` [px] wide, and all pixels that it encloses.
    Openings through which the support is visible are excluded.
    """
    out, measured, numbers = labels.copy(), np.isfinite(depth), range(1, int(labels.max()) + 1)
    for k in numbers:  # a pixel in the gaps of two objects goes to the lower number
        out[masks.closed(labels == k, radius) & ~measured & (out == 0)] = k
    for k in numbers:
        out[_bottom(out == k, (out == 0) & measured, points_W)] = k
        mask = out == k
        parts, areas = masks.components(masks.filled(mask) & (out == 0))
        for hole in (parts == i for i in range(1, len(areas))):
            if _is_own(hole, mask, points_W):
                out[hole] = k
    return out


def _bottom(mask: Mask, free: Mask, points_W: Array) -> Mask:
    """Return a mask of the ``free`` pixels inside a bowl, which are surrounded by its wall.

    The near rim of a bowl is often too thin to be measured along its entire length, so the labeled pixels may not
    enclose the inside.
    """
    import cv2

    nothing = np.zeros(mask.shape, bool)
    wall = points_W[mask & (points_W[..., 2] > WALL)][:, :2]
    if len(wall) < 50 or np.nanquantile(points_W[..., 2][mask], 0.02) > WALL or not _is_round(wall):
        return nothing
    # Rasterize the footprint in 2 mm cells, and shrink it by the thickness of a wall.
    corner = wall.min(axis=0) - 0.01
    columns, rows = (np.ceil((np.ptp(wall, axis=0) + 0.02) / CELL).astype(int) + 1).tolist()
    hull = cv2.convexHull(np.round((wall - corner) / CELL).astype(np.int32))
    footprint = cv2.fillConvexPoly(np.zeros((rows, columns), np.uint8), hull, 1) > 0
    plan = Plan(masks.shrunk(footprint, masks.disk(2)), corner, CELL)
    inside = _bounded(free & plan.contains(points_W[..., :2]) & (points_W[..., 2] < WALL), mask, free)
    xy = points_W[inside][:, :2]
    if len(xy) < OPEN * mask.sum():
        return nothing
    turn = np.arctan2(*(wall - np.median(xy, axis=0)).T[::-1])
    sectors = np.bincount(np.floor((turn + np.pi) / (2 * np.pi) * 15.999).astype(int), minlength=16)
    return inside if int((sectors > 5).sum()) >= SURROUNDED else nothing


def _bounded(area: Mask, mask: Mask, free: Mask) -> Mask:
    """Return the connected components of ``area`` whose measured surroundings mostly belong to ``mask``.

    The support surface below the overhang of a bowl is also within its footprint, but it adjoins more support surface.
    """
    gap = max(5, round(float(np.sqrt(area.sum())) / 10))  # where the rim was not measured
    parts, areas = masks.components(masks.opened(area, np.ones((gap, gap), np.uint8)))
    out = np.zeros(area.shape, bool)
    for i in range(1, len(areas)):
        part = grown(parts == i, times=2)
        rim = grown(part, times=2) & ~part
        own, other = int((rim & mask).sum()), int((rim & free).sum())
        if own > BOUNDED * (own + other):
            out |= part & area
    return out


def _is_round(xy: Array) -> bool:
    """Return True if positions fill their bounding circle at least as well as a square does.

    The positions [m] have shape (n, 2).
    """
    import cv2

    hull = cv2.convexHull((xy * 1000).astype(np.float32))
    _, radius = cv2.minEnclosingCircle(hull)
    return float(cv2.contourArea(hull)) > 0.6 * np.pi * radius**2


def _is_own(hole: Mask, mask: Mask, points_W: Array) -> bool:
    """Return True if ``hole`` shows a surface above the object's footprint, such as the bottom of a bowl.

    In contrast, the table seen through the handle of a mug is behind the mug, outside of its footprint.
    """
    measured = np.isfinite(points_W[..., 2])
    seen = points_W[hole & measured]
    if len(seen) < MEASURED * hole.sum():
        return True
    hull = masks.hull_mm(points_W[mask & measured], 1500)
    return float(masks.in_hull(hull, masks.thinned(seen, 100)).mean()) > INSIDE
