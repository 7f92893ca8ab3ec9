"""Outline of a support, with the parts that objects on it hide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose

MAX_CELLS = 700  # cells along the longer side: 5 mm on a table of 3.5 m
MAX_VERTICES = 24  # corners of an outline: as many as a person reads
TOLERANCE = 0.01  # [m] of the simplified outline
SHADOW = 0.25  # [m] the widest strip behind an object across which two seen parts are one surface
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TopView:
    """A map of the support seen from above: ``mask`` bool, shape (rows, columns), row along world y, column along x.

    Cell (r, c) is centered at ``corner + cell * (c, r)`` in world xy [m].
    """

    mask: Mask
    corner: Array
    cell: float

    def contains(self, xy: Array) -> Mask:
        """Test whether world points, shape (..., 2) [m], lie on the support; False for NaN."""
        index = np.round((np.nan_to_num(xy, nan=-1e6) - self.corner) / self.cell)
        rows, columns = self.mask.shape
        inside = (index >= 0).all(-1) & (index[..., 0] < columns) & (index[..., 1] < rows)
        index = np.where(inside[..., None], index, 0).astype(int)
        return np.asarray(inside & self.mask[index[..., 1], index[..., 0]])


def top_view(
    inliers: Mask, hidden: Mask, X_WC: Pose, K: Array, points_W: Array, finest: float = 0.005
) -> TopView | None:
    """The largest connected surface of ``inliers``, with what objects hide of it closed; None if there is none.

    ``inliers`` marks the plane's pixels and ``hidden`` those whose ray does not reach the plane (an object is in
    front, or there is no reading); every other ray passes the plane, so there is no surface there. ``points_W`` are
    the picture's points in the world [m], shape (h, w, 3).
    """
    import cv2

    xy = points_W[inliers][:, :2]
    if len(xy) < 10:
        return None
    lo, hi = np.quantile(xy, 0.002, axis=0) - 0.03, np.quantile(xy, 0.998, axis=0) + 0.03
    cell = max(finest, float((hi - lo).max()) / MAX_CELLS)
    columns, rows = (np.ceil((hi - lo) / cell).astype(int) + 1).tolist()
    to_pixel = _pixel_of_cell(X_WC, K, lo, cell)

    def seen_from_above(mask: Mask) -> Mask:
        # Linear weights, so that a border thinner than a cell does not vanish.
        picture = mask.astype(np.float32)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(picture, to_pixel, (columns, rows), flags=flags) > 0.5)

    surface, unseen = seen_from_above(inliers), seen_from_above(hidden)
    surface = _close(surface, 0.015 / cell) & (surface | unseen | _small_gap(surface, cell))
    bridged = surface | (unseen & _close(surface, SHADOW / 2 / cell))
    main = _largest(bridged, surface)
    if main is None:
        return None
    seen = surface & main
    filled = _fill(seen | (unseen & _hull(seen)))
    smooth = _largest(_open(filled, 0.01 / cell), filled)
    return None if smooth is None else TopView(_fill(smooth), lo, cell)


def polygon_of(plan: TopView) -> Array:
    """The plan's boundary in world xy [m], shape (n, 2): counter-clockwise, simple, few vertices."""
    import cv2
    from shapely.geometry import Polygon

    # Doubled and padded, the contour runs along the cells' borders instead of through their centers.
    fine = np.pad(np.kron(plan.mask, np.ones((2, 2), bool)), 1).astype(np.uint8)
    contours, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=cv2.contourArea)[:, 0, :].astype(np.float64)
    whole = Polygon(((contour - 1.5) / 2 + 0.25) * plan.cell + plan.corner).buffer(0)
    polygon = max(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
    tolerance = TOLERANCE
    simple = polygon.simplify(tolerance)
    while len(simple.exterior.coords) - 1 > MAX_VERTICES:
        tolerance *= 1.3
        simple = polygon.simplify(tolerance)
    ring = np.asarray(simple.exterior.coords)[:-1]
    return ring if simple.exterior.is_ccw else ring[::-1].copy()


def _pixel_of_cell(X_WC: Pose, K: Array, corner: Array, cell: float) -> Array:
    """Homography, shape (3, 3), from plan cells (column, row, 1) to pixels (u, v, 1)."""
    X_CW = X_WC.inverse()
    plane = np.column_stack([X_CW.rotation[:, 0], X_CW.rotation[:, 1], X_CW.p])
    cells = np.array([[cell, 0, corner[0]], [0, cell, corner[1]], [0, 0, 1]])
    return np.asarray(K @ plane @ cells)


def _disk(radius: float) -> NDArray[np.uint8]:
    import cv2

    size = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


def _close(mask: Mask, radius: float) -> Mask:
    import cv2

    pad = round(radius) + 2
    padded = np.pad(mask, pad).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(padded, cv2.MORPH_CLOSE, _disk(radius))[pad:-pad, pad:-pad] > 0)


def _open(mask: Mask, radius: float) -> Mask:
    import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disk(radius)) > 0)


def _small_gap(surface: Mask, cell: float) -> Mask:
    """Specks up to 1 cm where the plane seems missing: noise of the sensor rather than holes in a table."""
    return _close(surface, 0.005 / cell)


def _largest(mask: Mask, measured: Mask) -> Mask | None:
    """The connected part of ``mask`` that holds most of ``measured``."""
    import cv2

    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    if count < 2:
        return None
    sizes = np.bincount(labels[measured], minlength=count)
    sizes[0] = 0
    return np.asarray(labels == int(np.argmax(sizes)))


def _hull(mask: Mask) -> Mask:
    import cv2

    rows, columns = np.nonzero(mask)
    hull = cv2.convexHull(np.column_stack([columns, rows]).astype(np.int32))
    return np.asarray(cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), hull, 1) > 0)


def _fill(mask: Mask) -> Mask:
    from scipy.ndimage import binary_fill_holes

    return np.asarray(binary_fill_holes(mask))
