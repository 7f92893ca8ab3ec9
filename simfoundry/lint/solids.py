"""Shapes as convex pieces: boxes, balls, cylinders and capsules exactly, lathes and prisms cut into pieces.

A lathe is cut at the heights of its corners; what reaches the axis is a frustum, a ring is cut into ``SECTORS``. Both
are no wider than what the simulators get. A mesh is its hull of at most 64 corners; where it is not nearly convex it is
not ``sure``: what lies within the hull may lie in a hollow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from simfoundry.lint.convex import Piece
from simfoundry.lint.frames import Frame, Vec
from simfoundry.spec.models.base import (
    BoxShape,
    CapsuleShape,
    CylinderShape,
    LatheShape,
    PrismShape,
    Shape,
    SphereShape,
)

SECTORS = 16
"""Sectors of a ring; as in :mod:`simfoundry.assets.lathe`."""

FLATTEST = math.cos(math.pi / 12)
"""Simulators get a frustum as a body of 12 to 24 sides with its corners on the circle; between two corners the radius
is short by at most this factor, and what stands there does not touch it."""

THINNEST = 1e-6
"""Slices and pieces thinner than this [m] are left out."""

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Solid:
    """One shape in the frame of its link: the hull of it, and whether that is all that is known (not ``sure``)."""

    hull: Piece
    shape: LatheShape | PrismShape | None = None
    sure: bool = True

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Convex pieces that make it up."""
        match self.shape:
            case LatheShape():
                return tuple(_turned(self.shape.lathe.profile))
            case PrismShape():
                prism = self.shape.prism
                return tuple(_standing(corners, prism.height) for corners in convex_polygons(prism.outline))
        return (self.hull,)


def solid_of(shape: Shape) -> Solid:
    """A primitive as a solid in its own frame."""
    match shape:
        case BoxShape():
            x, y, z = (v / 2 for v in shape.box)
            corners = ((x, y, z), (x, y, -z), (x, -y, z), (x, -y, -z), (-x, y, z), (-x, y, -z), (-x, -y, z))
            return Solid(Piece(points=(*corners, (-x, -y, -z)), low=(-x, -y, -z), high=(x, y, z)))
        case SphereShape():
            return Solid(Piece.of(((0.0, 0.0, 0.0),), shape.sphere))
        case CylinderShape():
            r, z = shape.cylinder.radius, shape.cylinder.height / 2
            return Solid(Piece.of_discs(((0.0, 0.0, -z), (0.0, 0.0, z)), (r, r)))
        case CapsuleShape():
            r, z = shape.capsule.radius, shape.capsule.height / 2
            return Solid(Piece.of(((0.0, 0.0, -z), (0.0, 0.0, z)), r))
        case LatheShape():
            rings = shape.lathe.profile
            return Solid(Piece.of_discs([(0.0, 0.0, z) for _, z in rings], tuple(r for r, _ in rings)), shape)
    return Solid(_standing(shape.prism.outline, shape.prism.height), shape)


def posed(solid: Solid, X_AB: Frame) -> tuple[Piece, ...]:
    """The pieces of a solid in another frame."""
    return tuple(piece.moved(X_AB) for piece in solid.pieces)


def _standing(outline: tuple[Point, ...] | list[Point], height: float) -> Piece:
    return Piece.of([(x, y, z) for x, y in outline for z in (-height / 2, height / 2)])


def _turned(profile: tuple[Point, ...]) -> Iterator[Piece]:
    """Frusta and sectors of rings that make up a body of revolution."""
    heights = sorted({round(z, 7) for _, z in profile})
    edges = list(zip(profile, (*profile[1:], profile[0]), strict=True))
    step = 2 * math.pi / SECTORS
    around = [(math.cos(k * step), math.sin(k * step)) for k in range(SECTORS + 1)]
    for low, high in pairwise(heights):
        crossing = sorted(_crossings(edges, low, high))
        for (_, a, b), (_, c, d) in zip(crossing[::2], crossing[1::2], strict=False):
            if max(c - a, d - b) < THINNEST:
                continue
            if max(a, b) < THINNEST:
                yield Piece.of_discs(((0.0, 0.0, low), (0.0, 0.0, high)), (c * FLATTEST, d * FLATTEST))
                continue
            section = ((a, low), (c, low), (b, high), (d, high))
            for first, second in pairwise(around):
                yield Piece.of([(r * u, r * v, z) for u, v in (first, second) for r, z in section])


def _crossings(edges: list[tuple[Point, Point]], low: float, high: float) -> Iterator[tuple[float, float, float]]:
    """Each edge that spans a slice: its radius in the middle, at the lower and at the upper end of the slice."""
    middle = (low + high) / 2
    for (r0, z0), (r1, z1) in edges:
        if min(z0, z1) < middle < max(z0, z1):
            at_low, at_middle, at_high = (r0 + (r1 - r0) * (z - z0) / (z1 - z0) for z in (low, middle, high))
            yield at_middle, max(0.0, at_low), max(0.0, at_high)


def thinnest_wall(shape: LatheShape) -> float:
    """The least horizontal thickness of the walls of a hollow body of revolution [m]; infinite where it has none."""
    profile = shape.lathe.profile
    heights = sorted({round(z, 7) for _, z in profile})
    edges = list(zip(profile, (*profile[1:], profile[0]), strict=True))
    least = math.inf
    for low, high in pairwise(heights):
        crossing = sorted(_crossings(edges, low, high))
        for (_, a, b), (_, c, d) in zip(crossing[::2], crossing[1::2], strict=False):
            if max(a, b) > THINNEST:
                least = min(least, c - a, d - b)
    return least


def convex_polygons(outline: tuple[Point, ...]) -> list[list[Point]]:
    """Convex polygons that tile an outline: itself where it is convex, else triangles cut off ear by ear."""
    doubled = sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(outline, (*outline[1:], outline[0]), strict=True))
    corners = list(outline) if doubled > 0 else list(reversed(outline))
    tiles: list[list[Point]] = []
    while len(corners) > 3:
        bends = [_turn(corners[k - 1], p, corners[(k + 1) % len(corners)]) for k, p in enumerate(corners)]
        inward = [p for p, bend in zip(corners, bends, strict=True) if bend < 0]
        if not inward:
            return [*tiles, corners]
        ear = next((k for k, bend in enumerate(bends) if bend > 0 and _is_ear(corners, k, inward)), None)
        if ear is None:  # every corner that is left lies on a line
            return tiles
        tiles.append([corners[ear - 1], corners[ear], corners[(ear + 1) % len(corners)]])
        del corners[ear]
    return [*tiles, corners]


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])


def _is_ear(corners: list[Point], k: int, inward: list[Point]) -> bool:
    a, b, c = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
    return not any(
        p not in (a, b, c) and _turn(a, b, p) >= 0 and _turn(b, c, p) >= 0 and _turn(c, a, p) >= 0 for p in inward
    )


def hull_of_points(points: tuple[Vec, ...], scale: float, sure: bool) -> Solid:
    """A mesh as the hull of some points in the units of its file."""
    return Solid(Piece.of([(x * scale, y * scale, z * scale) for x, y, z in points]), sure=sure)
