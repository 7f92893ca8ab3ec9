"""Width of an object between two parallel fingers that approach it from straight above.

Each finger is a flat pad. It moves down beside the object or into it (a cup is grasped by its wall), so it needs
clearance beside the grasped part, from its tip upward. The pads make contact first where the object between them, above
their tips, is widest. A grasp counts if it can hold:

* at least one pad lies flat on the object over the width of the pad (:data:`UNEVEN`); the other may touch a ridge,
* both pads touch faces that are oriented toward them (:data:`FACING`), and
* the object does not narrow upward between them (:data:`WEDGE`): a ball is held at its equator, a plate's rim is not.

Only the shape is considered; reachability and neighboring objects are checked elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.crossings import TOGETHER, HalfSpaces, bounds, face_normal, part_spans

DIRECTIONS = 12
"""Number of closing directions over half a turn: every 15 degrees, starting with the dominant normal of the side faces.
Boxes and prisms are measured squarely; for other shapes the error is at most 7.5 degrees, which makes a width 0.9 % too
large."""

PAD = 0.016
"""Width of a finger pad [m]: 17.5 mm for the Franka Hand, 22 mm for Robotiq's 2F-85, 16 mm for the YAM."""

SMALL_SHARE = 0.25
"""Share of an object covered by a pad if the object is narrower than four pads: a standing marker is held by its round
side."""

ROOM = 0.020
"""Clearance that a finger needs beside the grasped part [m]: 12 mm of finger, and 4 mm on either side for the
approach."""

SHALLOWEST, FINGER_LENGTH = 0.010, 0.040
"""Range of depths of the fingertips below the top of an object [m]: pads are about 20 mm long and need contact on at
least half of that; at 40 mm the palm touches the object. Tall objects are grasped down to their middle."""

SOLE = 0.001
"""Least height of the fingertips above the bottom of an object [m], which usually stands on a surface."""

UPRIGHT = 1e-3
"""Largest vertical component of the unit normal of an upright face: a slope of a millimeter per meter."""

UNEVEN = 0.25
"""Depth by which a face may recede over the width of a pad, as a share of that width: 14 degrees, within the friction
cone of rubber on any material (coefficient of 0.3 or more)."""

FACING = 0.9
"""Least cosine between the normals of a pad and of the face that it touches: 26 degrees, the friction cone of a
coefficient of 0.5, that of rubber pads on dry plastic, glazed ceramic or wood."""

WEDGE = 0.2
"""Largest upward component of the mean of the two normals: beyond it, the object slips out of the pads if the friction
coefficient is below 0.2, as on wet or polished surfaces. On a ball, pads may be 12 degrees above the equator."""

LINES = 5
"""Number of lines across a pad, from edge to edge: at most 4 mm apart, the thickness of the thinnest usable handle."""

ROWS, ROW = (8, 24), 0.004
"""Least and greatest number of fingertip depths to try, and the spacing between them [m]: an 8 mm bar is hit twice."""


class _Run(NamedTuple):
    """Intersection of a finger line with the object above some depth.

    It reaches from ``start`` to ``end`` [m]; the line and the part at either end are recorded.
    """

    start: float
    end: float
    first: tuple[int, int]
    last: tuple[int, int]


def grasp_width(solid: HalfSpaces) -> float:
    """Return the least opening [m] of two fingers from above that hold an object in its pose; inf if none does.

    The width is measured between the outermost points of the grasped part, on lines a few millimeters apart.
    """
    best, first = math.inf, _main_direction(solid)
    for k in range(DIRECTIONS):
        best = min(best, _Closing(solid, first + k * math.pi / DIRECTIONS).narrowest(best))
    return best


def _main_direction(solid: HalfSpaces) -> float:
    """Azimuth [rad] in [0, pi), to a degree, of the dominant normal of the upright faces; 0 if there are none."""
    upright = solid.normals[np.abs(solid.normals[:, 2]) < UPRIGHT]
    if not len(upright):
        return 0.0
    azimuth = np.arctan2(upright[:, 1], upright[:, 0]) % math.pi
    degree = np.round(np.degrees(azimuth)).astype(int) % 180
    return float(azimuth[degree == np.bincount(degree).argmax()][0])


class _Closing:
    """Everything that fingers closing along one horizontal direction may grasp."""

    def __init__(self, solid: HalfSpaces, azimuth: float) -> None:
        self._solid = solid
        self._direction = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        axes = np.column_stack([[-self._direction[1], self._direction[0], 0.0], self._direction, [0.0, 0.0, 1.0]])
        low, high = bounds(solid, axes)
        self._pad = pad = min(PAD, SMALL_SHARE * float(high[0] - low[0]))
        lines = max(LINES, math.ceil(float(high[0] - low[0]) / max(pad / (LINES - 1), 1e-9)))
        across = low[0] + (np.arange(lines) + 0.5) * (high[0] - low[0]) / lines
        height = float(high[2] - low[2])
        shallow = min(SHALLOWEST, height / 2)
        deep = max(height / 2, min(FINGER_LENGTH, height - SOLE))
        rows = int(np.clip(math.ceil((deep - shallow) / ROW) + 1, *ROWS))
        # Nothing above the shallowest fingertips is grasped, but it must fit between the fingers.
        depths = np.concatenate([[0.02 * shallow, 0.5 * shallow], np.linspace(shallow, deep, rows)])
        self._skipped = 2
        a, z = np.meshgrid(across, high[2] - depths, indexing="xy")
        self._starts = np.column_stack([a.ravel(), np.full(a.size, low[1]), z.ravel()]) @ axes.T
        self._met: list[list[list[_Run]]] = [[[] for _ in range(lines)] for _ in depths]
        along = solid.corners @ axes
        for part in range(len(solid.first)):
            own = along[solid.owner == part]
            near = (own[:, 0].min() <= a) & (a <= own[:, 0].max()) & (own[:, 2].min() <= z) & (z <= own[:, 2].max())
            chosen = np.flatnonzero(near)
            enter, leave = part_spans(solid, part, self._starts[chosen], self._direction)
            for at, first, last in zip(chosen.tolist(), enter.tolist(), leave.tolist(), strict=True):
                if last > first:
                    self._met[at // lines][at % lines].append(_Run(first, last, (at, part), (at, part)))

    def narrowest(self, best: float) -> float:
        """Return the least width [m] below ``best``, or ``best``."""
        lines = len(self._met[0])
        above: list[list[_Run]] = [[] for _ in range(lines)]
        for row, met in enumerate(self._met):
            wider = [_merged([*old, *new]) for old, new in zip(above, met, strict=True)]
            changed = [new != old for new, old in zip(wider, above, strict=True)]
            above = wider
            if row < self._skipped:
                continue
            for line in range(lines - LINES + 1):
                # Below the upright faces nothing changes, so deeper fingertips find no further widths.
                if row == self._skipped or any(changed[line : line + LINES]):
                    best = self._between(above[line : line + LINES], best)
        return best

    def _between(self, above: Sequence[list[_Run]], best: float) -> float:
        """Return the width of the narrowest part that the lines of a pad hold, at most ``best``."""
        runs = _merged([run for line in above for run in line])
        for i, first in enumerate(runs):
            if i and first.start - runs[i - 1].end < ROOM:
                continue
            for j in range(i, len(runs)):
                last = runs[j]
                if last.end - first.start >= best:
                    break
                if (j + 1 == len(runs) or runs[j + 1].start - last.end >= ROOM) and self._holds(above, first, last):
                    best = last.end - first.start
        return best

    def _holds(self, above: Sequence[list[_Run]], first: _Run, last: _Run) -> bool:
        within = [[run for run in line if first.start <= run.start and run.end <= last.end] for line in above]
        if not all(within):
            return False
        near = [min(run.start for run in line) - first.start for line in within]
        far = [last.end - max(run.end for run in line) for line in within]
        flat = [max(ends) <= UNEVEN * self._pad for ends in (near, far)]
        if not any(flat):
            return False
        rise = 0.0
        for ends, is_flat, run_end, at, sign in (
            (near, flat[0], first.first, first.start, -1.0),
            (far, flat[1], last.last, last.end, 1.0),
        ):
            normal = face_normal(self._solid, self._starts[run_end[0]], self._direction, run_end[1], at, sign)
            on_ridge = 0 < ends.index(min(ends)) < LINES - 1
            if not is_flat and not on_ridge:
                return False
            facing = (
                sign * float(normal @ self._direction) if is_flat else math.sqrt(max(0.0, 1 - float(normal[2]) ** 2))
            )
            if facing < FACING:
                return False
            rise += float(normal[2]) / 2
        return rise <= WEDGE


def _merged(runs: list[_Run]) -> list[_Run]:
    """Return the union of runs, in order; runs separated by less than a small gap are merged."""
    if len(runs) < 2:
        return runs
    found: list[_Run] = []
    for run in sorted(runs):
        if found and run.start <= found[-1].end + TOGETHER:
            if run.end > found[-1].end:
                found[-1] = _Run(found[-1].start, run.end, found[-1].first, run.last)
        else:
            found.append(run)
    return found
