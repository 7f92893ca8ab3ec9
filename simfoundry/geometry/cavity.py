"""Cavities, the regions in which bowls, drawers or bins hold objects, represented as grids of signed depths."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array
from simfoundry.geometry.hulls import Hulls

# Number of grid cells along the longest side of a link.
CELLS = 64

# Minimum cell size [m].
FINEST = 0.001

# Pairs of perpendicular horizontal directions along which to look for walls, each both forward and backward.
PLANES = (((1, 0), (0, 1)), ((1, 1), (1, -1)), ((2, 1), (1, -2)), ((1, 2), (2, -1)))

# Candidate up axes of a link with their signs; +z comes first because most objects stand upright along it.
UPWARD = ((2, 1), (2, -1), (0, 1), (0, -1), (1, 1), (1, -1))

# Minimum number of cells in a cavity.
SMALLEST = 8

# Minimum size of a hollow, as a fraction of the largest hollow's cells; smaller hollows are ignored.
#
# Measured on 30 mugs with different handles, the handle loop contains at most 0.008 of the mug's cells, whereas the
# smallest compartment of an organizer contains 0.28.
LEAST_SHARE = 0.02

# Maximum fraction of a cavity's boundary, including floor and roof, that may be open to the sides.
#
# The open fraction is 0.16 for the compartments of a shelf with a back panel, 0.31 to 0.38 without one, and 0.51 for
# the loop of a mug's handle.
OPEN_SIDES = 0.45

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Cavity:
    """The cavity of a link, represented as a grid of signed depths.

    Attributes:
        depth: Signed depth [m] at the cell centers, float32, shape (x, y, z). The depth is positive inside the cavity
            and its walls.
        low: Center of the first cell in the link frame [m], shape (3,).
        cell: Side length of a cell [m].
        up: Unit vector along the link axis that points up.
        out: Unit vector toward the opening, or zero if the cavity is closed or open on opposite sides.
        deep: Depth of the cavity along ``up`` [m].
        middle: Center of a bounding sphere [m], shape (3,).
        size: Radius of the bounding sphere [m].
    """

    depth: NDArray[np.float32]
    low: Array
    cell: float
    up: Array
    out: Array
    deep: float
    middle: Array
    size: float

    def at(self, points: Array) -> Array:
        """Interpolate the depth [m] at points of shape (..., 3) in the link frame.

        Outside the grid, the depth decreases with distance.
        """
        shape = np.array(self.depth.shape)
        grid = ((points - self.low) / self.cell).astype(np.float32)
        inside = np.clip(grid, 0, (shape - 1.001).astype(np.float32))
        beyond = np.abs(grid - inside).max(axis=-1)
        first = inside.astype(np.int32)
        part = inside - first
        steps = (self.depth.shape[1] * self.depth.shape[2], self.depth.shape[2], 1)
        corner = first[..., 0] * steps[0] + first[..., 1] * steps[1] + first[..., 2]
        flat = self.depth.ravel()
        fx, fy, fz = part[..., 0], part[..., 1], part[..., 2]

        def along_z(offset: int) -> NDArray[np.float32]:
            low = flat.take(corner + offset)
            return np.asarray(low + fz * (flat.take(corner + (offset + 1)) - low))

        front, back = along_z(0), along_z(steps[0])
        front += fy * (along_z(steps[1]) - front)
        back += fy * (along_z(steps[0] + steps[1]) - back)
        return np.asarray(front + fx * (back - front) - beyond * self.cell, dtype=np.float64)


def cavity(form: Form) -> Cavity | None:
    """Return the cavity of a link in the most common orientation in which it has one, or None if it never has one."""
    return next((found for axis, sign in UPWARD if (found := cavity_upward(form, axis, sign)) is not None), None)


def cavity_upward(form: Form, axis: int, sign: int) -> Cavity | None:
    """Return the cavity of a link with the given axis pointing up, or None if it has no cavity in this orientation.

    If ``sign`` is negative, the axis points down instead. Links with identical shapes share the cached result.
    """
    return _cavity(_Key(form.digest, form), axis, sign)


@dataclass(frozen=True)
class _Key:
    """The cache key of a form, which is equal for forms with the same parts."""

    digest: bytes
    form: Form = field(compare=False)


@lru_cache(maxsize=256)
def _grid(key: _Key) -> tuple[NDArray[np.float32], Array, float] | None:
    """Return a grid of distances from a link's surface.

    Returns:
        The distances, the center of the first cell, and the cell size, all in [m].
    """
    form = key.form
    if not form.solid or len(form.parts.radius) < 2:  # a single convex part has no cavity
        return None
    cell = max(float((form.high - form.low)[:3].max()) / CELLS, FINEST)
    low = form.low[:3] - 2.5 * cell
    shape = np.ceil((form.high[:3] - form.low[:3]) / cell).astype(int) + 6
    return distances(form.parts, low, cell, shape), low, cell


@lru_cache(maxsize=512)
def _cavity(key: _Key, axis: int, sign: int) -> Cavity | None:
    if (grid := _grid(key)) is None:
        return None
    from scipy.ndimage import distance_transform_edt

    outside, low, cell = grid
    found, out = _hollow(outside, cell, axis, sign)
    if int(found.sum()) < SMALLEST:
        return None
    within = found | (outside <= 0)
    depth = distance_transform_edt(within) - distance_transform_edt(~within)
    depth = np.where(within, depth - 0.5, depth + 0.5) * cell
    cells = np.argwhere(found) * cell + low
    bottom, top = cells.min(axis=0), cells.max(axis=0)
    middle = (bottom + top) / 2
    deep, size = float((top - bottom)[axis]) + cell, float(np.linalg.norm(cells - middle, axis=1).max()) + cell
    return Cavity(np.ascontiguousarray(depth, np.float32), low, cell, np.eye(3)[axis] * sign, out, deep, middle, size)


def distances(parts: Hulls, low: Array, cell: float, shape: NDArray[np.int_]) -> NDArray[np.float32]:
    """Return the distance from each cell to the nearest part [m] in single precision.

    The distance is exact within two cells of a face. Elsewhere, it is a lower bound.
    """
    out = np.full(tuple(shape), np.float32(np.inf))
    axes = [low[k] + cell * np.arange(shape[k]) for k in range(3)]
    for number in range(len(parts.radius)):
        corners, radius = parts.corners[parts.part == number], float(parts.radius[number])
        reach = radius + 2.5 * cell
        low_corner, high_corner = corners.min(axis=0) - reach, corners.max(axis=0) + reach
        span = tuple(slice(*np.searchsorted(axes[k], (low_corner[k], high_corner[k]))) for k in range(3))
        points = np.stack(np.meshgrid(*(axes[k][span[k]] for k in range(3)), indexing="ij"), axis=-1)
        found = outside_part(parts, number, points.reshape(-1, 3)).reshape(points.shape[:3])
        out[span] = np.minimum(out[span], found)
    return out


def outside_part(parts: Hulls, number: int, points: Array) -> Array:
    """Return the distance from points to one part, which is negative inside the part.

    The distance is exact for round parts. For polyhedra, it is the largest distance to a face plane.

    Args:
        parts: Convex parts.
        number: Index of the part.
        points: Points [m], shape (n, 3).

    Returns:
        Distances [m], shape (n,).
    """
    rows = parts.part[parts.triangles[:, 0]] == number
    if rows.any():
        normals = parts.normals[rows]
        offsets = np.einsum("ij,ij->i", normals, parts.corners[parts.triangles[rows, 0]])
        planes = np.unique(np.round(np.column_stack([normals, offsets]), 9), axis=0)
        planes = planes[np.linalg.norm(planes[:, :3], axis=1) > 0.5]
        return np.asarray((points @ planes[:, :3].T - planes[:, 3]).max(axis=1))
    corners, radius = parts.corners[parts.part == number], float(parts.radius[number])
    foot, end = corners[0], corners[-1]
    way = end - foot
    share = np.clip((points - foot) @ way / max(float(way @ way), 1e-18), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - foot - share[:, None] * way, axis=1) - radius)


def _hollow(outside: NDArray[np.float32], cell: float, axis: int, sign: int) -> tuple[Mask, Array]:
    """Find the free cells that are enclosed when a grid axis points up, and the direction of their opening.

    An enclosed cell has a floor below it, and walls on both sides along two of three perpendicular axes, one of which
    is the up axis. The direction is a unit vector or zero.
    """
    turned = np.moveaxis(outside, axis, 2)[:, :, ::sign]
    wall = turned <= 0.75 * cell  # thick enough that no ray can pass through a wall
    floored = np.logical_or.accumulate(wall, axis=2)
    roofed = np.logical_or.accumulate(wall[:, :, ::-1], axis=2)[:, :, ::-1]
    standing = wall.copy()  # without the upward thickening: a cavity ends at its rim
    standing[:, :, :-1] &= wall[:, :, 1:]
    around = np.zeros(wall.shape, bool)
    beside = np.zeros(wall.shape, bool)
    for plane in PLANES:
        first, second = (_met(standing, dx, dy) & _met(standing, -dx, -dy) for dx, dy in plane)
        around |= first & second
        beside |= first | second
    found = _enclosed((turned > 0) & floored & (around | (roofed & beside)), wall)
    out = np.zeros(3)
    if found.any():
        free = [float((~_met(standing, *way))[found].mean()) for way in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        roofless = float((~roofed)[found].mean())
        open_ = np.array([free[0] > 0.5, free[2] > 0.5, roofless > 0.5], dtype=float)
        open_ -= np.array([free[1] > 0.5, free[3] > 0.5, False], dtype=float)
        open_[2] *= sign
        out = np.insert(open_[:2], axis, open_[2])
        out = out / max(float(np.linalg.norm(out)), 1.0)
    return np.moveaxis(found[:, :, ::sign], 2, axis), out


def _enclosed(found: Mask, wall: Mask) -> Mask:
    """Return the cells of connected hollows that are sufficiently closed (:data:`OPEN_SIDES`), up to the true walls.

    ``wall`` is thicker than the true walls, so any cells in ``found`` covered by ``wall`` belong to the adjacent
    hollow.
    """
    from scipy.ndimage import binary_dilation, label

    room = found & ~wall
    labels, count = label(room)
    boundary, free = np.zeros(count + 1), np.zeros(count + 1)
    for axis in (0, 1, 2):
        for step in (1, -1):  # the roll cannot wrap around: the grid has a margin of free cells
            beside = np.roll(labels, step, axis) != labels
            boundary += np.bincount(labels[room & beside], minlength=count + 1)
            if axis != 2:
                open_side = beside & ~np.roll(wall, step, axis)
                free += np.bincount(labels[room & open_side], minlength=count + 1)
    closed = free < OPEN_SIDES * boundary
    closed[0] = False  # label 0 is the background
    cells = np.bincount(labels.ravel(), minlength=count + 1) * closed
    closed &= cells >= LEAST_SHARE * cells.max()
    reached = binary_dilation(closed[labels], iterations=2)  # the thickened wall is at most two cells
    return np.asarray(found & reached)


def _met(wall: Mask, dx: int, dy: int) -> Mask:
    """Return a mask of the cells from which a ray in the horizontal direction (``dx``, ``dy``) hits a wall."""
    if abs(dx) < abs(dy):
        return _met(wall.transpose(1, 0, 2), dy, dx).transpose(1, 0, 2)
    if dx < 0:
        return _met(wall[::-1], -dx, dy)[::-1]
    met = np.zeros(wall.shape, bool)
    for x in range(wall.shape[0] - dx - 1, -1, -1):
        met[x] = _shifted(wall[x + dx] | met[x + dx], dy)
        if dx == 2:  # the ray passes between two cells of the column in between
            met[x] |= wall[x + 1] | _shifted(wall[x + 1], dy)
    return met


def _shifted(layer: Mask, dy: int) -> Mask:
    """Shift cells by ``-dy`` along y. Cells that are shifted in from outside the grid are empty."""
    out = np.zeros_like(layer)
    if dy == 0:
        return layer
    out[max(0, -dy) : len(out) - max(0, dy)] = layer[max(0, dy) : len(layer) - max(0, -dy)]
    return out


# Number of candidate points sampled in the bounding box of each part.
TRIED = 512


@lru_cache(maxsize=256)
def volume_samples(form: Form, count: int) -> Array:
    """Sample about ``count`` points inside a form.

    Regions where parts overlap are sampled once for each part.

    Returns:
        Points in the link frame [m], shape (k, 3).
    """
    unit = _spread_points()
    low, high, _, _ = form.pieces
    inside = []
    volume = np.zeros(len(low))
    for k in range(len(low)):
        points = low[k] + unit * (high[k] - low[k])
        points = points[outside_part(form.parts, k, points) <= 1e-9]
        inside.append(points if len(points) else ((low[k] + high[k]) / 2)[None])
        volume[k] = float(np.prod(high[k] - low[k])) * len(points) / TRIED
    share = volume / volume.sum() if volume.sum() > 0 else np.full(len(low), 1 / len(low))
    ends = np.round(np.cumsum(share) * count).astype(int)
    counts = np.diff(ends, prepend=0)
    return np.concatenate([points[: max(int(n), 0)] for points, n in zip(inside, counts, strict=True)])


@lru_cache(maxsize=1)
def _spread_points() -> Array:
    """Return points of a Halton sequence in the unit cube, as an array of shape (TRIED, 3)."""
    return np.array([[_radical(k, base) for base in (2, 3, 5)] for k in range(1, TRIED + 1)])


def _radical(k: int, base: int) -> float:
    value, share = 0.0, 1.0 / base
    while k:
        k, digit = divmod(k, base)
        value += digit * share
        share /= base
    return value
