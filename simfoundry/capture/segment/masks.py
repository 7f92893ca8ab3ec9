"""Operations on masks and outlines that the stages of a segmentation share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

if TYPE_CHECKING:
    from shapely.geometry import Polygon

Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]
Kernel = NDArray[np.uint8]
MAX_CORNERS = 24  # of an outline: as many as a person reads
SQUARE: Kernel = np.ones((3, 3), np.uint8)


def disk(radius: int) -> Kernel:
    """Return a round kernel of ``radius`` [px]."""
    import cv2

    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), dtype=np.uint8)


def grown(mask: Mask, kernel: Kernel = SQUARE, times: int = 1) -> Mask:
    """Dilate a mask."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel, iterations=times) > 0)


def shrunk(mask: Mask, kernel: Kernel) -> Mask:
    """Erode a mask; the outside of the picture does not erode it."""
    import cv2

    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel) > 0)


def opened(mask: Mask, kernel: Kernel) -> Mask:
    """Remove what is narrower than the kernel."""
    import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0)


def closed(mask: Mask, radius: int) -> Mask:
    """Fill gaps up to ``radius`` [px] wide to either side, also at the edge of the picture."""
    import cv2

    pad = radius + 2
    padded = np.pad(mask, pad).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disk(radius))[pad:-pad, pad:-pad] > 0)


def components(mask: Mask, connectivity: int = 4) -> tuple[Labels, NDArray[np.int64]]:
    """Number the connected parts of a mask from 1; also return the pixels of each number, 0 for the outside."""
    import cv2

    count, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)
    areas = np.bincount(parts.ravel(), minlength=count)
    areas[0] = 0
    return np.asarray(parts, dtype=np.int32), areas


def filled(mask: Mask) -> Mask:
    """Fill the holes of a mask."""
    from scipy.ndimage import binary_fill_holes

    return np.asarray(binary_fill_holes(mask))


def thinned(points: Array, count: int) -> Array:
    """Return every n-th point, so that between ``count`` and twice as many remain."""
    return points[:: max(1, len(points) // count)]


def hull_mm(points: Array, count: int = 2000) -> NDArray[np.float32]:
    """Convex hull [mm] of the xy of points [m], shape (n, 2) or (n, 3), of which about ``count`` are used."""
    import cv2

    return np.asarray(cv2.convexHull((thinned(points, count)[:, :2] * 1000).astype(np.float32)), dtype=np.float32)


def in_hull(hull: NDArray[np.float32], points: Array) -> Mask:
    """Mark the points [m] whose xy lies in a convex hull [mm]."""
    import cv2

    inside = [cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in points[:, :2] * 1000]
    return np.array(inside, dtype=bool)


def simplified(polygon: Polygon, tolerance: float, growth: float) -> Polygon:
    """Simplify an outline to at most MAX_CORNERS corners, by ``tolerance`` [m] times powers of ``growth``."""
    simple = polygon.simplify(tolerance)
    while len(simple.exterior.coords) - 1 > MAX_CORNERS:
        tolerance *= growth
        simple = polygon.simplify(tolerance)
    return simple


@dataclass(frozen=True, eq=False)
class Plan:
    """A map of the support seen from above: ``mask`` bool, shape (rows, columns), row along world y, column along x.

    Cell (r, c) is centered at ``corner + cell * (c, r)`` in world xy [m].
    """

    mask: Mask
    corner: Array
    cell: float

    def contains(self, xy: Array) -> Mask:
        """Mark the world points, shape (..., 2) [m], that lie on the mask; False for NaN."""
        index = np.round((np.nan_to_num(xy, nan=-1e6) - self.corner) / self.cell)
        rows, columns = self.mask.shape
        inside = (index >= 0).all(-1) & (index[..., 0] < columns) & (index[..., 1] < rows)
        index = np.where(inside[..., None], index, 0).astype(int)
        return np.asarray(inside & self.mask[index[..., 1], index[..., 0]])
