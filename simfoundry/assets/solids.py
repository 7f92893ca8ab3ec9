"""Create closed meshes and convex parts for solids of revolution about z (lathes) and extrusions along z (prisms)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.assets.deviation import distances_outside, face_planes
from simfoundry.assets.errors import MeshError, shape_crosses_itself
from simfoundry.assets.mass import Array, Faces

if TYPE_CHECKING:
    from shapely.geometry import Polygon

# Number of sides of the visual mesh, whose radius is up to 0.2% too small. The mass is that of the exact solid.
SIDES = 48

# Number of sectors in a ring that is split into convex parts; they protrude inward by at most 2% of its radius.
SECTORS = 16

# Range for the number of sides of a part that reaches the axis.
#
# The radius is up to 3.4% too small with 12 sides, and up to 0.9% with 24.
LEAST_SIDES, MOST_SIDES = 12, 24

_SIDE_COUNTS = (*range(LEAST_SIDES, MOST_SIDES + 1), SECTORS)

# Maximum distance [m] of joined bands of a profile from their common convex hull.
SAG = 0.0015

# Maximum number of corners per part supported by every engine; see :mod:`simfoundry.assets.convex`.
MOST_CORNERS = 64


def checked_profile(profile: Array) -> Array:
    """Validate a profile and order it from the top down along the outside.

    The profile consists of (radius, height) pairs [m], shape (n, 2).

    Raises:
        MeshError: If the profile does not start and end on the axis, or if it crosses itself or the axis.
    """
    from shapely.geometry import Polygon

    if profile[0, 0] != 0 or profile[-1, 0] != 0:
        raise MeshError("SF301", "a profile must start and end on the axis", "begin and end it with radius 0")
    if (profile[1:-1, 0] <= 0).any():
        hint = "give all corners in between a positive radius"
        raise MeshError("SF301", "a profile may touch the axis only at its ends", hint)
    polygon = Polygon(profile)
    if not polygon.is_valid or polygon.area < 1e-8:
        raise shape_crosses_itself("profile")
    return profile[::-1].copy() if polygon.exterior.is_ccw else profile


def lathe_mesh(profile: Array, sides: int = SIDES) -> tuple[Array, Faces]:
    """Return the vertices and outward-facing triangles of the closed solid of revolution for a validated profile."""
    angle = np.arange(sides) * (2 * math.pi / sides)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [np.column_stack([radius * around, np.full(sides, height)]) for radius, height in profile[1:-1]]
    vertices = np.concatenate([[[0.0, 0.0, profile[0, 1]]], *rings, [[0.0, 0.0, profile[-1, 1]]]])
    return vertices, ring_faces(len(rings), sides)


def ring_faces(rings: int, sides: int) -> Faces:
    """Return outward-facing triangles that join a top apex, ``rings`` rings of ``sides`` vertices, and a bottom apex.

    Vertices are numbered in this order, from the top down. The rings run counterclockwise when seen from above.
    """
    here = np.arange(sides)
    after = (here + 1) % sides
    last = 1 + (rings - 1) * sides
    faces = [np.column_stack([np.zeros(sides, int), 1 + here, 1 + after])]
    for ring in range(rings - 1):
        upper, lower = 1 + ring * sides, 1 + (ring + 1) * sides
        faces.append(np.column_stack([upper + here, lower + here, lower + after]))
        faces.append(np.column_stack([upper + here, lower + after, upper + after]))
    faces.append(np.column_stack([np.full(sides, last + sides), last + after, last + here]))
    return np.concatenate(faces).astype(np.int32)


def lathe_parts(profile: Array) -> list[Array]:
    """Return the corner points of the convex parts that form the solid of revolution for a validated profile.

    The profile is cut into bands at the heights of its corners, and neighboring bands are joined as long as they stay
    nearly convex. A band that reaches the axis becomes one part. All other bands are rings, which are cut into sectors.
    """
    return [part for band in _bands(profile) for part in _turned(np.array(band.exterior.coords)[:-1])]


def lathe_error(profile: Array, parts: list[tuple[Array, Faces]]) -> float:
    """Return the maximum distance [m] between the hulls from :func:`lathe_parts` and the solid of revolution.

    The distance is sampled and accurate to a few percent. Samples are taken at the corners, edges and faces of the
    hulls, which can protrude from the solid, and on the surface of the solid, which can protrude from the hulls.
    """
    from shapely import Polygon, distance, points

    body = Polygon(profile)
    proud = 0.0
    for corners, faces in parts:
        a, b, c = (corners[faces[:, k]] for k in range(3))
        samples = np.concatenate([corners, (a + b) / 2, (b + c) / 2, (a + c) / 2, (a + b + c) / 3])
        radius = np.hypot(samples[:, 0], samples[:, 1])
        proud = max(proud, float(distance(points(radius, samples[:, 2]), body).max()))
    # The middle of a side is at 180 deg / n; corners that were lost by simplifying a part can be at any angle.
    angles = np.array([*(math.pi / n for n in _SIDE_COUNTS), *np.linspace(0, 2 * math.pi, 96, endpoint=False)])
    edges = np.concatenate([a + np.linspace(0, 1, 9)[:, None] * (b - a) for a, b in pairwise(profile)])
    surface = _rotated(edges, angles)
    # Points within `proud` of any part, which are nearly all of them, do not change the result.
    planes = [face_planes(corners, faces) for corners, faces in parts]
    for (corners, _), (normal, offset) in zip(parts, planes, strict=True):
        near = ((surface >= corners.min(axis=0) - proud) & (surface <= corners.max(axis=0) + proud)).all(axis=1)
        near[near] = (surface[near] @ normal.T - offset).max(axis=1) <= proud
        surface = surface[~near]
    return max(proud, float(distances_outside(surface, planes).max(initial=0.0)))


def _bands(profile: Array) -> list[Polygon]:
    from shapely.geometry import Polygon, box

    whole = Polygon(profile)
    heights = np.unique(np.round(profile[:, 1], 6))
    reach = float(profile[:, 0].max()) + 1.0
    bands: list[Polygon] = []
    for low, high in pairwise(heights):
        band = whole.intersection(box(-1.0, low, reach, high))
        parts = getattr(band, "geoms", [band])
        bands += [part for part in parts if part.geom_type == "Polygon" and part.area > 1e-10]
    while (pair := next(_joinable(bands), None)) is not None:
        first, second, union = pair
        bands[first] = union
        del bands[second]
    return bands


def _joinable(bands: list[Polygon]) -> Iterator[tuple[int, int, Polygon]]:
    """Yield the indices and union of each pair of bands that share an edge and can be merged."""
    for first, second in combinations(range(len(bands)), 2):
        if bands[first].intersection(bands[second]).length > 1e-6:
            union = bands[first].union(bands[second])
            if _fits(union):
                yield first, second, union


def _fits(union: Any) -> bool:
    """Return True if the union is a single nearly convex piece and stays nearly convex when rotated about the axis."""
    if union.geom_type != "Polygon" or not _nearly_convex(union):
        return False
    corners = np.array(union.exterior.coords)[:-1]
    return not (corners[:, 0] < 1e-9).any() or _convex_of_revolution(corners)


def _convex_of_revolution(corners: Array) -> bool:
    """Return True if a band that reaches the axis is nearly convex when joined with its mirror image."""
    from shapely.geometry import Polygon

    mirrored = Polygon(corners).union(Polygon(corners * [-1.0, 1.0]))
    return mirrored.geom_type == "Polygon" and _nearly_convex(mirrored)


def _nearly_convex(polygon: Polygon) -> bool:
    return bool(polygon.exterior.hausdorff_distance(polygon.convex_hull.exterior) <= SAG)


def _turned(band: Array) -> list[Array]:
    """Return the corner points [m] of each convex part of a band, as arrays of shape (k, 3)."""
    if (band[:, 0] < 1e-9).any() and _convex_of_revolution(band):
        on_axis = int((band[:, 0] < 1e-9).sum())  # rotation does not multiply these corners
        sides = max(LEAST_SIDES, min(MOST_SIDES, (MOST_CORNERS - on_axis) // max(1, len(band) - on_axis)))
        angles = np.arange(sides, dtype=np.float64) * (2 * math.pi / sides)
        return [_swept(band, angles)]
    step = 2 * math.pi / SECTORS
    return [_swept(band, np.array([k * step, (k + 1) * step])) for k in range(SECTORS)]


def _swept(band: Array, angles: Array) -> Array:
    return np.unique(np.round(_rotated(band, angles), 9), axis=0)


def _rotated(profile: Array, angles: Array) -> Array:
    """Return the n points of a profile, rotated about the axis by k angles [rad], as an array of shape (k n, 3)."""
    x, y = np.cos(angles)[:, None] * profile[:, 0], np.sin(angles)[:, None] * profile[:, 0]
    return np.stack([x, y, np.broadcast_to(profile[:, 1], x.shape)], axis=-1).reshape(-1, 3)


def checked_outline(outline: Array) -> Array:
    """Validate an outline, make it counterclockwise, and remove redundant corners.

    The outline is an array of points [m] of shape (n, 2).

    Raises:
        MeshError: If the outline crosses itself or has no area.
    """
    from shapely.geometry import Polygon

    polygon = Polygon(outline)
    if not polygon.is_valid or polygon.area < 1e-8:
        raise shape_crosses_itself("outline")
    return _without_straights(outline if polygon.exterior.is_ccw else outline[::-1])


def prism_mesh(outline: Array, height: float) -> tuple[Array, Faces]:
    """Return the vertices and faces of a closed prism with a counterclockwise outline, vertically centered at zero."""
    n = len(outline)
    low = np.column_stack([outline, np.full(n, -height / 2)])
    high = np.column_stack([outline, np.full(n, height / 2)])
    caps = _triangles(outline)
    k = np.arange(n)
    following = (k + 1) % n
    sides = np.concatenate([np.column_stack([k, following, following + n]), np.column_stack([k, following + n, k + n])])
    return np.concatenate([low, high]), np.concatenate([caps[:, ::-1], caps + n, sides]).astype(np.int32)


def convex_outlines(outline: Array) -> list[Array]:
    """Partition a counterclockwise outline into convex polygons.

    The outline is triangulated, and neighbors are merged as long as the result stays convex. A single pass over the
    edges is sufficient (Hertel and Mehlhorn 1983).
    """
    polygons = {k: [int(v) for v in t] for k, t in enumerate(_triangles(outline))}
    owner = {(p[i - 1], p[i]): k for k, p in polygons.items() for i in range(3)}
    for start, end in sorted(edge for edge in owner if edge[0] < edge[1] and edge[::-1] in owner):
        kept, gone = owner[start, end], owner[end, start]
        union = _joined(polygons[kept], polygons[gone], start, end)
        edges = np.roll(outline[union], -1, axis=0) - outline[union]
        if (_cross(edges, np.roll(edges, -1, axis=0)) >= -1e-12).all():
            moved = polygons[gone]
            owner |= {(moved[i - 1], moved[i]): kept for i in range(len(moved))}
            polygons[kept] = union
            del polygons[gone]
    return [_without_straights(outline[p]) for p in polygons.values()]


def _triangles(outline: Array) -> Faces:
    """Triangulate an outline into counterclockwise triangles.

    Returns:
        Indices of the three corners of each triangle, shape (n - 2, 3).
    """
    import mapbox_earcut

    rings = np.array([len(outline)], dtype=np.uint32)
    found = mapbox_earcut.triangulate_float64(np.array(outline, order="C"), rings)
    triangles = np.array(found, dtype=np.int32).reshape(-1, 3)
    a, b, c = (outline[triangles[:, k]] for k in range(3))
    clockwise = _cross(b - a, c - a) < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return triangles


def _joined(a: list[int], b: list[int], start: int, end: int) -> list[int]:
    """Return the union of two counterclockwise polygons that share an edge.

    The edge runs from ``start`` to ``end`` in ``a``.
    """
    i, j = a.index(end), b.index(start)
    around_a = a[i:] + a[:i]  # from the end of the edge to its start
    around_b = b[j:] + b[:j]  # from the start of the edge to its end
    return around_a + around_b[1:-1]


def _without_straights(points: Array) -> Array:
    """Remove repeated and collinear corners from a polygon, because they would produce degenerate triangles."""
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


def _cross(a: Array, b: Array) -> Array:
    """Return the z components of the cross products of n pairs of 2D vectors."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
