"""First intersections of triangles with many rays from a common origin.

Rays that share an origin do not require a search tree. Each ray is represented by a point ``(x, y)`` on the plane z = 1
of a view frame at the origin, and each triangle covers a region of that plane. The signed volumes ``d . (v_j x v_k)``
that determine a hit are linear in ``(x, y)``, even for triangles that extend behind the origin. The plane is divided
into cells, and each triangle is tested against the rays in the cells that it covers. The same code is used for camera
pixels (one ray per cell) and for points that a light may reach (any number of rays per cell). All computations use
float64, and two triangles that share an edge compute identical values for the edge, so no ray can pass between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array, Index, cross

# Distance of the near clipping plane along z [m].
NEAREST = 1e-4

# Maximum number of triangle-ray pairs tested at once, which limits memory use.
_CHUNK = 1_000_000


@dataclass(frozen=True)
class Grid:
    """A grid of cells on the plane z = 1.

    Column ``c`` starts at ``x0 + c * dx`` and is ``wx`` wide. Row ``r`` starts at ``y0 + r * dy`` and is ``wy`` high.
    """

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

    Attributes:
        grid: The cells.
        x: X coordinate of each ray on the plane z = 1, shape (n,).
        y: Y coordinate of each ray on the plane z = 1, shape (n,).
        first: Index of the first ray in each cell, shape (rows * columns + 1,).
        order: Original index of each sorted ray, shape (n,).
    """

    grid: Grid
    x: Array
    y: Array
    first: Index
    order: Index


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hit of each ray, in the original order of the rays.

    Attributes:
        triangle: Index of the triangle that was hit, or -1 for rays without a hit, shape (n,).
        inverse_depth: Inverse of the depth along z [1/m], or 0 for rays without a hit, shape (n,).
        weights: Barycentric coordinates of the hit, shape (n, 3).
    """

    triangle: Index
    inverse_depth: Array
    weights: Array

    def at(self, rays: Index) -> Hits:
        """Select hits by ray index."""
        return Hits(self.triangle[rays], self.inverse_depth[rays], self.weights[rays])


def dot(a: Array, b: Array) -> Array:
    """Return the row-wise dot products of ``a`` and ``b``, which are broadcast to shape (n, 3).

    Returns:
        Dot products, shape (n,).
    """
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def unit(a: Array) -> Array:
    """Normalize the rows of an array of shape (..., 3). Rows of zeros are left unchanged."""
    return np.asarray(a / np.maximum(np.sqrt(dot(a, a)), 1e-30)[..., None])


def turned(R_AB: Array, vectors: Array) -> Array:
    """Rotate ``vectors`` of shape (..., 3) from frame B to frame A.

    BLAS is not used, because the last bits of its results differ between machines.
    """
    x, y, z = vectors[..., 0, None], vectors[..., 1, None], vectors[..., 2, None]
    return np.asarray(x * R_AB[:, 0] + y * R_AB[:, 1] + z * R_AB[:, 2])


def blend(corners: Array, weights: Array) -> Array:
    """Interpolate values that are given at the corners of triangles.

    Args:
        corners: Values at the corners, shape (n, 3, d).
        weights: Barycentric coordinates, shape (n, 3).
    """
    a, b, c = weights[:, 0, None], weights[:, 1, None], weights[:, 2, None]
    return np.asarray(a * corners[:, 0] + b * corners[:, 1] + c * corners[:, 2])


def area_normals(corners: Array) -> Array:
    """Return the area normals of triangles.

    The length of a normal is twice the area of its triangle.

    Args:
        corners: Corners of the triangles, counterclockwise as seen from outside, shape (m, 3, 3).

    Returns:
        Normals, shape (m, 3).
    """
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def pixel_rays(width: int, rows: range, fx: float, fy: float, cx: float, cy: float, samples: int = 1) -> Rays:
    """Create rays through ``samples`` x ``samples`` points per pixel of some rows, in row-major order.

    Pixel centers have integer coordinates. The rays of a row are the same, whatever the other rows are.
    """
    step = 1.0 / samples
    u = (np.arange(width * samples) + 0.5) * step - 0.5
    v = (np.arange(rows.start * samples, rows.stop * samples) + 0.5) * step - 0.5
    x, y = (u - cx) / fx, (v - cy) / fy
    grid = Grid(float(x[0]), float(y[0]), step / fx, step / fy, 0.0, 0.0, len(x), len(y))
    count = len(x) * len(y)
    return Rays(grid, np.tile(x, len(y)), np.repeat(y, len(x)), np.arange(count + 1), np.arange(count))


def scattered_rays(x: Array, y: Array) -> Rays:
    """Create one or more rays ``(x, y, 1)`` in any arrangement, with about two rays per cell."""
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
    """Find the nearest triangle along each ray. If several triangles have the same depth, the first one is returned.

    Args:
        triangles: Triangle corners in the view frame [m], shape (m, 3, 3).
        rays: The rays.
        floor: Minimum inverse depth of a hit [1/m], shape (n,), in the original order of the rays. This value restricts
            the search to hits between the origin and a point on the ray.
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
    """Return the linear forms in (x, y, 1) that describe the visible triangles.

    Returns:
        The indices of the visible triangles, their edge forms, shape (k, 3, 3), and their inverse-depth forms, shape
        (k, 3).
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    edges = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=1)
    volume = a[:, 0] * edges[:, 0, 0] + a[:, 1] * edges[:, 0, 1] + a[:, 2] * edges[:, 0, 2]
    kept = np.flatnonzero((volume != 0) & (triangles[:, :, 2].max(axis=1) > NEAREST))
    edges, volume = edges[kept] * np.sign(volume[kept])[:, None, None], np.abs(volume[kept])
    return kept, edges, (edges[:, 0] + edges[:, 1] + edges[:, 2]) / volume[:, None]


def _bounds(triangles: Array) -> tuple[Array, Array]:
    """Return the minimum and maximum (x, y) of each triangle projected onto the plane z = 1, as arrays of shape (m, 2).

    The part of a triangle in front of the near clipping plane (:data:`NEAREST`) is cut off.
    """
    front = triangles[:, :, 2] >= NEAREST
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b, c = (triangles[:, :, :2] / triangles[:, :, 2:]).swapaxes(0, 1)
    if front.all():
        return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    for corner, before in zip((a, b, c), front.T, strict=True):
        corner[~before] = np.nan
    low, high = np.fmin(np.fmin(a, b), c), np.fmax(np.fmax(a, b), c)
    cut = np.flatnonzero(front.any(axis=1) & ~front.all(axis=1))
    here, following = triangles[cut], np.roll(triangles[cut], -1, axis=1)
    z, z_next = here[:, :, 2], following[:, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (NEAREST - z) / (z_next - z)
        crossing = (here + t[..., None] * (following - here))[:, :, :2] / NEAREST
    crossing[(z >= NEAREST) == (z_next >= NEAREST)] = np.nan
    low[cut] = np.fmin(low[cut], np.fmin.reduce(crossing, axis=1))
    high[cut] = np.fmax(high[cut], np.fmax.reduce(crossing, axis=1))
    return low, high


def _cells(low: Array, high: Array, origin: float, step: float, width: float, count: int) -> tuple[Index, Index]:
    """Return the first and last cells that an interval may touch along one axis.

    If the last cell precedes the first, the interval does not touch any cell.
    """
    first = np.ceil(np.clip((low - origin - width) / step - 1e-6, 0, count))
    last = np.floor(np.clip((high - origin) / step + 1e-6, -1, count - 1))
    return first.astype(np.int64), last.astype(np.int64)


def _spans(triangles: Array, edges: Array, rays: Rays) -> tuple[Index, Index, Index]:
    """Return one span of rays for each row of cells that a triangle touches.

    Returns:
        The triangle index of each span, the index of its first ray, and the index after its last ray.
    """
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
    """Return all pairs (k, i) with ``begin[k] <= i < end[k]``, in order."""
    count = np.maximum(end - begin, 0)
    owner = np.repeat(np.arange(len(begin)), count)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, begin[owner] + within


def _test(
    owner: Index, begin: Index, end: Index, edges: Array, plane: Array, rays: Rays, best: Array, winner: Index
) -> None:
    """Test the rays in the given spans and update ``best`` and ``winner`` in place with the nearest hits."""
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
    nearest = np.flatnonzero(w == best[ray])[::-1]  # reversed: in a tie, the first triangle is written last and wins
    winner[ray[nearest]] = triangle[nearest]


def _gather(winner: Index, best: Array, kept: Index, edges: Array, rays: Rays) -> Hits:
    """Return the hits in the original order of the rays, using the caller's triangle indices."""
    triangle = np.full(len(winner), -1, dtype=np.int64)
    inverse_depth, weights = np.zeros(len(winner)), np.zeros((len(winner), 3))
    met = np.flatnonzero(winner >= 0)
    into, form = rays.order[met], edges[winner[met]]
    triangle[into] = kept[winner[met]]
    inverse_depth[into] = best[met]
    volumes = form[:, :, 0] * rays.x[met, None] + form[:, :, 1] * rays.y[met, None] + form[:, :, 2]
    weights[into] = volumes / volumes.sum(axis=1, keepdims=True)
    return Hits(triangle, inverse_depth, weights)
