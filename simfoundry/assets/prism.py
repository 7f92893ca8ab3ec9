"""Prisms: an outline extruded along z, as one closed mesh and as exact convex parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import shape_crosses_itself

Array = NDArray[np.float64]
Faces = NDArray[np.int32]


def checked_outline(outline: Array) -> Array:
    """The outline [m], shape (n, 2), counter-clockwise and without superfluous corners.

    Raises :class:`MeshError` where it crosses itself or has no area.
    """
    from shapely.geometry import Polygon

    polygon = Polygon(outline)
    if not polygon.is_valid or polygon.area < 1e-8:
        raise shape_crosses_itself("outline")
    return _without_straights(outline if polygon.exterior.is_ccw else outline[::-1])


def prism_mesh(outline: Array, height: float) -> tuple[Array, Faces]:
    """Return vertices and faces of the closed prism over a counter-clockwise outline, centered in height."""
    n = len(outline)
    low = np.column_stack([outline, np.full(n, -height / 2)])
    high = np.column_stack([outline, np.full(n, height / 2)])
    caps = _triangles(outline)
    k = np.arange(n)
    following = (k + 1) % n
    sides = np.concatenate([np.column_stack([k, following, following + n]), np.column_stack([k, following + n, k + n])])
    return np.concatenate([low, high]), np.concatenate([caps[:, ::-1], caps + n, sides]).astype(np.int32)


def convex_outlines(outline: Array) -> list[Array]:
    """Convex polygons that tile a counter-clockwise outline: triangles, joined across an edge while they stay convex.

    Whether a joint may go does not depend on those still to come (Hertel and Mehlhorn), so each is looked at once.
    """
    polygons = {k: [int(v) for v in t] for k, t in enumerate(_triangles(outline))}
    owner = {(p[i - 1], p[i]): k for k, p in polygons.items() for i in range(3)}
    for start, end in sorted(edge for edge in owner if edge[0] < edge[1] and edge[::-1] in owner):
        kept, gone = owner[start, end], owner[end, start]
        union = _joined(polygons[kept], polygons[gone], start, end)
        if _is_convex(outline[union]):
            moved = polygons[gone]
            owner |= {(moved[i - 1], moved[i]): kept for i in range(len(moved))}
            polygons[kept] = union
            del polygons[gone]
    return [_without_straights(outline[p]) for p in polygons.values()]


def _triangles(outline: Array) -> Faces:
    """Counter-clockwise triangles that tile an outline, shape (n - 2, 3)."""
    import mapbox_earcut

    rings = np.array([len(outline)], dtype=np.uint32)
    triangles = np.array(
        mapbox_earcut.triangulate_float64(np.array(outline, order="C"), rings), dtype=np.int32
    ).reshape(-1, 3)
    a, b, c = (outline[triangles[:, k]] for k in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return triangles


def _joined(a: list[int], b: list[int], start: int, end: int) -> list[int]:
    """Return the union of two counter-clockwise polygons that share the edge from ``start`` to ``end`` in ``a``."""
    i, j = a.index(end), b.index(start)
    around_a = a[i:] + a[:i]  # from the end of the edge to its start
    around_b = b[j:] + b[:j]  # from the start of the edge to its end
    return around_a + around_b[1:-1]


def _without_straights(points: Array) -> Array:
    """A polygon without repeated corners and corners on a straight line, which no triangle of it would use."""
    corners = [p for k, p in enumerate(points) if not np.array_equal(p, points[k - 1])]
    k = 0
    while k < len(corners) and len(corners) > 3:
        before, here, after = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
        (ax, ay), (bx, by) = here - before, after - here
        if abs(ax * by - ay * bx) <= 1e-12 * (abs(ax) + abs(ay)) * (abs(bx) + abs(by)):
            del corners[k]
            k = max(0, k - 1)
        else:
            k += 1
    return np.array(corners)


def _is_convex(points: Array) -> bool:
    edges = np.roll(points, -1, axis=0) - points
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool((turn >= -1e-12).all())
