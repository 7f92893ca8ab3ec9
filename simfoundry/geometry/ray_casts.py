"""First hits of many rays from one point with triangles.

Rays that share an origin need no search tree. Each ray is a point ``(x, y)`` on the plane z = 1 of a view frame at the
origin, a triangle covers a region of that plane, and the signed volumes ``d . (v_j x v_k)`` that decide the hit are
linear in ``(x, y)``, even for triangles that extend behind the origin. The plane is divided into cells; each triangle
visits the spans of cells that it covers and is tested against the rays in them. The same code serves the pixels of a
camera (one ray per cell) and the points that a light may reach (any number per cell). All computations are float64, and
two triangles that share an edge test it with identical numbers, so no ray passes between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array, Index, cross

NEAREST = 1e-4
"""Near clipping distance along z [m]."""

_CHUNK = 1_000_000
"""Number of pairs of triangle and ray tested at once; bounds the memory."""


@dataclass(frozen=True)
class Grid:
    """Cells on the plane z = 1: column ``c`` starts at ``x0 + c * dx`` and is ``wx`` wide; rows likewise in y."""

    x0: float
    y0: float
    dx: float
    dy: float
    wx: float
    wy: float
    columns: int
    rows: int


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays ``(x, y, 1)`` from the origin of a view frame, sorted by cell.

    ``x`` and ``y`` have shape (n,); ``first``, shape (rows * columns + 1,), is the start of each cell; ``order``, shape
    (n,), is the original index of each sorted ray.
    """

    grid: Grid
    x: Array
    y: Array
    first: Index
    order: Index


@dataclass(frozen=True, eq=False)
class Hits:
    """First hit of each ray, in the original order of the rays.

    ``triangle``, shape (n,): the index of the triangle, -1 for none; ``inverse_depth`` [1/m] along z, shape (n,), 0 for
    none; ``weights`` barycentric, shape (n, 3).
    """

    triangle: Index
    inverse_depth: Array
    weights: Array

    def at(self, rays: Index) -> Hits:
        """Select the hits of some rays by index."""
        return Hits(self.triangle[rays], self.inverse_depth[rays], self.weights[rays])


def dot(a: Array, b: Array) -> Array:
    """Dot products of the rows of ``a`` and ``b``, shape (n, 3) or broadcast to it: shape (n,)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def unit(a: Array) -> Array:
    """Normalize the rows of ``a``, shape (..., 3); rows of zeros stay zero."""
    return np.asarray(a / np.maximum(np.sqrt(dot(a, a)), 1e-30)[..., None])


def turned(R_AB: Array, vectors: Array) -> Array:
    """Rotate ``vectors`` in B, shape (..., 3), to A; without BLAS, whose threads and last bits vary by machine."""
    x, y, z = vectors[..., 0, None], vectors[..., 1, None], vectors[..., 2, None]
    return np.asarray(x * R_AB[:, 0] + y * R_AB[:, 1] + z * R_AB[:, 2])


def blend(corners: Array, weights: Array) -> Array:
    """Interpolate corner values of triangles, shape (n, 3, d), by barycentric ``weights`` (n, 3): shape (n, d)."""
    a, b, c = weights[:, 0, None], weights[:, 1, None], weights[:, 2, None]
    return np.asarray(a * corners[:, 0] + b * corners[:, 1] + c * corners[:, 2])


def area_normals(corners: Array) -> Array:
    """Normals of triangles (m, 3, 3), counter-clockwise from outside, with length twice the area: shape (m, 3)."""
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def pixel_rays(width: int, height: int, fx: float, fy: float, cx: float, cy: float, samples: int = 1) -> Rays:
    """Rays through ``samples`` x ``samples`` points per pixel, in row-major order; pixel centers are integers."""
    step = 1.0 / samples
    u = (np.arange(width * samples) + 0.5) * step - 0.5
    v = (np.arange(height * samples) + 0.5) * step - 0.5
    x, y = (u - cx) / fx, (v - cy) / fy
    grid = Grid(float(x[0]), float(y[0]), step / fx, step / fy, 0.0, 0.0, len(x), len(y))
    count = len(x) * len(y)
    return Rays(grid, np.tile(x, len(y)), np.repeat(y, len(x)), np.arange(count + 1), np.arange(count))


def scattered_rays(x: Array, y: Array) -> Rays:
    """Rays ``(x, y, 1)`` in any arrangement, at least one, about two per cell."""
    side = max(1, int(np.sqrt(len(x) / 2)))
    x0, y0 = float(x.min()), float(y.min())
    dx = max(float(x.max()) - x0, 1e-12) / side
    dy = max(float(y.max()) - y0, 1e-12) / side
    column = np.minimum(((x - x0) / dx).astype(np.int64), side - 1)
    row = np.minimum(((y - y0) / dy).astype(np.int64), side - 1)
    cell = row * side + column
    order = np.argsort(cell, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=side * side))])
    return Rays(Grid(x0, y0, dx, dy, dx, dy, side, side), x[order], y[order], first, order)


def first_hits(triangles: Array, rays: Rays, floor: Array | None = None) -> Hits:
    """Find the nearest of ``triangles`` [m, view frame], shape (m, 3, 3), along each ray.

    ``floor`` [1/m], shape (n,), in the original order of the rays, restricts the search to hits of greater inverse
    depth, that is, to hits between the origin and a point. Of triangles at equal depth, the first wins.
    """
    kept, edges, plane = _linear_forms(triangles)
    best = np.zeros(len(rays.x)) if floor is None else floor[rays.order].astype(np.float64)
    winner = np.full(len(rays.x), -1, dtype=np.int64)
    owner, begin, end = _spans(triangles[kept], edges, rays)
    total = np.concatenate([[0], np.cumsum(end - begin)])
    cut = 0
    while cut < len(owner):
        stop = max(cut + 1, int(np.searchsorted(total, total[cut] + _CHUNK, side="right")) - 1)
        _test(owner[cut:stop], begin[cut:stop], end[cut:stop], edges, plane, rays, best, winner)
        cut = stop
    return _gather(winner, best, kept, edges, rays)


def _linear_forms(triangles: Array) -> tuple[Index, Array, Array]:
    """Visible triangles, their edge forms (k, 3, 3) and inverse-depth form (k, 3) in (x, y, 1)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    edges = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=1)
    volume = a[:, 0] * edges[:, 0, 0] + a[:, 1] * edges[:, 0, 1] + a[:, 2] * edges[:, 0, 2]
    kept = np.flatnonzero((volume != 0) & (triangles[:, :, 2].max(axis=1) > NEAREST))
    edges, volume = edges[kept] * np.sign(volume[kept])[:, None, None], np.abs(volume[kept])
    return kept, edges, (edges[:, 0] + edges[:, 1] + edges[:, 2]) / volume[:, None]


def _bounds(triangles: Array) -> tuple[Array, Array]:
    """Lowest and highest (x, y) on the plane z = 1 of the part of each triangle beyond ``NEAREST``, shape (m, 2)."""
    following = np.roll(triangles, -1, axis=1)
    z, z_next = triangles[:, :, 2], following[:, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        corner = np.where((z >= NEAREST)[..., None], triangles[:, :, :2] / z[..., None], np.nan)
        t = (NEAREST - z) / (z_next - z)
        crossing = (triangles + t[..., None] * (following - triangles))[:, :, :2] / NEAREST
    crossing[(z >= NEAREST) == (z_next >= NEAREST)] = np.nan
    points = np.concatenate([corner, crossing], axis=1)
    return np.fmin.reduce(points, axis=1), np.fmax.reduce(points, axis=1)


def _cells(low: Array, high: Array, origin: float, step: float, width: float, count: int) -> tuple[Index, Index]:
    """First and last cell along one axis that an interval may touch; empty if the last precedes the first."""
    first = np.ceil(np.clip((low - origin - width) / step - 1e-6, 0, count))
    last = np.floor(np.clip((high - origin) / step + 1e-6, -1, count - 1))
    return first.astype(np.int64), last.astype(np.int64)


def _spans(triangles: Array, edges: Array, rays: Rays) -> tuple[Index, Index, Index]:
    """For each row of cells that a triangle touches: the triangle, the first ray of the span, and one past the last."""
    grid = rays.grid
    low, high = _bounds(triangles)
    top, bottom = _cells(low[:, 1], high[:, 1], grid.y0, grid.dy, grid.wy, grid.rows)
    owner, row = _expand(top, bottom + 1)
    y = grid.y0 + row * grid.dy
    left, right = low[owner, 0], high[owner, 0]
    for k in range(3):
        a, b, c = edges[owner, k].T
        highest = np.maximum(b * y, b * (y + grid.wy)) + c
        with np.errstate(divide="ignore", invalid="ignore"):
            x = -highest / a
        left = np.where(a > 0, np.maximum(left, x), left)
        right = np.where(a < 0, np.minimum(right, x), right)
    start, stop = _cells(left, right, grid.x0, grid.dx, grid.wx, grid.columns)
    begin = rays.first[np.minimum(row * grid.columns + start, len(rays.first) - 1)]
    end = rays.first[row * grid.columns + stop + 1]
    some = (start <= stop) & (begin < end)
    return owner[some], begin[some], end[some]


def _expand(begin: Index, end: Index) -> tuple[Index, Index]:
    """All pairs (k, i) with ``begin[k] <= i < end[k]``, in order."""
    count = np.maximum(end - begin, 0)
    owner = np.repeat(np.arange(len(begin)), count)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, begin[owner] + within


def _test(
    owner: Index, begin: Index, end: Index, edges: Array, plane: Array, rays: Rays, best: Array, winner: Index
) -> None:
    """Test the rays of spans and keep the nearest hits in ``best`` and ``winner``, which are modified."""
    span, ray = _expand(begin, end)
    triangle = owner[span]
    x, y = rays.x[ray], rays.y[ray]
    w = plane[triangle, 0] * x + plane[triangle, 1] * y + plane[triangle, 2]
    hit = w > best[ray]
    for k in range(3):
        e = edges[:, k]
        hit &= e[triangle, 0] * x + e[triangle, 1] * y + e[triangle, 2] >= 0
    ray, triangle, w = ray[hit], triangle[hit], w[hit]
    np.maximum.at(best, ray, w)
    nearest = np.flatnonzero(w == best[ray])[::-1]  # reversed: of tied triangles the first is written last and wins
    winner[ray[nearest]] = triangle[nearest]


def _gather(winner: Index, best: Array, kept: Index, edges: Array, rays: Rays) -> Hits:
    """Restore the original order of the rays and the caller's triangle indices."""
    triangle = np.full(len(winner), -1, dtype=np.int64)
    inverse_depth, weights = np.zeros(len(winner)), np.zeros((len(winner), 3))
    met = np.flatnonzero(winner >= 0)
    into, form = rays.order[met], edges[winner[met]]
    triangle[into] = kept[winner[met]]
    inverse_depth[into] = best[met]
    volumes = form[:, :, 0] * rays.x[met, None] + form[:, :, 1] * rays.y[met, None] + form[:, :, 2]
    weights[into] = volumes / volumes.sum(axis=1, keepdims=True)
    return Hits(triangle, inverse_depth, weights)
