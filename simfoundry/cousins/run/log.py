"""What is known of candidates, on disk: lines that are only ever added, so that a kill at any moment loses one at most.

``OUT/.cousins/log.jsonl`` is of runs of the whole, ``log-2-of-4.jsonl`` of a shard. Each line is on the disk before the
next is begun; of a line that is torn nothing is believed, and it is cut off before anything is added.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.errors import OutputError
from simfoundry.runtime.files import writing_atomically

WORK = ".cousins"
"""The folder of a run's own files below its output."""

WHOLE = "log.jsonl"


class LogEntry(NamedTuple):
    """The place of a candidate's line in a log, and whether the candidate is accepted."""

    file: Path
    start: int
    length: int
    accepted: bool


def log_file(out: Path, shard: tuple[int, int] | None) -> Path:
    """The log of a run, or of a shard (i, n) of it."""
    return out / WORK / (WHOLE if shard is None else f"log-{shard[0]}-of-{shard[1]}.jsonl")


def logs(out: Path) -> list[Path]:
    """Every log of a folder of cousins, that of the whole first."""
    return sorted((out / WORK).glob("log*.jsonl"), key=lambda path: (path.name != WHOLE, path.name))


def read_places(file: Path) -> dict[int, LogEntry]:
    """The whole lines of a log by index of the candidate. Raises :class:`OutputError` for what is no log."""
    found: dict[int, LogEntry] = {}
    if not file.is_file():
        return found
    with file.open("rb") as stream:
        start = 0
        for number, line in enumerate(stream, 1):
            if not line.endswith(b"\n"):
                break  # torn by a kill
            index = _index(line)
            if index is None:
                raise OutputError(
                    f"{file}:{number} is no line of a log of cousins; move the file away, and its candidates "
                    "are examined anew"
                )
            found[index] = LogEntry(file, start, len(line), b'"reasons":' not in line[:40])
            start += len(line)
    return found


def _index(line: bytes) -> int | None:
    try:
        index = json.loads(line)["index"]
    except (ValueError, KeyError, TypeError):
        return None
    return index if isinstance(index, int) else None


class Reader:
    """Reads candidates back from their places; the files stay open between two reads."""

    def __init__(self) -> None:
        self._open: dict[Path, int] = {}

    def line(self, place: LogEntry) -> bytes:
        """The line at a place."""
        if place.file not in self._open:
            self._open[place.file] = os.open(place.file, os.O_RDONLY)
        return os.pread(self._open[place.file], place.length, place.start)

    def candidate(self, place: LogEntry) -> Candidate:
        """The candidate at a place."""
        return Candidate.of(self.line(place))

    def close(self) -> None:
        """Close the files."""
        while self._open:
            os.close(self._open.popitem()[1])

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


class Log:
    """A log that is added to; one process at a time."""

    def __init__(self, file: Path) -> None:
        self.file = file
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream = file.open("ab")
        _lock(self._stream.fileno(), file)
        self._cut_torn_line()

    def add(self, candidate: Candidate) -> LogEntry:
        """Write a candidate, so that it outlives a kill of the machine."""
        line = candidate.line().encode() + b"\n"
        start = self._stream.tell()
        self._stream.write(line)
        self._stream.flush()
        os.fsync(self._stream.fileno())
        return LogEntry(self.file, start, len(line), candidate.accepted)

    def close(self) -> None:
        """Let go of the file."""
        self._stream.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _cut_torn_line(self) -> None:
        end = 0
        with self.file.open("rb") as stream:
            for line in stream:
                end += len(line) if line.endswith(b"\n") else 0
        self._stream.truncate(end)
        self._stream.seek(end)


def replace_logs(out: Path, places: Iterable[tuple[int, LogEntry]]) -> dict[int, LogEntry]:
    """Make one log of the lines at ``places`` by index, in their order, in the place of all that are there.

    Returns where the lines are now.
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
    """Hold the file until it is closed; where files cannot be locked nothing is held."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(f"another run writes to {file.parent.parent} right now; wait for it, or stop it") from None
    except OSError:
        return
