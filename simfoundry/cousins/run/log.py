"""Append-only log of examined candidates: a kill at any moment loses at most one line.

``OUT/.cousins/log.jsonl`` belongs to complete runs, ``log-2-of-4.jsonl`` to a shard. Each line is flushed to disk
before the next is written; a torn line is ignored, and truncated before anything is appended.
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
"""Folder of a run's internal files below its output."""

WHOLE = "log.jsonl"


class LogEntry(NamedTuple):
    """The position of a candidate's line in a log, and whether the candidate is accepted."""

    file: Path
    start: int
    length: int
    accepted: bool


def log_file(out: Path, shard: tuple[int, int] | None) -> Path:
    """Return the log file of a run, or of its shard (i, n)."""
    return out / WORK / (WHOLE if shard is None else f"log-{shard[0]}-of-{shard[1]}.jsonl")


def logs(out: Path) -> list[Path]:
    """Return every log of a folder of cousins, starting with that of the complete run."""
    return sorted((out / WORK).glob("log*.jsonl"), key=lambda path: (path.name != WHOLE, path.name))


def read_places(file: Path) -> dict[int, LogEntry]:
    """Index the complete lines of a log by candidate; raises :class:`OutputError` if the file is not a log."""
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
                    f"{file}:{number} is not a line of a log of cousins; move the file away to have its candidates "
                    "examined again"
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
    """Reader of candidates at known positions; files stay open between reads."""

    def __init__(self) -> None:
        self._open: dict[Path, int] = {}

    def line(self, place: LogEntry) -> bytes:
        """Read the line at a position."""
        if place.file not in self._open:
            self._open[place.file] = os.open(place.file, os.O_RDONLY)
        return os.pread(self._open[place.file], place.length, place.start)

    def candidate(self, place: LogEntry) -> Candidate:
        """Read the candidate at a position."""
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
    """An append-only log with a single writer process."""

    def __init__(self, file: Path) -> None:
        self.file = file
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream = file.open("ab")
        _lock(self._stream.fileno(), file)
        self._cut_torn_line()

    def add(self, candidate: Candidate) -> LogEntry:
        """Append a candidate durably so that it survives a machine crash."""
        line = candidate.line().encode() + b"\n"
        start = self._stream.tell()
        self._stream.write(line)
        self._stream.flush()
        os.fsync(self._stream.fileno())
        return LogEntry(self.file, start, len(line), candidate.accepted)

    def close(self) -> None:
        """Close the file and release its lock."""
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
    """Replace all logs by a single one with the lines at ``places``, by index and in their order.

    Return the new positions.
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
    """Lock the file until it is closed; does nothing on file systems without locks."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(
            f"another run writes to {file.parent.parent} at the moment; wait for it to end, or stop it"
        ) from None
    except OSError:
        return
