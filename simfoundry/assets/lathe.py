"""Solids of revolution: a profile rotated about z, as one closed mesh and as convex parts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.deviation import face_planes
from simfoundry.assets.errors import profile_misses_axis, profile_off_axis, shape_crosses_itself

if TYPE_CHECKING:
    from shapely.geometry import Polygon

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

SIDES = 48
"""Sides of the mesh that is shown; the radius between two of them is short by 0.2 %. The mass is that of the body."""

SECTORS = 16
"""Sectors of a ring that is split into convex parts; inside a ring they stand proud by at most 2 % of its radius."""

LEAST_SIDES, MOST_SIDES = 12, 24
"""Sides of a part that reaches the axis; its middle is short by 3.4 % of the radius with 12, by 0.9 % with 24."""

_SIDE_COUNTS = (*range(LEAST_SIDES, MOST_SIDES + 1), SECTORS)

SAG = 0.0015
"""Bands of the profile are joined while their hull stays within this distance of them [m]."""

MOST_CORNERS = 64
"""Largest number of corners of a part that every engine supports; see :mod:`simfoundry.assets.convex`."""


def checked_profile(profile: Array) -> Array:
    """The profile [m], shape (n, 2), of (radius, height), from the top down outside; raises :class:`MeshError`.

    It starts and ends on the axis and crosses neither itself nor the axis.
    """
    from shapely.geometry import Polygon

    if profile[0, 0] != 0 or profile[-1, 0] != 0:
        raise profile_misses_axis()
    if (profile[1:-1, 0] <= 0).any():
        raise profile_off_axis()
    polygon = Polygon(profile)
    if not polygon.is_valid or polygon.area < 1e-8:
        raise shape_crosses_itself("profile")
    return profile[::-1].copy() if polygon.exterior.is_ccw else profile


def lathe_mesh(profile: Array, sides: int = SIDES) -> tuple[Array, Faces]:
    """Return vertices and outward faces of the closed body of a checked profile."""
    angle = np.arange(sides) * (2 * math.pi / sides)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [np.column_stack([radius * around, np.full(sides, height)]) for radius, height in profile[1:-1]]
    vertices = np.concatenate([[[0.0, 0.0, profile[0, 1]]], *rings, [[0.0, 0.0, profile[-1, 1]]]])
    return vertices, ring_faces(len(rings), sides)


def ring_faces(rings: int, sides: int) -> Faces:
    """Outward faces over an apex, ``rings`` of ``sides`` vertices from the top down, and a second apex.

    The rings run counter-clockwise seen from above; the vertices are numbered in this order.
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
    """Return the corner points of convex parts that form the body of a checked profile.

    The profile is cut into bands at the heights of its corners; neighboring bands are joined while they stay nearly
    convex. A band that reaches the axis is one part, a ring is cut into sectors.
    """
    return [part for band in _bands(profile) for part in _turned(np.array(band.exterior.coords)[:-1])]


def lathe_error(profile: Array, parts: list[tuple[Array, Faces]]) -> float:
    """Return the greatest distance [m] of the hulls of :func:`lathe_parts` from the body of revolution.

    It is sampled, and finds the greatest distance to within some percent. Where a hull stands out of the body is
    measured at its corners, edges and faces; where the body stands out of all hulls, on its own surface.
    """
    from shapely import Polygon, distance, points

    body = Polygon(profile)
    proud = 0.0
    for corners, faces in parts:
        a, b, c = (corners[faces[:, k]] for k in range(3))
        samples = np.concatenate([corners, (a + b) / 2, (b + c) / 2, (a + c) / 2, (a + b + c) / 3])
        radius = np.hypot(samples[:, 0], samples[:, 1])
        proud = max(proud, float(distance(points(radius, samples[:, 2]), body).max()))
    # Of a part with n sides the middle of a side lies at 180 deg / n. A part of too many corners lost some, anywhere.
    angles = np.array([*(math.pi / n for n in _SIDE_COUNTS), *np.linspace(0, 2 * math.pi, 96, endpoint=False)])
    edges = np.concatenate([a + np.linspace(0, 1, 9)[:, None] * (b - a) for a, b in pairwise(profile)])
    surface = np.concatenate(
        [np.column_stack([edges[:, :1] * [math.cos(t), math.sin(t)], edges[:, 1]]) for t in angles]
    )
    # What is no farther outside of some part than the parts stand proud changes nothing: nearly all, seen from nearby.
    planes = [face_planes(corners, faces) for corners, faces in parts]
    for (corners, _), (normal, offset) in zip(parts, planes, strict=True):
        near = ((surface >= corners.min(axis=0) - proud) & (surface <= corners.max(axis=0) + proud)).all(axis=1)
        near[near] = (surface[near] @ normal.T - offset).max(axis=1) <= proud
        surface = surface[~near]
    outside = np.full(len(surface), np.inf)
    for normal, offset in planes:
        outside = np.minimum(outside, (surface @ normal.T - offset).max(axis=1))
    return max(proud, float(outside.max(initial=0.0)))


def _bands(profile: Array) -> list[Polygon]:
    from shapely.geometry import Polygon, box

    whole = Polygon(profile)
    heights = np.unique(np.round(profile[:, 1], 6))
    reach = float(profile[:, 0].max()) + 1.0
    bands: list[Polygon] = []
    for low, high in pairwise(heights):
        bands += _polygons(whole.intersection(box(-1.0, low, reach, high)))
    while (pair := next(_joinable(bands), None)) is not None:
        first, second, union = pair
        bands[first] = union
        del bands[second]
    return bands


def _joinable(bands: list[Polygon]) -> Iterator[tuple[int, int, Polygon]]:
    """Pairs of bands that touch along a line and stay nearly convex together, with their union."""
    for first, second in combinations(range(len(bands)), 2):
        if bands[first].intersection(bands[second]).length > 1e-6:
            union = bands[first].union(bands[second])
            if _fits(union):
                yield first, second, union


def _polygons(shape: Any) -> list[Polygon]:
    parts = list(getattr(shape, "geoms", [shape]))
    return [p for p in parts if p.geom_type == "Polygon" and p.area > 1e-10]


def _fits(union: Any) -> bool:
    """Return True if the union is one piece, nearly convex, and remains so when rotated about the axis."""
    if union.geom_type != "Polygon" or not _nearly_convex(union):
        return False
    corners = np.array(union.exterior.coords)[:-1]
    return not (corners[:, 0] < 1e-9).any() or _convex_of_revolution(corners)


def _convex_of_revolution(corners: Array) -> bool:
    """Return whether a band that reaches the axis is convex as a body: as a polygon joined with its mirror image."""
    from shapely.geometry import Polygon

    mirrored = Polygon(corners).union(Polygon(corners * [-1.0, 1.0]))
    return mirrored.geom_type == "Polygon" and _nearly_convex(mirrored)


def _nearly_convex(polygon: Polygon) -> bool:
    return bool(polygon.exterior.hausdorff_distance(polygon.convex_hull.exterior) <= SAG)


def _turned(band: Array) -> list[Array]:
    """The convex parts of one band, each as its corner points [m], shape (k, 3)."""
    if (band[:, 0] < 1e-9).any() and _convex_of_revolution(band):
        on_axis = int((band[:, 0] < 1e-9).sum())  # turned about the axis each stays one corner
        sides = max(LEAST_SIDES, min(MOST_SIDES, (MOST_CORNERS - on_axis) // max(1, len(band) - on_axis)))
        angles = np.arange(sides, dtype=np.float64) * (2 * math.pi / sides)
        return [_swept(band, angles)]
    step = 2 * math.pi / SECTORS
    return [_swept(band, np.array([k * step, (k + 1) * step])) for k in range(SECTORS)]


def _swept(band: Array, angles: Array) -> Array:
    x, y = np.cos(angles)[:, None] * band[:, 0], np.sin(angles)[:, None] * band[:, 0]
    points = np.stack([x, y, np.broadcast_to(band[:, 1], x.shape)], axis=-1).reshape(-1, 3)
    return np.unique(np.round(points, 9), axis=0)
