"""Places for things by rejection: uniform over all that is allowed, however that is shaped.

Positions and turns are drawn uniformly over a rectangle that holds every allowed one, many at once; the first that
passes every test is taken. So each allowed place is as likely as any other. Tests, from cheap to dear: the whole shadow
is over the support; no rectangle of what stands there is met, which is exact for boxes; what else is asked of the pose,
on all that are left together; the real convex parts, one candidate after the other, where rectangles overlap.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.cousins.outline import Outline
from simfoundry.cousins.support import Support
from simfoundry.scene.frames import Array

TRIES = 4096
"""Candidates until a thing counts as not placeable among what stands there."""

FIRST, MOST = 16, 1024
"""Candidates that are looked at together: first, and at most; more each time."""

NEAR_LEVEL = 0.02
"""What is lowest within this [m] of a level stands on it."""

Mask = NDArray[np.bool_]
Allowed = Callable[[Array, Array, Array], Mask]
"""Which candidates are allowed: x, y [m] of the thing's frame and turn about z [rad], shape (n,) each."""

Clear = Callable[[float, float, float, tuple[int, ...]], bool]
"""Whether one candidate is clear of the entries (by number) whose rectangles it meets, and all that is dear to ask."""


class There:
    """What stands there: for each entry a rectangle and a span of heights. Things of several links have several.

    Entries that are ``passed``, by number, are not met.
    """

    def __init__(self, room: int = 64) -> None:
        self.count = 0
        self.owners: list[str] = []
        self.passed: list[int] = []
        self._rows = np.zeros((10, room))
        self._boxy = np.zeros(room, dtype=bool)

    def add(self, owner: str, outline: Outline, x: float, y: float, z: float, yaw: float) -> None:
        """Add a thing whose frame is at x, y, z [m] and turned by ``yaw`` [rad] about z."""
        k = self.count
        if k == self._rows.shape[1]:
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)], axis=1)
            self._boxy = np.concatenate([self._boxy, np.zeros_like(self._boxy)])
        c, s = math.cos(yaw), math.sin(yaw)
        cx, cy = outline.centre.tolist()
        hx, hy = outline.half.tolist()
        turn = yaw + outline.angle
        self._rows[:, k] = (
            x + c * cx - s * cy,
            y + s * cx + c * cy,
            hx,
            hy,
            math.cos(turn),
            math.sin(turn),
            math.hypot(hx, hy),
            z + outline.low,
            z + outline.high,
            outline.area,
        )
        self._boxy[k] = outline.boxy
        self.owners.append(owner)
        self.count = k + 1

    def near(self, x: Array, y: Array, outline: Outline, z: float, gap: float) -> tuple[Mask, Array, Array]:
        """Pairs of candidates and entries whose circles are nearer than ``gap``, (n, k), and their offsets [m]."""
        n = self.count
        rows = self._rows[:, :n]
        dx, dy = rows[0] - x[:, None], rows[1] - y[:, None]
        reach = rows[6] + (math.hypot(*outline.half.tolist()) + gap)
        near = dx * dx + dy * dy < reach * reach
        low, high = z + outline.low - gap, z + outline.high + gap
        level = (rows[7] < high) & (rows[8] > low)
        if not level.all():
            near &= level
        if self.passed:
            near[:, self.passed] = False
        return near, dx, dy

    def met(
        self, i: NDArray[np.intp], j: NDArray[np.intp], dx: Array, dy: Array, turn: Array, half: Array, gap: float
    ) -> Mask:
        """Whether rectangles turned by ``turn`` [rad] meet those of entries: no side of either is between them."""
        hx, hy, cb, sb = self._rows[2:6, j]
        ca, sa = np.cos(turn)[i], np.sin(turn)[i]
        cos, sin = np.abs(ca * cb + sa * sb), np.abs(sa * cb - ca * sb)
        a, b = half.tolist()
        met = np.abs(dx * ca + dy * sa) < a + gap + hx * cos + hy * sin
        met &= np.abs(dy * ca - dx * sa) < b + gap + hx * sin + hy * cos
        met &= np.abs(dx * cb + dy * sb) < hx + gap + a * cos + b * sin
        met &= np.abs(dy * cb - dx * sb) < hy + gap + a * sin + b * cos
        return np.asarray(met)

    def area_on(self, height: float) -> float:
        """Sum of the shadows [m^2] of what is lowest near a height [m]."""
        low, area = self._rows[7, : self.count], self._rows[9, : self.count]
        return float(area[np.abs(low - height) < NEAR_LEVEL].sum())

    def boxy(self, j: NDArray[np.intp]) -> Mask:
        """Whether entries fill their rectangles."""
        return np.asarray(self._boxy[j])


@dataclass(frozen=True, eq=False)
class Region:
    """Where the centre of a thing's rectangle is drawn from [m], shape (2,) each, how it may be turned [rad], and on
    what it stands, at the height ``z`` [m] of its frame."""

    low: Array
    high: Array
    turn: tuple[float, float]
    support: Support
    z: float


@dataclass(frozen=True)
class Found:
    """Where a thing goes: x, y [m] of its frame, turn about z [rad]; or None, and what became of all candidates."""

    spot: tuple[float, float, float] | None
    tried: int
    standing: int
    allowed: int


def find(
    outline: Outline,
    region: Region,
    there: There,
    rng: np.random.Generator,
    gap: float = 0.0,
    allowed: Allowed | None = None,
    clear: Clear | None = None,
    tries: int = TRIES,
) -> Found:
    """A place for a thing in a region, uniform over all that are allowed; at most ``tries`` candidates."""
    tried = standing = permitted = 0
    size = FIRST
    low, span = np.array([*region.low, region.turn[0]]), np.array([*region.high, region.turn[1]])
    span = span - low
    cx, cy = outline.centre.tolist()
    while tried < tries:
        x, y, yaw = (low + rng.random((size, 3)) * span).T
        tried += size
        size = min(4 * size, MOST)
        cos, sin = np.cos(yaw), np.sin(yaw)
        left = np.flatnonzero(region.support.holds(x, y, cos, sin, outline))
        if not len(left):
            continue
        x, y, yaw, cos, sin = x[left], y[left], yaw[left], cos[left], sin[left]
        px, py = x - cos * cx + sin * cy, y - sin * cx - cos * cy
        standing += len(left)
        if allowed is not None:
            some = np.flatnonzero(allowed(px, py, yaw))
            if not len(some):
                continue
            x, y, yaw, px, py = x[some], y[some], yaw[some], px[some], py[some]
        permitted += len(x)
        spot = _first(outline, region, there, gap, clear, x, y, yaw, px, py)
        if spot is not None:
            return Found(spot, tried, standing, permitted)
    return Found(None, tried, standing, permitted)


def _first(
    outline: Outline,
    region: Region,
    there: There,
    gap: float,
    clear: Clear | None,
    x: Array,
    y: Array,
    yaw: Array,
    px: Array,
    py: Array,
) -> tuple[float, float, float] | None:
    """The first candidate that is clear of everything."""
    near, dx, dy = there.near(x, y, outline, region.z, gap)
    lonely = ~near.any(axis=1)
    if clear is None and lonely.any():  # what comes after one that is surely free need not be looked at
        near[int(lonely.argmax()) :] = False
    i, j = near.nonzero()
    blocked = np.zeros(len(x), dtype=bool)
    doubts: dict[int, list[int]] = {}
    if len(i):
        met = there.met(i, j, dx[i, j], dy[i, j], yaw + outline.angle, outline.half, gap)
        sure = met & there.boxy(j) if outline.boxy else np.zeros(len(i), dtype=bool)
        blocked[i[sure]] = True
        for k in np.flatnonzero(met & ~sure):
            doubts.setdefault(int(i[k]), []).append(int(j[k]))
    for k in np.flatnonzero(~blocked):
        spot = (float(px[k]), float(py[k]), float(yaw[k]))
        met_by = tuple(doubts.get(int(k), ()))
        if (clear is None and not met_by) or (clear is not None and clear(*spot, met_by)):
            return spot
    return None
