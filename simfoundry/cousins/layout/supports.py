"""Support surfaces and shadows of objects.

A shadow is the convex outline of an object's vertical projection, stored along with its smallest bounding rectangle.
"""

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

# Number of corners of the polygon around the shadow of a ball.
ROUND = 48

# Tolerance [m] on the corner heights of a box that stands flat; settled poses are slightly inaccurate.
LEVEL = 2e-4


@dataclass(frozen=True, eq=False)
class Outline:
    """Top view of an object, expressed in its frame before the rotation about z.

    Attributes:
        corners: Corners of the convex shadow [m], counterclockwise, shape (m, 2).
        middle: Center of the smallest rectangle around the shadow, as the complex number x + iy [m].
        half: Half extents of the rectangle, as a complex number [m].
        turn: Rotation of the rectangle, as a unit complex number.
        low: Lowest height relative to the frame's origin [m].
        high: Highest height relative to the frame's origin [m].
        boxy: True if the object is a box that fills the rectangle from ``low`` to ``high``.
    """

    corners: Array
    middle: complex
    half: complex
    turn: complex
    low: float
    high: float
    boxy: bool

    @classmethod
    def of(cls, shape: Hulls) -> Outline:
        """Compute the outline of convex parts.

        Raises:
            ValueError: There are no parts.
        """
        if not len(shape.corners):
            raise ValueError("there are no convex parts")
        corners = _shadow(shape)
        middle, half, turn = _rectangle(corners)
        low, high = shape.extent(np.array([0.0, 0.0, 1.0]))
        return cls(corners, middle, half, turn, low, high, _fills(shape, corners, half, low, high))

    @cached_property
    def spread(self) -> Array:
        """The corners of the shadow relative to the center of the rectangle [m], as an array of shape (2, m)."""
        return np.ascontiguousarray((self.corners - [self.middle.real, self.middle.imag]).T)

    @cached_property
    def radius(self) -> float:
        """The radius of the smallest circle that contains the shadow and is centered on the rectangle's center [m]."""
        return float(np.hypot(*self.spread).max())

    @cached_property
    def size(self) -> float:
        """The radius of the circle circumscribed about the rectangle [m]."""
        return abs(self.half)

    @cached_property
    def area(self) -> float:
        """The area of the shadow [m^2]."""
        return float(_areas(self.corners))

    @cached_property
    def width(self) -> float:
        """The minimum width of the shadow [m].

        This is the smallest distance between two parallel lines that enclose the shadow.
        """
        return float(np.ptp(_along_edges(self.corners)[2], axis=1).min())


def _shadow(shape: Hulls) -> Array:
    """Return the convex outline of all parts as seen from above.

    Spheres are replaced with circumscribed polygons.
    """
    points, radius = shape.corners[:, :2], shape.radius[shape.part]
    angle = (np.arange(ROUND) + 0.5) * (2 * np.pi / ROUND)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / ROUND)
    rounded = radius > 0
    balls = points[rounded][:, None] + radius[rounded][:, None, None] * ring
    return hull(np.concatenate([points[~rounded], balls.reshape(-1, 2)]))


def hull(points: Array) -> Array:
    """Compute the convex hull of points [m] in the plane.

    Returns:
        Corners of the hull in counterclockwise order [m], as an array of shape (m, 2). A degenerate hull is replaced
        with a thin rectangle.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        low, high = points.min(axis=0) - 1e-6, points.max(axis=0) + 1e-6
        return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])


def _areas(corners: Array) -> Array:
    """Return the signed areas [m^2] of polygons, given an array of their corners of shape (..., m, 2)."""
    x, y = corners[..., 0], corners[..., 1]
    return np.asarray((x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)).sum(axis=-1) / 2)


def _along_edges(corners: Array) -> tuple[Array, Array, Array]:
    """Return the directions of a polygon's edges and the coordinates of its corners relative to each edge.

    Returns:
        Unit directions, as an array of shape (m, 2), followed by the coordinates along the edges and across them, as
        two arrays of shape (m, m).
    """
    edges = np.roll(corners, -1, axis=0) - corners
    edges /= np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-12)
    return edges, edges @ corners.T, np.column_stack([-edges[:, 1], edges[:, 0]]) @ corners.T


def _rectangle(corners: Array) -> tuple[complex, complex, complex]:
    """Return the rectangle of minimum area around a convex polygon.

    One side of this rectangle is parallel to an edge of the polygon.

    Returns:
        Center [m], half extents [m] and rotation, all as complex numbers.
    """
    edges, along, across = _along_edges(corners)
    spans = [(v.min(axis=1), v.max(axis=1)) for v in (along, across)]
    area = (spans[0][1] - spans[0][0]) * (spans[1][1] - spans[1][0])
    k = int(np.argmin(np.round(area, 12)))
    u = edges[k]
    v = np.array([-u[1], u[0]])
    (a0, a1), (b0, b1) = ((low[k], high[k]) for low, high in spans)
    center = u * (a0 + a1) / 2 + v * (b0 + b1) / 2
    return complex(*center), complex(a1 - a0, b1 - b0) / 2, cmath.rect(1.0, np.arctan2(u[1], u[0]))


def _fills(shape: Hulls, corners: Array, half: complex, low: float, high: float) -> bool:
    """Return True if the object is a single box that stands flat."""
    z = shape.corners[:, 2]
    if len(shape.radius) != 1 or shape.radius[0] > 0 or len(z) != 8:
        return False
    flat = np.minimum(np.abs(z - low), np.abs(z - high)).max() < LEVEL
    area = float(_areas(corners))
    return bool(flat and abs(area - 4 * half.real * half.imag) < 1e-3 * area)


# Minimum z component of the unit normal of a level face.
UPWARD = 0.999

# Maximum height difference [m] between faces that belong to the same level.
STEP = 1e-3

# Width [m] below which a strip, such as a shelf's side panel or a box's rim, is too narrow to support objects. Most
# graspable objects are wider and would have to balance on it.
NARROW = 0.04

# Height above a level [m] at which rays test whether a hand can reach the level; greater than the height of tray lips.
ABOVE = 0.02

# Minimum fraction of the rays from an open level's center that must leave the object. The fraction is about a sixth for
# a shelf with an open front, and zero for a closed drawer.
OPEN_SHARE = 0.05

# Ray directions (x, y, 1) that cover a field of view of about 90 degrees.
_FAN = tuple(g.ravel() for g in np.meshgrid(np.linspace(-0.95, 0.95, 12), np.linspace(-0.95, 0.95, 12)))

# Axes of five views that look along +x, -x, +y, -y and up. The viewing direction is the last axis of each view.
VIEWS = (
    ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    ((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
    ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
)


@dataclass(frozen=True, eq=False)
class Support:
    """A level surface of an object on which other objects can stand.

    Attributes:
        name: Name of the object.
        height: Height of the surface [m].
        corners: Corners of the surface's convex hull [m], counterclockwise, shape (m, 2).
        area: Area of the surface [m^2].
        plane: Exact shape of the surface if it is not convex, otherwise None.
        plain: True if the object is a single convex part, so that nothing protrudes above the surface.
    """

    name: str
    height: float
    corners: Array
    area: float
    plane: BaseGeometry | None
    plain: bool

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The minimum and maximum corners of the bounding rectangle [m], as two arrays of shape (2,)."""
        return self.corners.min(axis=0), self.corners.max(axis=0)

    @cached_property
    def middle(self) -> tuple[float, float]:
        """The x and y coordinates of a point on the surface [m], away from its edges if possible."""
        if self.plane is None:
            x, y = self.corners.mean(axis=0).tolist()
            return x, y
        point = self.plane.representative_point()
        return float(point.x), float(point.y)

    @cached_property
    def normals(self) -> Array:
        """The outward unit normals of the sides of the hull, as an array of shape (m, 2)."""
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        outward = np.column_stack([edges[:, 1], -edges[:, 0]])
        return np.asarray(outward / np.linalg.norm(outward, axis=1, keepdims=True))

    @cached_property
    def offsets(self) -> Array:
        """The distances of the hull's sides from the origin along their normals [m], as an array of shape (m,)."""
        return np.asarray(np.einsum("ij,ij->i", self.normals, self.corners))

    def holds(self, center: Array, turn: Complex, spread: Array) -> NDArray[np.bool_]:
        """Test whether entire shadows are over the surface.

        Args:
            center: Centers of the shadows' rectangles [m], shape (n, 2).
            turn: Rotations about z as unit complex numbers, shape (n,).
            spread: Values of :attr:`Outline.spread` [m]. The shape is (2, m) if all shadows are equal and (n, 2, m)
                otherwise.

        Returns:
            A mask of the shadows that are entirely over the surface, shape (n,).
        """
        # Rotate the sides into the object's frame to find the shadow's farthest corner along each normal.
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
    """Return all level surfaces of an object on which other objects can stand, from lowest to highest.

    Strips narrower than :data:`NARROW` and surfaces that the object itself encloses are excluded. If ``links`` is
    given, only the surfaces of these links are returned.
    """
    found = (_support(name, triangles, shape, NARROW) for _, triangles in _levels(shape, links))
    return tuple(support for support in found if support is not None and not _is_enclosed(support, shape))


def support_of(name: str, shape: Hulls, near: float | None = None) -> Support | None:
    """Return the level surface of an object that is closest to the height ``near`` [m].

    If ``near`` is None, the largest level surface is returned. The result is None if the object has no level faces.
    """
    levels = _levels(shape)
    if not levels:
        return None
    if near is not None:
        _, triangles = min(levels, key=lambda level: abs(level[0] - near))
    else:
        _, triangles = max(levels, key=lambda level: float(np.abs(_areas(level[1][:, :, :2])).sum()))
    return _support(name, triangles, shape, NARROW) or _support(name, triangles, shape, 0.0)


def edges_of(shape: Hulls, links: Collection[int] | None = None) -> list[tuple[float, BaseGeometry]]:
    """Return the heights [m] and regions of all level strips narrower than :data:`NARROW`.

    Examples are the sides of shelves and the rims of boxes.
    """
    planes = [(height, _plane(triangles)) for height, triangles in _levels(shape, links)]
    strips = [(height, plane.difference(_without_strips(plane, NARROW))) for height, plane in planes]
    return [(height, strip) for height, strip in strips if strip.area > 0]


def _levels(shape: Hulls, links: Collection[int] | None = None) -> list[tuple[float, Array]]:
    """Return the height and the triangles of each level surface, from lowest to highest.

    The heights are in meters, and the corners of the triangles [m] have shape (m, 3, 3).
    """
    level = shape.normals[:, 2] > UPWARD
    if links is not None:
        level &= np.isin(shape.link[shape.part[shape.triangles[:, 0]]], list(links))
    triangles = shape.corners[shape.triangles[level]]
    height = triangles[:, :, 2].mean(axis=1)
    order = np.argsort(height, kind="stable")
    cuts = np.flatnonzero(np.diff(height[order]) >= STEP) + 1
    return [(float(height[some].mean()), triangles[some]) for some in np.split(order, cuts) if len(some)]


def _support(name: str, triangles: Array, shape: Hulls, narrow: float) -> Support | None:
    """Return the level surface that consists of the given triangles, without strips narrower than ``narrow`` [m].

    The result is None if nothing remains of the surface.
    """
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
    """Return the area that triangles cover when viewed from above."""
    import shapely

    area = np.abs(_areas(triangles[:, :, :2]))
    return shapely.union_all(shapely.polygons(triangles[area > 1e-12][:, :, :2]), grid_size=1e-9)


def _without_strips(plane: BaseGeometry, narrow: float) -> BaseGeometry:
    """Remove strips narrower than ``narrow`` [m] from an area. The corners of the remaining area are preserved."""
    half = narrow / 2
    return plane.buffer(-half, join_style="mitre").buffer(half, join_style="mitre") if narrow else plane


def _is_enclosed(support: Support, shape: Hulls) -> bool:
    """Return True if an object encloses one of its level surfaces so that no hand can reach the surface's center."""
    triangles = shape.corners[shape.triangles]
    if float(triangles[:, :, 2].max()) - support.height < STEP:
        return False
    local, rays = triangles - [*support.middle, support.height + ABOVE], scattered_rays(*_FAN)
    # Each view ignores the geometry behind it.
    out = sum(int((first_hits(local @ np.transpose(view), rays).triangle < 0).sum()) for view in VIEWS)
    return out < OPEN_SHARE * len(VIEWS) * len(_FAN[0])
