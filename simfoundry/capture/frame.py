"""One registered RGB-D picture, the input of every later stage of a capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose


@dataclass(frozen=True, eq=False)
class Frame:
    """A color picture with depth registered to it.

    ``color`` uint8 RGB, shape (h, w, 3); ``depth`` [m] along the optical axis, float64, shape (h, w), NaN where there
    is none; ``K`` the intrinsics [px], shape (3, 3); ``instances`` int32, shape (h, w), 0 where there is no object and
    one number an object, or None where the capture has no masks.
    """

    color: NDArray[np.uint8]
    depth: Array
    K: Array
    instances: NDArray[np.int32] | None = None

    @property
    def points(self) -> Array:
        """Points in the camera frame [m], shape (h, w, 3), NaN where there is no depth."""
        h, w = self.depth.shape
        u, v = np.meshgrid(np.arange(w), np.arange(h))
        x = (u - self.K[0, 2]) / self.K[0, 0] * self.depth
        y = (v - self.K[1, 2]) / self.K[1, 1] * self.depth
        return np.stack([x, y, self.depth], axis=-1)


@dataclass(frozen=True, eq=False)
class SupportSurface:
    """Supporting surface of the objects.

    ``X_WC`` puts the camera into the world whose origin lies on the surface, z up; ``outline`` [m] is the boundary of
    the seen surface in world xy, shape (n, 2), counter-clockwise, simple, not repeated at its end; ``residual`` [m] is
    the median distance of its points from the plane; ``inliers`` bool, shape (h, w), marks its pixels.
    """

    X_WC: Pose
    outline: Array
    residual: float
    inliers: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Objects above the support.

    ``labels`` int32, shape (h, w): 0 where there is no object, else 1..n. ``supports[k]`` is the support of object
    ``k``: another object's number, or 0 for the table.
    """

    labels: NDArray[np.int32]
    supports: dict[int, int]
