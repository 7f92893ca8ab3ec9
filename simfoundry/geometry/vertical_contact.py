"""Height at which an object comes to rest when lowered onto another object, computed exactly for rounded polyhedra.

Two convex parts that approach each other along z first touch corner to face, face to corner, or edge to edge. If one of
them is rounded, they may also touch corner to edge or corner to corner. In each case, there is a closed-form expression
for the contact height, and the first contact is at the maximum over all cases.

The upper object is mirrored across z = 0 to make its downward faces point up like the upward faces of the lower object.
Both objects then play the same role in every formula, and a contact height is the sum of a height on the lower object
and a height on the mirrored upper object.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from simfoundry.geometry.frames import Array, Index
from simfoundry.geometry.hulls import Hulls

# Fraction by which the upper object is narrowed, to prevent an object that fits exactly between two walls from resting
# on top of them.
SHRINK = 1e-6

# Tolerance beyond the border of a face or the end of an edge, as a fraction of its length.
NEAR = 1e-9

# Minimum z component of the unit normal of a face that can support an object; steeper faces are walls.
STEEP = 1e-9

# Minimum sine of the angle between two crossing edges as seen from above.
PARALLEL = 1e-12

# Maximum number of pairs processed at once.
CHUNK = 1 << 21

# Part indices in the first and second object, and the heights at which these parts touch.
Meetings = Iterator[tuple[Index, Index, Array]]


def heights(above: Hulls, below: Hulls) -> Array:
    """Return the heights [m] by which each part of ``above`` must be lifted to rest on each part of ``below``.

    The result has shape (parts above, parts below). A height is negative if the part can be lowered. It is -inf if the
    two parts do not overlap as seen from above, because no vertical motion can make them touch.
    """
    top = _level_top(below)
    if top is not None and top.contains(above):
        return top.heights(above)
    out = np.full((len(above.radius), len(below.radius)), -np.inf)
    a, b = _upper(_narrowed(above).flipped()), _landing(below)
    flat, width = out.reshape(-1), len(below.radius)
    for mine, yours, height in _meetings(a, b):
        np.maximum.at(flat, mine * width + yours, height)
    return out


@dataclass(frozen=True, eq=False)
class _LevelTop:
    """A level rectangle above which a shape has no other point, with its corners (x, y) [m] and its height [m].

    What is above the inside of the rectangle rests on its lowest point, as on a table.
    """

    low: Array
    high: Array
    height: float

    def contains(self, shape: Hulls) -> bool:
        """Return True if a shape is above the inside of the rectangle, as seen from above."""
        if not len(shape.corners):
            return False
        low, high = shape.bounds()
        return bool((low[:2] > self.low).all() and (high[:2] < self.high).all())

    def heights(self, shape: Hulls) -> Array:
        """Return the heights [m] by which each part of a shape must be lifted to rest on the top, shape (n, 1)."""
        lowest = np.full(len(shape.radius), np.inf)
        np.minimum.at(lowest, shape.part, shape.corners[:, 2])
        return np.asarray(self.height - (lowest - shape.radius * (1 - SHRINK)))[:, None]


@lru_cache(maxsize=16)  # as for `_landing`
def _level_top(shape: Hulls) -> _LevelTop | None:
    """Return the top of a shape that is a single part with a level rectangular top along the axes, such as a table."""
    if len(shape.radius) != 1 or shape.radius[0] or not len(shape.corners):
        return None
    height = shape.corners[:, 2].max()
    top = shape.corners[shape.corners[:, 2] == height, :2]
    low, high = top.min(axis=0), top.max(axis=0)
    if len(top) != 4 or len(np.unique(top, axis=0)) != 4 or not ((top == low) | (top == high)).all():
        return None
    return _LevelTop(low, high, float(height))


def _meetings(a: _Upper, b: _Upper) -> Meetings:
    rounded = bool(a.radius.any() or b.radius.any())
    yield from _corners_on_faces(a, b)
    yield from _swapped(_corners_on_faces(b, a))
    yield from _edges_on_edges(a, b)
    if rounded:
        yield from _corners_on_edges(a, b)
        yield from _swapped(_corners_on_edges(b, a))
        yield from _corners_on_corners(a, b)


def _swapped(meetings: Meetings) -> Meetings:
    return ((mine, yours, height) for yours, mine, height in meetings)


def _narrowed(shape: Hulls) -> Hulls:
    if not len(shape.corners):
        return shape
    x, y = (sum(shape.extent(axis)) / 2 for axis in np.eye(3)[:2])
    about = np.array([x, y, 0.0])
    scale = np.array([1 - SHRINK, 1 - SHRINK, 1.0])
    return replace(shape, corners=(shape.corners - about) * scale + about, radius=shape.radius * (1 - SHRINK))


@dataclass(frozen=True, eq=False)
class _Group:
    """A group of corners, edges or faces.

    Attributes:
        points: Points of each element [m], shape (n, 1, 3) for corners, (n, 2, 3) for edges and (n, 3, 3) for faces.
        part: Part index of each element, shape (n,).
        radius: Rounding radius of each element [m], shape (n,).
        low: Minimum corner of each bounding box in the xy plane [m], shape (n, 2).
        high: Maximum corner of each bounding box in the xy plane [m], shape (n, 2).
        normals: Unit normals of faces, shape (n, 3), or an empty array for corners and edges.
    """

    points: Array
    part: Index
    radius: Array
    low: Array
    high: Array
    normals: Array

    @classmethod
    def of(cls, points: Array, part: Index, radius: Array, normals: Array) -> _Group:
        rounding = radius[part][:, None]
        low, high = points[:, :, :2].min(axis=1) - rounding, points[:, :, :2].max(axis=1) + rounding
        return cls(points, part, radius[part], low, high, normals)


@dataclass(frozen=True, eq=False)
class _Upper:
    """The upward corners, edges and faces of an object, including any hidden by other parts of the object."""

    corners: _Group
    edges: _Group
    faces: _Group
    radius: Array


def _upper(shape: Hulls) -> _Upper:
    faces = shape.normals[:, 2] > STEEP
    edges = (shape.beside[:, 0] < 0) | np.append(faces, False)[shape.beside].any(axis=1)
    corners = np.ones(len(shape.corners), dtype=bool)
    corners[shape.triangles.ravel()] = False
    corners[shape.triangles[faces].ravel()] = True
    at, none = shape.corners, np.zeros((0, 3))
    return _Upper(
        _Group.of(at[corners][:, None], shape.part[corners], shape.radius, none),
        _Group.of(at[shape.edges[edges]], shape.part[shape.edges[edges, 0]], shape.radius, none),
        _Group.of(
            at[shape.triangles[faces]], shape.part[shape.triangles[faces, 0]], shape.radius, shape.normals[faces]
        ),
        shape.radius,
    )


# Cached because many objects are placed on one surface.
_landing = lru_cache(maxsize=16)(_upper)


def _pairs(a: _Group, b: _Group, rounded: bool = False) -> Iterator[tuple[Index, Index]]:
    """Yield pairs of indices of elements whose bounding boxes overlap in the xy plane.

    If ``rounded`` is set, only pairs in which at least one element is rounded are included.
    """
    if not len(a.part) or not len(b.part):
        return
    mine = np.flatnonzero(((a.high >= b.low.min(axis=0)) & (a.low <= b.high.max(axis=0))).all(axis=1))
    yours = np.flatnonzero(((b.high >= a.low.min(axis=0)) & (b.low <= a.high.max(axis=0))).all(axis=1))
    step = max(1, CHUNK // max(1, len(yours)))
    low, high, radius = b.low[yours], b.high[yours], b.radius[yours]
    for start in range(0, len(mine), step):
        some = mine[start : start + step]
        touching = (a.high[some, 0, None] >= low[:, 0]) & (a.low[some, 0, None] <= high[:, 0])
        touching &= (a.high[some, 1, None] >= low[:, 1]) & (a.low[some, 1, None] <= high[:, 1])
        if rounded:
            touching &= (a.radius[some, None] + radius) > 0
        i, j = np.nonzero(touching)
        yield some[i], yours[j]


def _corners_on_faces(a: _Upper, b: _Upper) -> Meetings:
    for i, j in _pairs(a.corners, b.faces):
        normal = b.faces.normals[j]
        offset = (a.corners.radius[i] + b.faces.radius[j])[:, None] * normal
        point = a.corners.points[i, 0]
        foot = point[:, :2] - offset[:, :2]
        p, q, r = (b.faces.points[j, k] for k in range(3))
        u, v, w = q[:, :2] - p[:, :2], r[:, :2] - p[:, :2], foot - p[:, :2]
        area = _cross(u, v)
        wide = np.abs(area) > PARALLEL * (np.abs(u).sum(axis=1) * np.abs(v).sum(axis=1))
        area = np.where(wide, area, 1.0)
        s, t = _cross(w, v) / area, _cross(u, w) / area
        on = wide & (s >= -NEAR) & (t >= -NEAR) & (s + t <= 1 + NEAR)
        height = p[:, 2] + s * (q[:, 2] - p[:, 2]) + t * (r[:, 2] - p[:, 2]) + point[:, 2] + offset[:, 2]
        yield a.corners.part[i[on]], b.faces.part[j[on]], height[on]


def _edges_on_edges(a: _Upper, b: _Upper) -> Meetings:
    for i, j in _pairs(a.edges, b.edges):
        p, q = a.edges.points[i, 0], b.edges.points[j, 0]
        u, v = a.edges.points[i, 1] - p, b.edges.points[j, 1] - q
        sine = _cross(u[:, :2], v[:, :2])
        crossing = np.abs(sine) > PARALLEL * (np.abs(u[:, :2]).sum(axis=1) * np.abs(v[:, :2]).sum(axis=1))
        sine = np.where(crossing, sine, 1.0)
        radius = (a.edges.radius[i] + b.edges.radius[j])[:, None]
        offset = np.zeros_like(p)
        if radius.any():
            across = np.cross(u * [1.0, 1.0, -1.0], v)
            across *= np.sign(across[:, 2:])
            offset = radius * across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        between = q[:, :2] - (p - offset)[:, :2]
        s, t = _cross(between, v[:, :2]) / sine, _cross(between, u[:, :2]) / sine
        on = crossing & (s >= -NEAR) & (s <= 1 + NEAR) & (t >= -NEAR) & (t <= 1 + NEAR)
        height = p[:, 2] + s * u[:, 2] + q[:, 2] + t * v[:, 2] + offset[:, 2]
        yield a.edges.part[i[on]], b.edges.part[j[on]], height[on]


def _corners_on_edges(a: _Upper, b: _Upper) -> Meetings:
    """Yield contacts between a corner and an edge, at least one of which is rounded.

    The corner is treated as a sphere that is lowered until it touches the edge. Its radius is the sum of both radii.
    """
    for i, j in _pairs(a.corners, b.edges, rounded=True):
        q = b.edges.points[j, 0]
        along = b.edges.points[j, 1] - q
        length = np.linalg.norm(along, axis=1)
        along = along / np.maximum(length, 1e-300)[:, None]
        radius = a.corners.radius[i] + b.edges.radius[j]
        start = a.corners.points[i, 0] * [1.0, 1.0, -1.0] - q
        aside = start - (start * along).sum(axis=1, keepdims=True) * along
        up = np.array([0.0, 0.0, 1.0]) - along[:, 2:] * along
        square = (up * up).sum(axis=1)
        half = (aside * up).sum(axis=1)
        inside = half**2 - square * ((aside * aside).sum(axis=1) - radius**2)
        on = (square > STEEP) & (inside >= 0)
        height = (np.sqrt(np.where(on, inside, 0.0)) - half) / np.where(on, square, 1.0)
        foot = (start * along).sum(axis=1) + height * along[:, 2]
        on &= (foot >= 0) & (foot <= length)
        yield a.corners.part[i[on]], b.edges.part[j[on]], height[on]


def _corners_on_corners(a: _Upper, b: _Upper) -> Meetings:
    for i, j in _pairs(a.corners, b.corners, rounded=True):
        p, q = a.corners.points[i, 0], b.corners.points[j, 0]
        reach = (a.corners.radius[i] + b.corners.radius[j]) ** 2 - ((p - q)[:, :2] ** 2).sum(axis=1)
        on = reach >= 0
        height = p[:, 2] + q[:, 2] + np.sqrt(np.where(on, reach, 0.0))
        yield a.corners.part[i[on]], b.corners.part[j[on]], height[on]


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
