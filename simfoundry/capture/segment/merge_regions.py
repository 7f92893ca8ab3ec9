"""Merge regions into objects across smooth borders, behind occluders and across rims, and attach hanging parts."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.masks import Labels, hull_mm, in_hull, thinned
from simfoundry.capture.segment.regions import Border, Crop, borders
from simfoundry.capture.segment.support_graph import below, carriers, parts_of
from simfoundry.geometry.frames import Array

EDGE = 0.8  # minimum edge strength of a border that separates two objects
TOUCHING = 3.0  # maximum jump along a border between regions that may touch
SMALL_PART = 0.2  # maximum size of a small part, as a fraction of its neighbor's pixels
SMALL_PART_PATIENCE = 1.5  # factor on the edge strength required to separate a small part
FEW_PAIRS = 60  # minimum number of pixel pairs along a border; shorter borders are inconclusive
HANDLE = 0.35  # maximum area of a handle, as a fraction of its neighbor's area: much smaller than its mug
IN_PLANE = 0.006  # [m] maximum distance of a point in a plane from that plane
SAME_TOP = 0.012  # [m] maximum difference between the top heights of two faces of the same box
SLIVER = 0.1  # a region with less than this fraction of the other region's points is a sliver
WIDEST = 0.25  # [m] maximum radius of a container
RIM = 0.012  # [m] height of the band below the highest point that is treated as a container's rim
Plane = tuple[Array, Array]


def merge_smooth(labels: Labels, crop: Crop, edge: float = EDGE) -> Labels:
    """Merge neighbors, starting with the least separated, until every remaining border is an edge.

    A region much smaller than its neighbor needs a stronger border to count as a separate object. Caps, handles and
    smeared object bases do not qualify.
    """
    graph = borders(labels, crop)
    sizes = dict(enumerate(np.bincount(labels.ravel()).tolist()))
    parent: dict[int, int] = {}
    while True:
        weak = []
        for b in graph.values():
            small, large = sorted((sizes[b.a], sizes[b.b]))
            patience = SMALL_PART_PATIENCE if small < SMALL_PART * large else 1.0
            if b.pairs >= FEW_PAIRS and b.edge < edge * patience:
                weak.append(b)
        if not weak:
            return renamed(labels, parent)
        best = min(weak, key=lambda b: (b.edge, b.a, b.b))
        parent[best.b] = best.a
        sizes[best.a] += sizes.pop(best.b)
        graph = _joined(graph, best.a, best.b)


def _joined(graph: dict[tuple[int, int], Border], keep: int, gone: int) -> dict[tuple[int, int], Border]:
    """Return the borders that remain after region ``gone`` has been merged into region ``keep``."""
    out: dict[tuple[int, int], Border] = {}
    for border in graph.values():
        a, b = (keep if k == gone else k for k in (border.a, border.b))
        if a == b:
            continue
        moved = replace(border, a=a, b=b) if a < b else replace(border, a=b, b=a, jump=-border.jump)
        key = moved.a, moved.b
        out[key] = _sum(out[key], moved) if key in out else moved
    return out


def _sum(one: Border, other: Border) -> Border:
    n = one.pairs + other.pairs
    share = one.pairs / n
    means = {k: share * getattr(one, k) + (1 - share) * getattr(other, k) for k in ("bend", "jump", "meets")}
    return replace(one, pairs=n, **means)


def join_hanging(labels: Labels, crop: Crop) -> Labels:
    """Merge each floating part, such as the handle of a mug, with the part that shares its longest border."""
    parts = parts_of(labels, crop.points_W, crop.pixel_area)
    on, hidden = carriers(parts), below(labels, crop)
    graph = borders(labels, crop).values()
    area = {p.label: p.area for p in parts}
    parent: dict[int, int] = {}
    for part in sorted(parts, key=lambda p: (p.area, p.label)):
        if part.is_grounded or on[part.label] or hidden[part.label] > 0.5:
            continue
        touching = [
            (border.pairs, other)
            for border in graph
            for k, other in ((border.a, border.b), (border.b, border.a))
            if k == part.label and abs(border.jump) < TOUCHING and part.area < HANDLE * area[other]
        ]
        if touching:
            other = root(parent, max(touching, key=lambda found: found[0])[1])
            if other != part.label:
                parent[part.label] = other
    return renamed(labels, parent)


def join_hidden(labels: Labels, crop: Crop) -> Labels:
    """Merge regions that are sides of the same box or bowl behind an occluder.

    The pixels between two faces of a box are included.
    """
    behind: dict[int, set[int]] = {}
    # Thin uniformly, so that the number of points stays proportional to the size of each region.
    points = {k: crop.points_W[labels == k][::4] for k in range(1, int(labels.max()) + 1)}
    for front, back in _occlusions(labels, crop):
        behind.setdefault(front, set()).add(back)
    parent: dict[int, int] = {}
    for front in sorted(behind):
        for a, b in combinations(sorted(behind[front]), 2):
            low, high = sorted((root(parent, a), root(parent, b)))
            if low == high or front in (low, high):
                continue
            if _one_box(points[a], points[b]):
                parent[high] = low
                labels = _between(labels, crop.points_W, front, a, b)
            elif _one_rim(points[a], points[b]) and _one_rim(points[b], points[a]):
                parent[high] = low  # two sides of a bowl, beside what is in it
    return renamed(labels, parent)


def join_containers(labels: Labels, crop: Crop) -> Labels:
    """Merge the outside of a bowl or mug with its inside, which is visible behind the near rim."""
    points = {k: thinned(crop.points_W[labels == k], 1500) for k in range(1, int(labels.max()) + 1)}
    parent: dict[int, int] = {}
    for front, back in _occlusions(labels, crop):
        low, high = sorted((root(parent, front), root(parent, back)))
        if low != high and _one_rim(points[front], points[back]):
            parent[high] = low
    return renamed(labels, parent)


def _one_box(a: Array, b: Array) -> bool:
    """Return True if two sets of points belong to the same upright face, or to the top of a single long box.

    The points [m] have shape (n, 3), and z points up.
    """
    small, large = sorted((a, b), key=len)
    if len(small) < 20:
        return False
    if len(small) < SLIVER * len(large):  # a sliver has no top face of its own
        face = _main_plane(large, level=False)
        if face is not None and _share(large, face) > 0.3 and _share(small, face) > 0.6:
            return True
    if abs(np.quantile(a[:, 2], 0.98) - np.quantile(b[:, 2], 0.98)) > SAME_TOP:
        return False
    both = np.concatenate([a, b])
    upright = _main_plane(both, level=False)
    if upright is not None and min(_share(a, upright), _share(b, upright)) > 0.4:
        return True
    top = _main_plane(both, level=True)
    if top is None or min(_share(a, top), _share(b, top)) < 0.4:
        return False
    widths = [_short_side(p[_distance(p, top) < IN_PLANE]) for p in (a, b, both)]
    return widths[2] < 1.15 * min(widths[:2]) + 0.008


def _one_rim(front: Array, back: Array) -> bool:
    """Return True if the highest points of two sets of points [m] form a circular rim.

    ``front`` is the near part of the rim, and ``back`` is inside it.
    """
    top_front, top_back = np.quantile(front[:, 2], 0.98), np.quantile(back[:, 2], 0.98)
    if abs(top_front - top_back) > 1.5 * RIM:
        return False
    rims = [p[p[:, 2] > top - RIM][:, :2] for p, top in ((front, top_front), (back, top_back))]
    if min(len(r) for r in rims) < 10:
        return False
    xy = np.concatenate(rims)
    system = np.column_stack([2 * xy, np.ones(len(xy))])
    solution = np.linalg.lstsq(system, (xy**2).sum(axis=1), rcond=None)[0]
    center, radius = solution[:2], float(np.sqrt(max(1e-9, solution[2] + solution[:2] @ solution[:2])))
    # A lid or a box top would fill the disk, while the points of a rim are close to the circle.
    round_enough = all(
        np.quantile(np.abs(np.linalg.norm(rim - center, axis=1) - radius), 0.8) < 0.003 + 0.07 * radius for rim in rims
    )
    turn = np.arctan2(*(xy - center).T[::-1])
    seen = len(np.unique(np.floor((turn + np.pi) / (2 * np.pi) * 11.999).astype(int)))
    facing = float((rims[0].mean(axis=0) - center) @ (rims[1].mean(axis=0) - center))
    inside = float(np.mean(np.linalg.norm(back[:, :2] - center, axis=1) < 1.08 * radius + 0.004))
    return bool(round_enough and radius < WIDEST and seen >= 8 and facing < 0 and inside > 0.85)


def _occlusions(labels: Labels, crop: Crop) -> list[tuple[int, int]]:
    """Return the pairs (front, back) of regions that meet at a depth step."""
    return [
        (border.b, border.a) if border.jump > 0 else (border.a, border.b)
        for border in borders(labels, crop).values()
        if abs(border.jump) > max(EDGE, border.bend)
    ]


def _between(labels: Labels, points_W: Array, front: int, a: int, b: int) -> Labels:
    """Move the pixels of ``front`` inside the combined footprint and height of ``a`` and ``b`` to region ``a``."""
    joined = thinned(points_W[(labels == a) | (labels == b)], 1500)
    rows, columns = np.nonzero(labels == front)
    own = points_W[rows, columns]
    top, bottom = np.quantile(joined[:, 2], [0.98, 0.02])
    inside = (own[:, 2] < top + 0.01) & (own[:, 2] > bottom - 0.01)
    inside[inside] = in_hull(hull_mm(joined), own[inside])
    if inside.mean() > 0.5:  # the hull is inconclusive because the front region is inside it
        return labels
    out = labels.copy()
    out[rows[inside], columns[inside]] = a
    return out


def _main_plane(points: Array, level: bool) -> Plane | None:
    """Return the center and normal of the plane that contains the largest number of ``points``.

    If ``level`` is True, only roughly horizontal planes are considered. Otherwise, only roughly vertical planes are
    considered.
    """
    rng = np.random.default_rng(0)
    triples = points[rng.integers(len(points), size=(400, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals / (length[:, None] + 1e-12)
    fit = (length > 1e-7) & ((np.abs(normals[:, 2]) > 0.95) if level else (np.abs(normals[:, 2]) < 0.5))
    if not fit.any():
        return None
    normals, offsets = normals[fit], np.einsum("ij,ij->i", normals[fit], triples[fit][:, 0])
    best = int(np.argmax((np.abs(points @ normals.T - offsets) < 0.005).sum(axis=0)))
    inliers = points[np.abs(points @ normals[best] - offsets[best]) < IN_PLANE]
    center = inliers.mean(axis=0)
    return center, np.linalg.eigh((inliers - center).T @ (inliers - center))[1][:, 0]


def _distance(points: Array, plane: Plane) -> Array:
    return np.asarray(np.abs((points - plane[0]) @ plane[1]))


def _share(points: Array, plane: Plane) -> float:
    return float(np.mean(_distance(points, plane) < IN_PLANE))


def _short_side(points: Array) -> float:
    """Return the shorter side [m] of the smallest rectangle around ``points`` in the xy plane."""
    import cv2

    inner = points[:, :2].astype(np.float32) * 1000
    return float(min(cv2.minAreaRect(inner)[1])) / 1000


def renamed(labels: Labels, parent: dict[int, int]) -> Labels:
    """Recursively merge every region in ``parent`` into its parent, and renumber the labels 1..n without gaps."""
    return compact(np.array([root(parent, region) for region in range(int(labels.max()) + 1)])[labels])


def compact(labels: NDArray[np.integer[Any]]) -> Labels:
    """Renumber the non-zero labels 1..n, preserving their order."""
    present = np.unique(labels[labels > 0])
    table = np.zeros(int(labels.max()) + 1, np.int32)
    table[present] = np.arange(1, len(present) + 1)
    return np.asarray(table[labels], dtype=np.int32)


def root(parent: dict[int, int], k: int) -> int:
    """Return the region into which ``k`` was ultimately merged."""
    while k in parent:
        k = parent[k]
    return k
