"""Examine candidates until a run is complete, log the results, and resume interrupted runs.

The cousins are the first N accepted candidates by index. Candidates that are examined out of order or beyond the last
cousin do not affect the result. The result therefore does not depend on the number of workers, their scheduling,
interruptions or shards.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.log import WORK, Log, LogEntry, Reader, log_file, logs, read_places, replace_logs
from simfoundry.cousins.run.worker_pools import CandidatePool
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically

if TYPE_CHECKING:
    from simfoundry.cousins.recipe.variant_pool import VariantCount

# Minimum number of candidates to examine before a recipe can be judged too hard.
PATIENCE = 200

# Minimum acceptance rate, below which a recipe is judged too hard.
LEAST_RATE = 0.005


class RunEnd(StrEnum):
    """The reason why a run ended. The value is OPEN while the run continues."""

    OPEN = "open"
    COMPLETE = "complete"
    HOPELESS = "hopeless"
    EXHAUSTED = "exhausted"


@dataclass
class Ledger:
    """A count of the candidates ``first``, ``first + step``, …, up to the first candidate that has not been examined.

    Attributes:
        wanted: Number of candidates to accept.
        first: Index of the first candidate.
        step: Difference between consecutive indices, which is greater than 1 for a shard.
        most: Highest existing index, or None if the number of candidates is unbounded.
        known: Log entries of all examined candidates by index.
        accepted: Indices of the counted candidates that were accepted.
        totals: Number of counted candidates rejected for each reason.
        unchecked: Mapping whose keys are the checks that could not be performed for some accepted candidate.
        next_index: Index of the first candidate that has not been counted yet.
        end: Reason why the run ended, or OPEN.
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
        """The number of counted candidates."""
        return (self.next_index - self.first) // self.step

    @property
    def last(self) -> int:
        """The index of the last counted candidate."""
        return self.next_index - self.step

    @property
    def rate(self) -> float:
        """The fraction of the counted candidates that were accepted."""
        return len(self.accepted) / self.examined if self.examined else 0.0

    def advance(self, reader: Reader, settled: Callable[[Candidate], None]) -> None:
        """Count candidates until the run ends or the next candidate has not been examined yet.

        Args:
            reader: Reader of the logs.
            settled: Callback that receives each accepted candidate when it is counted.
        """
        while self.end is RunEnd.OPEN and self.next_index in self.known:
            candidate = reader.candidate(self.known[self.next_index])
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
        """Yield the log entries of the counted candidates, in order."""
        return (self.known[k] for k in self.indices())

    def indices(self) -> range:
        """Return the indices of the counted candidates, in order."""
        return range(self.first, self.next_index, self.step)

    def unknown(self) -> Iterator[int]:
        """Yield the indices of unexamined candidates in order.

        If the number of candidates is unbounded, the sequence never ends.
        """
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


# Maximum number of candidates per worker to examine ahead of the first unexamined candidate. This limits memory use and
# wasted work.
AHEAD = 32

# File name of a run's manifest in the output folder.
MANIFEST = "manifest.json"


@dataclass(frozen=True)
class RunPlan:
    """The parameters of a run.

    Attributes:
        out: Output folder.
        wanted: Number of cousins to generate.
        about: Fingerprint of the run. Runs with the same fingerprint produce identical bytes.
        shard: Pair (i, n) to examine only every n-th candidate, starting with candidate i (counted from 1), without
            writing any cousins. The value is None for a full run.
        most: Number of candidates, or None if it is unbounded.
        variants: Variant counts of each object that varies.
        varied: For each value that varies, its entry in the recipe and what depends on it.
    """

    out: Path
    wanted: int
    about: dict[str, Any]
    shard: tuple[int, int] | None = None
    most: int | None = None
    variants: tuple[VariantCount, ...] = ()
    varied: Mapping[str, Mapping[str, str]] = field(default_factory=lambda: MappingProxyType({}))

    def ledger(self) -> Ledger:
        """Return an empty ledger for this run.

        A shard accepts only its fraction of the requested cousins.
        """
        if self.shard is None:
            return Ledger(self.wanted, most=self.most)
        first, step = self.shard
        return Ledger(-(-self.wanted // step), first, step, self.most)


def begin(plan: RunPlan) -> None:
    """Create the output folder of a run.

    If the folder already exists, it must belong to a run with this fingerprint.

    Raises:
        OutputError: The folder belongs to a different run, contains unrelated files, or is damaged.
    """
    path = plan.out / WORK / "run.json"
    if path.is_file():
        try:
            found = dict(json.loads(path.read_text(encoding="utf-8")))
        except (ValueError, TypeError):
            raise OutputError(f"{path} is damaged; delete it to resume the run from its logs") from None
        for key, value in plan.about.items():
            if found.get(key) != value:
                differs = f"is {found.get(key)!r}, not {value!r}" if len(str(value)) < 48 else "differs"
                text = f"{plan.out} contains cousins from a different run: its {key} {differs}; choose another folder "
                raise OutputError(text + "or delete this one")
        return
    strange = sorted(p.name for p in plan.out.iterdir() if p.name != WORK) if plan.out.is_dir() else []
    if strange:
        text = f"{plan.out} contains {strange[0]}, which was not written by a cousins run; choose an empty folder"
        raise OutputError(text)
    write_atomically(path, (json.dumps(plan.about, indent=1, ensure_ascii=False) + "\n").encode())


def run(
    plan: RunPlan, pool: Callable[[], CandidatePool], heard: Callable[[Ledger], None] = lambda ledger: None
) -> Ledger:
    """Examine candidates until the run ends. Candidates that are already in the logs are not examined again.

    Args:
        plan: Parameters of the run.
        pool: Function that opens the worker pool. It is called only if there are candidates to examine.
        heard: Callback that receives the ledger after each candidate.

    Returns:
        The final ledger.
    """
    begin(plan)
    with Reader() as reader, Log(log_file(plan.out, plan.shard)) as log:
        if plan.shard is None:  # delete temporary files of killed runs; the log's lock excludes concurrent runs
            for left in (*plan.out.glob(".[0-9]*.yaml.*"), *plan.out.glob(f".{MANIFEST}.*")):
                left.unlink(missing_ok=True)
        ledger = plan.ledger()
        for file in logs(plan.out):
            ledger.known.update(read_places(file))

        def settled(candidate: Candidate) -> None:
            if plan.shard is None:  # a shard cannot tell which of its candidates will count in the full run
                write_documents(plan.out, candidate)

        ledger.advance(reader, settled)
        heard(ledger)
        if ledger.end is not RunEnd.OPEN:
            _require_none_beyond(plan, ledger)
            return ledger
        with closing(pool()) as workers:
            for candidate in _examined(ledger, workers):
                ledger.known[candidate.index] = log.add(candidate)
                ledger.advance(reader, settled)
                heard(ledger)
    return ledger


def _require_none_beyond(plan: RunPlan, ledger: Ledger) -> None:
    """Check that the output folder contains no more cousins than requested.

    Raises:
        OutputError: If it contains more cousins.
    """
    beyond = [p.name for p in plan.out.glob("[0-9]*.*.yaml") if int(p.name.partition(".")[0]) > ledger.last]
    if beyond and plan.shard is None:
        text = f"{plan.out} contains {len(beyond)} documents of cousins beyond the {plan.wanted} requested; choose "
        raise OutputError(text + "another folder, or request as many cousins as before")


def _examined(ledger: Ledger, pool: CandidatePool) -> Iterator[Candidate]:
    """Yield newly examined candidates as they finish. The pool is kept busy until the run ends."""
    todo, running, ahead = ledger.unknown(), 0, AHEAD * ledger.step * pool.size
    index = next(todo, None)
    while ledger.end is RunEnd.OPEN:
        while index is not None and running < 2 * pool.size and index - ledger.next_index < ahead:
            pool.submit(index)
            running += 1
            index = next(todo, None)
        yield pool.next()
        running -= 1


def write_documents(out: Path, candidate: Candidate) -> None:
    """Write a cousin's documents, except if identical files already exist."""
    for kind, name in candidate.files().items():
        path, data = out / name, candidate.documents[kind].encode()
        if not (path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data):
            write_atomically(path, data)


def finish(plan: RunPlan, ledger: Ledger) -> None:
    """Replace all logs with a single log that contains only the counted candidates, in order."""
    ledger.known = replace_logs(plan.out, ((k, ledger.known[k]) for k in ledger.indices()))
