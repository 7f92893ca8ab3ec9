"""Width of an object between two parallel fingers that approach from straight above.

Each finger is a flat pad. It moves down beside or into the object (for example, to grasp a cup by its wall), so it
needs clearance beside the grasped part, from the fingertip upward. The pads first make contact at the widest point of
the object above the fingertips. A grasp is valid if all of these conditions are met:

* At least one pad is flat against the object over the width of the pad (:data:`UNEVEN`). The other pad may touch
  a ridge.
* Both pads touch faces that are oriented toward them (:data:`FACING`).
* The object does not taper upward between the pads (:data:`WEDGE`). For example, a ball can be grasped at its equator,
  but a plate cannot be grasped by its rim.

Only the shape is considered. Reachability and neighboring objects are checked elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simfoundry.geometry.crossings import HalfSpaces, SolidRun, bounds, face_normal, part_spans, union

# Number of closing directions over half a turn: one every 15 degrees, starting with the dominant normal of the side
# faces. This measures boxes and prisms exactly. For other shapes, the direction is off by at most 7.5 degrees, which
# makes the width at most 0.9% too large.
DIRECTIONS = 12

# Width of a finger pad [m]: 17.5 mm for the Franka Hand, 22 mm for Robotiq's 2F-85, 16 mm for the YAM.
PAD = 0.016

# Width of a pad as a fraction of the object's width, for objects narrower than four pads. With it, a standing marker
# can be grasped by its round side.
SMALL_SHARE = 0.25

# Clearance that a finger needs beside the grasped part [m]: 12 mm for the finger, plus 4 mm on either side for the
# approach.
ROOM = 0.020

# Minimum and maximum depth of the fingertips below the top of an object [m]. Pads are about 20 mm long and need contact
# over at least half of their length; at a depth of 40 mm, the palm touches the object. Tall objects are grasped down to
# half their height.
SHALLOWEST, FINGER_LENGTH = 0.010, 0.040

# Minimum height of the fingertips above the bottom of an object [m], because it usually stands on a surface.
SOLE = 0.001

# Maximum vertical component of the unit normal of an upright face; this is a slope of one millimeter per meter.
UPRIGHT = 1e-3

# Maximum depth by which a face may recede over the width of a pad, as a fraction of that width. This corresponds to 14
# degrees, which is within the friction cone of rubber on any material (a coefficient of at least 0.3).
UNEVEN = 0.25

# Minimum cosine between the normal of a pad and the normal of the face that it touches. This corresponds to 26 degrees,
# the friction cone for a coefficient of 0.5 (rubber pads on dry plastic, glazed ceramic or wood).
FACING = 0.9

# Maximum upward component of the mean of the two face normals. Beyond it, the object slips out of the pads if the
# friction coefficient is below 0.2, as for wet or polished surfaces. On a ball, the pads may be up to 12 degrees above
# the equator.
WEDGE = 0.2

# Number of lines across a pad, from edge to edge. They are at most 4 mm apart, the thickness of the thinnest usable
# handle.
LINES = 5

# Minimum and maximum number of fingertip depths to try, and the spacing between them [m]. With this spacing, two depths
# hit a bar that is 8 mm thick.
ROWS, ROW = (8, 24), 0.004


def grasp_width(solid: HalfSpaces, enough: float = 0.0) -> float:
    """Return the smallest gripper opening [m] that can grasp an object from above in its current pose.

    The width is measured between the outermost points of the grasped part, along lines that are a few millimeters
    apart. If no grasp is valid, the result is inf. The search ends at the first direction with a width of at most
    ``enough`` [m].
    """
    best, first = math.inf, _main_direction(solid)
    for k in range(DIRECTIONS):
        if best <= enough:
            break
        best = min(best, _Closing(solid, first + k * math.pi / DIRECTIONS).narrowest(best))
    return best


def _main_direction(solid: HalfSpaces) -> float:
    """Return the azimuth [rad] of the dominant normal of the upright faces, or 0 if there are no upright faces.

    The azimuth is in [0, pi). The dominant normal is chosen from a histogram with bins of one degree.
    """
    upright = solid.normals[np.abs(solid.normals[:, 2]) < UPRIGHT]
    if not len(upright):
        return 0.0
    azimuth = np.arctan2(upright[:, 1], upright[:, 0]) % math.pi
    degree = np.round(np.degrees(azimuth)).astype(int) % 180
    return float(azimuth[degree == np.bincount(degree).argmax()][0])


class _Closing:
    """The candidate grasps for fingers that close along one horizontal direction."""

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
        # Grasps above the minimum depth are not considered, but that part of the object must fit between the fingers.
        depths = np.concatenate([[0.02 * shallow, 0.5 * shallow], np.linspace(shallow, deep, rows)])
        self._skipped = 2
        a, z = np.meshgrid(across, high[2] - depths, indexing="xy")
        self._starts = np.column_stack([a.ravel(), np.full(a.size, low[1]), z.ravel()]) @ axes.T
        self._met: list[list[list[SolidRun]]] = [[[] for _ in range(lines)] for _ in depths]
        along = solid.corners @ axes
        for part in range(len(solid.first)):
            own = along[solid.owner == part]
            near = (own[:, 0].min() <= a) & (a <= own[:, 0].max()) & (own[:, 2].min() <= z) & (z <= own[:, 2].max())
            chosen = np.flatnonzero(near)
            enter, leave = part_spans(solid, part, self._starts[chosen], self._direction)
            for at, first, last in zip(chosen.tolist(), enter.tolist(), leave.tolist(), strict=True):
                if last > first:
                    self._met[at // lines][at % lines].append(SolidRun(first, last, (at, part), (at, part)))

    def narrowest(self, best: float) -> float:
        """Return the smallest width of a valid grasp [m], or ``best`` if no width is smaller."""
        lines = len(self._met[0])
        above: list[list[SolidRun]] = [[] for _ in range(lines)]
        for row, met in enumerate(self._met):
            wider = [union(sorted([*old, *new])) for old, new in zip(above, met, strict=True)]
            changed = [new != old for new, old in zip(wider, above, strict=True)]
            above = wider
            if row < self._skipped:
                continue
            for line in range(lines - LINES + 1):
                # If no line has changed since the previous depth, the widths have not changed either.
                if row == self._skipped or any(changed[line : line + LINES]):
                    best = self._between(above[line : line + LINES], best)
        return best

    def _between(self, above: Sequence[list[SolidRun]], best: float) -> float:
        """Return the width [m] of the narrowest part that a pad can grasp along its lines.

        If ``best`` is smaller than this width, it is returned instead.
        """
        runs = union(sorted(run for line in above for run in line))
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

    def _holds(self, above: Sequence[list[SolidRun]], first: SolidRun, last: SolidRun) -> bool:
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
            level = math.sqrt(max(0.0, 1 - float(normal[2]) ** 2))
            if (sign * float(normal @ self._direction) if is_flat else level) < FACING:
                return False
            rise += float(normal[2]) / 2
        return rise <= WEDGE
