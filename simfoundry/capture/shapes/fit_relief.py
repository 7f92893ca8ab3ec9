"""Fit a height field: a solid between the surface on which an object stands and what is seen of the object from above.

It suits objects that lie flat and are no primitives, such as tools, clamps and fruit: their upper side is visible, and
their walls are nearly upright. Cells that the object itself hides belong to it as far as its back may slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate, is_seen_free
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh, closed_mesh

# Cells along the longer side of an object, and limits of their size [m]: the spacing of pixels at 1 m, and the edge of
# a finger of a clamp.
CELLS, LEAST_PITCH, MOST_PITCH = 48, 0.0025, 0.006

# Percentile of the heights in a cell that counts as its surface: above the middle, because a wall belongs to its cell.
SURFACE_PERCENTILE = 70.0

# Least height [m] of a cell: the depth noise at half a meter.
LEAST_HEIGHT = 0.003

# Heights, relative to that of the nearest visible cell, at which a hidden cell must not be seen to be free.
HIDDEN_LEVELS = (0.3, 0.6)

# Distance of hidden cells from the nearest visible one, relative to its height. The hidden part of a lying cylinder
# extends by 0.15 of its height at a view of 45 degrees, and that of a lying carton by more.
HIDDEN_REACH = 0.35


class _Relief(NamedTuple):
    """Heights above the base [m], shape (nx, ny), NaN outside; xy [m] of the first corner, and the pitch [m]."""

    height: Array
    corner: Array
    pitch: float


def fit_relief(evidence: Evidence) -> FitCandidate | None:
    """Return the height field of the visible points on ``base_z``, or None if they do not fill a few cells."""
    relief = _visible(evidence)
    relief = relief._replace(height=_manifold(_with_hidden(evidence, relief)))
    if np.isfinite(relief.height).sum() < 4:
        return None
    mesh, X_WO = _solid(relief, evidence.base_z)
    return FitCandidate("relief", mesh, X_WO, evidence.judge(cast_mesh, X_WO.apply(mesh.vertices), mesh.faces))


def fit_mirrored_relief(evidence: Evidence) -> FitCandidate | None:
    """Return the solid between the upper side and its mirror image, which touches ``base_z``, or None without one.

    Most objects that lie are as good as symmetric to a level plane: bottles, cans, tools, mugs with the handle aside.
    """
    full = evidence.top - evidence.base_z
    relief = _visible(evidence, full / 2)
    relief = relief._replace(height=_manifold(np.minimum(_with_hidden(evidence, relief), full)))
    if np.isfinite(relief.height).sum() < 4 or full < 2 * LEAST_HEIGHT:
        return None
    mesh, X_WO = _solid(relief, evidence.base_z, full)
    return FitCandidate("mirrored", mesh, X_WO, evidence.judge(cast_mesh, X_WO.apply(mesh.vertices), mesh.faces))


def _visible(evidence: Evidence, least: float = -1.0) -> _Relief:
    """Return the heights of the cells that contain visible points, without isolated cells and small gaps.

    Points below the height ``least`` [m] above the base do not count.
    """
    from scipy import ndimage

    above = evidence.points[evidence.points[:, 2] - evidence.base_z > least]
    above = above if len(above) else evidence.points
    xy, z = above[:, :2], above[:, 2] - evidence.base_z
    low, high = np.percentile(xy, [0.5, 99.5], axis=0)
    pitch = float(np.clip((high - low).max() / CELLS, LEAST_PITCH, MOST_PITCH))
    margin = 4 + int(HIDDEN_REACH * float(np.percentile(z, 99)) / pitch)
    shape = np.ceil((high - low) / pitch).astype(int) + 2 * margin
    corner = (low + high) / 2 - shape * pitch / 2
    cell = np.floor((xy - corner) / pitch).astype(np.int64)
    inside = (cell >= 0).all(axis=1) & (cell < shape).all(axis=1)
    index = cell[inside, 0] * shape[1] + cell[inside, 1]
    heights = _percentiles(index, z[inside], int(shape.prod())).reshape(shape)
    filled = ndimage.binary_closing(np.isfinite(heights), np.ones((3, 3)))
    filled = ndimage.binary_opening(filled, np.ones((2, 2)))
    return _Relief(np.where(filled, _smoothed(heights), np.nan), corner, pitch)


def _percentiles(index: NDArray[np.int64], values: Array, count: int) -> Array:
    """Return the percentile of the values of each index, or NaN without values, shape (count,)."""
    order = np.lexsort((values, index))
    index, values = index[order], values[order]
    first = np.searchsorted(index, np.arange(count))
    number = np.searchsorted(index, np.arange(count), side="right") - first
    at = first + np.floor((number - 1) * SURFACE_PERCENTILE / 100).astype(np.int64)
    return np.where(number > 0, values[np.clip(at, 0, max(len(values) - 1, 0))], np.nan)


def _smoothed(heights: Array) -> Array:
    """Return the median of each cell and its neighbors that have a height."""
    padded = np.pad(heights, 1, constant_values=np.nan)
    around = [padded[i : i + heights.shape[0], j : j + heights.shape[1]] for i in range(3) for j in range(3)]
    stack = np.sort(np.stack(around), axis=0)  # NaN last
    count = np.isfinite(stack).sum(axis=0)
    middle = np.take_along_axis(stack, (np.maximum(count - 1, 0) // 2)[None], axis=0)[0]
    return np.where(count > 0, np.maximum(middle, LEAST_HEIGHT), np.nan)


def _with_hidden(evidence: Evidence, relief: _Relief) -> Array:
    """Return the heights with those of the cells beside the visible ones that the camera cannot see to be free."""
    from scipy import ndimage

    height = relief.height
    known = np.isfinite(height)
    if not known.any():
        return height
    distance, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    beside = height[nearest[0], nearest[1]]
    distance = distance * relief.pitch
    rows, columns = np.nonzero(~known & (distance <= HIDDEN_REACH * beside))
    centers = relief.corner + (np.column_stack([rows, columns]) + 0.5) * relief.pitch
    hidden: Mask = np.ones(len(rows), dtype=bool)
    for level in HIDDEN_LEVELS:
        z = evidence.base_z + level * beside[rows, columns]
        hidden &= ~is_seen_free(evidence, np.column_stack([centers, z]))
    rows, columns = rows[hidden], columns[hidden]
    out = height.copy()
    out[rows, columns] = np.maximum(beside[rows, columns] - distance[rows, columns], LEAST_HEIGHT)
    closed = ndimage.binary_opening(np.isfinite(out), np.ones((2, 2)))
    return np.where(closed, out, np.nan)


def _manifold(height: Array) -> Array:
    """Return the heights of the parts of some size, without cells that touch at a corner only."""
    from scipy import ndimage

    parts, count = ndimage.label(np.isfinite(height))
    if count:
        sizes = np.bincount(parts.ravel())[1:]
        height = np.where(np.isin(parts, 1 + np.flatnonzero(sizes >= 0.1 * sizes.max())), height, np.nan)
    out = np.pad(height, 1, constant_values=np.nan)
    while True:
        is_in = np.isfinite(out)
        a, b, c, d = is_in[:-1, :-1], is_in[:-1, 1:], is_in[1:, :-1], is_in[1:, 1:]
        rows, columns = np.nonzero((a & d & ~b & ~c) | (b & c & ~a & ~d))
        if not len(rows):
            return out
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
            block = out[i : i + 2, j : j + 2]
            block[np.isnan(block)] = np.nanmean(block)


def _solid(relief: _Relief, base_z: float, full: float | None = None) -> tuple[Mesh, Pose]:
    """Return the closed mesh of a height field, and its pose with the origin below its middle.

    Its lower side is level, or the mirror image of the upper one at half of the height ``full`` [m].
    """
    is_in = np.isfinite(relief.height)
    padded = np.pad(relief.height, 1, constant_values=np.nan)
    nx, ny = is_in.shape
    corners = np.stack([padded[i : i + nx + 1, j : j + ny + 1] for i in (0, 1) for j in (0, 1)])
    used = np.isfinite(corners).any(axis=0)
    number = np.full(used.shape, -1)
    number[used] = np.arange(used.sum())
    total = int(used.sum())
    top = np.nanmean(corners[:, used], axis=0)
    rows, columns = np.nonzero(used)
    xy = relief.corner - relief.pitch + np.column_stack([rows, columns]) * relief.pitch
    i, j = np.nonzero(is_in)
    a, b, c, d = number[i, j], number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]
    quads = np.concatenate([np.column_stack([a, b, c, d]), np.column_stack([d, c, b, a]) + total])
    edges = np.concatenate([np.column_stack(e) for e in ((a, b), (b, c), (c, d), (d, a))])
    key, back = edges[:, 0] * total + edges[:, 1], edges[:, 1] * total + edges[:, 0]
    border = edges[~np.isin(key, back)]
    one, other = border.T
    quads = np.concatenate([quads, np.column_stack([other, one, one + total, other + total])])
    xy = _rounded(xy, border)
    middle = (xy.min(axis=0) + xy.max(axis=0)) / 2
    xy = xy - middle
    if full is not None:
        top = np.maximum(top, full / 2 + LEAST_HEIGHT / 2)
    below = np.zeros(total) if full is None else full - top
    vertices = np.concatenate([np.column_stack([xy, top]), np.column_stack([xy, below])])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return closed_mesh(vertices, faces), Pose.of((*middle, base_z))


def _rounded(xy: Array, border: NDArray[np.int64]) -> Array:
    """Smooth the outline, whose corners follow the cells: each one moves toward the middle of its two neighbors."""
    out = xy.copy()
    for _ in range(2):
        sums = np.zeros_like(out)
        count = np.zeros(len(out))
        for one, other in ((0, 1), (1, 0)):
            np.add.at(sums, border[:, one], out[border[:, other]])
            np.add.at(count, border[:, one], 1)
        at = count > 0
        out[at] = 0.5 * out[at] + 0.5 * sums[at] / count[at, None]
    return out
