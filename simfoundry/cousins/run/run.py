"""What is known of the candidates of a run, and where it ends. It depends on nothing but the candidates themselves.

Cousins are the first N accepted candidates by index: what lies beyond the last of them, or is known before one of lower
index, changes nothing. So workers, their order, kills and shards leave no trace.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from simfoundry.cousins.objects.swap import VariantCount
from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.log import WORK, Log, LogEntry, Reader, log_file, logs, read_places, replace_logs
from simfoundry.cousins.run.worker_pools import CandidatePool
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically

PATIENCE = 200
"""So many candidates are examined before a recipe counts as too hard."""

LEAST_RATE = 0.005
"""A recipe of whose candidates fewer than this share is accepted is too hard."""


class RunEnd(StrEnum):
    """The end of a run, or that it goes on."""

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
    known: dict[int, LogEntry] = field(default_factory=dict)
    accepted: list[int] = field(default_factory=list)
    totals: Counter[str] = field(default_factory=Counter)
    unchecked: dict[str, None] = field(default_factory=dict)
    next_index: int = 0
    end: RunEnd = RunEnd.OPEN

    def __post_init__(self) -> None:
        self.next_index = self.next_index or self.first

    @property
    def examined(self) -> int:
        """Return how many candidates count."""
        return (self.next_index - self.first) // self.step

    @property
    def last(self) -> int:
        """The index of the last that counts."""
        return self.next_index - self.step

    @property
    def rate(self) -> float:
        """Return which share of those that count is accepted."""
        return len(self.accepted) / self.examined if self.examined else 0.0

    def advance(self, reader: Reader, settled: Callable[[Candidate], None]) -> None:
        """Count on as far as candidates are known, or the run ends."""
        while self.end is RunEnd.OPEN and self.next_index in self.known:
            place = self.known[self.next_index]
            candidate = reader.candidate(place)
            self.next_index += self.step
            if candidate.accepted:
                self.accepted.append(candidate.index)
                self.unchecked.update(dict.fromkeys(candidate.unchecked))
                settled(candidate)
            self.totals.update({reason.code for reason in candidate.reasons})
            self.end = self._end()
        if self.end is RunEnd.OPEN and self._is_beyond(self.next_index):
            self.end = RunEnd.EXHAUSTED

    def counted(self) -> Iterator[LogEntry]:
        """Return where the candidates that count stand, in order."""
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

    def _end(self) -> RunEnd:
        if len(self.accepted) == self.wanted:
            return RunEnd.COMPLETE
        if self.examined >= PATIENCE and len(self.accepted) < LEAST_RATE * self.examined:
            return RunEnd.HOPELESS
        return RunEnd.EXHAUSTED if self._is_beyond(self.next_index) else RunEnd.OPEN


AHEAD = 32
"""So many candidates for each worker may be known before one of lower index is."""

MANIFEST = "manifest.json"
"""What a run says of itself when it is done, in its folder."""

Heard = Callable[[Ledger], None]
"""Hears the ledger after each candidate."""


@dataclass(frozen=True)
class RunPlan:
    """The aim of a run: ``wanted`` cousins in ``out``; equal ``about`` gives equal bytes.

    ``shard`` (i, n), i from 1, examines every n-th candidate from the i-th on, and writes no cousins. ``most`` is how
    many candidates there are, None without end; ``variants`` what came of each object that varies.
    """

    out: Path
    wanted: int
    about: dict[str, Any]
    shard: tuple[int, int] | None = None
    most: int | None = None
    variants: tuple[VariantCount, ...] = ()

    def ledger(self) -> Ledger:
        """An empty ledger of the run; a shard takes its share of what is wanted."""
        if self.shard is None:
            return Ledger(self.wanted, most=self.most)
        first, step = self.shard
        return Ledger(-(-self.wanted // step), first, step, self.most)


def begin(plan: RunPlan) -> None:
    """Make the folder of a run, or see that the one that is there is of the same; raises :class:`OutputError`."""
    path = plan.out / WORK / "run.json"
    if path.is_file():
        found = _read(path)
        for key, value in plan.about.items():
            if found.get(key) != value:
                differs = f"is {found.get(key)!r}, not {value!r}" if len(str(value)) < 48 else "differs"
                raise OutputError(
                    f"{plan.out} holds cousins of another run: its {key} {differs}; write to another folder, or remove "
                    "that one"
                )
        return
    strange = [p.name for p in plan.out.iterdir() if p.name != WORK] if plan.out.is_dir() else []
    if strange:
        raise OutputError(f"{plan.out} holds {sorted(strange)[0]}, which is of no run of cousins; give an empty folder")
    write_atomically(path, (json.dumps(plan.about, indent=1, ensure_ascii=False) + "\n").encode())


def _read(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError):
        raise OutputError(f"{path} is damaged; remove it, and the run goes on from its logs") from None


def run(plan: RunPlan, pool: Callable[[], CandidatePool], heard: Heard = lambda ledger: None) -> Ledger:
    """Examine candidates until the plan is met or cannot be; what the logs know already is not examined again."""
    begin(plan)
    with Reader() as reader, Log(log_file(plan.out, plan.shard)) as log:
        if plan.shard is None:
            _clear_half_written(plan.out)
        ledger = plan.ledger()
        for file in logs(plan.out):
            ledger.known.update(read_places(file))
        settled = _nothing if plan.shard is not None else lambda candidate: write_documents(plan.out, candidate)
        ledger.advance(reader, settled)
        heard(ledger)
        if ledger.end is not RunEnd.OPEN:
            _see_no_more(plan, ledger)
            return ledger
        with closing(pool()) as workers:
            for candidate in _examined(ledger, workers):
                ledger.known[candidate.index] = log.add(candidate)
                ledger.advance(reader, settled)
                heard(ledger)
    return ledger


def _clear_half_written(out: Path) -> None:
    """Remove what killed runs left of documents and manifests. The log's lock sees to it that no other writes them."""
    for pattern in (".[0-9]*.yaml.*", f".{MANIFEST}.*"):
        for left in out.glob(pattern):
            left.unlink(missing_ok=True)


def _see_no_more(plan: RunPlan, ledger: Ledger) -> None:
    """Raise :class:`OutputError` where cousins of a longer run would be left over."""
    beyond = [p.name for p in plan.out.glob("[0-9]*.*.yaml") if int(p.name.partition(".")[0]) > ledger.last]
    if beyond and plan.shard is None:
        raise OutputError(
            f"{plan.out} holds {len(beyond)} documents of more cousins than the {plan.wanted} that are asked for; "
            "write to another folder, or ask for as many as before"
        )


def _examined(ledger: Ledger, pool: CandidatePool) -> Iterator[Candidate]:
    """Candidates that were not known, as they are done; the pool is kept busy until the ledger is at its end."""
    todo, running = ledger.unknown(), 0
    index = next(todo, None)
    while ledger.end is RunEnd.OPEN:
        while index is not None and running < 2 * pool.size and _is_near(index, ledger, pool):
            pool.submit(index)
            running += 1
            index = next(todo, None)
        yield pool.next()
        running -= 1


def _is_near(index: int, ledger: Ledger, pool: CandidatePool) -> bool:
    """Return whether a candidate is near enough to those that count, so that memory and vain work stay bounded."""
    return index - ledger.next_index < AHEAD * ledger.step * pool.size


def _nothing(candidate: Candidate) -> None:
    """A shard does not know which of its candidates will count."""


def write_documents(out: Path, candidate: Candidate) -> None:
    """Write the documents of a cousin, unless they are there as they should be."""
    for kind, name in candidate.files().items():
        path, data = out / name, candidate.documents[kind].encode()
        if not (path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data):
            write_atomically(path, data)


def finish(plan: RunPlan, ledger: Ledger) -> None:
    """Leave one log, of the candidates that count and nothing else, in their order."""
    ledger.known = replace_logs(plan.out, ((k, ledger.known[k]) for k in ledger.indices()))
