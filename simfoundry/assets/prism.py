"""Prisms: an outline extruded along z, as one closed mesh and as exact convex parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.mesh import MeshError

Array = NDArray[np.float64]
Faces = NDArray[np.int32]


def checked_outline(outline: Array) -> Array:
    """The outline [m], shape (n, 2), counter-clockwise; raises MeshError where it crosses itself or has no area."""
    from shapely.geometry import Polygon

    polygon = Polygon(outline)
    if not polygon.is_valid or polygon.area < 1e-8:
        raise MeshError("SF301", "the outline crosses itself or has no area", "list its corners in order around it")
    return outline if polygon.exterior.is_ccw else outline[::-1].copy()


def prism_mesh(outline: Array, height: float) -> tuple[Array, Faces]:
    """Vertices and faces of the closed prism over a counter-clockwise outline, centred in height."""
    n = len(outline)
    low = np.column_stack([outline, np.full(n, -height / 2)])
    high = np.column_stack([outline, np.full(n, height / 2)])
    caps = _triangles(outline)
    k = np.arange(n)
    following = (k + 1) % n
    sides = np.concatenate([np.column_stack([k, following, following + n]), np.column_stack([k, following + n, k + n])])
    return np.concatenate([low, high]), np.concatenate([caps[:, ::-1], caps + n, sides]).astype(np.int32)


def convex_outlines(outline: Array) -> list[Array]:
    """Convex polygons that tile a counter-clockwise outline: triangles, joined while the union stays convex."""
    polygons = [list(map(int, t)) for t in _triangles(outline)]
    merged = True
    while merged:
        merged = False
        for i in range(len(polygons)):
            for j in range(i + 1, len(polygons)):
                union = _joined(polygons[i], polygons[j])
                if union is not None and _is_convex(outline[union]):
                    polygons[i] = union
                    del polygons[j]
                    merged = True
                    break
            if merged:
                break
    return [outline[p] for p in polygons]


def _triangles(outline: Array) -> Faces:
    """Counter-clockwise triangles that tile an outline, shape (n - 2, 3)."""
    import mapbox_earcut

    rings = np.array([len(outline)], dtype=np.uint32)
    triangles = np.array(mapbox_earcut.triangulate_float64(outline, rings), dtype=np.int32).reshape(-1, 3)
    a, b, c = (outline[triangles[:, k]] for k in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return triangles


def _joined(a: list[int], b: list[int]) -> list[int] | None:
    """The union of two counter-clockwise polygons that share exactly one edge, or None."""
    for i, start in enumerate(a):
        end = a[(i + 1) % len(a)]
        if end in b and start in b and b[(b.index(end) + 1) % len(b)] == start:
            j = b.index(start)
            around = b[j + 1 :] + b[: j + 1]  # from after `start` all the way round to it
            extra = [v for v in around if v not in (start, end)]
            if set(extra) & set(a):
                return None
            return a[: i + 1] + extra + a[i + 1 :]
    return None


def _is_convex(points: Array) -> bool:
    edges = np.roll(points, -1, axis=0) - points
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool((turn >= -1e-12).all())
