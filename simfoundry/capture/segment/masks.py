"""Operations on masks and outlines, shared by the segmentation stages."""

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
MAX_CORNERS = 24  # maximum number of corners in an outline, so that a person can still read it
SQUARE: Kernel = np.ones((3, 3), np.uint8)


def disk(radius: int) -> Kernel:
    """Return a round kernel with the given radius [px]."""
    import cv2

    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), dtype=np.uint8)


def grown(mask: Mask, kernel: Kernel = SQUARE, times: int = 1) -> Mask:
    """Dilate a mask."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel, iterations=times) > 0)


def shrunk(mask: Mask, kernel: Kernel) -> Mask:
    """Erode a mask.

    Pixels at the edge of the image are not eroded from outside the image.
    """
    import cv2

    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel) > 0)


def opened(mask: Mask, kernel: Kernel) -> Mask:
    """Open a mask, which removes parts narrower than the kernel."""
    import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0)


def closed(mask: Mask, radius: int) -> Mask:
    """Close a mask, which fills gaps up to twice ``radius`` [px] wide, including those at the edge of the image."""
    import cv2

    pad = radius + 2
    padded = np.pad(mask, pad).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disk(radius))[pad:-pad, pad:-pad] > 0)


def components(mask: Mask, connectivity: int = 4) -> tuple[Labels, NDArray[np.int64]]:
    """Number the connected components of a mask from 1.

    Returns:
        The labels, which are 0 outside the mask, and the number of pixels in each component. The entry for 0 is 0.
    """
    import cv2

    count, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)
    areas = np.bincount(parts.ravel(), minlength=count)
    areas[0] = 0
    return np.asarray(parts, dtype=np.int32), areas


def filled(mask: Mask) -> Mask:
    """Fill the holes in a mask."""
    from scipy.ndimage import binary_fill_holes

    return np.asarray(binary_fill_holes(mask))


def thinned(points: Array, count: int) -> Array:
    """Return every n-th point.

    The number n is chosen so that ``count`` to twice as many points remain.
    """
    return points[:: max(1, len(points) // count)]


def hull_mm(points: Array, count: int = 2000) -> NDArray[np.float32]:
    """Return the convex hull [mm] of points [m] in the xy plane.

    The points have shape (n, 2) or (n, 3). They are thinned to about ``count`` points first.
    """
    import cv2

    return np.asarray(cv2.convexHull((thinned(points, count)[:, :2] * 1000).astype(np.float32)), dtype=np.float32)


def in_hull(hull: NDArray[np.float32], points: Array) -> Mask:
    """Return a mask of the points [m] whose xy positions are inside a convex hull [mm]."""
    import cv2

    inside = [cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in points[:, :2] * 1000]
    return np.array(inside, dtype=bool)


def solidity(mask: Mask) -> float:
    """Return the fraction of its convex hull that a mask fills."""
    import cv2

    hull = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32))
    return float(mask.sum()) / max(1.0, float(cv2.contourArea(hull)))


def outline_of(mask: Mask) -> tuple[tuple[int, int], ...]:
    """Return at most 12 pixels (column, row) around the largest part of a mask."""
    import cv2

    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    contour = max(contours, key=cv2.contourArea)
    tolerance = 2.0
    while len(corners := cv2.approxPolyDP(contour, tolerance, True)) > 12:
        tolerance *= 1.5
    return tuple((int(u), int(v)) for u, v in corners[:, 0])


def simplified(polygon: Polygon, tolerance: float, growth: float) -> Polygon:
    """Simplify an outline to at most MAX_CORNERS corners.

    The tolerance starts at ``tolerance`` [m] and is multiplied by ``growth`` until the outline is simple enough.
    """
    simple = polygon.simplify(tolerance)
    while len(simple.exterior.coords) - 1 > MAX_CORNERS:
        tolerance *= growth
        simple = polygon.simplify(tolerance)
    return simple


def window_around(mask: Mask, margin: int) -> tuple[slice, slice]:
    """Return the rows and the columns of a mask that contain its pixels, and a margin [px] as far as the image reaches.

    Raises:
        ValueError: The mask is empty.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        raise ValueError("an empty mask has no window")
    first = max(0, int(rows[0]) - margin), max(0, int(columns[0]) - margin)
    return slice(first[0], int(rows[-1]) + margin + 1), slice(first[1], int(columns[-1]) + margin + 1)


@dataclass(frozen=True, eq=False)
class Plan:
    """A map of the support as seen from above.

    ``mask`` is a bool array of shape (rows, columns), with rows along world y and columns along world x. Cell (r, c) is
    centered at ``corner + cell * (c, r)`` in world xy [m].
    """

    mask: Mask
    corner: Array
    cell: float

    def contains(self, xy: Array) -> Mask:
        """Return a mask of the points inside the plan.

        The points ``xy`` are in the world [m] and have shape (..., 2). NaN points are never inside.
        """
        index = np.round((np.nan_to_num(xy, nan=-1e6) - self.corner) / self.cell)
        rows, columns = self.mask.shape
        inside = (index >= 0).all(-1) & (index[..., 0] < columns) & (index[..., 1] < rows)
        index = np.where(inside[..., None], index, 0).astype(int)
        return np.asarray(inside & self.mask[index[..., 1], index[..., 0]])
