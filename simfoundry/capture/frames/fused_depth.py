"""Average the depth of several frames in the view of one of them, and fill its holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.frame import FARTHEST, NEAREST, Frame, depth_sigma
from simfoundry.capture.frames.sensors import register
from simfoundry.capture.segment.masks import Mask
from simfoundry.geometry.frames import Array, Pose

# Maximum difference of two readings of one surface, in standard deviations of a reading; noise exceeds it in 0.3 %.
SAME_SURFACE = 3.0

# Least number of frames that must agree on the depth of a pixel at which the image itself has none.
WITNESSES = 2

# Change of the depth between neighbors, as a share of it, that is an edge. A table seen at 20 degrees from 1 m changes
# by 0.5 % from pixel to pixel.
JUMP = 0.02

# Radius [px] around edges and holes in which a reading may be of either side: sensors place edges to about a pixel.
EDGE_PX = 1

# Width [px] of the band beside edges in which sensors leave holes: half the matching window of stereo cameras, and the
# shadow of a projector 7 cm away, on a table 10 cm behind an object.
BLIND_PX = 6


@dataclass(frozen=True, eq=False)
class DepthView:
    """The depth of another frame of a capture.

    Attributes:
        depth: Depth along the optical axis [m], shape (h, w), NaN where it is not known well.
        K: Intrinsic matrix [px].
        X_CV: Pose of its camera in the camera frame of the image with which it is fused.
    """

    depth: Array
    K: Array
    X_CV: Pose

    def along_rays(self, p_V: Array) -> Array:
        """Return the depth [m] along the rays through points in the frame of the view's camera.

        The points [m] have shape (..., 3). Readings are interpolated; they are NaN outside the view and beside holes.
        """
        h, w = self.depth.shape
        z = np.where(p_V[..., 2] > NEAREST, p_V[..., 2], np.nan)
        u, v = p_V[..., 0] / z * self.K[0, 0] + self.K[0, 2], p_V[..., 1] / z * self.K[1, 1] + self.K[1, 2]
        inside = (u >= 0) & (u < w - 1) & (v >= 0) & (v < h - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        column, row = u.astype(np.intp), v.astype(np.intp)
        du, dv = u - column, v - row
        upper = (1 - du) * self.depth[row, column] + du * self.depth[row, column + 1]
        lower = (1 - du) * self.depth[row + 1, column] + du * self.depth[row + 1, column + 1]
        return np.where(inside, (1 - dv) * upper + dv * lower, np.nan)


def without_edges(depth: Array) -> Array:
    """Return a depth image [m], shape (h, w), without the readings beside edges and holes."""
    unsure = _dilated(_jumps(depth) | ~np.isfinite(depth), EDGE_PX)
    return np.where(unsure, np.nan, depth)


def _jumps(depth: Array) -> Mask:
    """Return a mask of the pixels of a depth image [m] whose neighbors have another depth; holes are no neighbors."""
    import cv2

    known, kernel = np.isfinite(depth), np.ones((3, 3), np.uint8)
    highest = cv2.dilate(np.where(known, depth, 0.0), kernel)
    lowest = cv2.erode(np.where(known, depth, FARTHEST), kernel)
    return np.asarray(known & (highest - lowest > 2 * JUMP * np.where(known, depth, 0.0)))


def _dilated(mask: Mask, radius: int) -> Mask:
    """Return a mask grown by a radius [px]."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((2 * radius + 1,) * 2, np.uint8)) > 0)


def fused_depth(frame: Frame, views: Sequence[DepthView]) -> Array:
    """Return the depth of an image [m], with less noise and fewer holes.

    A reading becomes the mean of those that agree with it; a difference along the ray of another camera is as large
    along that of the image, but for the change in slant, which averages out. A hole is filled with the median of the
    readings of other frames, if enough of them agree, except beside an edge: there, what the image would have shown may
    be in front of all that the others saw.

    Returns:
        Depth along the optical axis [m], shape (h, w), NaN for holes.
    """
    depth = frame.depth
    if not views:
        return depth
    points, limit = frame.points, SAME_SURFACE * depth_sigma(depth)
    total, count = np.zeros(depth.shape), np.ones(depth.shape)
    for view in views:
        p_V = view.X_CV.inverse().apply(points)
        gap = view.along_rays(p_V) - p_V[..., 2]
        with np.errstate(invalid="ignore"):
            same = np.abs(gap) < limit
        total[same] += gap[same]
        count += same
    measured = np.isfinite(depth)
    filled = np.where(measured, depth + total / count, _hole_depth(frame, views))
    return np.where(measured | ~_dilated(_jumps(filled), BLIND_PX), filled, np.nan)


def _hole_depth(frame: Frame, views: Sequence[DepthView]) -> Array:
    """Return the median depth [m] that other frames have in an image, NaN where too few of them agree."""
    size = frame.depth.shape[0], frame.depth.shape[1]
    stack = np.stack([register(view.depth, view.K, view.X_CV, frame.K, size) for view in views])
    guess = _median(stack)
    with np.errstate(invalid="ignore"):
        agreeing = np.abs(stack - guess) < SAME_SURFACE * depth_sigma(guess)
    return np.where(agreeing.sum(axis=0) >= WITNESSES, guess, np.nan)


def same_surface(depth: Array, other: Array) -> Mask:
    """Return a mask of the pixels at which two depth images [m] show the same surface."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(depth - other) < SAME_SURFACE * depth_sigma(depth))


def _median(stack: Array) -> Array:
    """Return the median over the first axis without NaN, or NaN where there is nothing else."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of pixels that no frame has seen
        return np.asarray(np.nanmedian(stack, axis=0))
