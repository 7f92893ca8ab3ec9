"""Support surfaces and shadows of objects: the vertical projection's convex outline and its smallest rectangle."""

from __future__ import annotations

import cmath
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.ray_casts import first_hits, scattered_rays

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Complex = NDArray[np.complex128]

ROUND = 48
"""Number of corners of the polygon around the shadow of a ball."""

LEVEL = 2e-4
"""Height tolerance [m] for the corners of a box that stands flat: settling leaves that much."""


@dataclass(frozen=True, eq=False)
class Outline:
    """Top view of an object, in the frame that it has at its place before the rotation about z.

    ``corners`` [m] of its convex shadow, counter-clockwise, shape (m, 2). The rectangle has its ``center`` [m], shape
    (2,), ``half`` extents [m], shape (2,), and is rotated by ``angle`` [rad]. ``low`` and ``high`` [m] are relative to
    the frame's origin. ``boxy`` is true if the object fills the rectangle from low to high.
    """

    corners: Array
    center: Array
    half: Array
    angle: float
    low: float
    high: float
    boxy: bool

    @classmethod
    def of(cls, shape: Hulls) -> Outline:
        """Outline convex parts; raises ValueError if there are none."""
        if not len(shape.corners):
            raise ValueError("there are no convex parts")
        corners = _shadow(shape)
        center, half, angle = _rectangle(corners)
        low, high = shape.extent(np.array([0.0, 0.0, 1.0]))
        return cls(corners, center, half, angle, low, high, _fills(shape, corners, half, low, high))

    @cached_property
    def spread(self) -> Array:
        """Corners relative to the center of the rectangle [m], shape (2, m)."""
        return np.ascontiguousarray((self.corners - self.center).T)

    @cached_property
    def radius(self) -> float:
        """Radius [m] of the circle about the center of the rectangle that contains the shadow."""
        return float(np.hypot(*self.spread).max())

    @cached_property
    def size(self) -> float:
        """Radius [m] of the circumscribed circle of the rectangle."""
        return float(np.hypot(*self.half))

    @cached_property
    def middle(self) -> complex:
        """Center as x + iy [m]."""
        return complex(*self.center.tolist())

    @cached_property
    def turn(self) -> complex:
        """Rotation of the rectangle as a unit complex number."""
        return cmath.rect(1.0, self.angle)

    @cached_property
    def area(self) -> float:
        """Area of the shadow [m^2]."""
        return _area(self.corners)

    @cached_property
    def width(self) -> float:
        """Minimum width: distance between the closest two parallel lines that enclose the shadow [m]."""
        return float(_spans(self.corners).min())


def _shadow(shape: Hulls) -> Array:
    """Convex outline of all parts in the top view; balls are replaced by circumscribed polygons."""
    points, radius = shape.corners[:, :2], shape.radius[shape.part]
    angle = (np.arange(ROUND) + 0.5) * (2 * np.pi / ROUND)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / ROUND)
    rounded = radius > 0
    balls = points[rounded][:, None] + radius[rounded][:, None, None] * ring
    return hull(np.concatenate([points[~rounded], balls.reshape(-1, 2)]))


def hull(points: Array) -> Array:
    """Corners of the convex hull, counter-clockwise, shape (m, 2); a degenerate hull is replaced by a thin
    rectangle.
    """
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
    """Rectangle of smallest area around a convex polygon; one of its sides lies along an edge."""
    edges, along, across = _along_edges(corners)
    spans = [(v.min(axis=1), v.max(axis=1)) for v in (along, across)]
    area = (spans[0][1] - spans[0][0]) * (spans[1][1] - spans[1][0])
    k = int(np.argmin(np.round(area, 12)))
    u = edges[k]
    v = np.array([-u[1], u[0]])
    (a0, a1), (b0, b1) = ((low[k], high[k]) for low, high in spans)
    center = u * (a0 + a1) / 2 + v * (b0 + b1) / 2
    return center, np.array([a1 - a0, b1 - b0]) / 2, float(np.arctan2(u[1], u[0]))


def _fills(shape: Hulls, corners: Array, half: Array, low: float, high: float) -> bool:
    """Return whether the object is exactly one box that stands flat."""
    z = shape.corners[:, 2]
    if len(shape.radius) != 1 or shape.radius[0] > 0 or len(z) != 8:
        return False
    flat = np.minimum(np.abs(z - low), np.abs(z - high)).max() < LEVEL
    return bool(flat and abs(_area(corners) - 4 * half[0] * half[1]) < 1e-3 * _area(corners))


UPWARD = 0.999
"""A face whose unit normal has at least this z component is level."""

STEP = 1e-3
"""Faces whose heights differ by less than this [m] are one level."""

NARROW = 0.04
"""Maximum width [m] of an edge that is no place to stand on, such as the side panel of a shelf or the rim of a box.
Graspable objects are about this wide or wider, and would balance there.
"""

ABOVE = 0.02
"""Height above a level [m] from which rays test for access by a hand: lower than the lips that keep objects on
trays.
"""

OPEN_SHARE = 0.05
"""A level is open if at least this share of the rays from its center leave the object: about a sixth for a shelf with
an open front, none for a closed drawer.
"""

_FAN = tuple(g.ravel() for g in np.meshgrid(np.linspace(-0.95, 0.95, 12), np.linspace(-0.95, 0.95, 12)))
"""Rays (x, y, 1) that fill a right angle."""

SIDEWAYS = tuple(
    np.array(axes, dtype=np.float64).T
    for axes in (
        ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
        ((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
        ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
        ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    )
)
"""Rotations whose last column is the viewing direction: +x, -x, +y, -y and up."""


@dataclass(frozen=True, eq=False)
class Support:
    """A level surface at ``height`` [m] of the object ``name``.

    ``corners`` [m] of the convex hull of its ``area`` [m^2], counter-clockwise, shape (m, 2); ``plane`` is the area
    itself if it is not convex. ``plain`` is true if the object is one convex part, so that nothing protrudes above the
    level.
    """

    name: str
    height: float
    corners: Array
    area: float
    plane: BaseGeometry | None
    plain: bool

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner [m], shape (2,) each."""
        return self.corners.min(axis=0), self.corners.max(axis=0)

    @cached_property
    def middle(self) -> tuple[float, float]:
        """A point inside the level [m], away from its edges where possible."""
        if self.plane is None:
            x, y = self.corners.mean(axis=0).tolist()
            return x, y
        point = self.plane.representative_point()
        return float(point.x), float(point.y)

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals of the sides of the hull, shape (m, 2)."""
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        outward = np.column_stack([edges[:, 1], -edges[:, 0]])
        return np.asarray(outward / np.linalg.norm(outward, axis=1, keepdims=True))

    @cached_property
    def offsets(self) -> Array:
        """Offsets of the sides along their normals [m], shape (m,)."""
        return np.asarray(np.einsum("ij,ij->i", self.normals, self.corners))

    def holds(self, center: Array, turn: Complex, spread: Array) -> NDArray[np.bool_]:
        """Return whether whole shadows lie over the level, (n,).

        Arguments: the centers of their rectangles [m], (n, 2); their rotations about z as unit complex numbers, (n,);
        and the :attr:`Outline.spread`, either one for all, (2, m), or one each, (n, 2, m).
        """
        # Rotate the sides into the object's frame, in which the shadow's farthest corner along each side is known.
        sides = (self._sides * turn.conj()[:, None]).view(np.float64).reshape(len(turn), -1, 2)
        reach = (sides @ spread).max(axis=-1)
        within: NDArray[np.bool_] = (center @ self.normals.T + reach <= self.offsets).all(axis=1)
        if self.plane is not None and within.any():
            import shapely

            each = np.broadcast_to(spread, (len(turn), *spread.shape[-2:]))[within]
            corners = (each[:, 0] + 1j * each[:, 1]) * turn[within, None]
            points = corners.view(np.float64).reshape(*corners.shape, 2) + center[within, None]
            within[within] = shapely.covers(self.plane, shapely.polygons(points))
        return within

    @cached_property
    def _sides(self) -> Complex:
        return np.ascontiguousarray(self.normals).view(np.complex128)[:, 0]


def supports_of(name: str, shape: Hulls, links: Collection[int] | None = None) -> tuple[Support, ...]:
    """Return every level surface of an object on which another can stand, lowest first, optionally of some ``links``
    only.

    Strips narrower than :data:`NARROW` and levels enclosed by the object itself are excluded.
    """
    found = []
    for _, triangles in _levels(shape, links):
        support = _support(name, triangles, shape, NARROW)
        if support is not None and not _is_enclosed(support, shape):
            found.append(support)
    return tuple(found)


def support_of(name: str, shape: Hulls, near: float | None = None) -> Support | None:
    """Return the level of an object closest to the height ``near`` [m], or its largest; None if no face is level."""
    levels = _levels(shape)
    if not levels:
        return None
    if near is not None:
        _, triangles = min(levels, key=lambda level: abs(level[0] - near))
    else:
        _, triangles = max(levels, key=lambda level: float(np.abs(_areas(level[1][:, :, :2])).sum()))
    return _support(name, triangles, shape, NARROW) or _support(name, triangles, shape, 0.0)


def edges_of(shape: Hulls, links: Collection[int] | None = None) -> list[tuple[float, BaseGeometry]]:
    """Heights [m] and areas of level surfaces narrower than :data:`NARROW`, such as shelf sides and box rims."""
    found = []
    for height, triangles in _levels(shape, links):
        plane = _plane(triangles)
        narrow = plane.difference(_without_strips(plane, NARROW))
        if narrow.area > 0:
            found.append((height, narrow))
    return found


def _levels(shape: Hulls, links: Collection[int] | None = None) -> list[tuple[float, Array]]:
    """Heights [m] of all level surfaces and their triangles [m], shape (m, 3, 3), in ascending order."""
    level = shape.normals[:, 2] > UPWARD
    if links is not None:
        level &= np.isin(shape.link[shape.part[shape.triangles[:, 0]]], list(links))
    triangles = shape.corners[shape.triangles[level]]
    height = triangles[:, :, 2].mean(axis=1)
    order = np.argsort(height, kind="stable")
    cuts = np.flatnonzero(np.diff(height[order]) >= STEP) + 1
    return [(float(height[some].mean()), triangles[some]) for some in np.split(order, cuts) if len(some)]


def _support(name: str, triangles: Array, shape: Hulls, narrow: float) -> Support | None:
    """Return the level formed by triangles, without strips narrower than ``narrow`` [m]; None if nothing remains."""
    import shapely

    plane = _without_strips(_plane(triangles), narrow)
    if plane.is_empty:
        return None
    corners = hull(shapely.get_coordinates(plane))
    whole = float(shapely.area(shapely.polygons(corners)))
    convex = float(plane.area) >= 0.999 * whole
    shapely.prepare(plane)
    top = float(triangles[:, :, 2].max())
    return Support(name, top, corners, float(plane.area), None if convex else plane, len(shape.radius) == 1)


def _plane(triangles: Array) -> BaseGeometry:
    """Area covered by triangles in the top view."""
    import shapely

    area = np.abs(_areas(triangles[:, :, :2]))
    return shapely.union_all(shapely.polygons(triangles[area > 1e-12][:, :, :2]), grid_size=1e-9)


def _without_strips(plane: BaseGeometry, narrow: float) -> BaseGeometry:
    """Return an area without the parts narrower than ``narrow`` [m]; the corners of the rest are unchanged."""
    half = narrow / 2
    return plane.buffer(-half, join_style="mitre").buffer(half, join_style="mitre") if narrow else plane


def _is_enclosed(support: Support, shape: Hulls) -> bool:
    """Return whether the object encloses a level so far that a hand cannot reach its center."""
    triangles = shape.corners[shape.triangles]
    if float(triangles[:, :, 2].max()) - support.height < STEP:
        return False
    x, y = support.middle
    seen_from = np.array([x, y, support.height + ABOVE])
    out = 0
    for side in SIDEWAYS:  # one view to each side and one up; a view sees nothing behind its ray origins
        local = (triangles - seen_from) @ side
        rays = scattered_rays(*_FAN)
        out += int((first_hits(local, rays).triangle < 0).sum())
    return out < OPEN_SHARE * len(SIDEWAYS) * len(_FAN[0])


def _areas(triangles: Array) -> Array:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2)
