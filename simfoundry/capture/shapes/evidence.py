"""Evidence of the camera about one object: its points, and a grid of rays through and around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.geometry.frames import Array

MAX_RAYS = 2600  # rays of one object: a grid of 51 x 51; a fit casts them some thousand times
_WINDOW_MARGIN = 0.12  # of the object's size in the picture: free space beside it is evidence too


@dataclass(frozen=True, eq=False)
class Evidence:
    """Points of one object and rays through and around it.

    ``points`` [m], world, shape (n, 3), without flying pixels; ``eye`` [m] the camera center in the world, shape (3,);
    ``rays`` world directions scaled so that ``eye + depth * ray`` is the point at that depth, shape (m, 3); ``depth``
    [m] observed along the rays, NaN where there is none, shape (m,); ``inside`` marks the object's own rays and
    ``hidden`` those that belong to other objects, both bool, shape (m,); ``scale`` [m] is the distance at which a
    residual stops counting as noise; ``base_z`` [m] the height of what the object stands on.
    """

    points: Array
    eye: Array
    rays: Array
    depth: Array
    inside: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    scale: float
    base_z: float

    @property
    def view(self) -> Array:
        """Horizontal unit direction from the camera to the object, shape (2,)."""
        away = np.median(self.points[:, :2], axis=0) - self.eye[:2]
        norm = float(np.linalg.norm(away))
        return away / norm if norm > 1e-6 else np.array([1.0, 0.0])

    @property
    def top(self) -> float:
        """Robust height of the highest points [m]."""
        return robust_top(self.points[:, 2])


def robust_top(z: Array) -> float:
    """Height [m] that noise does not inflate: the median of the highest two percent, but of at least ten points."""
    count = max(min(10, len(z)), len(z) // 50)
    return float(np.median(np.partition(z, len(z) - count)[len(z) - count :]))


def gather(
    frame: Frame,
    support: SupportSurface,
    mask: NDArray[np.bool_],
    base_z: float,
    labels: NDArray[np.int32] | None = None,
) -> Evidence:
    """Collect the evidence for the object under ``mask`` (bool, shape (h, w)).

    ``labels`` (int32, shape (h, w)) names the other objects, so that rays that end on them are not taken for misses.
    """
    keep = mask & np.isfinite(frame.depth) & ~flying_pixels(frame.depth)
    distance = float(np.median(frame.depth[keep])) if keep.any() else 1.0
    scale = depth_scale(distance)
    p_W = support.X_WC.apply(frame.points[keep])
    connected = main_body(p_W, 0.008 + 0.5 * scale)
    points = p_W[connected & (p_W[:, 2] > base_z - scale)]
    stray = np.zeros_like(mask)
    stray[keep] = ~connected
    mask, keep = mask & ~stray, keep & ~stray
    rows, cols = _ray_grid(mask)
    directions = np.column_stack(
        [(cols - frame.K[0, 2]) / frame.K[0, 0], (rows - frame.K[1, 2]) / frame.K[1, 1], np.ones(len(rows))]
    )
    inside = mask[rows, cols]
    hidden = np.zeros(len(rows), dtype=bool) if labels is None else (labels[rows, cols] > 0) & ~inside
    return Evidence(
        points=points,
        eye=support.X_WC.p,
        rays=directions @ support.X_WC.rotation.T,
        depth=np.where(keep | ~mask, frame.depth, np.nan)[rows, cols],
        inside=inside,
        hidden=hidden,
        scale=scale,
        base_z=base_z,
    )


def main_body(points: Array, pitch: float) -> NDArray[np.bool_]:
    """Select the points of the object itself, without stray background under its mask; bool, shape (n,).

    Points are joined through a grid of ``pitch`` [m]; a part counts if it holds a tenth of the largest part's points,
    so that an object cut in two by something before it stays whole.
    """
    from scipy import ndimage

    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    low = np.percentile(points, 1.0, axis=0) - 0.5
    cell = np.floor((np.clip(points, low, low + 1.5) - low) / pitch).astype(np.int64)
    cell -= cell.min(axis=0)
    grid = np.zeros(cell.max(axis=0) + 1, dtype=bool)
    grid[tuple(cell.T)] = True
    part = ndimage.label(grid, structure=np.ones((3, 3, 3)))[0][tuple(cell.T)]
    count = np.bincount(part)
    return np.asarray(count[part] >= max(1, 0.1 * int(count.max())))


def depth_scale(distance: float) -> float:
    """Residual [m] beyond the noise of common depth cameras at a distance [m]: it grows with the square of it."""
    return 0.005 + 0.004 * distance**2


def flying_pixels(depth: Array) -> NDArray[np.bool_]:
    """Pixels that hang between a near and a far surface: fewer than three of eight neighbors are at their depth."""
    padded = np.pad(depth, 1, constant_values=np.nan)
    h, w = depth.shape
    agreeing = np.zeros((h, w), dtype=np.int32)
    for dv in (0, 1, 2):
        for du in (0, 1, 2):
            if (dv, du) != (1, 1):
                neighbor = padded[dv : dv + h, du : du + w]
                agreeing += np.abs(neighbor - depth) < 0.012 * depth
    return np.asarray(np.isfinite(depth) & (agreeing < 3))


def _ray_grid(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the rays: a regular grid over the mask's window, with a margin."""
    rows, cols = np.nonzero(mask)
    margin = int(6 + _WINDOW_MARGIN * max(np.ptp(rows), np.ptp(cols)))
    top, bottom = max(0, rows.min() - margin), min(mask.shape[0] - 1, rows.max() + margin)
    left, right = max(0, cols.min() - margin), min(mask.shape[1] - 1, cols.max() + margin)
    step = max(1, int(np.ceil(np.sqrt((bottom - top + 1) * (right - left + 1) / MAX_RAYS))))
    grid = np.meshgrid(np.arange(top, bottom + 1, step), np.arange(left, right + 1, step), indexing="ij")
    return grid[0].ravel(), grid[1].ravel()
