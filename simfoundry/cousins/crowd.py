"""Many things that may stand anywhere on one support, placed together.

The same as one after another by :func:`simfoundry.cousins.placing.find`: each takes the first of its own candidates
that is clear of all before it. But a few candidates of all things are drawn at once, and tested against each other at
once; only what finds none among them is looked for alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from simfoundry.cousins.outline import Complex, Outline
from simfoundry.cousins.placing import Found, Mask, Region, There, rectangles_meet
from simfoundry.geometry.frames import Array

EACH = 4
"""Candidates of each thing that are drawn at once."""

TOGETHER = 24
"""Things that are looked at at once: few enough for the tables of their pairs to stay in a processor's cache."""

Spot = tuple[float, float, float]

Clear = Callable[[int, Spot, tuple[int, ...]], bool]
"""Whether a thing, by number, is clear at a spot of the entries whose rectangles it meets."""

Put = Callable[[int, Spot], None]
"""Lets a thing stand at a spot: enters it among what stands there."""

Alone = Callable[[int], Found]
"""Looks for a place for a thing alone."""


def place_together(
    things: Sequence[tuple[Outline, Region]],
    there: There,
    rng: np.random.Generator,
    gap: float,
    clear: Clear,
    put: Put,
    alone: Alone,
) -> tuple[int, Found] | None:
    """Place things in their order; the number of the first that finds no place, and what became of it, or None."""
    for first in range(0, len(things), TOGETHER):
        block = _Block(things[first : first + TOGETHER], there, rng, gap)
        for t in range(len(block.things)):
            spot, entered = block.first_clear(t, lambda s, met, k=first + t: clear(k, s, met)), there.count  # type: ignore[misc]
            chosen = spot is not None
            if spot is None:
                found = alone(first + t)
                if found.spot is None:
                    return first + t, found
                spot = found.spot
            put(first + t, spot)
            block.entered(t, range(entered, there.count), chosen)
    return None


class _Block:
    """Candidates of some things, :data:`EACH` of each in a row, and which of them meet each other and what stands."""

    def __init__(
        self, things: Sequence[tuple[Outline, Region]], there: There, rng: np.random.Generator, gap: float
    ) -> None:
        self.things, self._there, self._gap = things, there, gap
        outlines, regions = [o for o, _ in things], [r for _, r in things]
        low, span = (np.repeat(np.array([r.span[k] for r in regions]), EACH, axis=0) for k in (0, 1))
        drawn = rng.random((len(things) * EACH, 3)) * span + low
        turn = np.exp(1j * drawn[:, 2])
        self._centre = drawn[:, 0] + 1j * drawn[:, 1]
        frame = self._centre - turn * _each([o.middle for o in outlines])
        self._spots: list[Spot] = list(zip(frame.real.tolist(), frame.imag.tolist(), drawn[:, 2].tolist(), strict=True))
        self._side = turn * _each([o.turn for o in outlines])
        self._half = _each([complex(*o.half.tolist()) for o in outlines])
        self._low = _each([r.z + o.low for o, r in things]).real
        self._high = _each([r.z + o.high for o, r in things]).real
        self._boxy = [o.boxy for o in outlines]
        stands = regions[0].support.holds(drawn[:, :2], turn, np.repeat(_spreads(outlines), EACH, axis=0))
        self._dead: list[bool] = (~stands).tolist()
        self._doubts: dict[int, list[int]] = {}
        self._meets: dict[int, list[int]] = {}
        self._chosen: dict[int, int] = {}
        self._meet_each_other(stands)
        self._meet_entries(range(there.count))

    def _meet_each_other(self, standing: Mask) -> None:
        live = np.flatnonzero(standing)
        p, size = self._centre[live], np.abs(self._half[live])
        dx, dy = p.real - p.real[:, None], p.imag - p.imag[:, None]
        reach = size + (size[:, None] + self._gap)
        close = dx * dx + dy * dy < reach * reach
        i, j = close.nonzero()
        i, j = live[i], live[j]
        other = (i // EACH < j // EACH) & (self._low[i] < self._high[j] + self._gap)
        other &= self._low[j] < self._high[i] + self._gap
        i, j = i[other], j[other]
        met = rectangles_meet(
            self._centre[j] - self._centre[i], self._side[i], self._half[i], self._side[j], self._half[j], self._gap
        )
        for a, b in zip(i[met].tolist(), j[met].tolist(), strict=True):
            self._meets.setdefault(a, []).append(b)

    def _meet_entries(self, entries: range) -> None:
        """Note which candidates meet some of the entries of what stands there."""
        for c, entry in self._there.all_met(
            entries, self._centre, self._side, self._half, self._low, self._high, self._gap
        ):
            self._doubt(c, entry)

    def _doubt(self, c: int, entry: int) -> None:
        if self._boxy[c // EACH] and self._there.any_boxy((entry,)):
            self._dead[c] = True
        else:
            self._doubts.setdefault(c, []).append(entry)

    def first_clear(self, t: int, clear: Callable[[Spot, tuple[int, ...]], bool]) -> Spot | None:
        """The first candidate of a thing that is clear of all that stands; None where none is."""
        for c in range(EACH * t, EACH * (t + 1)):
            doubts = tuple(self._doubts.get(c, ()))
            if not self._dead[c] and (not doubts or clear(self._spots[c], doubts)):
                self._chosen[t] = c
                return self._spots[c]
        return None

    def entered(self, t: int, entries: range, chosen: bool) -> None:
        """Note that a thing stands now, as some entries: at its chosen candidate, or elsewhere."""
        if not chosen:
            self._meet_entries(entries)
            return
        for c in self._meets.get(self._chosen[t], ()):
            for entry in entries:
                self._doubt(c, entry)


def _spreads(outlines: Sequence[Outline]) -> Array:
    """The corners of shadows, as many of each, shape (n, 2, m): the last ones are repeated."""
    out = np.empty((len(outlines), 2, max(o.spread.shape[1] for o in outlines)))
    for row, outline in zip(out, outlines, strict=True):
        count = outline.spread.shape[1]
        row[:, :count] = outline.spread
        row[:, count:] = outline.spread[:, -1:]
    return out


def _each(values: Sequence[complex]) -> Complex:
    """A value for each candidate of each thing."""
    return np.repeat(np.array(values, dtype=np.complex128), EACH)
