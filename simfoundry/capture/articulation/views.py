"""Depth images with known poses, and what they say about points: seen there, seen through, or hidden."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, depth_sigma
from simfoundry.capture.segment.regions import normals_of, tangents
from simfoundry.geometry.frames import Array, Pose

Mask = NDArray[np.bool_]

# Radius of the window in which tangent planes are fitted, as a share of the width of the image: 6 of 640 pixels, so
# that normals of noisy depth are good to a few degrees. It has at least 3 pixels.
TANGENT_RADIUS, LEAST_RADIUS = 0.01, 3

# A reading counts as behind a point, or as the point itself, if it is farther than, or within, this many standard
# deviations of the depth, plus SLACK [m] for errors of the poses.
DEVIATIONS, SLACK = 3.0, 0.003


class Sight(IntEnum):
    """The visibility of a point in a view."""

    HIDDEN = 0  # behind a surface, outside of the image, or where depth is missing
    SEEN = 1  # on a surface
    FREE = 2  # in front of a surface, so that there is nothing at the point


@dataclass(frozen=True, eq=False)
class PosedView:
    """A depth image in the world frame.

    Attributes:
        depth: Depth along the optical axis [m], shape (h, w). Pixels without a reading are NaN.
        K: Intrinsic matrix [px], shape (3, 3).
        X_WC: The pose of the camera.
        mask: The pixels that may belong to the object, shape (h, w).
    """

    depth: Array
    K: Array
    X_WC: Pose
    mask: Mask

    @staticmethod
    def of(frame: Frame, X_WC: Pose, mask: Mask | None = None) -> PosedView:
        """Return a frame with the pose of its camera. By default, all pixels may belong to the object."""
        clean = frame.cleaned()
        return PosedView(clean.depth, clean.K, X_WC, np.isfinite(clean.depth) if mask is None else mask)

    @cached_property
    def points(self) -> Array:
        """The points in the world frame [m], shape (h, w, 3)."""
        color = np.zeros((*self.depth.shape, 3), np.uint8)
        local = Frame(color, self.depth, self.K).points
        return local @ self.X_WC.rotation.T + self.X_WC.p

    @cached_property
    def normals(self) -> Array:
        """The unit normals toward the camera in the world frame, shape (h, w, 3)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            radius = max(LEAST_RADIUS, round(TANGENT_RADIUS * self.depth.shape[1]))
            local = normals_of(tangents(self.depth, radius, max(1, radius // 3)), self.K)
        return local @ self.X_WC.rotation.T

    def sight(self, points: Array) -> NDArray[np.int8]:
        """Return the :class:`Sight` of points in the world frame [m], shape (n, 3), as an array of shape (n,).

        The nearest of the nine pixels around a point decides, so that points at outlines are not taken for free space.
        """
        z = (points - self.X_WC.p) @ self.X_WC.rotation[:, 2]
        u, v = self.pixels(points)
        h, w = self.depth.shape
        inside = (z > 0) & (u >= 1) & (v >= 1) & (u < w - 1) & (v < h - 1)
        out = np.full(len(points), Sight.HIDDEN, np.int8)
        index = np.flatnonzero(inside)
        at = v[index], u[index]
        near, far, best = (layer[at] for layer in self._around)
        depth = z[index]
        tolerance = DEVIATIONS * depth_sigma(depth) + SLACK
        with np.errstate(invalid="ignore"):
            seen = (
                (depth > near - tolerance) & (depth < far + tolerance) & (np.abs(best - depth) < far - near + tolerance)
            )
            free = ~seen & (depth < near - tolerance)
        out[index[seen]] = Sight.SEEN
        out[index[free]] = Sight.FREE
        return out

    def is_unread(self, points: Array) -> Mask:
        """Return True for points in the world frame [m], shape (n, 3), at whose pixel there is no reading."""
        u, v = self.pixels(points)
        h, w = self.depth.shape
        inside = (u >= 0) & (v >= 0) & (u < w) & (v < h)
        out = np.zeros(len(points), np.bool_)
        out[inside] = np.isnan(self.depth[v[inside], u[inside]])
        return out

    def pixels(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the columns and the rows of points in the world frame [m], shape (n, 3), also outside of the image."""
        x, y, z = ((points - self.X_WC.p) @ self.X_WC.rotation).T
        depth = np.where(np.abs(z) < 1e-6, 1e-6, z)
        u, v = x / depth * self.K[0, 0] + self.K[0, 2], y / depth * self.K[1, 1] + self.K[1, 2]
        return tuple(np.rint(np.clip(np.nan_to_num(each, nan=-1), -1, 2**31)).astype(np.int64) for each in (u, v))

    @cached_property
    def _around(self) -> tuple[Array, Array, Array]:
        """The smallest and the largest depth of the nine pixels around each pixel, and its own; NaN where one lacks."""
        padded = np.pad(self.depth, 1, constant_values=np.nan)
        nine = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
        return nine.min(axis=(2, 3)), nine.max(axis=(2, 3)), self.depth
