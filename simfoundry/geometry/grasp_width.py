"""The width of an object between two parallel fingers that come straight down on it.

Each finger is a flat pad. It goes down beside the object or into it (a cup is taken by its wall), so it needs room
beside what it takes, from its tip up. The pads touch first where what lies between them, above their tips, is widest.
A grasp counts if it can hold:

* at least one pad lies flat on the object over the width of the pad (:data:`UNEVEN`); the other may touch a ridge,
* both touch faces that look towards them (:data:`FACING`), and
* the object does not narrow upward between them (:data:`WEDGE`): a ball is taken at its equator, a plate's rim not.

Only the shape counts here: whether an arm reaches it and what stands around it is known elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.crossings import TOGETHER, HalfSpaces, bounds, face_normal, part_spans

DIRECTIONS = 12
"""Closing directions over half a turn, every 15 degrees from the one that most of the side faces look along: boxes and
prisms are measured square, and anything else is at most 7.5 degrees off, where a width is 0.9 % too large."""

PAD = 0.016
"""Width of a finger pad [m]: those of Franka's hand are 17.5 mm wide, of Robotiq's 2F-85 22 mm, of the YAM's 16 mm."""

SMALL_SHARE = 0.25
"""Of an object narrower than four pads, a pad covers this share: a marker that stands is held by its round side."""

ROOM = 0.020
"""Room that a finger needs beside what it takes [m]: 12 mm thick, and 4 mm free on either side as it comes."""

SHALLOWEST, FINGER_LENGTH = 0.010, 0.040
"""Depth of the finger tips below the top of an object [m]: pads are about 20 mm long and cover at least half of
themselves; 40 mm below the top the palm touches. A tall object is entered down to its middle, wherever that is."""

SOLE = 0.001
"""Height of the finger tips above the foot of an object at least [m]: it mostly stands on something."""

UPRIGHT = 1e-3
"""Vertical part of the unit normal of an upright face at most: a millimetre on a metre."""

UNEVEN = 0.25
"""Depth by which a face may recede over the width of a pad, as a share of that: 14 degrees, within the cone of friction
of rubber on anything (0.3 and more)."""

FACING = 0.9
"""Least cosine between a pad's normal and that of the face that it touches: 26 degrees, the cone of a friction of 0.5,
which is that of rubber pads on dry plastic, glazed ceramic or wood."""

WEDGE = 0.2
"""Greatest upward part of the two normals' mean: beyond it the object slips down out of the pads where the friction is
below 0.2, which is that of wet or polished surfaces. Of a ball, pads may be 12 degrees above the equator."""

LINES = 5
"""Lines across a pad, from edge to edge: at most 4 mm apart, as thick as the thinnest handle that holds anything."""

ROWS, ROW = (8, 24), 0.004
"""Number of depths of the tips that are tried, at least and at most, and the distance between two of them [m] in
between: a bar of 8 mm is met twice."""


class _Run(NamedTuple):
    """What a finger line meets above some depth: ``start`` to ``end`` [m], and the line and part at either end."""

    start: float
    end: float
    first: tuple[int, int]
    last: tuple[int, int]


def grasp_width(solid: HalfSpaces) -> float:
    """Return the least opening [m] of two fingers from above that hold an object as it stands; inf if none does.

    It is measured between the outermost points of what the pads take, on lines a few millimetres apart.
    """
    best, first = math.inf, _main_direction(solid)
    for k in range(DIRECTIONS):
        best = min(best, _Closing(solid, first + k * math.pi / DIRECTIONS).narrowest(best))
    return best


def _main_direction(solid: HalfSpaces) -> float:
    """Azimuth [rad] in [0, pi), to a degree, that most upright faces look along; 0 if there are none."""
    upright = solid.normals[np.abs(solid.normals[:, 2]) < UPRIGHT]
    if not len(upright):
        return 0.0
    azimuth = np.arctan2(upright[:, 1], upright[:, 0]) % math.pi
    degree = np.round(np.degrees(azimuth)).astype(int) % 180
    return float(azimuth[degree == np.bincount(degree).argmax()][0])


class _Closing:
    """All that fingers may take that close along one level direction."""

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
        # Above the shallowest tips nothing is taken, but what is there must pass between the fingers.
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
                # Below what is upright nothing changes, and what has been found is all there is.
                if row == self._skipped or any(changed[line : line + LINES]):
                    best = self._between(above[line : line + LINES], best)
        return best

    def _between(self, above: Sequence[list[_Run]], best: float) -> float:
        """Return the width of the narrowest that a pad's lines hold, if it is below ``best``."""
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
    """Return the union of runs, in order; what is nearly together is one."""
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
