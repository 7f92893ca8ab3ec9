"""Intersections of lines with an object whose convex parts are represented as half-spaces."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Geometry, tessellate

# Number of sides used to approximate round shapes.
SEGMENTS = 32

# Minimum area of a face, relative to the largest face. Smaller faces are ignored because their normals are dominated by
# rounding errors.
SLIVER = 1e-9

# Maximum gap between two parts along a line [m] for the parts to be merged.
TOGETHER = 1e-3


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Convex parts in the world frame, represented as half-spaces.

    Part k is the set of points ``x`` that satisfy ``normals @ x <= offsets`` in the rows from ``first[k]`` up to
    ``first[k + 1]``. ``corners`` [m], shape (n, 3), contains the corners of all parts, and ``owner``, shape (n,),
    contains the part index of each corner.
    """

    normals: Array
    offsets: Array
    first: NDArray[np.intp]
    corners: Array
    owner: NDArray[np.intp]

    def rows(self, part: int) -> slice:
        """Return the range of the rows that contain the half-spaces of a part."""
        return slice(int(self.first[part]), int([*self.first[1:], len(self.offsets)][part]))


@dataclass(frozen=True, eq=False)
class Span:
    """A segment of a line inside one part or several touching parts, from ``start`` to ``end`` along the line [m].

    ``facing`` is the smaller of the two cosines between the line and the surface normals at the ends of the segment. It
    is 1 if the line is perpendicular to both surfaces.
    """

    start: float
    end: float
    facing: float

    @property
    def width(self) -> float:
        """The length of the segment [m]."""
        return self.end - self.start


def solid_of(
    shapes: Iterable[tuple[Geometry, Pose]], keep: Callable[[Array], bool] = lambda corners: True
) -> HalfSpaces:
    """Return the half-spaces of posed shapes, including only the parts whose corners [m] satisfy ``keep``."""
    normals, offsets, corners = [], [], []
    for geometry, X_WG in shapes:
        n, d, c = _half_spaces(geometry)
        placed = X_WG.apply(c)
        if not keep(placed):
            continue
        normals.append(n @ X_WG.rotation.T)
        offsets.append(d + normals[-1] @ X_WG.p)
        corners.append(placed)
    first = np.cumsum([0, *(len(n) for n in normals[:-1])])
    owner = np.repeat(np.arange(len(corners)), [len(c) for c in corners])
    return HalfSpaces(np.concatenate(normals), np.concatenate(offsets), first, np.concatenate(corners), owner)


@lru_cache(maxsize=4096)
def _half_spaces(geometry: Geometry) -> tuple[Array, Array, Array]:
    """Return the outward face normals, plane offsets and corners of a convex geometry in its own frame."""
    surface = tessellate(geometry, SEGMENTS)
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    faces = area > SLIVER * area.max()
    normals = normals[faces] / area[faces, None]
    offsets = np.einsum("ij,ij->i", normals, a[faces])
    planes = np.unique(np.round(np.column_stack([normals, offsets]), 9) + 0.0, axis=0)
    return planes[:, :3].copy(), planes[:, 3].copy(), surface.vertices


def bounds(shape: HalfSpaces, axes: Array) -> tuple[Array, Array]:
    """Return the minimum and maximum coordinates [m] along the columns of ``axes``, as arrays of shape (3,)."""
    along = shape.corners @ axes
    return along.min(axis=0), along.max(axis=0)


def crossings(shape: HalfSpaces, starts: Array, direction: Array) -> list[list[Span]]:
    """Return the segments of each line that lie inside the object, in order along the line.

    Args:
        shape: The object.
        starts: Start points of the lines [m], shape (n, 3).
        direction: Unit vector along all lines, shape (3,).
    """
    slope = shape.normals @ direction
    room = shape.offsets - starts @ shape.normals.T
    entry, leave = _clipped(shape.first, room, np.broadcast_to(slope, room.shape))
    return [_merged(shape, room[k], slope, entry[k], leave[k]) for k in range(len(starts))]


def part_spans(shape: HalfSpaces, part: int, starts: Array, direction: Array) -> tuple[Array, Array]:
    """Return the positions [m] at which lines enter and leave one part, measured along the lines.

    Args:
        shape: The object.
        part: Index of the part.
        starts: Start points of the lines [m], shape (lines, 3).
        direction: Unit vector along all lines, shape (3,).

    Returns:
        Entry and exit positions [m], shape (lines,) each. For a line that misses the part, the entry position is
        greater than the exit position.
    """
    rows = shape.rows(part)
    normals = shape.normals[rows]
    room = shape.offsets[rows] - starts @ normals.T
    enter, leave = _clipped(np.zeros(1, np.intp), room, np.broadcast_to(normals @ direction, room.shape))
    return enter[:, 0], leave[:, 0]


def face_normal(shape: HalfSpaces, start: Array, direction: Array, part: int, at: float, sign: float) -> Array:
    """Return the outward normal of the face through which a line enters or leaves a part.

    Args:
        shape: The object.
        start: Start point of the line [m], shape (3,).
        direction: Unit vector along the line, shape (3,).
        part: Index of the part.
        at: Position of the intersection, measured along the line [m].
        sign: -1 if the line enters the part, 1 if it leaves the part.
    """
    rows = shape.rows(part)
    slope = shape.normals[rows] @ direction
    room = shape.offsets[rows] - shape.normals[rows] @ start
    off = np.where(sign * slope > 1e-9, np.abs(room - slope * at), np.inf)
    return np.asarray(shape.normals[rows][off.argmin()])


def met(shape: HalfSpaces, start: Array, directions: Array) -> NDArray[np.bool_]:
    """Return a mask of the rays from ``start`` [m] that hit the object.

    ``directions`` is an array of shape (n, 3).
    """
    slope = directions @ shape.normals.T
    room = np.broadcast_to(shape.offsets - shape.normals @ start, slope.shape)
    entry, leave = _clipped(shape.first, room, slope)
    return np.asarray(((leave > entry) & (leave > 0)).any(axis=1))


def _clipped(parts: NDArray[np.intp], room: Array, slope: Array) -> tuple[Array, Array]:
    """Return the positions [m] at which lines enter and leave each part, as arrays of shape (lines, parts).

    ``parts`` contains the first row of each part.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        at = room / slope
    beside = (np.abs(slope) <= 1e-9) & (room < 0)
    first = np.where(slope < -1e-9, at, np.where(beside, np.inf, -np.inf))
    last = np.where(slope > 1e-9, at, np.inf)
    return np.maximum.reduceat(first, parts, axis=1), np.minimum.reduceat(last, parts, axis=1)


class SolidRun(NamedTuple):
    """The intersection of a line with one or more parts, from ``start`` to ``end`` along the line [m].

    ``first`` and ``last`` contain the line index and the part index at the start and at the end.
    """

    start: float
    end: float
    first: tuple[int, int]
    last: tuple[int, int]


def union(runs: Iterable[SolidRun]) -> list[SolidRun]:
    """Return the union of runs that are sorted by their start.

    Runs separated by at most :data:`TOGETHER` are merged.
    """
    found: list[SolidRun] = []
    for run in runs:
        if not found or run.start > found[-1].end + TOGETHER:
            found.append(run)
        elif run.end > found[-1].end:
            found[-1] = SolidRun(found[-1].start, run.end, found[-1].first, run.last)
    return found


def _merged(shape: HalfSpaces, room: Array, slope: Array, entry: Array, leave: Array) -> list[Span]:
    inside = np.flatnonzero(leave > entry)
    ordered = inside[np.argsort(entry[inside], kind="stable")].tolist()
    spans = []
    for start, end, (_, first), (_, last) in union(
        SolidRun(float(entry[k]), float(leave[k]), (0, k), (0, k)) for k in ordered
    ):
        enter, exit_ = _facing(shape, room, slope, first, start, -1.0), _facing(shape, room, slope, last, end, 1.0)
        spans.append(Span(start, end, min(enter, exit_)))
    return spans


def _facing(shape: HalfSpaces, room: Array, slope: Array, part: int, at: float, sign: float) -> float:
    """Return the cosine between a line and the normal of the face where it enters or leaves a part at ``at`` [m].

    ``sign`` is -1 if the line enters the part, and 1 if it leaves the part.
    """
    rows = shape.rows(part)
    through = sign * slope[rows]
    off = np.where(through > 1e-9, np.abs(room[rows] - slope[rows] * at), np.inf)
    return float(through[off.argmin()])
