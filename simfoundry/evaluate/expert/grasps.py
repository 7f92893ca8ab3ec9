"""Parallel-jaw grasps of an object, found on its collision geometry."""

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
"""Number of closing directions about the approach direction over half a turn; each is used twice, with the hand
flipped.
"""

ACROSS, ALONG = 17, 12
"""Maximum number of lines across the hand and along its approach."""

SPACING, FINE = 0.006, 0.0025
"""Minimum spacing of lines across the hand and along its approach [m]."""

MOST = 300
"""Number of best grasps that are kept."""

FACING = 0.92
"""Minimum cosine between a finger's direction and the surface normal that it meets, within the friction cone."""

CLEARANCE = 0.004
"""Clearance beside each finger during the approach [m]."""

PRELOAD = 0.012
"""Additional opening of the fingers on each side of the object [m], if the gripper is wide enough."""

TIP = 0.005
"""Minimum distance of the object from the tips of the pads [m]."""

ALIKE = 0.004
"""Maximum difference between the spans of neighboring lines for them to form one surface for the pads [m]."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A hand about to close: its closed pose ``X_WH``, its finger opening ``open`` during the approach, and the
    ``width`` held.

    Better grasps have a smaller ``cost``.
    """

    X_WH: Pose
    width: float
    open: float
    cost: float


def down(tilts: tuple[float, ...] = (0.0,)) -> list[Array]:
    """Approach directions, shape (3,): straight down, and tilted by the given angles [rad] toward eight sides."""
    found = []
    for tilt in tilts:
        for side in range(8 if tilt else 1):
            angle = side * math.pi / 4
            found.append(_tilted(tilt, angle))
    return found


def _tilted(tilt: float, angle: float) -> Array:
    return np.array([math.sin(tilt) * math.cos(angle), math.sin(tilt) * math.sin(angle), -math.cos(tilt)])


def rotations(shape: HalfSpaces, approach: Array) -> Iterator[Array]:
    """Yield rotations of the hand with its z along ``approach``, and closing directions y all around.

    They start from the direction in which the shape is longest as seen along the approach, so that long objects are
    grasped across.
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
    """Return all grasps of a shape with its center of mass at ``center`` [m], best first, including flipped hands."""
    found: list[Grasp] = []
    for approach in approaches:
        for R_WH in rotations(shape, approach):
            found += _along(shape, center, jaws, R_WH)
    flip = Pose.of(q=[0.0, 0.0, 0.0, 1.0])
    both = [turned for g in found for turned in (g, Grasp(g.X_WH @ flip, g.width, g.open, g.cost + 1e-3))]
    return sorted(both, key=lambda g: g.cost)[:MOST]


def _along(shape: HalfSpaces, center: Array, jaws: Jaws, R_WH: Array) -> Iterator[Grasp]:
    """Yield grasps with the hand rotated by R_WH."""
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
    """Evenly spaced coordinates slightly inside ``low`` and ``high``, at least ``spacing`` apart."""
    count = int(np.clip((high - low) / spacing, 1, most))
    return low + (np.arange(count) + 0.5) * (high - low) / count


def _holdable(spans: list[Span], jaws: Jaws) -> list[Span]:
    """Spans and sequences of spans that the fingers can close on from both ends."""
    widest = jaws.opening - 2 * CLEARANCE
    found = []
    for i, first in enumerate(spans):
        for last in spans[i:]:
            facing = min(first.facing, last.facing)
            if last.end - first.start <= widest and facing >= FACING:
                found.append(Span(first.start, last.end, facing))
    return found


def _area(spans: list[list[list[Span]]], i: int, j: int, span: Span) -> float:
    """Share of the neighboring lines that meet the same surfaces, a measure of the pads' contact area."""
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
