"""Join regions into objects: what is smooth or bent outwards across a border belongs together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.capture.regions import Border, Labels, borders
from simfoundry.capture.stacking import below, carriers, parts_of
from simfoundry.scene.frames import Array

EDGE = 0.8  # edge of a border from which it separates two objects
FEW_PAIRS = 60  # a shorter border says nothing


def merge_smooth(labels: Labels, depth: Array, reach: int, edge: float = EDGE) -> Labels:
    """Join neighbours, the least separated first, until every border left is an edge."""
    graph = borders(labels, depth, reach)
    parent: dict[int, int] = {}
    while True:
        weak = [b for b in graph.values() if b.edge < edge and b.pairs >= FEW_PAIRS]
        if not weak:
            return renamed(labels, parent)
        best = min(weak, key=lambda b: (b.edge, b.a, b.b))
        parent[best.b] = best.a
        graph = _joined(graph, best.a, best.b)


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
    return replace(one, pairs=n, bend=bend, jump=jump)


def renamed(labels: Labels, parent: dict[int, int]) -> Labels:
    """``labels`` after every region in ``parent`` has become its parent, and so on up, numbered 1..n without gaps."""
    table = np.arange(int(labels.max()) + 1)
    for region in table:
        root = int(region)
        while root in parent:
            root = parent[root]
        table[region] = root
    return compact(table[labels])


def compact(labels: np.ndarray) -> Labels:
    """Number the non-zero labels 1..n in ascending order."""
    present = np.unique(labels[labels > 0])
    table = np.zeros(int(labels.max()) + 1, np.int32)
    table[present] = np.arange(1, len(present) + 1)
    return table[labels]


def join_hidden(labels: Labels, depth: Array, points_W: Array, reach: int) -> Labels:
    """Join regions that lie in one plane and are parted by something in front of both."""
    graph = borders(labels, depth, reach)
    behind: dict[int, set[int]] = {}
    for border in graph.values():
        if abs(border.jump) > EDGE and abs(border.jump) > border.bend:
            front, back = (border.b, border.a) if border.jump > 0 else (border.a, border.b)
            behind.setdefault(front, set()).add(back)
    count = int(labels.max())
    points = {k: _thinned(points_W[labels == k]) for k in range(1, count + 1)}
    parent: dict[int, int] = {}
    for front in sorted(behind):
        backs = sorted(behind[front])
        for i, a in enumerate(backs):
            for b in backs[i + 1 :]:
                low, high = sorted((_root(parent, a), _root(parent, b)))
                if low != high and (low, high) not in graph and _one_plane(points[a], points[b]):
                    parent[high] = low
    return renamed(labels, parent)


def _root(parent: dict[int, int], k: int) -> int:
    while k in parent:
        k = parent[k]
    return k


def _thinned(points: Array) -> Array:
    return points[:: max(1, len(points) // 1500)]


def _one_plane(a: Array, b: Array) -> bool:
    """Whether the main face of each of two point sets [m] goes on in the other, and is not level (tops are alike)."""
    if min(len(a), len(b)) < 30:
        return False
    share = []
    for one, other in ((a, b), (b, a)):
        center, normal = main_plane(one)
        if abs(normal[2]) > 0.9:
            return False
        share.append(float(np.mean(np.abs((other - center) @ normal) < 0.008)))
    return min(share) > 0.5


def main_plane(points: Array) -> tuple[Array, Array]:
    """Centre and normal of the plane through most of ``points`` [m], shape (n, 3)."""
    rng = np.random.default_rng(0)
    triples = points[rng.integers(len(points), size=(200, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    offsets = np.einsum("ij,ij->i", normals, triples[:, 0])
    best = int(np.argmax((np.abs(points @ normals.T - offsets) < 0.005).sum(axis=0)))
    inliers = points[np.abs(points @ normals[best] - offsets[best]) < 0.006]
    center = inliers.mean(axis=0)
    return center, np.linalg.eigh(np.cov((inliers - center).T))[1][:, 0]


def join_hanging(labels: Labels, depth: Array, K: Array, points_W: Array, down: tuple[float, float], reach: int) -> Labels:
    """Join what hangs in the air, like the handle of a mug, to what it touches most."""
    parts = parts_of(labels, points_W, depth, K)
    on, hidden = carriers(parts), below(labels, depth, down, reach)
    graph = borders(labels, depth, reach)
    parent: dict[int, int] = {}
    for part in sorted(parts, key=lambda p: (p.area, p.label)):
        if part.is_grounded or on[part.label] or hidden[part.label] > 0.5:
            continue
        touching = [b for b in graph.values() if part.label in (b.a, b.b) and abs(b.jump) < 3.0]
        if touching:
            most = max(touching, key=lambda b: b.pairs)
            other = _root(parent, most.a if most.b == part.label else most.b)
            if other != part.label:
                parent[part.label] = other
    return renamed(labels, parent)
