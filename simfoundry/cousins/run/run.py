"""The state of a run and its end, which depend only on the candidates themselves.

Cousins are the first N accepted candidates by index. Candidates beyond the last of them, or examined out of order,
change nothing, so the result does not depend on workers, their order, kills or shards.
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
"""Number of candidates examined before a recipe may count as too hard."""

LEAST_RATE = 0.005
"""Minimum acceptance rate; below it a recipe counts as too hard."""


class RunEnd(StrEnum):
    """The end of a run, or OPEN while it goes on."""

    OPEN = "open"
    COMPLETE = "complete"
    HOPELESS = "hopeless"
    EXHAUSTED = "exhausted"


@dataclass
class Ledger:
    """Counts candidates ``first``, ``first + step``, … in this order, up to the first unknown one.

    ``wanted`` is the number to accept; ``most`` is the last existing index, None if unbounded. ``known`` maps
    candidates to their log entries; ``accepted`` lists the counted accepted ones, ``totals`` the number of rejections
    per reason, and ``unchecked`` the checks that could not be made for some accepted ones.
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
        """Number of counted candidates."""
        return (self.next_index - self.first) // self.step

    @property
    def last(self) -> int:
        """Index of the last counted candidate."""
        return self.next_index - self.step

    @property
    def rate(self) -> float:
        """Share of the counted candidates that are accepted."""
        return len(self.accepted) / self.examined if self.examined else 0.0

    def advance(self, reader: Reader, settled: Callable[[Candidate], None]) -> None:
        """Count further, until a candidate is unknown or the run ends."""
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
        """Yield the log entries of the counted candidates in order."""
        return (self.known[k] for k in self.indices())

    def indices(self) -> range:
        """Indices of the counted candidates, in order."""
        return range(self.first, self.next_index, self.step)

    def unknown(self) -> Iterator[int]:
        """Yield unknown indices in order, without end if the number of candidates is unbounded."""
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
"""Number of candidates per worker that may be examined ahead of the first unknown one."""

MANIFEST = "manifest.json"
"""File of the final report of a run, in its folder."""

Heard = Callable[[Ledger], None]
"""Callback that receives the ledger after each candidate."""


@dataclass(frozen=True)
class RunPlan:
    """The aim of a run: ``wanted`` cousins in ``out``; equal ``about`` gives equal bytes.

    ``shard`` (i, n), with i from 1, examines every n-th candidate starting at i, and writes no cousins. ``most`` is the
    number of candidates, None if unbounded; ``variants`` are the counts for each object that varies.
    """

    out: Path
    wanted: int
    about: dict[str, Any]
    shard: tuple[int, int] | None = None
    most: int | None = None
    variants: tuple[VariantCount, ...] = ()

    def ledger(self) -> Ledger:
        """Return an empty ledger; a shard accepts its share of the wanted cousins."""
        if self.shard is None:
            return Ledger(self.wanted, most=self.most)
        first, step = self.shard
        return Ledger(-(-self.wanted // step), first, step, self.most)


def begin(plan: RunPlan) -> None:
    """Create the folder of a run, or verify that an existing one has the same fingerprint; raises
    :class:`OutputError`.
    """
    path = plan.out / WORK / "run.json"
    if path.is_file():
        found = _read(path)
        for key, value in plan.about.items():
            if found.get(key) != value:
                differs = f"is {found.get(key)!r}, not {value!r}" if len(str(value)) < 48 else "differs"
                raise OutputError(
                    f"{plan.out} holds cousins of another run: its {key} {differs}; choose another folder or remove "
                    "this one"
                )
        return
    strange = [p.name for p in plan.out.iterdir() if p.name != WORK] if plan.out.is_dir() else []
    if strange:
        raise OutputError(
            f"{plan.out} holds {sorted(strange)[0]}, which does not belong to a run of cousins; choose an empty folder"
        )
    write_atomically(path, (json.dumps(plan.about, indent=1, ensure_ascii=False) + "\n").encode())


def _read(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError):
        raise OutputError(f"{path} is damaged; remove it to continue the run from its logs") from None


def run(plan: RunPlan, pool: Callable[[], CandidatePool], heard: Heard = lambda ledger: None) -> Ledger:
    """Examine candidates until the plan is met or cannot be; candidates in the logs are not examined again."""
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
    """Remove partly written documents and manifests of killed runs. The log's lock ensures that no other run writes
    them.
    """
    for pattern in (".[0-9]*.yaml.*", f".{MANIFEST}.*"):
        for left in out.glob(pattern):
            left.unlink(missing_ok=True)


def _see_no_more(plan: RunPlan, ledger: Ledger) -> None:
    """Raise :class:`OutputError` if the folder has cousins beyond the wanted number."""
    beyond = [p.name for p in plan.out.glob("[0-9]*.*.yaml") if int(p.name.partition(".")[0]) > ledger.last]
    if beyond and plan.shard is None:
        raise OutputError(
            f"{plan.out} holds {len(beyond)} documents of cousins beyond the {plan.wanted} requested; "
            "choose another folder, or request as many as before"
        )


def _examined(ledger: Ledger, pool: CandidatePool) -> Iterator[Candidate]:
    """Yield newly examined candidates as they finish; keep the pool busy until the ledger reaches its end."""
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
    """Return whether a candidate is close enough to the counted ones; this limits memory and wasted work."""
    return index - ledger.next_index < AHEAD * ledger.step * pool.size


def _nothing(candidate: Candidate) -> None:
    """Write nothing: a shard does not know which of its candidates will count."""


def write_documents(out: Path, candidate: Candidate) -> None:
    """Write the documents of a cousin, unless identical ones exist."""
    for kind, name in candidate.files().items():
        path, data = out / name, candidate.documents[kind].encode()
        if not (path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data):
            write_atomically(path, data)


def finish(plan: RunPlan, ledger: Ledger) -> None:
    """Reduce the logs to a single one that contains exactly the counted candidates in order."""
    ledger.known = replace_logs(plan.out, ((k, ledger.known[k]) for k in ledger.indices()))
