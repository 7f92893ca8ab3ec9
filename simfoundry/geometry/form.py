"""Rigid bodies prepared for measuring: the convex parts of one, its extents and bounding balls."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.hulls import Hulls, hulls_of
from simfoundry.geometry.shapes import Geometry

TURNED = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -1, 0]])
TURNED[3:] /= np.sqrt(2)
TURNED.setflags(write=False)
"""The axes along which a thing is boxed: its own, and those turned by 45 degrees about z; shape (5, 3)."""


@dataclass(frozen=True, eq=False)
class Form:
    """The shapes of a rigid body in its frame, and their convex parts.

    Where it is not ``solid`` it touches nothing: its shapes are only seen.
    ``points`` [m], shape (m, 3), with a ``radius`` each, shape (m,), have the same hull as the parts. ``low`` and
    ``high`` [m] are the ends along :data:`TURNED`, shape (5,).
    """

    shapes: tuple[tuple[Geometry, Pose], ...]
    solid: bool
    parts: Hulls

    @classmethod
    def of(cls, shapes: Iterable[tuple[Geometry, Pose]], solid: bool = True) -> Form:
        """Return the form of posed shapes; meshes must be convex where it is solid."""
        shapes = tuple(shapes)
        return cls(shapes, solid, hulls_of((geometry, pose, 0) for geometry, pose in shapes))

    @cached_property
    def _support(self) -> tuple[Array, Array]:
        points, radius = self.parts.corners, self.parts.radius[self.parts.part]
        sharp = radius == 0
        kept = _corners(points[sharp])
        return np.concatenate([kept, points[~sharp]]), np.concatenate([np.zeros(len(kept)), radius[~sharp]])

    @property
    def points(self) -> Array:
        """Corners of its hull, and centres of its balls [m], (m, 3)."""
        return self._support[0]

    @property
    def radius(self) -> Array:
        """Of the ball at each point [m], (m,)."""
        return self._support[1]

    @cached_property
    def _span(self) -> tuple[Array, Array]:
        along = self.points @ TURNED.T
        return (along - self.radius[:, None]).min(axis=0), (along + self.radius[:, None]).max(axis=0)

    @property
    def low(self) -> Array:
        """The lower ends along :data:`TURNED` [m], (5,)."""
        return self._span[0]

    @property
    def high(self) -> Array:
        """The higher ends along :data:`TURNED` [m], (5,)."""
        return self._span[1]

    @cached_property
    def ball(self) -> tuple[Array, float]:
        """A ball around it: centre [m], shape (3,), and radius [m]."""
        middle = (self.low[:3] + self.high[:3]) / 2
        return middle, float((np.linalg.norm(self.points - middle, axis=1) + self.radius).max())

    @cached_property
    def digest(self) -> bytes:
        """The SHA-256 of the parts: equal for forms of the same parts."""
        arrays = (self.parts.corners, self.parts.part, self.parts.radius, self.parts.triangles)
        return hashlib.sha256(b"".join(np.ascontiguousarray(v).tobytes() for v in arrays)).digest()

    @cached_property
    def pieces(self) -> tuple[Array, Array, Array, Array]:
        """Of each part: the corners of its box [m], (k, 3) twice, and a ball around it, (k, 3) and (k,)."""
        rows = []
        for k in range(len(self.parts.radius)):
            corners, r = self.parts.corners[self.parts.part == k], float(self.parts.radius[k])
            low, high = corners.min(axis=0) - r, corners.max(axis=0) + r
            middle = (low + high) / 2
            rows.append((low, high, middle, float(np.linalg.norm(corners - middle, axis=1).max()) + r))
        low, high, middle, size = zip(*rows, strict=True)
        return np.array(low), np.array(high), np.array(middle), np.array(size)


def _corners(points: Array) -> Array:
    """The corners of the hull of points, in their order; all of them where they have no volume."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 5:
        return points
    try:
        return np.asarray(points[np.sort(ConvexHull(points).vertices)])
    except QhullError:
        return points
