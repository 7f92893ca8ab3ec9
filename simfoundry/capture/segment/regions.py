"""Cut what stands above the support into smooth regions, bounded by steps and inward creases; list their borders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import depth_sigma
from simfoundry.geometry.frames import Array

CUT = 0.012  # [m] a neighbor farther off in depth than this (and the noise) belongs to another surface
Tangents = NDArray[np.float64]


def tangents(depth: Array, radius: int, stride: int = 1, labels: NDArray[np.int32] | None = None) -> Tangents:
    """Affine fits of disparity round every pixel: (d, d_u, d_v) in 1/m and 1/m per pixel, shape (h, w, 3).

    NaN where there is no depth. Neighbors across a depth step, or of another label, are left out, so that the fits
    do not bend round edges.
    """
    h, w = depth.shape
    near_depth, disparity = depth.astype(np.float32), (1.0 / depth).astype(np.float32)
    cut = (CUT + 3 * depth_sigma(depth)).astype(np.float32)
    sums = np.zeros((9, h, w))  # 1, u, v, uu, uv, vv, d, ud, vd
    row = np.empty((5, h, w), np.float32)  # within one row of the window: 1, u, uu, d, ud
    for dv in range(-radius, radius + 1, stride):
        row[:] = 0
        for du in range(-radius, radius + 1, stride):
            if du * du + dv * dv > radius * radius:
                continue
            here, there = _overlap(h, w, du, dv)
            near = np.abs(near_depth[there] - near_depth[here]) < cut[here]  # False for NaN
            if labels is not None:
                near &= labels[there] == labels[here]
            delta = np.where(near, disparity[there] - disparity[here], np.float32(0))
            row[0][here] += near
            row[3][here] += delta
            if du:
                row[1][here] += np.float32(du) * near
                row[2][here] += np.float32(du * du) * near
                row[4][here] += np.float32(du) * delta
        sums[[0, 1, 3, 6, 7]] += row
        sums[[2, 4, 8]] += dv * row[[0, 1, 3]]
        sums[5] += dv * dv * row[0]
    fits = _solve(sums)
    fits[..., 0] += 1.0 / depth
    return np.where(np.isfinite(depth)[..., None], fits, np.nan)


def _solve(s: Array) -> Array:
    """Least squares for every pixel from its moment sums, slightly damped toward fronto-parallel."""
    damping = 0.5
    n, u, v, uu, uv, vv = s[0] + 1e-9, s[1], s[2], s[3] + damping, s[4], s[5] + damping
    a, b, c = uu - u * u / n, uv - u * v / n, vv - v * v / n
    p, q = s[7] - u * s[6] / n, s[8] - v * s[6] / n
    determinant = a * c - b * b
    slope_u, slope_v = (c * p - b * q) / determinant, (a * q - b * p) / determinant
    return np.stack([(s[6] - slope_u * u - slope_v * v) / n, slope_u, slope_v], axis=-1)


def normals_of(fits: Tangents, K: Array) -> Array:
    """Unit normals toward the camera, shape (h, w, 3), of tangent planes."""
    h, w = fits.shape[:2]
    u, v = np.meshgrid(np.arange(w) - K[0, 2], np.arange(h) - K[1, 2])
    d, d_u, d_v = np.moveaxis(fits, -1, 0)
    normals = -np.stack([d_u * K[0, 0], d_v * K[1, 1], d - d_u * u - d_v * v], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def edge_strength(fits: Tangents, reach: int) -> tuple[Array, Array]:
    """Distances [m] of two surfaces from each other's tangent planes at every pixel: (``inward``, ``step``).

    Both compare the pixels ``reach`` to either side, along four directions, and take the strongest. ``inward``: each
    lies in front of the other's tangent plane, as at the foot of a box on a table. ``step``: one lies in front and one
    behind, as where one box hides another. Zero where neither holds: on flat, outward bent or unseen surfaces.
    """
    inward, step = np.zeros(fits.shape[:2]), np.zeros(fits.shape[:2])
    for middle, a, b in across(fits.shape[:2], reach):
        bend, jump = bend_and_jump(fits[a], fits[b], np.subtract(start_of(b), start_of(a)))
        inward[middle] = np.fmax(inward[middle], np.maximum(np.nan_to_num(bend), 0))
        step[middle] = np.fmax(step[middle], np.abs(np.nan_to_num(jump)))
    return inward, step


Window = tuple[slice, slice]


def start_of(window: Window) -> tuple[int, int]:
    """Return the (u, v) of a window's first pixel."""
    return window[1].start, window[0].start


def across(shape: tuple[int, ...], reach: int) -> list[tuple[Window, Window, Window]]:
    """Windows of all middle pixels and of the pixels ``reach`` before and after, for four directions."""
    h, w = shape
    out = []
    for du, dv in ((1, 0), (0, 1), (1, 1), (1, -1)):
        r = reach if du * dv == 0 else max(1, round(reach * 0.7))
        middle = (slice(r, h - r), slice(r, w - r))
        out.append((middle, _moved(middle, -du * r, -dv * r), _moved(middle, du * r, dv * r)))
    return out


def bend_and_jump(a: Tangents, b: Tangents, offset: Array) -> tuple[Array, Array]:
    """Bend and jump of the surface [m] from pixels ``a`` to pixels ``b``, ``offset`` (u, v) further.

    ``bend``: positive for an inward crease (each lies in front of the other's tangent plane), negative for an outward
    one. ``jump``: positive where ``b`` lies in front and ``a`` behind, negative the other way round. One of them is 0.
    """
    along_a = offset[0] * a[..., 1] + offset[1] * a[..., 2]
    along_b = offset[0] * b[..., 1] + offset[1] * b[..., 2]
    to_meters = 1.0 / (a[..., 0] * b[..., 0])
    b_before_a = (b[..., 0] - a[..., 0] - along_a) * to_meters
    a_before_b = (a[..., 0] - b[..., 0] + along_b) * to_meters
    size = np.minimum(np.abs(b_before_a), np.abs(a_before_b))
    same = b_before_a * a_before_b > 0
    sign = np.sign(b_before_a)
    return np.where(same, sign * size, 0.0), np.where(same, 0.0, sign * size)


def _overlap(h: int, w: int, du: int, dv: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Overlap of a picture with itself moved by (du, dv): slices of the pixel and of its neighbor."""
    rows = slice(max(0, -dv), h - max(0, dv)), slice(max(0, dv), h - max(0, -dv))
    columns = slice(max(0, -du), w - max(0, du)), slice(max(0, du), w - max(0, -du))
    return (rows[0], columns[0]), (rows[1], columns[1])


def _moved(window: tuple[slice, slice], du: int, dv: int) -> tuple[slice, slice]:
    rows, columns = window
    return slice(rows.start + dv, rows.stop + dv), slice(columns.start + du, columns.stop + du)


SCALE = 0.009  # [m] on the object, over which a surface is smoothed and its edges are judged
FLAT = 0.5  # edge strength, in units of `Relief.edge`, below which a pixel may seed a region
BROKEN = 5.0  # step, likewise, across which nothing hangs together
Labels = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Relief:
    """Input of the cut: smoothed ``points`` [m] and ``normals`` in the camera frame, (h, w, 3), and edges, (h, w).

    ``inward`` and ``step`` are the edge strengths over what the noise explains: 1 is a likely edge.
    """

    points: Array
    normals: Array
    inward: Array
    step: Array
    reach: int

    @property
    def edge(self) -> Array:
        """The stronger of both edges."""
        return np.asarray(np.maximum(self.inward, self.step))


def reach_of(depth: Array, K: Array) -> float:
    """Convert the scale of edges to pixels at the median depth."""
    return SCALE * float(K[0, 0] + K[1, 1]) / 2 / float(np.nanmedian(depth))


def relief_of(depth: Array, K: Array, scale: float) -> Relief:
    """Smooth a depth picture [m], shape (h, w), NaN where there is none, and find its edges, at ``scale`` [px]."""
    reach = int(np.clip(round(scale), 3, 14))
    fits = tangents(depth, reach, stride=1 + (reach - 1) // 5)
    inward, step = edge_strength(fits, reach)
    noise = noise_of(depth)
    h, w = depth.shape
    u, v = np.meshgrid((np.arange(w) - K[0, 2]) / K[0, 0], (np.arange(h) - K[1, 2]) / K[1, 1])
    z = 1.0 / fits[..., 0]
    step = np.maximum(step, _breaks(depth))
    return Relief(np.stack([u * z, v * z, z], axis=-1), normals_of(fits, K), inward / noise, step / noise, reach)


def _breaks(depth: Array) -> Array:
    """Jump of the depth [m] to a direct neighbor beyond any slope; it needs no surface on either side."""
    limit = CUT + 3 * depth_sigma(depth)
    out = np.zeros(depth.shape)
    for axis in (0, 1):
        jump = np.nan_to_num(np.abs(np.diff(depth, axis=axis)))
        here, there = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        for side in (here, there):
            out[side] = np.maximum(out[side], np.where(jump > limit[side], jump, 0.0))
    return out


def noise_of(depth: Array) -> Array:
    """The edge strength [m] that smoothed noise reaches, shape (h, w)."""
    return np.asarray(0.0015 + 0.8 * np.nan_to_num(depth_sigma(depth), nan=1.0))


def cut(mask: NDArray[np.bool_], relief: Relief) -> Labels:
    """Regions 1..n of ``mask``, 0 outside: a watershed of the edge strength from its flat parts."""
    import cv2

    seeds = np.zeros(mask.shape, np.int32)
    flat = (mask & (relief.edge < FLAT)).astype(np.uint8)
    _, islands = cv2.connectedComponents((mask & (relief.step < BROKEN)).astype(np.uint8), connectivity=4)
    # A narrow strip along a silhouette makes no region of its own, unless its island would be left with none.
    for radius in (max(2, relief.reach // 2), 1, 0):
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        inner = cv2.erode(flat, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        inner[np.isin(islands, np.unique(islands[seeds > 0]))] = 0
        _, parts, stats, _ = cv2.connectedComponentsWithStats(inner, connectivity=4)
        sound = stats[:, cv2.CC_STAT_AREA] >= 12
        sound[0] = False
        renumber = np.where(sound, np.cumsum(sound) + int(seeds.max()), 0).astype(np.int32)
        seeds = np.maximum(seeds, renumber[parts])
    return flood(seeds, mask, relief.edge)


def flood(seeds: Labels, mask: NDArray[np.bool_], height: Array) -> Labels:
    """Grow the regions of ``seeds`` over ``mask``, low ``height`` first, until they meet; parts without seed stay 0."""
    import cv2

    # float32 holds every label exactly, and OpenCV dilates it; where two regions arrive together the later one wins.
    labels = np.where(mask, seeds, 0).astype(np.float32)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    levels = np.append(np.linspace(0.1, 3.0, 30), np.inf)
    for level in levels:
        open_ = mask & (height <= level)
        while True:
            front = open_ & (labels == 0)
            grown = np.where(front, cv2.dilate(labels, cross), labels)
            if np.array_equal(grown, labels):
                break
            labels = grown
    return labels.astype(np.int32)


@dataclass(frozen=True)
class Border:
    """Border of two regions ``a < b``: pixel ``pairs`` seen across it, and means over these in units of the noise.

    ``bend``: positive for an inward crease, negative for an outward one. ``jump``: positive where ``b`` is in front.
    ``meets`` is the share of the closer pairs across which the surface goes on within the noise.
    """

    a: int
    b: int
    pairs: float
    bend: float
    jump: float
    meets: float

    @property
    def edge(self) -> float:
        """Separation of the two: 1 is a likely border of two objects, negative a convex edge of one."""
        return max(self.bend, 0.8 * abs(self.jump))


def borders(labels: Labels, depth: Array, reach: int) -> dict[tuple[int, int], Border]:
    """All borders of regions, keyed (a, b) with a < b, in ascending order.

    The tangent planes are fitted within each region alone, and signed, so that noise cancels along a border.
    """
    rows, columns = np.nonzero((labels > 0).any(axis=1))[0], np.nonzero((labels > 0).any(axis=0))[0]
    if not len(rows):
        return {}
    used = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    labels, depth = labels[used], depth[used]
    fits = tangents(np.where(labels > 0, depth, np.nan), reach, 1 + (reach - 1) // 5, labels)
    noise = noise_of(depth)
    keys, bends, jumps, close = [], [], [], []
    for r in (reach, max(2, reach // 2)):
        for _, a, b in across(labels.shape, r):
            la, lb = labels[a], labels[b]
            where = (la != lb) & (la > 0) & (lb > 0)
            bend, jump = bend_and_jump(fits[a][where], fits[b][where], np.subtract(start_of(b), start_of(a)))
            scale = np.fmax(noise[a][where], noise[b][where])
            swap = la[where] > lb[where]
            keys.append(np.sort(np.stack([la[where], lb[where]], axis=1), axis=1))
            bends.append(bend / scale)
            jumps.append(np.where(swap, -jump, jump) / scale)
            close.append(np.full(len(bend), r < reach))
    pair = np.concatenate(keys)
    if not len(pair):
        return {}
    unique, index, counts = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
    limit = 10.0  # so that few far-off pixels do not outvote a long border
    bend = np.bincount(index.ravel(), np.clip(np.concatenate(bends), -limit, limit)) / counts
    jump = np.bincount(index.ravel(), np.clip(np.concatenate(jumps), -limit, limit)) / counts
    near = np.concatenate(close)
    smooth = near & (np.maximum(np.concatenate(bends), 0.8 * np.abs(np.concatenate(jumps))) < 1)
    meets = np.bincount(index.ravel(), smooth) / np.maximum(np.bincount(index.ravel(), near), 1)
    return {
        (int(a), int(b)): Border(int(a), int(b), float(n), float(x), float(y), float(m))
        for (a, b), n, x, y, m in zip(unique, counts, bend, jump, meets, strict=True)
    }
