"""Local tangent planes of a depth picture, and the edges between objects: creases that point inward, and steps.

All fits are made in disparity 1/z, in which a plane of the world is exactly affine in pixel coordinates. So a tangent
plane is three numbers a pixel: the disparity and its derivatives along u and v.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.noise import depth_sigma
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
