"""Places for things by rejection: uniform over all that is allowed, however that is shaped.

Positions and turns are drawn uniformly over a rectangle that holds every allowed one, many at once; the first that
passes every test is taken. So each allowed place is as likely as any other. Tests, in their order: the whole shadow is
over the support; what is asked of the pose, on all that are left together; no rectangle of what stands there is met,
which is exact for boxes; the real convex parts, one candidate after the other, where rectangles overlap.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.cousins.layout.supports import Complex, Outline, Support
from simfoundry.geometry.frames import Array

TRIES = 4096
"""Candidates until a thing counts as not placeable among what stands there."""

FIRST, FIRST_JUDGED, MOST = 4, 64, 1024
"""Candidates that are looked at together: first, also where they are judged, and at most; more each time."""

NEAR_LEVEL = 0.02
"""What is lowest within this [m] of a level stands on it."""

Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Allowed = Callable[[Array, Array, Array], Mask]
"""Which candidates are allowed: x, y [m] of the thing's frame and turn about z [rad], shape (n,) each."""

Clear = Callable[[float, float, float, tuple[int, ...]], bool]
"""Whether one candidate is clear of the entries, by number, whose rectangles it meets."""

Last = Callable[[float, float, float], bool]
"""Whether one candidate passes what is too dear to ask of many."""


class Occupancy:
    """Rectangles and spans of heights of what stands on a support; objects of several links have several entries."""

    def __init__(self, room: int = 64) -> None:
        self.count = 0
        self.owners: list[str] = []
        self._rows = np.zeros((6, room))  # centre x and y, radius of the circle around, lowest, highest, shadow's area
        self._heights = np.zeros((2, room))  # lowest and highest, also of what is set aside
        self._half, self._turn = np.zeros((2, room), dtype=np.complex128)
        self._boxy: list[bool] = []

    def add(self, owner: str, outline: Outline, x: float, y: float, z: float, yaw: float) -> None:
        """Add a thing whose frame is at x, y, z [m] and turned by ``yaw`` [rad] about z."""
        k = self.count
        if k == len(self._half):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)], axis=1)
            self._heights = np.concatenate([self._heights, np.zeros_like(self._heights)], axis=1)
            self._half, self._turn = (np.concatenate([v, np.zeros_like(v)]) for v in (self._half, self._turn))
        turn = cmath.rect(1.0, yaw)
        centre = complex(x, y) + turn * outline.middle
        self._rows[:, k] = centre.real, centre.imag, outline.size, z + outline.low, z + outline.high, outline.area
        self._heights[:, k] = self._rows[3:5, k]
        self._half[k], self._turn[k] = complex(*outline.half.tolist()), turn * outline.turn
        self._boxy.append(outline.boxy)
        self.owners.append(owner)
        self.count = k + 1

    def set_aside(self, owner: str | None) -> None:
        """Leave out what is called ``owner``, and nothing else: what stands on it touches it."""
        self._rows[3:5, : self.count] = self._heights[:, : self.count]
        aside = [k for k, name in enumerate(self.owners) if name == owner]
        self._rows[3, aside], self._rows[4, aside] = np.inf, -np.inf

    def near(self, centre: Array, outline: Outline, z: float, gap: float) -> tuple[Mask, Array, Array]:
        """Pairs of candidates and entries whose circles are nearer than ``gap``, (n, k), and their offsets [m]."""
        rows = self._rows[:, : self.count]
        dx, dy = rows[0] - centre[:, :1], rows[1] - centre[:, 1:]
        reach = rows[2] + (outline.size + gap)
        near = dx * dx + dy * dy < reach * reach
        level = (rows[3] < z + outline.high + gap) & (rows[4] > z + outline.low - gap)
        if not level.all():
            near &= level
        return near, dx, dy

    def met(self, i: Index, j: Index, dx: Array, dy: Array, turn: Complex, outline: Outline, gap: float) -> Mask:
        """Return whether rectangles of candidates i, turned by unit complex numbers, meet those of entries j.

        ``dx`` and ``dy`` [m] are the offsets between their centres.
        """
        half = complex(*outline.half.tolist())
        return rectangles_meet(dx + 1j * dy, turn[i] * outline.turn, half, self._turn[j], self._half[j], gap)

    def all_met(
        self, entries: range, centre: Complex, side: Complex, half: Complex, low: Array, high: Array, gap: float
    ) -> Iterator[tuple[int, int]]:
        """Pairs of rectangles, as in :func:`rectangles_meet`, with a span of heights each, and of entries they meet."""
        rows = self._rows[:, entries.start : entries.stop]
        if not rows.shape[1]:
            return
        off = (rows[0] + 1j * rows[1]) - centre[:, None]
        reach = rows[2] + (np.abs(half)[:, None] + gap)
        near = off.real**2 + off.imag**2 < reach * reach
        near &= (rows[3] < high[:, None] + gap) & (rows[4] > low[:, None] - gap)
        i, j = near.nonzero()
        k = j + entries.start
        met = rectangles_meet(off[i, j], side[i], half[i], self._turn[k], self._half[k], gap)
        yield from zip(i[met].tolist(), k[met].tolist(), strict=True)

    def area_on(self, height: float) -> float:
        """Sum of the shadows [m^2] of what is lowest near a height [m]."""
        low, area = self._rows[3, : self.count], self._rows[5, : self.count]
        return float(area[np.abs(low - height) < NEAR_LEVEL].sum())

    def any_boxy(self, entries: Iterable[int]) -> bool:
        """Return whether one of some entries fills its rectangle."""
        return any(self._boxy[k] for k in entries)


def rectangles_meet(
    off: Complex, turn_a: Complex, half_a: Complex | complex, turn_b: Complex, half_b: Complex | complex, gap: float
) -> Mask:
    """Return whether rectangles are nearer than ``gap`` [m] along the sides of both: no line lies between them.

    ``off`` is from the centre of the first to that of the second [m]; turns are unit complex numbers; half extents [m]
    have that along the first side as real part.
    """
    way = turn_a * turn_b.conj()
    cos, sin = np.abs(way.real), np.abs(way.imag)
    a, b = off * turn_a.conj(), off * turn_b.conj()
    met = np.abs(a.real) < half_a.real + gap + half_b.real * cos + half_b.imag * sin
    met &= np.abs(a.imag) < half_a.imag + gap + half_b.real * sin + half_b.imag * cos
    met &= np.abs(b.real) < half_b.real + gap + half_a.real * cos + half_a.imag * sin
    met &= np.abs(b.imag) < half_b.imag + gap + half_a.real * sin + half_a.imag * cos
    return np.asarray(met)


@dataclass(frozen=True, eq=False)
class Region:
    """A range for the centre of an object's rectangle [m], shape (2,) each, for its turn [rad]; the ``support`` that
    it stands on, and the height ``z`` [m] of its frame there."""

    low: Array
    high: Array
    turn: tuple[float, float]
    support: Support
    z: float

    @cached_property
    def span(self) -> tuple[Array, Array]:
        """The lowest x, y [m] and turn [rad], and how far they go from there, shape (3,) each."""
        low, high = np.array([*self.low, self.turn[0]]), np.array([*self.high, self.turn[1]])
        return low, high - low

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Centres [m], shape (count, 2), and turns [rad], shape (count,), uniform over all of it."""
        low, span = self.span
        drawn = rng.random((count, 3)) * span + low
        return drawn[:, :2], drawn[:, 2]


@dataclass(frozen=True)
class Found:
    """A place for an object: x, y [m] of its frame, turn about z [rad], or None; and what became of all candidates."""

    spot: tuple[float, float, float] | None
    tried: int
    standing: int
    allowed: int


@dataclass(frozen=True, eq=False)
class Demands:
    """Tests that a place must pass beyond being over the support and clear of what fills its rectangle.

    ``allowed`` is asked of many at once; ``clear`` of one that meets rectangles of entries, with their numbers; and
    ``last`` of one that is clear.
    """

    allowed: Allowed | None = None
    clear: Clear | None = None
    last: Last | None = None


def find(
    outline: Outline,
    region: Region,
    there: Occupancy,
    rng: np.random.Generator,
    gap: float,
    demands: Demands,
    tries: int = TRIES,
) -> Found:
    """A place for a thing in a region, uniform over all that pass every test; of at most ``tries`` candidates."""
    tried = standing = permitted = 0
    size, offset = FIRST if demands.allowed is None else FIRST_JUDGED, outline.middle
    while tried < tries:
        centre, yaw = region.draw(rng, size)
        turn = np.exp(1j * yaw)
        tried += size
        size = min(4 * size, MOST)
        left = region.support.holds(centre, turn, outline.spread).nonzero()[0]
        standing += len(left)
        if demands.allowed is not None and len(left):
            p = _frames(centre[left], turn[left], offset)
            left = left[demands.allowed(p.real, p.imag, yaw[left])]
            permitted += len(left)
        if not len(left):
            continue
        centre, yaw, turn = centre[left], yaw[left], turn[left]
        for k, met in _unblocked(outline, region.z, there, gap, demands.last is None, centre, turn):
            if met and (demands.clear is None or not demands.clear(*_spot(centre[k], yaw[k], turn[k], offset), met)):
                continue
            spot = _spot(centre[k], yaw[k], turn[k], offset)
            if demands.last is None or demands.last(*spot):
                return Found(spot, tried, standing, permitted)
    return Found(None, tried, standing, permitted)


def _frames(centre: Array, turn: Complex, offset: complex) -> Complex:
    """Return where the frames are, x + iy [m], of things whose rectangles are centred so."""
    return np.asarray(centre[:, 0] + 1j * centre[:, 1] - turn * offset)


def _spot(centre: Array, yaw: float, turn: complex, offset: complex) -> tuple[float, float, float]:
    p = complex(*centre.tolist()) - complex(turn) * offset
    return p.real, p.imag, float(yaw)


def _unblocked(
    outline: Outline, z: float, there: Occupancy, gap: float, first: bool, centre: Array, turn: Complex
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Candidates in their order that are not surely blocked, with the entries whose rectangles each meets.

    What comes after one that meets nothing is left out where only the ``first`` is wanted.
    """
    near, dx, dy = there.near(centre, outline, z, gap)
    some: list[bool] = np.asarray(near.any(axis=1)).tolist()
    if first and False in some:
        some = some[: some.index(False) + 1]
    meets: dict[int, list[int]] = {}
    if any(some):
        i, j = near[: len(some)].nonzero()
        met = there.met(i, j, dx[i, j], dy[i, j], turn, outline, gap)
        for k, entry in zip(i[met].tolist(), j[met].tolist(), strict=True):
            meets.setdefault(k, []).append(entry)
    for k in range(len(some)):
        found = meets.get(k, ())
        if not (found and outline.boxy and there.any_boxy(found)):
            yield k, tuple(found)
