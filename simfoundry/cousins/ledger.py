"""What is known of the candidates of a run, and where it ends. It depends on nothing but the candidates themselves.

Cousins are the first N accepted candidates by index: what lies beyond the last of them, or is known before one of lower
index, changes nothing. So workers, their order, kills and shards leave no trace.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from simfoundry.cousins.candidate import Candidate
from simfoundry.cousins.log import Place, Reader

PATIENCE = 200
"""So many candidates are examined before a recipe counts as too hard."""

LEAST_RATE = 0.005
"""A recipe of whose candidates fewer than this share is accepted is too hard."""


class End(StrEnum):
    """How a run ended, or that it did not yet."""

    OPEN = "open"
    COMPLETE = "complete"
    HOPELESS = "hopeless"
    EXHAUSTED = "exhausted"


@dataclass
class Ledger:
    """Counts candidates ``first``, ``first + step``, … in this order, as far as all are known.

    ``wanted`` are to be accepted; ``most`` is the last index that there is, None without end. ``known`` is where each
    candidate stands; ``accepted`` are the indices of those that count, ``totals`` how many candidates each reason
    rejected, ``unchecked`` what could not be looked at in some that are accepted.
    """

    wanted: int
    first: int = 1
    step: int = 1
    most: int | None = None
    known: dict[int, Place] = field(default_factory=dict)
    accepted: list[int] = field(default_factory=list)
    totals: Counter[str] = field(default_factory=Counter)
    unchecked: dict[str, None] = field(default_factory=dict)
    next_index: int = 0
    end: End = End.OPEN

    def __post_init__(self) -> None:
        self.next_index = self.next_index or self.first

    @property
    def examined(self) -> int:
        """How many candidates count."""
        return (self.next_index - self.first) // self.step

    @property
    def last(self) -> int:
        """The index of the last that counts."""
        return self.next_index - self.step

    @property
    def rate(self) -> float:
        """Which share of those that count is accepted."""
        return len(self.accepted) / self.examined if self.examined else 0.0

    def advance(self, reader: Reader, settled: Callable[[Candidate], None]) -> None:
        """Count on as far as candidates are known, or the run ends."""
        while self.end is End.OPEN and self.next_index in self.known:
            place = self.known[self.next_index]
            candidate = reader.candidate(place)
            self.next_index += self.step
            if candidate.accepted:
                self.accepted.append(candidate.index)
                self.unchecked.update(dict.fromkeys(candidate.unchecked))
                settled(candidate)
            self.totals.update({reason.code for reason in candidate.reasons})
            self.end = self._end()
        if self.end is End.OPEN and self._is_beyond(self.next_index):
            self.end = End.EXHAUSTED

    def counted(self) -> Iterator[Place]:
        """Where the candidates that count stand, in order."""
        return (self.known[k] for k in self.indices())

    def indices(self) -> range:
        """The candidates that count, in order."""
        return range(self.first, self.next_index, self.step)

    def unknown(self) -> Iterator[int]:
        """Indices that are not known, in order; more than are needed, as nobody knows how many those are."""
        index = self.next_index
        while not self._is_beyond(index):
            if index not in self.known:
                yield index
            index += self.step

    def _is_beyond(self, index: int) -> bool:
        return self.most is not None and index > self.most

    def _end(self) -> End:
        if len(self.accepted) == self.wanted:
            return End.COMPLETE
        if self.examined >= PATIENCE and len(self.accepted) < LEAST_RATE * self.examined:
            return End.HOPELESS
        return End.EXHAUSTED if self._is_beyond(self.next_index) else End.OPEN
