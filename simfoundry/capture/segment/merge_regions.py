"""Merging of regions into objects across borders that are smooth or bent outward."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.regions import Border, Labels, borders
from simfoundry.capture.segment.support_graph import below, carriers, parts_of
from simfoundry.geometry.frames import Array

EDGE = 0.8  # edge of a border from which it separates two objects
TOUCHING = 3.0  # jump along a border up to which two regions may touch
SMALL_PART = 0.2  # of its neighbor's pixels
SMALL_PART_PATIENCE = 1.5  # factor on the edge that separates such a part
FEW_PAIRS = 60  # a shorter border says nothing


def merge_smooth(labels: Labels, depth: Array, reach: int, edge: float = EDGE) -> Labels:
    """Merge neighbors, starting with the least separated, until every remaining border is an edge.

    Next to a region many times its size, a small one must be separated more clearly to be an object: caps,
    handles and the smeared feet of objects are not.
    """
    graph = borders(labels, depth, reach)
    sizes = dict(enumerate(np.bincount(labels.ravel()).tolist()))
    parent: dict[int, int] = {}
    while True:
        weak = [b for b in graph.values() if b.pairs >= FEW_PAIRS and b.edge < edge * _patience(sizes, b)]
        if not weak:
            return renamed(labels, parent)
        best = min(weak, key=lambda b: (b.edge, b.a, b.b))
        parent[best.b] = best.a
        sizes[best.a] += sizes.pop(best.b)
        graph = _joined(graph, best.a, best.b)


def _patience(sizes: dict[int, int], border: Border) -> float:
    small, large = sorted((sizes[border.a], sizes[border.b]))
    return SMALL_PART_PATIENCE if small < SMALL_PART * large else 1.0


def _joined(graph: dict[tuple[int, int], Border], keep: int, gone: int) -> dict[tuple[int, int], Border]:
    """The borders after ``gone`` has become part of ``keep``."""
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
    bend = share * one.bend + (1 - share) * other.bend
    jump = share * one.jump + (1 - share) * other.jump
    meets = share * one.meets + (1 - share) * other.meets
    return replace(one, pairs=n, bend=bend, jump=jump, meets=meets)


def renamed(labels: Labels, parent: dict[int, int]) -> Labels:
    """``labels`` after every region in ``parent`` has become its parent, and so on up, numbered 1..n without gaps."""
    table = np.arange(int(labels.max()) + 1)
    for region in table:
        root = int(region)
        while root in parent:
            root = parent[root]
        table[region] = root
    return compact(table[labels])


def compact(labels: NDArray[np.integer[Any]]) -> Labels:
    """Number the non-zero labels 1..n in ascending order."""
    present = np.unique(labels[labels > 0])
    table = np.zeros(int(labels.max()) + 1, np.int32)
    table[present] = np.arange(1, len(present) + 1)
    return np.asarray(table[labels], dtype=np.int32)


def join_hanging(
    labels: Labels, depth: Array, K: Array, points_W: Array, down: tuple[float, float], reach: int
) -> Labels:
    """Merge floating parts, such as the handle of a mug, with the part they touch most."""
    parts = parts_of(labels, points_W, depth, K)
    on, hidden = carriers(parts), below(labels, depth, down, reach)
    graph = borders(labels, depth, reach)
    parent: dict[int, int] = {}
    for part in sorted(parts, key=lambda p: (p.area, p.label)):
        if part.is_grounded or on[part.label] or hidden[part.label] > 0.5:
            continue
        # A handle is far smaller than its mug, and no farther off than its rim is wide.
        size = {p.label: p.area for p in parts}
        touching = [
            b
            for b in graph.values()
            if part.label in (b.a, b.b) and abs(b.jump) < TOUCHING and part.area < 0.35 * size[_other(b, part.label)]
        ]
        if touching:
            most = max(touching, key=lambda b: b.pairs)
            other = root(parent, _other(most, part.label))
            if other != part.label:
                parent[part.label] = other
    return renamed(labels, parent)


def _other(border: Border, label: int) -> int:
    return border.a if border.b == label else border.b


def root(parent: dict[int, int], k: int) -> int:
    """Follow the joins of ``k`` to the region that remains."""
    while k in parent:
        k = parent[k]
    return k
