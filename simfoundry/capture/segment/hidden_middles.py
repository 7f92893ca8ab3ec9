"""Join the visible parts of objects whose middle another object hides."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.segment.merge_regions import renamed, root
from simfoundry.geometry.frames import Array

WIDTH = 640  # [px] width to which larger images are reduced
# Two regions that meet all of these limits were one object in 3 of 3 cases on 70 real tables, and in 4 of 4 on 250
# synthetic ones that nothing was chosen on.
ALIKE = 12.0  # maximum distance of their median colors in CIELAB, in which lightness counts half because of shading
LEVEL = 0.004  # [m] maximum difference of their highest points; tops of different objects are seldom as equal
HIGHEST = 0.97  # quantile of heights that is the highest point, without stray ones
HIDDEN = 0.65  # minimum share of what is between them that something nearer, or without depth, hides
NEARER = 0.015  # [m] minimum distance of what hides them
FARTHEST = 0.25  # [m] maximum distance of their centers; few objects on tables are larger
LINES, STEPS = 60, 40  # number of lines between them along which the image is examined, and of places on each


@dataclass(frozen=True, eq=False)
class _Region:
    """The pixels (row, column), shape (n, 2), of a region, its color, center in plan [m] and highest point [m]."""

    pixels: NDArray[np.intp]
    color: Array
    center: Array
    top: float


def join_parts(labels: Labels, frame: Frame, points_W: Array) -> tuple[Labels, list[tuple[int, int]]]:
    """Join regions that are alike and have something between them that hides whether they are one object.

    Args:
        labels: The regions, shape (h, w).
        frame: The image.
        points_W: Its points in the world [m], shape (h, w, 3).

    Returns:
        The regions, numbered without gaps, and a pixel (row, column) in each that was joined.
    """
    import cv2

    step = max(1, round(labels.shape[1] / WIDTH))
    small, depth, points = labels[::step, ::step], frame.depth[::step, ::step], points_W[::step, ::step]
    color = cv2.cvtColor(np.ascontiguousarray(frame.color[::step, ::step], np.float32) / 255, cv2.COLOR_RGB2LAB)
    regions = {int(k): _region(np.argwhere(small == k), color, points) for k in np.unique(small[small > 0])}
    parent: dict[int, int] = {}
    for (a, one), (b, other) in combinations(regions.items(), 2):
        near = np.linalg.norm(one.center - other.center) < FARTHEST and abs(one.top - other.top) < LEVEL
        alike = near and np.linalg.norm(one.color - other.color) < ALIKE
        if alike and root(parent, a) != root(parent, b) and _hidden(one, other, small, depth) > HIDDEN:
            parent[root(parent, b)] = root(parent, a)
    marks = [regions[k].pixels[0] * step for k in {root(parent, k) for k in parent}]
    return renamed(labels, parent), [(int(row), int(column)) for row, column in marks]


def _region(pixels: NDArray[np.intp], color: NDArray[np.float32], points: Array) -> _Region:
    own = points[tuple(pixels.T)]
    own = own[np.isfinite(own[:, 2])]
    if not len(own):
        own = np.full((1, 3), np.nan)
    tone = np.median(color[tuple(pixels.T)].astype(np.float64), axis=0) * [0.5, 1.0, 1.0]
    return _Region(pixels, tone, np.median(own[:, :2], axis=0), float(np.quantile(own[:, 2], HIGHEST)))


def _hidden(one: _Region, other: _Region, labels: Labels, depth: Array) -> float:
    """Return the share of what is between two regions in the image that is hidden by an object, or has no depth."""
    rng = np.random.default_rng(0)
    start, end = (r.pixels[rng.integers(len(r.pixels), size=LINES)] for r in (one, other))
    t = np.linspace(0, 1, STEPS)[:, None]
    rows, columns = (np.rint(start[:, k] + (end[:, k] - start[:, k]) * t).astype(np.intp) for k in (0, 1))
    first, last, seen, there = depth[tuple(start.T)], depth[tuple(end.T)], depth[rows, columns], labels[rows, columns]
    straight = 1 / ((1 - t) / first + t / last)  # depth along a straight line in space
    own = [labels[tuple(pixels[0])] for pixels in (start, end)]
    gap = ~np.isin(there, own) & np.isfinite(straight)
    hiding = gap & (np.isnan(seen) | ((there > 0) & (seen < straight - NEARER)))
    return float(hiding.sum() / gap.sum()) if gap.any() else 0.0
