"""Grasps of an object: across what a gripper's fingers can close on, found on the object's colliders."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.crossings import HalfSpaces, Span, bounds, crossings
from simfoundry.geometry.frames import Array, Pose

if TYPE_CHECKING:
    pass
from simfoundry.robots.fingers import Jaws

YAWS = 12
"""Directions of closing about the direction of approach, over half a turn; each counts twice, with the hand turned."""

ACROSS, ALONG = 17, 12
"""Most lines across the hand and along its approach."""

SPACING, FINE = 0.006, 0.0025
"""Least distance between lines across the hand, and along its approach [m]."""

MOST = 300
"""The best so many are enough to choose from."""

FACING = 0.92
"""Fingers meet surfaces that face them at least this much: the cosine, within the cone of friction."""

CLEARANCE = 0.004
"""Room left beside each finger when it comes [m]."""

PRELOAD = 0.012
"""How much wider than the thing the open fingers come, on each side [m], where the gripper is that wide."""

TIP = 0.005
"""How far behind the tip of the pads what is taken lies at least [m]."""

ALIKE = 0.004
"""Neighbouring lines whose spans differ by less than this [m] are one surface for the pads."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A hand about to close: ``X_WH`` when closed; it comes with its fingers at share ``open`` and closes on ``width``.

    ``cost`` is smaller for better ones.
    """

    X_WH: Pose
    width: float
    open: float
    cost: float


def down(tilts: tuple[float, ...] = (0.0,)) -> list[Array]:
    """Directions of approach, shape (3,): straight down, and tilted by angles [rad] towards eight sides."""
    found = []
    for tilt in tilts:
        for side in range(8 if tilt else 1):
            angle = side * math.pi / 4
            found.append(_tilted(tilt, angle))
    return found


def _tilted(tilt: float, angle: float) -> Array:
    return np.array([math.sin(tilt) * math.cos(angle), math.sin(tilt) * math.sin(angle), -math.cos(tilt)])


def rotations(shape: HalfSpaces, approach: Array) -> Iterator[Array]:
    """Rotations of the hand whose z is ``approach``, with closing directions y all around.

    They start from the direction in which the shape is longest, seen along the approach: what is long is taken across.
    """
    side = np.array([1.0, 0.0, 0.0]) if abs(approach[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    side = np.cross(approach, side)
    side /= np.linalg.norm(side)
    other = np.cross(approach, side)
    flat = shape.corners @ np.column_stack([side, other])
    _, axes = np.linalg.eigh(np.cov(flat.T))
    start = math.atan2(axes[1, 1], axes[0, 1])
    for k in range(YAWS):
        angle = start + k * math.pi / YAWS
        y = math.cos(angle) * side + math.sin(angle) * other
        yield np.column_stack([np.cross(y, approach), y, approach])


def grasps(shape: HalfSpaces, center: Array, jaws: Jaws, approaches: list[Array]) -> list[Grasp]:
    """All grasps of a shape whose mass is centred at ``center`` [m], from the best; both turns of the hand."""
    found: list[Grasp] = []
    for approach in approaches:
        for R_WH in rotations(shape, approach):
            found += _along(shape, center, jaws, R_WH)
    flip = Pose.of(q=[0.0, 0.0, 0.0, 1.0])
    both = [turned for g in found for turned in (g, Grasp(g.X_WH @ flip, g.width, g.open, g.cost + 1e-3))]
    return sorted(both, key=lambda g: g.cost)[:MOST]


def _along(shape: HalfSpaces, center: Array, jaws: Jaws, R_WH: Array) -> Iterator[Grasp]:
    """Grasps with the hand turned by R_WH."""
    low, high = bounds(shape, R_WH)
    across = _grid(low[0], high[0], ACROSS, SPACING)
    along = _grid(low[2], high[2], ALONG, FINE)
    a, h = np.meshgrid(across, along, indexing="ij")
    y = (low[1] + high[1]) / 2
    starts = np.column_stack([a.ravel(), np.full(a.size, y), h.ravel()]) @ R_WH.T
    lines = crossings(shape, starts, R_WH[:, 1])
    spans = [
        [_holdable(spans, jaws) for spans in lines[k * len(along) : (k + 1) * len(along)]] for k in range(len(across))
    ]
    tilt = math.acos(min(1.0, max(-1.0, -float(R_WH[2, 2]))))
    for i in range(len(across)):
        for j in range(len(along)):
            for span in spans[i][j]:
                middle = R_WH @ np.array([across[i], y + (span.start + span.end) / 2, along[j]])
                area = _area(spans, i, j, span)
                _, first, tip = jaws.at_width(span.width)
                opened = jaws.at_width(min(span.width + 2 * PRELOAD, jaws.opening))[0]
                aside = middle - center
                aside = aside - (aside @ R_WH[:, 2]) * R_WH[:, 2]
                off = float(np.linalg.norm(aside))
                tight = max(0.0, 0.008 - (jaws.opening - span.width) / 2) / 0.008
                for depth in ((first + tip) / 2, tip - TIP):
                    shallow = 0.15 if depth > (first + tip) / 2 else 0.0
                    cost = (1 - area) + 5 * off + 0.5 * tilt + 0.5 * tight + shallow + 2 * (1 - span.facing)
                    yield Grasp(_pose(R_WH, middle - R_WH[:, 2] * depth), span.width, opened, cost)


def _grid(low: float, high: float, most: int, spacing: float) -> Array:
    """Coordinates from a little inside ``low`` to a little inside ``high``, at least ``spacing`` apart."""
    count = int(np.clip((high - low) / spacing, 1, most))
    return low + (np.arange(count) + 0.5) * (high - low) / count


def _holdable(spans: list[Span], jaws: Jaws) -> list[Span]:
    """Single pieces and runs of pieces that the fingers can close on from both ends."""
    widest = jaws.opening - 2 * CLEARANCE
    found = []
    for i, first in enumerate(spans):
        for last in spans[i:]:
            facing = min(first.facing, last.facing)
            if last.end - first.start <= widest and facing >= FACING:
                found.append(Span(first.start, last.end, facing))
    return found


def _area(spans: list[list[list[Span]]], i: int, j: int, span: Span) -> float:
    """Share of the lines around one that meet the same surfaces: how much of the pads will touch."""
    around = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1) if di or dj]
    alike = 0
    for k, m in around:
        if 0 <= k < len(spans) and 0 <= m < len(spans[k]):
            near = (max(abs(other.start - span.start), abs(other.end - span.end)) for other in spans[k][m])
            alike += min(near, default=math.inf) < ALIKE
    return alike / len(around)


def _pose(R_WH: Array, p: Array) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R_WH, p
    return Pose.from_matrix(matrix)
