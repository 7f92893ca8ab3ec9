"""Rigid bodies that are preprocessed for measurements, including convex parts, extents and bounding spheres."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.hulls import Hulls, hulls_of
from simfoundry.geometry.shapes import Geometry

TURNED = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -1, 0]])
TURNED[3:] /= np.sqrt(2)
TURNED.setflags(write=False)
"""Axes of an object's bounding boxes, shape (5, 3): its own axes, and x and y rotated by 45 degrees about z."""

# Maximum number of states that are measured individually; for more states, precomputing shared data is faster.
FEW = 16


@dataclass(frozen=True, eq=False)
class Form:
    """The shapes of a rigid body in the body frame, with their convex parts.

    A form that is not ``solid`` has only visual shapes and never collides. ``low`` and ``high`` [m] are the extents
    along :data:`TURNED`, shape (5,).
    """

    shapes: tuple[tuple[Geometry, Pose], ...]
    solid: bool
    parts: Hulls

    @classmethod
    def of(cls, shapes: Iterable[tuple[Geometry, Pose]], solid: bool = True) -> Form:
        """Create a form from posed shapes. In a solid form, all meshes must be convex."""
        shapes = tuple(shapes)
        return cls(shapes, solid, hulls_of((geometry, pose, 0) for geometry, pose in shapes))

    @cached_property
    def _corners(self) -> tuple[Array, Array]:
        points, radius = self.parts.corners, self.parts.radius[self.parts.part]
        if len(self.parts.radius) == 1 or not (radius == 0).any():
            return points, radius
        sharp = radius == 0
        kept = _hull_corners(points[sharp])
        return np.concatenate([kept, points[~sharp]]), np.concatenate([np.zeros(len(kept)), radius[~sharp]])

    def support(self, states: int) -> tuple[Array, Array]:
        """Return balls that have the same convex hull as the parts.

        Corners inside the hull are removed only if there are many states, because removing them for a few states does
        not save time.

        Returns:
            The centers [m], shape (m, 3), and the radii [m], shape (m,).
        """
        return self._corners if states > FEW else (self.parts.corners, self.parts.radius[self.parts.part])

    @cached_property
    def low(self) -> Array:
        """The lower extents [m] along the directions in :data:`TURNED`."""
        points, radius = self.support(1)
        return np.asarray((points @ TURNED.T - radius[:, None]).min(axis=0))

    @cached_property
    def high(self) -> Array:
        """The upper extents [m] along the directions in :data:`TURNED`."""
        points, radius = self.support(1)
        return np.asarray((points @ TURNED.T + radius[:, None]).max(axis=0))

    @cached_property
    def ball(self) -> tuple[Array, float]:
        """The center [m] and the radius [m] of the bounding sphere."""
        middle = (self.low[:3] + self.high[:3]) / 2
        points, radius = self.support(1)
        return middle, float((np.linalg.norm(points - middle, axis=1) + radius).max())

    @cached_property
    def digest(self) -> bytes:
        """The SHA-256 hash of the parts."""
        arrays = (self.parts.corners, self.parts.part, self.parts.radius, self.parts.triangles)
        return hashlib.sha256(b"".join(np.ascontiguousarray(v).tobytes() for v in arrays)).digest()

    @cached_property
    def pieces(self) -> tuple[Array, Array, Array, Array]:
        """The bounds of each part [m].

        Returns:
            The minimum and maximum corners of the bounding boxes, shape (k, 3) each, followed by the centers, shape
            (k, 3), and the radii, shape (k,), of the bounding spheres.
        """
        rows = []
        for k in range(len(self.parts.radius)):
            corners, r = self.parts.corners[self.parts.part == k], float(self.parts.radius[k])
            low, high = corners.min(axis=0) - r, corners.max(axis=0) + r
            middle = (low + high) / 2
            rows.append((low, high, middle, float(np.linalg.norm(corners - middle, axis=1).max()) + r))
        low, high, middle, size = zip(*rows, strict=True)
        return np.array(low), np.array(high), np.array(middle), np.array(size)

    def part_shape(self, number: int) -> tuple[Array, Array, Array]:
        """Return the corners [m], the unit face normals and the unit edge directions of a part."""
        if number not in self._part_shapes:
            parts = self.parts
            own = parts.part == number
            normals = parts.normals[own[parts.triangles[:, 0]]]
            normals = _distinct(normals[np.abs(normals).sum(axis=1) > 0.5])  # degenerate faces have zero normals
            ends = parts.edges[own[parts.edges[:, 0]]]
            edges = parts.corners[ends[:, 1]] - parts.corners[ends[:, 0]]
            edges = edges / np.linalg.norm(edges, axis=1, keepdims=True)
            edges = _distinct(edges * np.where(_is_backward(edges), -1.0, 1.0)[:, None])
            self._part_shapes[number] = parts.corners[own], normals, edges
        return self._part_shapes[number]

    @cached_property
    def _part_shapes(self) -> dict[int, tuple[Array, Array, Array]]:
        return {}


def _distinct(ways: Array) -> Array:
    return np.unique(np.round(ways, 9) + 0.0, axis=0)


def _is_backward(ways: Array) -> NDArray[np.bool_]:
    """Return a mask of the directions whose first nonzero coordinate is negative.

    Exactly one of two opposite directions is marked.
    """
    rounded = np.round(ways, 9)
    first = (rounded != 0).argmax(axis=1)
    return np.asarray(rounded[np.arange(len(ways)), first] < 0)


def _hull_corners(points: Array) -> Array:
    """Return the points on the convex hull in their original order, or all points if the hull has no volume."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 5:
        return points
    try:
        return np.asarray(points[np.sort(ConvexHull(points).vertices)])
    except QhullError:
        return points
