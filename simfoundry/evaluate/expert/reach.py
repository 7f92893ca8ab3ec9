"""Paths of one arm through the scene: straight lines of the hand, and ways around what is in between."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.expert.arm import Arm
from simfoundry.evaluate.expert.cell import Cell
from simfoundry.evaluate.expert.jaws import Jaws
from simfoundry.geometry.frames import Array, Pose

Path = list[Array]
"""Postures to go through, each shape (n,) [rad or m]."""

LINE = 0.015
"""Between the postures of a straight line [m]."""

TURN = 0.1
"""And between their rotations [rad]."""

LEAP = 0.35
"""A joint that moves more than this between them [rad] has changed its branch."""

FINE = 0.08
"""Between the postures of a path that are looked at [rad]."""

GAP = 0.004
"""What moves freely stays this far from everything [m]."""

WIDE = 0.02
"""And on its way this far where it can: the joints lag behind their targets, each in its own way, and cut corners."""

NODES, STRIDE = 1500, 0.3
"""How many postures a search tries, and how far it steps [rad]."""


@dataclass(frozen=True, eq=False)
class Held:
    """What a hand holds, and how: ``X_HO``."""

    name: str
    X_HO: Pose


class Reach:
    """One arm in its cell."""

    def __init__(self, cell: Cell, arm: Arm, fingers: Jaws, rng: np.random.Generator) -> None:
        self.cell, self.arm, self.jaws, self.rng = cell, arm, fingers, rng
        self.name = arm.robot.name

    def clear(
        self, q: Array, share: float, held: Held | None = None, gap: float = GAP, ignore: Iterable[str] = ()
    ) -> bool:
        """Whether a posture touches nothing."""
        self.cell.pose(self.name, q, share)
        moving = [self.name]
        if held is not None:
            self.cell.put(held.name, self.arm.hand(q) @ held.X_HO)
            moving.append(held.name)
        return self.cell.clash(moving, gap, ignore) is None

    def line(
        self,
        q: Array,
        X_WH: Pose,
        share: float,
        held: Held | None = None,
        gap: float = 0.0,
        ignore: Iterable[str] = (),
    ) -> Path | None:
        """Postures that take the hand from ``q`` straight to ``X_WH``; None where it cannot go so."""
        start = self.arm.hand(q)
        count = max(1, int(np.ceil(max(float(np.linalg.norm(X_WH.p - start.p)) / LINE, start.angle_to(X_WH) / TURN))))
        path = [q]
        for k in range(1, count + 1):
            between = self.arm.solve(blend(start, X_WH, k / count), path[-1])
            if between is None or np.abs(between - path[-1]).max() > LEAP:
                return None
            if not self.clear(between, share, held, gap, ignore):
                return None
            path.append(between)
        return path

    def way(
        self, q: Array, goal: Array, share: float, held: Held | None = None, ignore: Iterable[str] = ()
    ) -> Path | None:
        """Postures from ``q`` to ``goal`` around what is in between, far from it if there is such a way; or None."""
        ignored = tuple(ignore)
        for gap in (WIDE, GAP):

            def free(posture: Array, gap: float = gap) -> bool:
                return self.clear(posture, share, held, gap, ignored)

            if not free(goal):
                continue
            if _straight(q, goal, free):
                return [q, goal]
            found = _search(q, goal, free, self.arm.low, self.arm.high, self.rng)
            if found is not None:
                return _shortened(found, free, self.rng)
        return None


def blend(a: Pose, b: Pose, share: float) -> Pose:
    """A pose between two."""
    qb = b.q if float(a.q @ b.q) >= 0 else -b.q
    angle = float(np.arccos(np.clip(a.q @ qb, -1.0, 1.0)))
    if angle < 1e-6:
        return Pose.of(a.p + share * (b.p - a.p), b.q)
    q = (np.sin((1 - share) * angle) * a.q + np.sin(share * angle) * qb) / np.sin(angle)
    return Pose.of(a.p + share * (b.p - a.p), q)


def _straight(a: Array, b: Array, free: object) -> bool:
    """Whether every posture between two is free; the first is taken to be."""
    count = max(1, int(np.ceil(np.abs(b - a).max() / FINE)))
    return all(free(a + (b - a) * k / count) for k in range(1, count + 1))  # type: ignore[operator]


def _search(start: Array, goal: Array, free: object, low: Array, high: Array, rng: np.random.Generator) -> Path | None:
    """Rapidly exploring random trees from both ends (RRT-Connect, Kuffner and LaValle 2000)."""
    trees = ([start], [goal])
    parents: tuple[list[int], list[int]] = ([-1], [-1])
    side = 0
    for _ in range(NODES):
        # Between the two ends more often than anywhere: most ways lead there.
        mix = rng.uniform(size=len(start))
        near = start + mix * (goal - start) + rng.normal(scale=0.5, size=len(start))
        sample = np.clip(near, low, high) if rng.uniform() < 0.8 else rng.uniform(low, high)
        new = _extend(trees[side], parents[side], sample, free)
        if new is not None:
            other = 1 - side
            while True:
                step = _extend(trees[other], parents[other], trees[side][new], free)
                if step is None:
                    break
                if np.abs(trees[other][step] - trees[side][new]).max() < 1e-9:
                    ends = [_back(trees[0], parents[0], new if side == 0 else step)[::-1]]
                    return ends[0] + _back(trees[1], parents[1], step if side == 0 else new)[1:]
        side = 1 - side
    return None


def _extend(tree: list[Array], parent: list[int], towards: Array, free: object) -> int | None:
    """Grow a tree by one step; the number of the new posture."""
    distance = np.abs(np.array(tree) - towards).max(axis=1)
    nearest = int(distance.argmin())
    if distance[nearest] < 1e-9:
        return None
    step = tree[nearest] + (towards - tree[nearest]) * min(1.0, STRIDE / distance[nearest])
    if not _straight(tree[nearest], step, free):
        return None
    tree.append(step)
    parent.append(nearest)
    return len(tree) - 1


def _back(tree: list[Array], parent: list[int], k: int) -> Path:
    found = []
    while k >= 0:
        found.append(tree[k])
        k = parent[k]
    return found


def _shortened(path: Path, free: object, rng: np.random.Generator) -> Path:
    """A path without detours that need not be."""
    for _ in range(40):
        if len(path) < 3:
            break
        i, j = sorted(int(k) for k in rng.choice(len(path), 2, replace=False))
        if j > i + 1 and _straight(path[i], path[j], free):
            path = path[: i + 1] + path[j:]
    return path
