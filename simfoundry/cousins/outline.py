"""The shadow of a thing on the ground: its convex outline, and the smallest rectangle around that."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.geometry.hulls import Hulls

Complex = NDArray[np.complex128]

ROUND = 48
"""Corners of the polygon around the shadow of a ball."""

LEVEL = 2e-4
"""A box whose corners are level within this [m] stands flat: settling leaves that much."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A thing seen from above, in the frame that it has at its place before it is turned about z.

    ``corners`` [m] of its convex shadow, counter-clockwise, shape (m, 2). The rectangle has its ``centre`` [m], shape
    (2,), ``half`` extents [m], shape (2,), and is turned by ``angle`` [rad]. ``low`` and ``high`` [m] over the frame's
    origin. ``boxy`` where the thing fills the rectangle from low to high.
    """

    corners: Array
    centre: Array
    half: Array
    angle: float
    low: float
    high: float
    boxy: bool

    @classmethod
    def of(cls, shape: Hulls) -> Outline:
        """Of convex parts; raises ValueError where there are none."""
        if not len(shape.corners):
            raise ValueError("nothing to see")
        corners = _shadow(shape)
        centre, half, angle = _rectangle(corners)
        low, high = shape.extent(np.array([0.0, 0.0, 1.0]))
        return cls(corners, centre, half, angle, low, high, _fills(shape, corners, half, low, high))

    @cached_property
    def spread(self) -> Array:
        """The corners seen from the centre of the rectangle [m], shape (2, m)."""
        return np.ascontiguousarray((self.corners - self.centre).T)

    @cached_property
    def radius(self) -> float:
        """Of the circle about the centre of the rectangle that holds the shadow [m]."""
        return float(np.hypot(*self.spread).max())

    @cached_property
    def size(self) -> float:
        """Of the circle around the rectangle [m]."""
        return float(np.hypot(*self.half))

    @cached_property
    def middle(self) -> complex:
        """The centre as x + iy [m]."""
        return complex(*self.centre.tolist())

    @cached_property
    def turn(self) -> complex:
        """The turn of the rectangle as a unit complex number."""
        return cmath.rect(1.0, self.angle)

    @cached_property
    def area(self) -> float:
        """Of the shadow [m^2]."""
        return _area(self.corners)

    @cached_property
    def width(self) -> float:
        """Between the nearest two parallel lines that hold the shadow [m]."""
        return float(_spans(self.corners).min())


def _shadow(shape: Hulls) -> Array:
    """Convex outline of all parts seen from above; balls count as polygons around them."""
    points, radius = shape.corners[:, :2], shape.radius[shape.part]
    angle = (np.arange(ROUND) + 0.5) * (2 * np.pi / ROUND)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / ROUND)
    rounded = radius > 0
    balls = points[rounded][:, None] + radius[rounded][:, None, None] * ring
    return hull(np.concatenate([points[~rounded], balls.reshape(-1, 2)]))


def hull(points: Array) -> Array:
    """Corners of the convex hull, counter-clockwise, shape (m, 2); of what has no area, its box made a hair wide."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        low, high = points.min(axis=0) - 1e-6, points.max(axis=0) + 1e-6
        return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])


def _area(corners: Array) -> float:
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def _along_edges(corners: Array) -> tuple[Array, Array, Array]:
    """Unit directions of the edges, (m, 2), and the corners along and across each, (m, m)."""
    edges = np.roll(corners, -1, axis=0) - corners
    edges /= np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-12)
    return edges, edges @ corners.T, np.column_stack([-edges[:, 1], edges[:, 0]]) @ corners.T


def _spans(corners: Array) -> Array:
    across = _along_edges(corners)[2]
    return np.asarray(across.max(axis=1) - across.min(axis=1))


def _rectangle(corners: Array) -> tuple[Array, Array, float]:
    """The rectangle of least area around a convex polygon: one of its sides is along an edge."""
    edges, along, across = _along_edges(corners)
    spans = [(v.min(axis=1), v.max(axis=1)) for v in (along, across)]
    area = (spans[0][1] - spans[0][0]) * (spans[1][1] - spans[1][0])
    k = int(np.argmin(np.round(area, 12)))
    u = edges[k]
    v = np.array([-u[1], u[0]])
    (a0, a1), (b0, b1) = ((low[k], high[k]) for low, high in spans)
    centre = u * (a0 + a1) / 2 + v * (b0 + b1) / 2
    return centre, np.array([a1 - a0, b1 - b0]) / 2, float(np.arctan2(u[1], u[0]))


def _fills(shape: Hulls, corners: Array, half: Array, low: float, high: float) -> bool:
    """Whether one box that stands flat is all there is."""
    z = shape.corners[:, 2]
    if len(shape.radius) != 1 or shape.radius[0] > 0 or len(z) != 8:
        return False
    flat = np.minimum(np.abs(z - low), np.abs(z - high)).max() < LEVEL
    return bool(flat and abs(_area(corners) - 4 * half[0] * half[1]) < 1e-3 * _area(corners))
