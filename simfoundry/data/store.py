"""The folder of a recording: finished attempts outside shards, and shards that are written when they are full."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from simfoundry.data.attempt import NOT_REPRODUCED, AttemptJob
from simfoundry.data.index import INDEX, build_index, check_index, read_index, write_index
from simfoundry.data.plan import RecordPlan, RecordSummary
from simfoundry.data.shards import Attempt, read_shard, write_shard
from simfoundry.errors import OutputError
from simfoundry.runtime.files import clear_staged_files

SHARDS, UNFINISHED = "shards", "unfinished"

# Number of demonstrations per shard; a shard is rewritten at most once, and takes about 5 MB.
SHARD = 25


class AttemptStore:
    """The attempts of a recording that are finished, in memory and on disk."""

    def __init__(self, plan: RecordPlan) -> None:
        self.plan = plan
        self.done: dict[int, Attempt] = {}
        self._flushed = 0  # the number of attempts in full shards
        self._shards = 0  # the number of full shards
        self._written: dict[int, tuple[int, ...]] = {}  # the attempts in each shard on disk
        _open_folder(plan)
        self._read()

    @property
    def kept(self) -> int:
        """The number of demonstrations."""
        return sum(attempt.is_kept for attempt in self.done.values())

    def _read(self) -> None:
        folder = self.plan.folder
        for place in (folder, folder / SHARDS, folder / UNFINISHED):
            clear_staged_files(place)
        count = len(shard_files(folder))
        for number, (_, attempts) in enumerate(read_shards(folder)):
            self.done |= {attempt.index: _without_arrays(attempt) for attempt in attempts}
            self._written[number] = tuple(attempt.index for attempt in attempts)
            if number < count - 1 or sum(attempt.is_kept for attempt in attempts) >= SHARD:
                self._flushed, self._shards = len(self.done), number + 1
            else:  # the last shard continues to grow
                self.done |= {attempt.index: attempt for attempt in attempts}
        in_shards = len(self.done)
        for path in sorted((folder / UNFINISHED).glob("*.npz")):
            for attempt in read_shard(path):
                if attempt.index < in_shards:
                    path.unlink()  # the shard was written, but the process was killed before this file was removed
                else:
                    self.done[attempt.index] = attempt

    def next(self, running: set[int]) -> AttemptJob | None:
        """Return the next attempt to start, or None if no attempt should start now.

        An attempt starts only if the running ones cannot suffice. No attempt after the last demonstration is therefore
        ever started, whatever the number of processes.
        """
        known = self.done.keys() | running
        index = next(k for k in range(len(known) + 1) if k not in known)
        is_gap = any(k > index for k in self.done)  # the process was killed before this attempt had finished
        if index >= self.plan.max_attempts or not (is_gap or self.kept + len(running) < self.plan.count):
            return None
        return self.plan.job(index)

    def add(self, attempt: Attempt) -> None:
        """Write a finished attempt, and a shard if it is complete."""
        write_shard(self._unfinished(attempt.index), [attempt])
        self.done[attempt.index] = attempt
        while (shard := self._next_shard()) is not None:
            self._write(shard)
            self._flushed, self._shards = shard[-1].index + 1, self._shards + 1
            self.done |= {one.index: _without_arrays(one) for one in shard}

    def _next_shard(self) -> list[Attempt] | None:
        """Return the attempts of the next shard if it is full."""
        shard = list(self._open_attempts())
        ends = [k for k, _ in enumerate(shard) if sum(one.is_kept for one in shard[: k + 1]) == SHARD]
        return shard[: ends[0] + 1] if ends else None

    def _open_attempts(self) -> Iterator[Attempt]:
        """Yield the attempts after the full shards, up to the first that is not finished."""
        index = self._flushed
        while index in self.done:
            yield self.done[index]
            index += 1

    def finish(self) -> None:
        """Write the attempts after the last full shard as a shard that may still grow."""
        shard = list(self._open_attempts())
        if shard and tuple(one.index for one in shard) != self._written.get(self._shards):
            self._write(shard)
        with suppress(OSError):
            (self.plan.folder / UNFINISHED).rmdir()

    def _write(self, shard: list[Attempt]) -> None:
        write_shard(self.plan.folder / SHARDS / _shard_name(self._shards), shard)
        self._written[self._shards] = tuple(one.index for one in shard)
        for attempt in shard:
            self._unfinished(attempt.index).unlink(missing_ok=True)

    def _unfinished(self, index: int) -> Path:
        return self.plan.folder / UNFINISHED / f"{index:06d}.npz"

    def summary(self) -> RecordSummary:
        """Return the counts of attempts."""
        failed = [self.done[k].about for k in sorted(self.done) if not self.done[k].is_kept]
        reasons = {str(about["end"]): str(about["reason"]) for about in reversed(failed)}
        lost = tuple(int(about["index"]) for about in failed if about["end"] == NOT_REPRODUCED)
        return RecordSummary(self.kept, len(self.done), Counter(str(a["end"]) for a in failed), reasons, lost)


def _without_arrays(attempt: Attempt) -> Attempt:
    return Attempt({key: attempt.about[key] for key in ("index", "kept", "end", "reason")})


def _shard_name(number: int) -> str:
    return f"{number:05d}.npz"


def shard_files(folder: Path) -> list[Path]:
    """Return the shards of a recording, in order."""
    return sorted(path for path in (folder / SHARDS).glob("*.npz") if re.fullmatch(r"\d{5}\.npz", path.name))


def read_shards(folder: Path, with_arrays: bool = True) -> Iterator[tuple[Path, list[Attempt]]]:
    """Yield the shards of a recording with their attempts, in order, optionally without the arrays.

    Raises:
        OutputError: If a file is not a shard, or if a shard is missing.
    """
    first = 0
    for number, path in enumerate(shard_files(folder)):
        attempts = read_shard(path, with_arrays)
        indices = [attempt.index for attempt in attempts]
        if path.name != _shard_name(number) or indices != list(range(first, first + len(indices))):
            raise OutputError(f"{path} does not continue the shards before it; move {folder}, and record again")
        first += len(indices)
        yield path, attempts


def _open_folder(plan: RecordPlan) -> None:
    """Compare the folder with the plan, and write its index if the folder is empty.

    Raises:
        OutputError: If the folder contains other files, or demonstrations of other tasks, policies or versions.
    """
    path, wanted = plan.folder / INDEX, build_index(plan)
    others = [one.name for one in plan.folder.iterdir() if one.name != INDEX and not one.name.startswith(f".{INDEX}.")]
    if others and not path.exists():
        raise OutputError(f"{plan.folder} contains other files, such as {min(others)}; choose another folder")
    index = read_index(path) if path.exists() else {}
    if any(any((plan.folder / name).glob("*.npz")) for name in (SHARDS, UNFINISHED)):
        check_index(plan.folder, index, wanted)
    else:
        write_index(plan.folder, wanted)
