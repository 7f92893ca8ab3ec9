"""Logs of examined candidates.

A log is append-only, so a process that is killed at any point loses at most one line. ``OUT/.cousins/log.jsonl`` is the
log of full runs, and ``log-2-of-4.jsonl`` is the log of a shard. Each line is flushed to disk before the next one is
written. A truncated last line is ignored and is removed before anything is appended.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.errors import OutputError
from simfoundry.runtime.files import writing_atomically

# Subfolder of the output folder for a run's internal files.
WORK = ".cousins"

# File name of the log of a full run.
WHOLE = "log.jsonl"


class LogEntry(NamedTuple):
    """The location of a candidate's line in a log, with a flag that is True if the candidate was accepted."""

    file: Path
    start: int
    length: int
    accepted: bool


def log_file(out: Path, shard: tuple[int, int] | None) -> Path:
    """Return the path to the log of a full run, or of shard (i, n)."""
    return out / WORK / (WHOLE if shard is None else f"log-{shard[0]}-of-{shard[1]}.jsonl")


def logs(out: Path) -> list[Path]:
    """Return the paths of all logs in an output folder, starting with the log of the full run."""
    return sorted((out / WORK).glob("log*.jsonl"), key=lambda path: (path.name != WHOLE, path.name))


def read_places(file: Path) -> dict[int, LogEntry]:
    """Return the log entries for all complete lines in a log, keyed by candidate index.

    Raises:
        OutputError: The file is not a log.
    """
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
                hint = "move the file elsewhere to examine its candidates again"
                raise OutputError(f"{file}:{number} is not a valid line in a cousins log; {hint}") from None
            found[index] = LogEntry(file, start, len(line), b'"reasons":' not in line[:40])
            start += len(line)
    return found


class Reader(ExitStack):
    """A reader of candidates in logs that keeps the log files open between reads."""

    def __init__(self) -> None:
        super().__init__()
        self._open: dict[Path, int] = {}

    def line(self, place: LogEntry) -> bytes:
        """Return the line to which a log entry refers."""
        if place.file not in self._open:
            self._open[place.file] = self.enter_context(place.file.open("rb")).fileno()
        return os.pread(self._open[place.file], place.length, place.start)

    def candidate(self, place: LogEntry) -> Candidate:
        """Return the candidate to which a log entry refers."""
        return Candidate.of(self.line(place))


class Log(ExitStack):
    """An append-only log to which only one process can write.

    Closing the log releases its lock.
    """

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
        """Append a candidate and flush it to disk so that it survives a machine crash."""
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
        places: Candidate indices and log entries, in the order in which to write them.

    Returns:
        The new log entries, keyed by candidate index.
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
    """Lock a file until it is closed.

    If the file system does not support locks, nothing happens.
    """
    with suppress(ImportError, OSError):
        import fcntl

        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            message = f"another run is writing to {file.parent.parent}; wait until it ends, or stop it"
            raise OutputError(message) from None
