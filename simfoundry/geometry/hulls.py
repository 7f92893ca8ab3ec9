"""Convex parts of an object, represented as corners, edges and triangles in the world frame, for use in placement.

A part is a polyhedron that may be rounded: a sphere is a corner with a radius, and a capsule is an edge with a radius.
A cylinder or cone is approximated by a circumscribed prism or pyramid whose corners protrude by at most
:data:`PROUD`, or by 5 ppm of the radius if the radius is greater than 10 m. An ellipsoid is approximated by a
polyhedron whose corners are on its surface, so that its faces are up to 0.2% of the largest radius inside. All other
shapes are exact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from simfoundry.geometry.frames import Array, Index, Pose
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere, tessellate

# Maximum distance [m] by which the corners of a prism protrude from the cylinder that it approximates.
PROUD = 5e-5

# Maximum number of sides of a prism that approximates a cylinder.
MOST_SIDES = 1024

# Tolerance on the cosine between the normals of adjacent triangles; an edge within this of 1 is ignored as flat.
FLAT = 1e-12


@dataclass(frozen=True, eq=False)
class Hulls:
    """The convex parts of an object.

    Attributes:
        corners: Corners of all parts [m], shape (n, 3).
        edges: Corner indices of each edge, shape (k, 2).
        triangles: Corner indices of each triangle, shape (m, 3).
        normals: Outward unit normals of the triangles, shape (m, 3).
        beside: Indices of the two triangles adjacent to each edge, or -1 if there are none, shape (k, 2).
        part: Part index of each corner, shape (n,).
        radius: Rounding radius of each part [m], shape (parts,).
        link: Link index of each part, shape (parts,).
    """

    corners: Array
    edges: Index
    triangles: Index
    normals: Array
    beside: Index
    part: Index
    radius: Array
    link: Index

    def extent(self, axis: Array) -> tuple[float, float]:
        """Return the minimum and maximum coordinates [m] along a unit vector."""
        along, radius = self.corners @ axis, self.radius[self.part]
        return float((along - radius).min()), float((along + radius).max())

    def bounds(self) -> tuple[Array, Array]:
        """Return the minimum and maximum corners of the axis-aligned bounding box of all parts.

        Returns:
            Minimum and maximum corners [m], shape (3,) each.
        """
        radius = self.radius[self.part][:, None]
        return (self.corners - radius).min(axis=0), (self.corners + radius).max(axis=0)

    def middle(self, rotation: Array) -> Array:
        """Return the center [m] of the bounding box aligned with the columns of ``rotation``.

        The center is an array of shape (3,).
        """
        return np.asarray(rotation @ [sum(self.extent(rotation[:, k])) / 2 for k in range(3)])

    def size(self) -> Array:
        """Return the extents [m] along the world axes, as an array of shape (3,)."""
        low, high = self.bounds()
        return np.asarray(high - low)

    def posed(self, X_AB: Pose) -> Hulls:
        """Return the parts transformed from frame B to frame A."""
        return self._with(X_AB.apply(self.corners), self.normals @ X_AB.rotation.T)

    def moved(self, offset: Array) -> Hulls:
        """Return the parts translated by ``offset`` [m]."""
        return self._with(self.corners + offset, self.normals)

    def flipped(self) -> Hulls:
        """Return the mirror image of the parts across the plane z = 0."""
        mirror = np.array([1.0, 1.0, -1.0])
        return self._with(self.corners * mirror, self.normals * mirror)

    def _with(self, corners: Array, normals: Array) -> Hulls:
        """Return the parts with other corners and normals; faster than `replace`, for scenes of many objects."""
        return Hulls(corners, self.edges, self.triangles, normals, self.beside, self.part, self.radius, self.link)

    def of_link(self, link: int) -> Hulls:
        """Return a copy that contains only the parts of one link, without renumbering the parts."""
        return self.of_parts(np.flatnonzero(self.link == link))

    def of_parts(self, parts: Sequence[int] | Index) -> Hulls:
        """Return a copy that contains only the parts with the given indices, without renumbering the parts."""
        kept = np.isin(self.part, parts)
        number = np.cumsum(kept) - 1
        triangles, edges = (kept[index[:, 0]] for index in (self.triangles, self.edges))
        numbered = np.where(self.beside >= 0, (np.cumsum(triangles) - 1)[self.beside], -1)
        return replace(
            self,
            corners=self.corners[kept],
            edges=number[self.edges[edges]],
            triangles=number[self.triangles[triangles]],
            normals=self.normals[triangles],
            beside=numbered[edges],
            part=self.part[kept],
        )


def hulls_of(shapes: Iterable[tuple[Geometry, Pose, int]]) -> Hulls:
    """Return the convex parts of shapes, each of which is specified with its pose and link index."""
    links, parts = [], []
    for geometry, pose, link in shapes:
        links.append(link)
        parts.append(_part(geometry).posed(pose))
    if len(parts) == 1:
        return replace(parts[0], link=np.array(links, dtype=np.int64))
    corners = _starts([len(part.corners) for part in parts])
    triangles = _starts([len(part.triangles) for part in parts])
    beside = [np.where(p.beside >= 0, p.beside + k, -1) for p, k in zip(parts, triangles, strict=False)]
    return Hulls(
        np.concatenate([NO_CORNERS, *(part.corners for part in parts)]),
        np.concatenate([NO_EDGES, *(part.edges + k for part, k in zip(parts, corners, strict=False))]),
        np.concatenate([NO_TRIANGLES, *(part.triangles + k for part, k in zip(parts, corners, strict=False))]),
        np.concatenate([NO_CORNERS, *(part.normals for part in parts)]),
        np.concatenate([NO_EDGES, *beside]),
        np.repeat(np.arange(len(parts)), np.diff(corners)),
        np.array([part.radius[0] for part in parts]),
        np.array(links, dtype=np.int64),
    )


def _starts(counts: Sequence[int]) -> Index:
    """Return the start indices of consecutive groups with the given sizes, and the total size."""
    return np.cumsum([0, *counts], dtype=np.int64)


def _part(geometry: Geometry) -> Hulls:
    """Return the convex part of a geometry in its own frame."""
    return _box_part(*geometry.size.tolist()) if isinstance(geometry, Box) else _other_part(geometry)


@lru_cache(maxsize=256)  # boxes of equal size share their parts
def _box_part(x: float, y: float, z: float) -> Hulls:
    return _assembled(SIGNS * np.array([x, y, z]), BOX, NO_EDGES, 0.0)


@lru_cache(maxsize=256)
def _other_part(geometry: Mesh | Sphere | Ellipsoid | Capsule | Cylinder | Cone) -> Hulls:
    return _assembled(*convex_core(geometry))


def _assembled(corners: Array, triangles: Index, rods: Index, radius: float) -> Hulls:
    normals = _normals(corners, triangles)
    edges, beside = _edges(triangles, normals)
    edges, beside = np.concatenate([edges, rods]), np.concatenate([beside, np.full(rods.shape, -1)])
    none = np.zeros(len(corners), np.int64)
    return Hulls(corners, edges, triangles, normals, beside, none, np.array([radius]), none[:1])


# Corners, triangles, edges that have no adjacent triangles, and radius of a geometry in its own frame.
Core = tuple[Array, Index, Index, float]

NO_CORNERS, NO_TRIANGLES, NO_EDGES = np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 2), np.int64)

SIGNS = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
BOX = np.array([(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
                (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)])  # fmt: skip


def convex_core(geometry: Mesh | Sphere | Ellipsoid | Capsule | Cylinder | Cone) -> Core:
    """Return the corners, triangles, rods and radius that represent a geometry in its own frame."""
    match geometry:
        case Ellipsoid():
            return convex_core(tessellate(geometry))
        case Cone():
            return _pyramid(geometry.radius, geometry.height)
        case Mesh():
            return geometry.vertices, geometry.faces.astype(np.int64), NO_EDGES, 0.0
        case Sphere():
            return np.zeros((1, 3)), NO_TRIANGLES, NO_EDGES, geometry.radius
        case Capsule():
            half = geometry.height / 2
            return np.array([[0, 0, -half], [0, 0, half]]), NO_TRIANGLES, np.array([[0, 1]]), geometry.radius
        case Cylinder():
            return _prism(geometry.radius, geometry.height)


def _polygon(radius: float) -> Array:
    """Return the corners [m] of a regular polygon around a circle, shape (sides, 2)."""
    half = math.acos(min(radius / (radius + PROUD), 1 - 1e-12))
    sides = min(4 * max(3, math.ceil(math.pi / half / 4)), MOST_SIDES)
    angle = (np.arange(sides) + 0.5) * (2 * math.pi / sides)
    return np.asarray(np.column_stack([np.cos(angle), np.sin(angle)]) * (radius / math.cos(math.pi / sides)))


@lru_cache(maxsize=64)
def _pyramid(radius: float, height: float) -> Core:
    """Return a pyramid around a cone. The number of sides is a multiple of four, as for :func:`_prism`."""
    ring = _polygon(radius)
    sides = len(ring)
    here, tip = np.arange(sides), np.array([[0.0, 0.0, height / 2]])
    base = np.column_stack([np.zeros(sides - 2, np.int64), here[2:], here[1:-1]])
    walls = np.column_stack([here, (here + 1) % sides, np.full(sides, sides)])
    corners = np.concatenate([np.column_stack([ring, np.full(sides, -height / 2)]), tip])
    return corners, np.concatenate([base, walls]), NO_EDGES, 0.0


@lru_cache(maxsize=64)
def _prism(radius: float, height: float) -> Core:
    """Return a prism around a cylinder. The number of sides is a multiple of four to make its x and y extents exact."""
    ring = _polygon(radius)
    sides = len(ring)
    low, high = (np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2))
    here = np.arange(sides)
    after = (here + 1) % sides
    cap = np.column_stack([np.zeros(sides - 2, np.int64), here[1:-1], here[2:]])
    walls = [np.column_stack([here, after, after + sides]), np.column_stack([here, after + sides, here + sides])]
    return np.concatenate([low, high]), np.concatenate([cap[:, ::-1], cap + sides, *walls]), NO_EDGES, 0.0


def _normals(corners: Array, triangles: Index) -> Array:
    """Return the unit normals of triangles. Degenerate triangles have zero normals."""
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-14))


def _edges(triangles: Index, normals: Array) -> tuple[Index, Index]:
    """Return the edges that are not inside a flat face, and the two triangles adjacent to each edge."""
    if not len(triangles):
        return NO_EDGES, NO_EDGES
    ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(triangles)), 3)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, owner = ends[order], owner[order]
    first = np.concatenate([[True], (ends[1:] != ends[:-1]).any(axis=1)])
    last = np.concatenate([first[1:], [True]])
    edges, beside = ends[first], np.column_stack([owner[first], owner[last]])
    cosine = np.einsum("ij,ij->i", normals[beside[:, 0]], normals[beside[:, 1]])
    bent = (cosine < 1 - FLAT) | (beside[:, 0] == beside[:, 1])
    return edges[bent], beside[bent]
