"""Cut the surfaces above the support into smooth regions, and find the borders between these regions.

The regions are bounded by steps and inward creases. All fits are made in disparity (1/z) because the disparity of a
plane is exactly affine in pixel coordinates. A tangent plane is therefore represented by three numbers per pixel: the
disparity and its derivatives along u and v.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, depth_sigma
from simfoundry.capture.segment.masks import Labels, Mask, components, disk
from simfoundry.geometry.frames import Array

CUT = 0.012  # [m] a neighbor whose depth differs by more than this (and the noise) is on a different surface
SCALE = 0.009  # [m] distance on the object over which surfaces are smoothed and edges are evaluated
FLAT = 0.5  # edge strength (in units of `Crop.edge`) below which a pixel may seed a region
CURVED = 6e-4  # [m²] minimum area of a region that is flat nowhere; noise between objects leaves smaller ones
BROKEN = 5.0  # step (in units of `Crop.step`) above which two pixels are not connected
CLEAREST = 10.0  # limit on the bend or jump of a pair, in units of the noise: one pair must not outweigh a long border
Window = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class Crop:
    """The part of the image around the objects on the support.

    All arrays have the shape (h, w, ...) of ``window``. ``mask`` marks the pixels above the support. ``edge`` and
    ``step`` are the strengths of all edges and of depth steps, respectively. They are evaluated over ``reach`` [px] and
    relative to the noise, so that a value of 1 is a likely edge. ``down`` is the direction (u, v) in the image in which
    a point on the optical axis would fall. ``whole`` is the shape of the full image.
    """

    window: Window
    whole: tuple[int, int]
    color: NDArray[np.uint8]
    depth: Array
    pixel_area: Array
    points_W: Array
    mask: Mask
    edge: Array
    step: Array
    reach: int
    down: tuple[float, float]


def pixel_area(frame: Frame) -> Array:
    """Return the area [m²] that each pixel covers on a surface facing the camera."""
    return np.asarray(frame.depth**2 / (frame.K[0, 0] * frame.K[1, 1]))


def reach_of(depth: Array, K: Array) -> float:
    """Return the edge scale :data:`SCALE`, converted to pixels at the median depth."""
    return SCALE * float(K[0, 0] + K[1, 1]) / 2 / float(np.nanmedian(depth))


def edges_of(depth: Array, K: Array, reach: int) -> tuple[Array, Array, Array]:
    """Smooth a depth image [m], and compute its edges.

    The edge strength is the distance of two surfaces from each other's tangent planes, measured ``reach`` pixels to
    either side. The maximum over four directions is used. At an inward crease, such as the base of a box on a table,
    each surface is in front of the other's tangent plane. At a step, such as one box in front of another, one surface
    is in front and the other behind.

    Returns:
        The points in the camera frame [m], the edges, and the steps. Edges and steps are defined as in :class:`Crop`.
    """
    fits = tangents(depth, reach, stride=1 + (reach - 1) // 5)
    inward, step = np.zeros(depth.shape), np.zeros(depth.shape)
    for middle, a, b, offset in _across(depth.shape, reach):
        bend, jump = _bend_and_jump(fits[a], fits[b], offset)
        inward[middle] = np.fmax(inward[middle], np.maximum(np.nan_to_num(bend), 0))
        step[middle] = np.fmax(step[middle], np.abs(np.nan_to_num(jump)))
    noise = _noise_of(depth)
    step = np.maximum(step, _breaks(depth)) / noise
    points = Frame(np.zeros((*depth.shape, 3), np.uint8), 1.0 / fits[..., 0], K).points
    return points, np.maximum(inward / noise, step), step


def cut(crop: Crop) -> Labels:
    """Segment the crop's mask into regions 1..n with a watershed on the edge strength, seeded in flat areas.

    Pixels outside the mask are 0.
    """
    import cv2

    mask = crop.mask
    seeds = np.zeros(mask.shape, np.int32)
    flat = mask & (crop.edge < FLAT)
    islands, _ = components(mask & (crop.step < BROKEN))
    # A narrow strip along a silhouette does not become a separate region, unless its island would have no other region.
    # Small bowls are flat nowhere: the last round takes an entire island without regions, unless it is small.
    for radius, where in ((max(2, crop.reach // 2), flat), (1, flat), (0, flat), (0, islands > 0)):
        kernel = disk(radius)
        inner = cv2.erode(where.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
        parts, areas = components(inner & ~np.isin(islands, np.unique(islands[seeds > 0])))
        sound = areas >= 12
        if where is not flat:
            sound &= np.bincount(parts.ravel(), np.nan_to_num(crop.pixel_area).ravel()) >= CURVED
        renumber = np.where(sound, np.cumsum(sound) + int(seeds.max()), 0).astype(np.int32)
        seeds = np.maximum(seeds, renumber[parts])
    return flood(seeds, mask, crop.edge)


def flood(seeds: Labels, mask: Mask, height: Array) -> Labels:
    """Grow the regions in ``seeds`` over ``mask`` until they meet, in order of increasing ``height``.

    Connected parts of the mask without a seed remain 0.
    """
    import cv2

    # float32 represents every label exactly and is supported by OpenCV's dilation. If two regions reach a pixel at the
    # same time, the one with the higher label wins.
    labels = np.where(mask, seeds, 0).astype(np.float32)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    levels = np.append(np.linspace(0.1, 3.0, 30), np.inf)
    for level in levels:
        front = mask & (labels == 0) & (height <= level)
        while front.any():
            grown = np.where(front, cv2.dilate(labels, cross), 0)
            reached = grown > 0
            if not reached.any():
                break
            labels[reached] = grown[reached]
            front &= ~reached
    return labels.astype(np.int32)


@dataclass(frozen=True)
class Border:
    """The border between two regions ``a < b``.

    ``pairs`` is the number of pixel pairs across the border. ``bend`` and ``jump`` are means over these pairs in units
    of the noise. ``bend`` is positive for an inward crease and negative for an outward one. ``jump`` is positive if
    ``b`` is in front. ``meets`` is the fraction of the closer pairs across which the surface is continuous within the
    noise.
    """

    a: int
    b: int
    pairs: float
    bend: float
    jump: float
    meets: float

    @property
    def edge(self) -> float:
        """The edge strength of the border.

        A value of 1 is a likely border between two objects, and negative values are convex edges of one object.
        """
        return max(self.bend, 0.8 * abs(self.jump))


def borders(labels: Labels, crop: Crop) -> dict[tuple[int, int], Border]:
    """Return all borders between regions, keyed by (a, b) with a < b, in ascending order.

    The tangent planes are fitted separately within each region, and the values are signed, so that noise cancels out
    along a border.
    """
    rows, columns = np.nonzero((labels > 0).any(axis=1))[0], np.nonzero((labels > 0).any(axis=0))[0]
    if not len(rows):
        return {}
    used = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    labels, depth, reach = labels[used], crop.depth[used], crop.reach
    fits = tangents(np.where(labels > 0, depth, np.nan), reach, 1 + (reach - 1) // 5, labels)
    noise = _noise_of(depth)
    found = []
    for r in (reach, max(2, reach // 2)):
        for _, a, b, offset in _across(labels.shape, r):
            where = (labels[a] != labels[b]) & (labels[a] > 0) & (labels[b] > 0)
            one, other = labels[a][where], labels[b][where]
            bend, jump = _bend_and_jump(fits[a][where], fits[b][where], offset)
            scale = np.fmax(noise[a][where], noise[b][where])
            pair = np.sort(np.stack([one, other], axis=1), axis=1)
            signed = np.where(one > other, -jump, jump)
            found.append((pair, bend / scale, signed / scale, np.full(len(bend), r < reach)))
    if not found:
        return {}
    pairs, bends, jumps, near = (np.concatenate(column) for column in zip(*found, strict=True))
    if not len(pairs):
        return {}
    unique, index, counts = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    bend, jump = (np.bincount(index, np.clip(x, -CLEAREST, CLEAREST)) / counts for x in (bends, jumps))
    smooth = near & (np.maximum(bends, 0.8 * np.abs(jumps)) < 1)
    meets = np.bincount(index, smooth) / np.maximum(np.bincount(index, near), 1)
    values = np.column_stack([counts, bend, jump, meets])
    return {(a, b): Border(a, b, *row) for (a, b), row in zip(unique.tolist(), values.tolist(), strict=True)}


def adjacent_pairs(labels: Labels) -> frozenset[tuple[int, int]]:
    """Return the pairs (low, high) of labels of adjacent regions."""
    sides = ((labels[:-1], labels[1:]), (labels[:, :-1], labels[:, 1:]))
    pairs = np.concatenate([np.stack([a[a != b], b[a != b]], axis=1) for a, b in sides])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    return frozenset((int(a), int(b)) for a, b in pairs if a > 0)


def tangents(depth: Array, radius: int, stride: int = 1, labels: Labels | None = None) -> Array:
    """Return affine fits of the disparity around every pixel.

    Neighbors across a depth step or with a different label are excluded, so that the fits do not bend around edges.

    Returns:
        The fits (d, d_u, d_v), as an array of shape (h, w, 3). The unit of d is 1/m, and the unit of d_u and d_v is 1/m
        per pixel. Pixels without depth are NaN.
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
            here = np.s_[max(0, -dv) : h - max(0, dv), max(0, -du) : w - max(0, du)]
            there = _moved(here, du, dv)
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
    """Solve the least-squares problem at every pixel from its moment sums.

    The solution is slightly damped toward zero slope.
    """
    damping = 0.5
    n, u, v, uu, uv, vv = s[0] + 1e-9, s[1], s[2], s[3] + damping, s[4], s[5] + damping
    a, b, c = uu - u * u / n, uv - u * v / n, vv - v * v / n
    p, q = s[7] - u * s[6] / n, s[8] - v * s[6] / n
    determinant = a * c - b * b
    slope_u, slope_v = (c * p - b * q) / determinant, (a * q - b * p) / determinant
    return np.stack([(s[6] - slope_u * u - slope_v * v) / n, slope_u, slope_v], axis=-1)


def normals_of(fits: Array, K: Array) -> Array:
    """Return the unit normals of tangent planes, as an array of shape (h, w, 3).

    The normals point toward the camera.
    """
    h, w = fits.shape[:2]
    u, v = np.meshgrid(np.arange(w) - K[0, 2], np.arange(h) - K[1, 2])
    d, d_u, d_v = np.moveaxis(fits, -1, 0)
    normals = -np.stack([d_u * K[0, 0], d_v * K[1, 1], d - d_u * u - d_v * v], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _across(shape: tuple[int, ...], reach: int) -> Iterator[tuple[Window, Window, Window, tuple[int, int]]]:
    """Yield windows for comparing pixels on opposite sides of a middle pixel, for each direction.

    Each item contains three windows and an offset. The windows select the middle pixels, the pixels ``reach`` before
    them, and the pixels ``reach`` after them. The offset (u, v) is that between the last two windows.
    """
    h, w = shape
    for du, dv in ((1, 0), (0, 1), (1, 1), (1, -1)):
        r = reach if du * dv == 0 else max(1, round(reach * 0.7))
        if 2 * r >= min(h, w):
            continue  # the window of middle pixels is empty
        middle = (slice(r, h - r), slice(r, w - r))
        yield middle, _moved(middle, -du * r, -dv * r), _moved(middle, du * r, dv * r), (2 * du * r, 2 * dv * r)


def _moved(window: Window, du: int, dv: int) -> Window:
    rows, columns = window
    return slice(rows.start + dv, rows.stop + dv), slice(columns.start + du, columns.stop + du)


def _bend_and_jump(a: Array, b: Array, offset: tuple[int, int]) -> tuple[Array, Array]:
    """Return the bend and the jump of the surface between pixels ``a`` and pixels ``b`` at ``offset`` (u, v).

    Both are in meters, and at least one of them is 0. The bend is positive for an inward crease, where each surface is
    in front of the other's tangent plane, and negative for an outward one. The jump is positive if ``b`` is in front of
    ``a`` and negative if it is behind.
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


def _breaks(depth: Array) -> Array:
    """Return the depth jump [m] to adjacent pixels, or 0 if a sloping surface could explain it."""
    limit = CUT + 3 * depth_sigma(depth)
    out = np.zeros(depth.shape)
    for axis in (0, 1):
        jump = np.nan_to_num(np.abs(np.diff(depth, axis=axis)))
        here, there = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        for side in (here, there):
            out[side] = np.maximum(out[side], np.where(jump > limit[side], jump, 0.0))
    return out


def _noise_of(depth: Array) -> Array:
    """Return the edge strength that smoothed noise can reach [m].

    Returns:
        Array of shape (h, w).
    """
    return np.asarray(0.0015 + 0.8 * np.nan_to_num(depth_sigma(depth), nan=1.0))
