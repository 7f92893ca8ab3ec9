"""Examine candidates until a run is complete, log the results, and resume interrupted runs.

The cousins are the first N accepted candidates by index. Candidates that are examined out of order or beyond the last
cousin do not affect the result. It therefore does not depend on the number of workers, their scheduling, kills or
shards.

The log is append-only, so a kill at any point loses at most one line. ``OUT/.cousins/log.jsonl`` records full runs, and
``log-2-of-4.jsonl`` records a shard. Each line is flushed to disk before the next one is written. A truncated line is
ignored and removed before anything is appended.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.worker_pools import CandidatePool
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically, writing_atomically

if TYPE_CHECKING:
    from simfoundry.cousins.recipe.variant_pool import VariantCount

# Subfolder of the output folder for a run's internal files.
WORK = ".cousins"

WHOLE = "log.jsonl"


class LogEntry(NamedTuple):
    """The location of a candidate's line in a log, and whether the candidate was accepted."""

    file: Path
    start: int
    length: int
    accepted: bool


def log_file(out: Path, shard: tuple[int, int] | None) -> Path:
    """Return the path of the log for a full run, or for the shard (i, n)."""
    return out / WORK / (WHOLE if shard is None else f"log-{shard[0]}-of-{shard[1]}.jsonl")


def logs(out: Path) -> list[Path]:
    """Return the paths of all logs in an output folder, starting with the log of the full run."""
    return sorted((out / WORK).glob("log*.jsonl"), key=lambda path: (path.name != WHOLE, path.name))


def read_places(file: Path) -> dict[int, LogEntry]:
    """Index the complete lines in a log by candidate; raise :class:`OutputError` if the file is not a log."""
    found: dict[int, LogEntry] = {}
    if not file.is_file():
        return found
    with file.open("rb") as stream:
        start = 0
        for number, line in enumerate(stream, 1):
            if not line.endswith(b"\n"):
                break  # truncated by a kill
            try:
                index = int(json.loads(line)["index"])
            except (ValueError, KeyError, TypeError):
                raise OutputError(
                    f"{file}:{number} is not a valid line in a cousins log; move the file elsewhere to examine its "
                    "candidates again"
                ) from None
            found[index] = LogEntry(file, start, len(line), b'"reasons":' not in line[:40])
            start += len(line)
    return found


class Reader(ExitStack):
    """Reads candidates at known positions and keeps the log files open between reads."""

    def __init__(self) -> None:
        super().__init__()
        self._open: dict[Path, int] = {}

    def line(self, place: LogEntry) -> bytes:
        """Return the line at a position."""
        if place.file not in self._open:
            self._open[place.file] = self.enter_context(place.file.open("rb")).fileno()
        return os.pread(self._open[place.file], place.length, place.start)

    def candidate(self, place: LogEntry) -> Candidate:
        """Return the candidate at a position."""
        return Candidate.of(self.line(place))


class Log(ExitStack):
    """An append-only log that a single process may write to; closing the log releases its lock."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.file = file
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream = self.enter_context(file.open("ab"))
        _lock(self._stream.fileno(), file)
        with file.open("rb") as stream:
            end = sum(len(line) for line in stream if line.endswith(b"\n"))  # removes a truncated line
        self._stream.truncate(end)
        self._stream.seek(end)

    def add(self, candidate: Candidate) -> LogEntry:
        """Append a candidate durably so that it survives a machine crash."""
        line = candidate.line().encode() + b"\n"
        start = self._stream.tell()
        self._stream.write(line)
        self._stream.flush()
        os.fsync(self._stream.fileno())
        return LogEntry(self.file, start, len(line), candidate.accepted)


def replace_logs(out: Path, places: Iterable[tuple[int, LogEntry]]) -> dict[int, LogEntry]:
    """Replace all logs with a single log.

    Args:
        out: Output folder of the run.
        places: Candidate indices and the positions of their lines, in the order in which to write them.

    Returns:
        The new positions by candidate index.
    """
    old, now = logs(out), dict[int, LogEntry]()
    whole, start = out / WORK / WHOLE, 0
    with Reader() as reader, writing_atomically(whole) as stream:
        for index, place in places:
            stream.write(reader.line(place))
            now[index] = LogEntry(whole, start, place.length, place.accepted)
            start += place.length
    for file in old:
        if file != whole:
            file.unlink(missing_ok=True)
    return now


def _lock(handle: int, file: Path) -> None:
    """Lock the file until it is closed; do nothing on file systems that do not support locks."""
    with suppress(ImportError, OSError):
        import fcntl

        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                f"another run is writing to {file.parent.parent}; wait until it ends, or stop it"
            ) from None


# Minimum number of candidates to examine before a recipe can be judged too hard.
PATIENCE = 200

# Minimum acceptance rate, below which a recipe is judged too hard.
LEAST_RATE = 0.005


class RunEnd(StrEnum):
    """The reason why a run ended, or OPEN while it continues."""

    OPEN = "open"
    COMPLETE = "complete"
    HOPELESS = "hopeless"
    EXHAUSTED = "exhausted"


@dataclass
class Ledger:
    """Counts the candidates ``first``, ``first + step``, … in this order, up to the first one not yet examined.

    Attributes:
        wanted: Number of candidates to accept.
        first: Index of the first candidate.
        step: Difference between consecutive indices; greater than 1 for a shard.
        most: Highest existing index, or None if the number of candidates is unbounded.
        known: Log entries of all examined candidates by index.
        accepted: Indices of the counted candidates that were accepted.
        totals: Number of counted candidates rejected for each reason.
        unchecked: Checks that could not be performed for at least one accepted candidate.
        next_index: Index of the first candidate that is not counted yet.
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
        """Number of counted candidates."""
        return (self.next_index - self.first) // self.step

    @property
    def last(self) -> int:
        """Index of the last counted candidate."""
        return self.next_index - self.step

    @property
    def rate(self) -> float:
        """Fraction of the counted candidates that were accepted."""
        return len(self.accepted) / self.examined if self.examined else 0.0

    def advance(self, reader: Reader, settled: Callable[[Candidate], None]) -> None:
        """Continue counting until a candidate has not been examined yet or the run ends.

        Args:
            reader: Reads the candidates from the logs.
            settled: Called with each newly counted candidate that was accepted.
        """
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
        """Yield the log entries of the counted candidates, in order."""
        return (self.known[k] for k in self.indices())

    def indices(self) -> range:
        """Return the indices of the counted candidates, in order."""
        return range(self.first, self.next_index, self.step)

    def unknown(self) -> Iterator[int]:
        """Yield the indices of unexamined candidates in order; infinite if the number of candidates is unbounded."""
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


# Maximum number of candidates per worker to examine ahead of the first unexamined one; limits memory use and wasted
# work.
AHEAD = 32

# File name of a run's final report in the output folder.
MANIFEST = "manifest.json"

# Callback that receives the ledger after each candidate.
Heard = Callable[[Ledger], None]


@dataclass(frozen=True)
class RunPlan:
    """The parameters of a run.

    Attributes:
        out: Output folder.
        wanted: Number of cousins to generate.
        about: Fingerprint of the run; runs with equal fingerprints produce identical bytes.
        shard: (i, n) to examine only every n-th candidate, starting with candidate i (1-based), and to write no
            cousins; None for a full run.
        most: Number of candidates, or None if it is unbounded.
        variants: Variant counts for each object that varies.
    """

    out: Path
    wanted: int
    about: dict[str, Any]
    shard: tuple[int, int] | None = None
    most: int | None = None
    variants: tuple[VariantCount, ...] = ()

    def ledger(self) -> Ledger:
        """Return an empty ledger; a shard must accept only its fraction of the wanted cousins."""
        if self.shard is None:
            return Ledger(self.wanted, most=self.most)
        first, step = self.shard
        return Ledger(-(-self.wanted // step), first, step, self.most)


def begin(plan: RunPlan) -> None:
    """Create the output folder of a run, or check that an existing folder belongs to a run with the same fingerprint.

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
                raise OutputError(
                    f"{plan.out} contains cousins from a different run: its {key} {differs}; choose another folder or "
                    "delete this one"
                )
        return
    strange = [p.name for p in plan.out.iterdir() if p.name != WORK] if plan.out.is_dir() else []
    if strange:
        raise OutputError(
            f"{plan.out} contains {sorted(strange)[0]}, which was not written by a cousins run; choose an empty folder"
        )
    write_atomically(path, (json.dumps(plan.about, indent=1, ensure_ascii=False) + "\n").encode())


def run(plan: RunPlan, pool: Callable[[], CandidatePool], heard: Heard = lambda ledger: None) -> Ledger:
    """Examine candidates until the plan is fulfilled or fails; candidates in the logs are not examined again.

    Args:
        plan: Parameters of the run.
        pool: Function that opens the worker pool; called only if there are candidates to examine.
        heard: Called with the ledger after each candidate.

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
            if plan.shard is None:  # a shard does not know which of its candidates will count
                write_documents(plan.out, candidate)

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


def _see_no_more(plan: RunPlan, ledger: Ledger) -> None:
    """Raise :class:`OutputError` if the folder contains more cousins than requested."""
    beyond = [p.name for p in plan.out.glob("[0-9]*.*.yaml") if int(p.name.partition(".")[0]) > ledger.last]
    if beyond and plan.shard is None:
        raise OutputError(
            f"{plan.out} contains {len(beyond)} documents of cousins beyond the {plan.wanted} requested; "
            "choose another folder, or request as many cousins as before"
        )


def _examined(ledger: Ledger, pool: CandidatePool) -> Iterator[Candidate]:
    """Yield newly examined candidates as they finish, and keep the pool busy until the run ends."""
    todo, running = ledger.unknown(), 0
    index, ahead = next(todo, None), AHEAD * ledger.step * pool.size
    while ledger.end is RunEnd.OPEN:
        while index is not None and running < 2 * pool.size and index - ledger.next_index < ahead:
            pool.submit(index)
            running += 1
            index = next(todo, None)
        yield pool.next()
        running -= 1


def write_documents(out: Path, candidate: Candidate) -> None:
    """Write a cousin's documents, unless identical files already exist."""
    for kind, name in candidate.files().items():
        path, data = out / name, candidate.documents[kind].encode()
        if not (path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data):
            write_atomically(path, data)


def finish(plan: RunPlan, ledger: Ledger) -> None:
    """Merge the logs into a single log that contains exactly the counted candidates, in order."""
    ledger.known = replace_logs(plan.out, ((k, ledger.known[k]) for k in ledger.indices()))
