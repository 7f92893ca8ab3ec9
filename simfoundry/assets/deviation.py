"""How far convex parts are from the surface of the mesh that they stand for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

ON_MESH, ON_PARTS = 20_000, 4_000
"""Points that are compared, on the mesh and on the parts: of a thing of 20 cm the former are about 1 mm apart."""

NEIGHBOURS = 8
"""Triangles beside the nearest points among which the nearest one is looked for."""

CHECKED = 4_000
"""Of the points on the mesh, how many are looked for in the parts."""

TOUCHING = 0.01
"""Parts whose gap is less than this share of the longest side meet where they were cut, and nothing fits in between."""


def deviation(vertices: Array, faces: Faces, parts: list[tuple[Array, Faces]]) -> float:
    """The greatest distance [m] between the surface of a mesh and the outer one of convex parts.

    Sampled with a fixed seed, so that it is the same everywhere. Where the mesh stands out of all parts, it is the
    distance to the nearest plane of a part; elsewhere the distance from the outer points of the parts to the mesh.
    """
    points, owner = surface_samples(vertices, faces, ON_MESH)
    planes = [_planes(corners, sides) for corners, sides in parts]
    step = max(1, len(points) // CHECKED)
    short = _outside(points[::step], planes)
    outer = _outer(parts, planes, TOUCHING * float(np.ptp(vertices, axis=0).max()))
    return max(0.0, float(short.max()), float(_to_mesh(outer, vertices[faces], points, owner).max(initial=0.0)))


def distance_to_mesh(points: Array, vertices: Array, faces: Faces) -> Array:
    """Distances [m] of points, shape (n, 3), to the surface of a mesh."""
    samples, owner = surface_samples(vertices, faces, ON_MESH)
    return _to_mesh(points, vertices[faces], samples, owner)


def surface_samples(vertices: Array, faces: Faces, count: int) -> tuple[Array, NDArray[np.int64]]:
    """Points spread over triangles by area, shape (count, 3), the same for the same mesh, and the triangle of each."""
    rng = np.random.default_rng(0)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    ends = np.cumsum(area)
    owner = np.minimum(np.searchsorted(ends, (np.arange(count) + 0.5) / count * ends[-1]), len(faces) - 1)
    u, v = rng.random((2, count))
    folded = u + v > 1
    u[folded], v[folded] = 1 - u[folded], 1 - v[folded]
    return a[owner] + u[:, None] * (b - a)[owner] + v[:, None] * (c - a)[owner], owner


def _planes(corners: Array, sides: Faces) -> tuple[Array, Array]:
    """Outward unit normals (n, 3) and offsets [m] of the faces of a convex part."""
    a, b, c = (corners[sides[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal = normal[length > 0] / length[length > 0, None]
    return normal, np.einsum("ij,ij->i", normal, a[length > 0])


def _outside(points: Array, planes: list[tuple[Array, Array]]) -> Array:
    """How far points are outside of the nearest part [m], negative within one, shape (n,)."""
    nearest = np.full(len(points), np.inf)
    for normal, offset in planes:
        nearest = np.minimum(nearest, (points @ normal.T - offset).max(axis=1))
    return nearest


def _outer(parts: list[tuple[Array, Faces]], planes: list[tuple[Array, Array]], touching: float) -> Array:
    """Points on the surfaces of the parts that no other part covers or touches, shape (n, 3)."""
    found = []
    for k, (corners, sides) in enumerate(parts):
        points, _ = surface_samples(corners, sides, max(200, ON_PARTS // len(parts)))
        points = np.concatenate([points, corners])
        others = planes[:k] + planes[k + 1 :]
        found.append(points[_outside(points, others) > touching] if others else points)
    return np.concatenate(found)


def _to_mesh(points: Array, triangles: Array, samples: Array, owner: NDArray[np.int64]) -> Array:
    """Distances [m] of points to a mesh, by the triangles of the samples that are nearest to each."""
    import trimesh
    from scipy.spatial import cKDTree

    _, near = cKDTree(samples).query(points, k=NEIGHBOURS)
    candidates = triangles[owner[near]].reshape(-1, 3, 3)
    closest = trimesh.triangles.closest_point(candidates, np.repeat(points, NEIGHBOURS, axis=0))
    apart = np.linalg.norm(closest.reshape(len(points), NEIGHBOURS, 3) - points[:, None], axis=2)
    return np.asarray(apart.min(axis=1))
