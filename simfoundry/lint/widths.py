"""What a parallel gripper must span to take a thing from above."""

from __future__ import annotations

import math

from simfoundry.lint.convex import Piece
from simfoundry.lint.frames import Vec
from simfoundry.lint.solids import thinnest_wall
from simfoundry.lint.things import Thing
from simfoundry.spec.models.base import LatheShape

STEPS = 36
"""Directions in which a piece with round faces is measured: every 5 degrees."""


def grasp_width(thing: Thing) -> float:
    """The smallest horizontal width of any piece of a thing as it stands [m]: of a bowl that of its rim."""
    shapes = [solid.shape for limb in thing.limbs.values() for solid, _ in limb.solids]
    walls = [thinnest_wall(shape) for shape in shapes if isinstance(shape, LatheShape)]
    return min([*walls, *map(piece_width, thing.touching)], default=0.0)


def piece_width(piece: Piece) -> float:
    """The smallest horizontal width of a convex piece [m]."""
    if piece.radii:
        lean = math.atan2(piece.axis[1], piece.axis[0])
        angles = [k * math.pi / STEPS for k in range(STEPS)] + [lean, lean + math.pi / 2]
        directions = [(math.cos(a), math.sin(a), 0.0) for a in angles]
    else:
        directions = _normals(piece.points)
    spans = (piece.extent(n) for n in directions)
    return min((high - low for low, high in spans), default=2 * piece.margin)


def _normals(points: tuple[Vec, ...]) -> list[Vec]:
    """Directions across the sides of the outline of points seen from above: one of them is the narrowest."""
    corners = _outline(sorted({(x, y) for x, y, _ in points}))
    if len(corners) < 3:
        (ax, ay), (bx, by) = corners[0], corners[-1]
        corners = [(ax, ay), (bx, by)]
    sides = zip(corners, (*corners[1:], corners[0]), strict=True)
    found: list[Vec] = []
    for (ax, ay), (bx, by) in sides:
        long = math.hypot(bx - ax, by - ay)
        if long > 1e-12:
            found.append((-(by - ay) / long, (bx - ax) / long, 0.0))
    return found


def _outline(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The convex hull of sorted points, counter-clockwise (Andrew's monotone chain)."""
    halves: list[list[tuple[float, float]]] = []
    for ordered in (points, points[::-1]):
        half: list[tuple[float, float]] = []
        for p in ordered:
            while len(half) > 1 and _turn(half[-2], half[-1], p) <= 0:
                half.pop()
            half.append(p)
        halves.append(half[:-1])
    return halves[0] + halves[1] or points


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
