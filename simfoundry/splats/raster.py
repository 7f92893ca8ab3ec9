"""Images of Gaussian splats on a CPU: ellipses, composited from front to back at each pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.splats.gaussians import GaussianSplat
from simfoundry.splats.projection import BLUR, Ellipses, Pinhole, project

# Number of pairs of a Gaussian and a pixel that are computed at once; each takes about 150 bytes.
_PAIRS = 1_000_000

# Number of pixels that are rendered at once, so that a single Gaussian has at most as many pairs.
_PIXELS = 1_000_000

# Transmittance below which nothing behind is visible, as when trainers render (Kerbl et al., section 6).
_OPAQUE = 1e-4

# Maximum opacity at a pixel. Trainers have 0.99, which lets the background shine through; logarithms need less than 1.
_MOST_ALPHA = 0.9999

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SplatImage:
    """A splat seen by a camera.

    Attributes:
        color: sRGB color in [0, 1], multiplied by ``alpha``, shape (h, w, 3).
        alpha: Opacity in [0, 1], shape (h, w).
        depth: Depth [m] along the optical axis at which half of the light is blocked, or 0 where ``alpha`` is less
            than one half, shape (h, w).
        nearest: Depth [m] of the nearest Gaussian, or infinity, shape (h, w).
        farthest: Depth [m] of the farthest Gaussian that is visible, or 0, shape (h, w).
    """

    color: Array
    alpha: Array
    depth: Array
    nearest: Array
    farthest: Array


def splat_image(splat: GaussianSplat, X_CF: Pose, camera: Pinhole, blur: float = BLUR) -> SplatImage:
    """Render a splat in a frame F whose pose in the camera frame (x right, y down, z forward) is ``X_CF``."""
    return composite(project(splat, X_CF, camera, blur), camera)


def composite(
    ellipses: Ellipses,
    camera: Pinhole,
    stop: Array | None = None,
    wanted: NDArray[np.bool_] | None = None,
) -> SplatImage:
    """Composite ellipses from front to back.

    Args:
        ellipses: The Gaussians. At each pixel, they are sorted by their depth there, as rays meet them.
        camera: The camera that they were projected to.
        stop: Depth [m] of an opaque surface at each pixel, or infinity, shape (h, w). What is behind it is left out.
        wanted: Pixels to render, shape (h, w); the others stay empty. By default, all are rendered.
    """
    w, h = camera.width, camera.height
    canvas = _Canvas.empty(w, h)
    if wanted is not None:
        canvas.transmittance[~wanted.reshape(-1)] = 0.0
    rows = max(1, _PIXELS // w)
    depths = None if stop is None else stop.reshape(-1)
    for top in range(0, h, rows):
        waiting = _Fragments.empty()
        for pairs, limit in _pairs(canvas, ellipses, w, top, min(top + rows, h)):
            waiting = _blend(canvas, ellipses, waiting.joined(_fragments(canvas, ellipses, pairs, depths)), limit)
    alpha = np.where(canvas.transmittance > _OPAQUE, 1.0 - canvas.transmittance, 1.0)
    if wanted is not None:
        alpha[~wanted.reshape(-1)] = 0.0
    return SplatImage(
        color=canvas.color.reshape(h, w, 3),
        alpha=alpha.reshape(h, w),
        depth=canvas.depth.reshape(h, w),
        nearest=canvas.nearest.reshape(h, w),
        farthest=canvas.farthest.reshape(h, w),
    )


class _Canvas(NamedTuple):
    """The image composited so far, at each of n pixels; see :class:`SplatImage`."""

    transmittance: Floats
    color: Floats
    depth: Floats
    nearest: Floats
    farthest: Floats

    @classmethod
    def empty(cls, w: int, h: int) -> _Canvas:
        n = w * h
        return cls(np.ones(n), np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf), np.zeros(n))


class _Pairs(NamedTuple):
    """Pairs of a row of an ellipse and a pixel in it.

    Attributes:
        ellipse: Index of the ellipse of each row, shape (r,).
        y: Offset of each row from the center of its ellipse [px], shape (r,).
        row: Index of the row of each pair, shape (n,).
        column: Image column of each pair, shape (n,).
        pixel: Index of the pixel of each pair, shape (n,).
    """

    ellipse: Index
    y: Floats
    row: Index
    column: Index
    pixel: Index


class _Fragments(NamedTuple):
    """Ellipses at pixels, with their opacities and depths [m] there. All arrays have shape (n,)."""

    ellipse: Index
    pixel: Index
    alpha: Floats
    depth: Floats

    @classmethod
    def empty(cls) -> _Fragments:
        none = np.zeros(0, dtype=np.int64)
        return cls(none, none, np.zeros(0), np.zeros(0))

    def joined(self, other: _Fragments) -> _Fragments:
        if not len(self.pixel):
            return other
        return _Fragments(
            np.concatenate([self.ellipse, other.ellipse]),
            np.concatenate([self.pixel, other.pixel]),
            np.concatenate([self.alpha, other.alpha]),
            np.concatenate([self.depth, other.depth]),
        )

    def at(self, index: Index) -> _Fragments:
        return _Fragments(self.ellipse[index], self.pixel[index], self.alpha[index], self.depth[index])


def _pairs(canvas: _Canvas, ellipses: Ellipses, width: int, top: int, bottom: int) -> Iterator[tuple[_Pairs, float]]:
    """Yield the pairs in the image rows from ``top`` to ``bottom``, in batches of limited size from front to back.

    Each batch is followed by a depth [m] in front of which no later batch has a pair within 1.4 standard deviations.
    """
    half = np.sqrt(ellipses.reach * ellipses.conic[:, 0] / _determinant(ellipses.conic))
    first = np.maximum(np.ceil(ellipses.center[:, 1] - half), top).astype(np.int64)
    last = np.minimum(np.floor(ellipses.center[:, 1] + half), bottom - 1).astype(np.int64)
    kept = np.flatnonzero(last >= first)
    counts = (last - first + 1)[kept]
    across = np.sqrt(ellipses.reach[kept] * ellipses.conic[kept, 2] / _determinant(ellipses.conic[kept]))
    total = np.cumsum(counts * np.minimum(2.0 * across + 1.0, width))
    start = 0
    while start < len(kept):
        before = total[start - 1] if start else 0.0
        end = max(start + 1, int(np.searchsorted(total, before + _PAIRS)))
        limit = float(ellipses.nearest[kept[end]]) if end < len(kept) else np.inf
        yield _batch(canvas, ellipses, kept[start:end], first[kept[start:end]], counts[start:end], width), limit
        start = end


def _determinant(conic: Array) -> Array:
    return np.asarray(conic[:, 0] * conic[:, 2] - conic[:, 1] ** 2)


def _batch(canvas: _Canvas, ellipses: Ellipses, index: Index, first: Index, counts: Index, width: int) -> _Pairs:
    """Return the pairs of some ellipses, each with ``counts`` image rows from ``first`` on.

    Rows that are behind opaque pixels are left out.
    """
    row_ellipse = np.repeat(index, counts)
    image_row = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(len(row_ellipse))
    a, b, c = ellipses.conic[row_ellipse].T
    x, y = ellipses.center[row_ellipse, 0], image_row - ellipses.center[row_ellipse, 1]
    # Solutions of a dx^2 + 2 b dx y + c y^2 = reach.
    half = np.sqrt(np.maximum((b * b - a * c) * y * y + a * ellipses.reach[row_ellipse], 0.0)) / a
    middle = x - b / a * y
    left = np.maximum(np.ceil(middle - half), 0).astype(np.int64)
    right = np.minimum(np.floor(middle + half), width - 1).astype(np.int64)
    lengths = np.maximum(right - left + 1, 0)
    clear = np.concatenate([[0], np.cumsum(canvas.transmittance > _OPAQUE)])  # number of pixels before each one
    start = image_row * width + np.minimum(left, width - 1)
    lengths[clear[start + lengths] == clear[start]] = 0
    row = np.repeat(np.arange(len(lengths)), lengths)
    column = np.repeat(left - np.cumsum(lengths) + lengths, lengths) + np.arange(len(row))
    return _Pairs(row_ellipse, y, row, column, np.repeat(image_row * width, lengths) + column)


def _fragments(canvas: _Canvas, ellipses: Ellipses, pairs: _Pairs, stop: Floats | None) -> _Fragments:
    """Return the pairs at pixels that are not opaque yet, in front of the depths ``stop`` [m], with their opacities."""
    visible = np.flatnonzero(canvas.transmittance[pairs.pixel] > _OPAQUE)
    row, pixel = pairs.row[visible], pairs.pixel[visible]
    ellipse, y = pairs.ellipse[row], pairs.y[row]
    x = pairs.column[visible] - ellipses.center[ellipse, 0]
    depth = ellipses.depth[ellipse] + ellipses.slope[ellipse, 0] * x + ellipses.slope[ellipse, 1] * y
    if stop is not None:
        front = np.flatnonzero(depth < stop[pixel])
        ellipse, pixel = ellipse[front], pixel[front]
        x, y, depth = x[front], y[front], depth[front]
    a, b, c = ellipses.conic[ellipse].T
    alpha = ellipses.opacity[ellipse] * np.exp(-0.5 * ((a * x + 2.0 * b * y) * x + c * y * y))
    return _Fragments(ellipse, pixel, np.minimum(alpha, _MOST_ALPHA), depth)


def _blend(canvas: _Canvas, ellipses: Ellipses, found: _Fragments, limit: float) -> _Fragments:
    """Composite the fragments nearer than ``limit`` [m] behind what the canvas shows, and return the others."""
    ready = found.depth < limit
    waiting = found.at(np.flatnonzero(~ready))
    if len(waiting.pixel):
        found = found.at(np.flatnonzero(ready))
    if not len(found.pixel):
        return waiting
    ellipse, pixel, alpha, depth = found.at(_sorted(found))
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    at, lengths = pixel[starts], np.diff(starts, append=len(pixel))
    passed = np.cumsum(np.log1p(-alpha))  # logarithm of the light that passes the fragments up to and including each
    begin = np.concatenate([[0.0], passed[starts[1:] - 1]])
    after = np.exp(passed - np.repeat(begin, lengths)) * np.repeat(canvas.transmittance[at], lengths)
    before = after / (1.0 - alpha)
    weight = (alpha * before).astype(np.float32)
    for channel in range(3):
        canvas.color[at, channel] += np.add.reduceat(weight * ellipses.color[ellipse, channel], starts)
    middle = np.flatnonzero((before >= 0.5) & (after < 0.5))
    canvas.depth[pixel[middle]] = depth[middle]
    ends = starts + lengths - 1
    canvas.nearest[at] = np.minimum(canvas.nearest[at], depth[starts])
    canvas.farthest[at] = depth[ends]
    canvas.transmittance[at] = after[ends]
    return waiting


def _sorted(found: _Fragments) -> Index:
    """Return the order of fragments by pixel and depth.

    Sorting one key that contains the index takes a third of the time of a stable sort. Depths are rounded for it to a
    fraction of their range that is at most 2^-12, and those of a million fragments to 2^-17.
    """
    n = len(found.pixel)
    index_bits, pixel_bits = n.bit_length(), int(found.pixel.max()).bit_length()
    steps = 2 ** max(63 - index_bits - pixel_bits, 1) - 1
    low, high = float(found.depth.min()), float(found.depth.max())
    rank = ((found.depth - low) * (steps / max(high - low, 1e-9))).astype(np.int64)
    keys = ((found.pixel * (steps + 1) + rank) << index_bits) + np.arange(n)
    keys.sort()
    return np.asarray(keys & ((1 << index_bits) - 1))
