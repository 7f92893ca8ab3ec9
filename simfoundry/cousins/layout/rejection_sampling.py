"""Rejection sampling of placements, uniform over an allowed region of any shape.

Positions and yaw angles are drawn in batches, uniformly over a rectangle that contains the allowed region. The first
candidate that passes all tests is used, so all allowed placements are equally likely. The tests are, in order:

1. The entire shadow of the object is over the support.
2. The pose satisfies the predicates, which are evaluated for all remaining candidates at once.
3. The object's rectangle does not overlap the rectangle of another object. This test is exact for boxes.
4. If the rectangles overlap, the convex parts do not overlap. Candidates are tested individually.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.cousins.layout.supports import Complex, Outline, Support
from simfoundry.geometry.frames import Array

# Number of candidates after which the search for a placement fails.
TRIES = 4096

# Size of the first batch, size of the first batch if predicates are evaluated, and maximum batch size. Each batch is
# larger than the one before.
FIRST, FIRST_JUDGED, MOST = 4, 64, 1024

# Clearance between objects that should not touch [m]; equal to the contact margin of the engines.
GAP = 0.002

# Number of candidate placements drawn for each object in a batch.
EACH = 4

# Tolerance [m] on the height of an object's lowest point for the object to stand on a level.
NEAR_LEVEL = 0.02

Mask = NDArray[np.bool_]
Rng = np.random.Generator

# Position x and y [m] of an object's frame, and its rotation about z [rad].
Spot = tuple[float, float, float]

# Function that returns a mask of the allowed candidates, given x and y [m] of the object's frame and its rotation about
# z [rad], shape (n,) each.
Allowed = Callable[[Array, Array, Array], Mask]

# Function that returns True if a candidate is clear of the given entries even though it overlaps their rectangles.
Clear = Callable[[float, float, float, tuple[int, ...]], bool]

# Function that returns True if a candidate passes a test that is too expensive to run on many candidates.
Last = Callable[[float, float, float], bool]


class Occupancy:
    """The rectangles and height ranges occupied by the objects in a scene, with one entry for each link."""

    def __init__(self, room: int = 64) -> None:
        self.count = 0
        self.owners: list[str] = []
        # Rows: center x and y, bounding radius, lowest and highest point, area of the shadow. The last two rows are the
        # lowest and highest points regardless of :meth:`set_aside`.
        self._rows = np.zeros((8, room))
        self._half, self._turn = np.zeros((2, room), dtype=np.complex128)
        self._boxy: list[bool] = []

    def add(self, owner: str, outline: Outline, x: float, y: float, z: float, yaw: float) -> None:
        """Add an entry for an object whose frame is at x, y, z [m] and rotated by ``yaw`` [rad] about z."""
        k = self.count
        if k == len(self._half):
            table = self._rows, self._half, self._turn
            self._rows, self._half, self._turn = (np.concatenate([v, np.zeros_like(v)], axis=-1) for v in table)
        turn = cmath.rect(1.0, yaw)
        center, span = complex(x, y) + turn * outline.middle, (z + outline.low, z + outline.high)
        self._rows[:, k] = center.real, center.imag, outline.size, *span, outline.area, *span
        self._half[k], self._turn[k] = outline.half, turn * outline.turn
        self._boxy.append(outline.boxy)
        self.owners.append(owner)
        self.count = k + 1

    def set_aside(self, owner: str | None) -> None:
        """Ignore the entries of ``owner`` from now on.

        Objects that stand on ``owner`` touch it, so these entries would always overlap. The entries of a previously
        ignored owner take effect again.
        """
        self._rows[3:5] = self._rows[6:]
        aside = [k for k, name in enumerate(self.owners) if name == owner]
        self._rows[3, aside], self._rows[4, aside] = np.inf, -np.inf

    def overlaps(
        self, entries: range, center: Complex, side: Complex, half: Complex, low: Array, high: Array, gap: float
    ) -> dict[int, list[int]]:
        """Find the entries that overlap rectangles or are less than ``gap`` [m] away from them.

        The rectangles are specified as in :func:`rectangles_meet`, and each has a height range [m].

        Returns:
            A mapping from the index of each rectangle to its entries. Rectangles without entries are omitted.
        """
        found = dict[int, list[int]]()
        rows = self._rows[:, entries.start : entries.stop]
        off = (rows[0] + 1j * rows[1]) - center[:, None]
        reach = rows[2] + (np.abs(half)[:, None] + gap)
        near = off.real**2 + off.imag**2 < reach * reach
        near &= (rows[3] < high[:, None] + gap) & (rows[4] > low[:, None] - gap)
        i, j = near.nonzero()
        k = j + entries.start
        met = rectangles_meet(off[i, j], side[i], half[i], self._turn[k], self._half[k], gap)
        for rectangle, entry in zip(i[met].tolist(), k[met].tolist(), strict=True):
            found.setdefault(rectangle, []).append(entry)
        return found

    def area_on(self, height: float) -> float:
        """Return the total shadow area [m^2] of the objects that stand on a level surface at the given height [m]."""
        low, area = self._rows[3, : self.count], self._rows[5, : self.count]
        return float(area[np.abs(low - height) < NEAR_LEVEL].sum())

    def any_boxy(self, entries: Iterable[int]) -> bool:
        """Return True if at least one of the given entries is a box that fills its rectangle."""
        return any(self._boxy[k] for k in entries)


def rectangles_meet(
    off: Complex, turn_a: Complex, half_a: Complex | complex, turn_b: Complex, half_b: Complex | complex, gap: float
) -> Mask:
    """Test whether pairs of rectangles overlap or are closer than ``gap`` [m], using the separating axis theorem.

    Args:
        off: Vectors from the center of rectangle a to the center of rectangle b [m], as complex numbers.
        turn_a: Rotations of rectangle a as unit complex numbers.
        half_a: Half extents of rectangle a [m]. The real part is along its first side.
        turn_b: Rotations of rectangle b.
        half_b: Half extents of rectangle b [m].
        gap: Required distance [m].
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
    """The region from which the placements of an object are drawn.

    Attributes:
        low: Lower bounds of the center of the object's rectangle [m], shape (2,).
        high: Upper bounds of the center [m], shape (2,).
        turn: Range of the rotation about z [rad].
        support: Level surface on which the object stands.
        z: Height of the object's frame [m].
    """

    low: Array
    high: Array
    turn: tuple[float, float]
    support: Support
    z: float

    @cached_property
    def span(self) -> tuple[Array, Array]:
        """The region as a lower corner and a size, each of shape (3,).

        The components are x [m], y [m] and the rotation [rad].
        """
        low, high = np.array([*self.low, self.turn[0]]), np.array([*self.high, self.turn[1]])
        return low, high - low

    def draw(self, rng: Rng, count: int) -> tuple[Array, Array]:
        """Draw placements uniformly over the region.

        Returns:
            Centers [m], as an array of shape (count, 2), and rotations [rad], as an array of shape (count,).
        """
        low, span = self.span
        drawn = rng.random((count, 3)) * span + low
        return drawn[:, :2], drawn[:, 2]


@dataclass(frozen=True)
class Found:
    """The result of a search for a placement.

    Attributes:
        spot: x and y [m] of the object's frame and its rotation about z [rad], or None if the search failed.
        tried: Number of candidates drawn.
        standing: Number of candidates that are entirely over the support.
        allowed: Number of those candidates that also satisfy the predicates.
    """

    spot: tuple[float, float, float] | None
    tried: int = 0
    standing: int = 0
    allowed: int = 0


def find(
    outline: Outline,
    region: Region,
    there: Occupancy,
    rng: Rng,
    gap: float,
    allowed: Allowed | None = None,
    clear: Clear | None = None,
    last: Last | None = None,
) -> Found:
    """Find a placement for an object in a region. All placements that pass the tests are equally likely.

    Args:
        outline: Top view of the object.
        region: Region from which placements are drawn.
        there: Occupancy of the objects that have already been placed.
        rng: Random generator.
        gap: Required distance from other objects [m].
        allowed: Additional test that is applied to many candidates at once.
        clear: Test for a candidate whose rectangle overlaps entries, or None to reject these candidates.
        last: Additional test that is applied only to candidates that passed all other tests.
    """
    tried = standing = permitted = 0
    size, offset = FIRST if allowed is None else FIRST_JUDGED, outline.middle
    while tried < TRIES:
        center, yaw = region.draw(rng, size)
        turn = np.exp(1j * yaw)
        tried += size
        size = min(4 * size, MOST)
        left = region.support.holds(center, turn, outline.spread).nonzero()[0]
        standing += len(left)
        if allowed is not None and len(left):
            p = center[left, 0] + 1j * center[left, 1] - turn[left] * offset
            left = left[allowed(p.real, p.imag, yaw[left])]
            permitted += len(left)
        if not len(left):
            continue
        center, yaw, turn = center[left, 0] + 1j * center[left, 1], yaw[left], turn[left]
        half, low, high = (
            np.full(len(left), v) for v in (outline.half, region.z + outline.low, region.z + outline.high)
        )
        overlaps = there.overlaps(range(there.count), center, turn * outline.turn, half, low, high, gap)
        for k in range(len(left)):
            met = tuple(overlaps.get(k, ()))
            if met and (clear is None or (outline.boxy and there.any_boxy(met))):
                continue
            p = complex(center[k]) - complex(turn[k]) * offset
            spot = p.real, p.imag, float(yaw[k])
            if not (met and clear is not None and not clear(*spot, met)) and (last is None or last(*spot)):
                return Found(spot, tried, standing, permitted)
    return Found(None, tried, standing, permitted)


class Batch:
    """A batch of candidate placements, with :data:`EACH` candidates per object.

    Each object gets the first of its candidates that is clear of all previous objects, as if the objects were placed
    individually by :func:`find`. For speed, the candidates of all objects are drawn and tested together. Only an object
    without a free candidate requires an individual search.
    """

    def __init__(self, things: Sequence[tuple[Outline, Region]], there: Occupancy, rng: Rng) -> None:
        self._there = there
        outlines, regions = [o for o, _ in things], [r for _, r in things]
        low, span = (np.repeat(np.array([r.span[k] for r in regions]), EACH, axis=0) for k in (0, 1))
        drawn = rng.random((len(things) * EACH, 3)) * span + low
        turn = np.exp(1j * drawn[:, 2])
        self._center = drawn[:, 0] + 1j * drawn[:, 1]
        frame = self._center - turn * _each([o.middle for o in outlines])
        self.spots: list[Spot] = list(zip(frame.real.tolist(), frame.imag.tolist(), drawn[:, 2].tolist(), strict=True))
        self._side = turn * _each([o.turn for o in outlines])
        self._half = _each([o.half for o in outlines])
        self._low = _each([r.z + o.low for o, r in things]).real
        self._high = _each([r.z + o.high for o, r in things]).real
        self._boxy = [o.boxy for o in outlines]
        stands = regions[0].support.holds(drawn[:, :2], turn, np.repeat(_spreads(outlines), EACH, axis=0))
        self._dead: list[bool] = (~stands).tolist()
        self._doubts: dict[int, list[int]] = {}
        self._meets: dict[int, list[int]] = {}
        self._meet_each_other(stands)
        self._meet_entries(range(there.count))

    def _meet_each_other(self, standing: Mask) -> None:
        live = np.flatnonzero(standing)
        p, size = self._center[live], np.abs(self._half[live])
        dx, dy = p.real - p.real[:, None], p.imag - p.imag[:, None]
        reach = size + (size[:, None] + GAP)
        close = dx * dx + dy * dy < reach * reach
        i, j = close.nonzero()
        i, j = live[i], live[j]
        other = (i // EACH < j // EACH) & (self._low[i] < self._high[j] + GAP)
        other &= self._low[j] < self._high[i] + GAP
        i, j = i[other], j[other]
        met = rectangles_meet(
            self._center[j] - self._center[i], self._side[i], self._half[i], self._side[j], self._half[j], GAP
        )
        for a, b in zip(i[met].tolist(), j[met].tolist(), strict=True):
            self._meets.setdefault(a, []).append(b)

    def _meet_entries(self, entries: range) -> None:
        """Record which candidates overlap the given entries."""
        rectangles = self._center, self._side, self._half, self._low, self._high
        for c, met in self._there.overlaps(entries, *rectangles, GAP).items():
            self._doubt(c, met)

    def _doubt(self, c: int, met: Iterable[int]) -> None:
        """Record that the rectangle of candidate ``c`` overlaps the entries ``met``."""
        if self._boxy[c // EACH] and self._there.any_boxy(met):
            self._dead[c] = True
        else:
            self._doubts.setdefault(c, []).extend(met)

    def first_clear(self, t: int, clear: Clear) -> int | None:
        """Return the index of the first candidate of object ``t`` that is clear of all placed objects.

        The result is None if there is no such candidate.
        """
        for c in range(EACH * t, EACH * (t + 1)):
            doubts = tuple(self._doubts.get(c, ()))
            if not self._dead[c] and (not doubts or clear(*self.spots[c], doubts)):
                return c
        return None

    def entered(self, entries: range, chosen: int | None) -> None:
        """Record the entries of an object that was placed at candidate ``chosen``.

        If ``chosen`` is None, the object was placed elsewhere.
        """
        if chosen is None:
            self._meet_entries(entries)
            return
        for c in self._meets.get(chosen, ()):
            self._doubt(c, entries)


def _spreads(outlines: Sequence[Outline]) -> Array:
    """Return the corners of the shadows [m] as an array of shape (n, 2, m).

    Shorter lists of corners are padded by repeating the last corner.
    """
    out = np.empty((len(outlines), 2, max(o.spread.shape[1] for o in outlines)))
    for row, outline in zip(out, outlines, strict=True):
        count = outline.spread.shape[1]
        row[:, :count] = outline.spread
        row[:, count:] = outline.spread[:, -1:]
    return out


def _each(values: Sequence[complex]) -> Complex:
    """Repeat the value of each object for all of its candidates."""
    return np.repeat(np.array(values, dtype=np.complex128), EACH)
