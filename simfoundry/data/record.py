"""Record demonstrations: attempts from successive initial states until enough of them have succeeded.

Attempt k starts from initial state k. The demonstrations are those of the first n attempts that succeed and whose
replay is identical, so they depend only on the task, the policy and the seed, and neither on the number of processes
nor on interruptions. Every finished attempt is written at once to ``unfinished/``. When the attempts before it are
finished as well, they become shards of :data:`SHARD` demonstrations.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from simfoundry import __version__
from simfoundry.assets.cache import Cache
from simfoundry.data.attempt import ENGINE, NOT_REPRODUCED, SILENCE_S, AttemptJob, carry_out, close, is_answered
from simfoundry.data.shards import FORMAT, Attempt, read_shard, write_shard
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.entries import Contender, ExpertChoice
from simfoundry.evaluate.resets.starts import RolloutStart, key_of_starts, starts
from simfoundry.evaluate.task import Task, load_task, need_robots
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.files import clear_staged_files, locked_folder, write_atomically
from simfoundry.runtime.workers import GRACE_S, Limits, WorkerError, WorkerPool
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Condition

INDEX, SHARDS, UNFINISHED = "demonstrations.json", "shards", "unfinished"

# Maximum size of an index to read [bytes]; real ones take a few kilobytes.
MOST_BYTES = 2**24

# Number of demonstrations per shard; a shard is rewritten at most once, and takes about 5 MB.
SHARD = 25

# Number of consecutive attempts without a response after which recording stops, as in an evaluation.
GIVE_UP = 3

# Maximum number of initial states to find at once, so that they do not delay the first attempts.
STARTS_AHEAD = 25


@dataclass(frozen=True)
class RecordPlan:
    """The demonstrations to record.

    Attributes:
        folder: The output folder.
        document: The task document.
        contender: The policy.
        count: The number of demonstrations.
        max_attempts: The maximum number of attempts, including successful ones.
        seed: The seed for the initial states.
    """

    folder: Path
    document: Path
    contender: Contender
    count: int
    max_attempts: int
    seed: int = 0


@dataclass(frozen=True)
class RecordSummary:
    """The state of a recording.

    Attributes:
        kept: The number of demonstrations in the folder.
        attempts: The number of finished attempts.
        failures: The number of other attempts by the reason why they ended.
        reasons: The reason of the first attempt with each of these ends.
        not_reproduced: The indices of successful attempts whose replay differed.
    """

    kept: int
    attempts: int
    failures: Mapping[str, int]
    reasons: Mapping[str, str]
    not_reproduced: tuple[int, ...]


# Callback that receives each finished attempt, the number of demonstrations so far, and the number of attempts so far.
Seen = Callable[[Attempt, int, int], None]


def record(plan: RecordPlan, seen: Seen = lambda attempt, kept, of: None, workers: int = 1) -> RecordSummary:
    """Record demonstrations until there are enough, or until the attempts are used up. Existing ones are kept.

    Raises:
        SimfoundryError: If the policy does not respond, or if the folder cannot be used.
    """
    if isinstance(plan.contender.choice(), ExpertChoice):
        need_extra("expert", "policy `expert`")
    task = load_task(plan.document, Cache.default())
    need_robots(task)
    with _writing(plan.folder):
        store = _Store(plan, task)
        carried_out = _in_workers(store, workers) if workers > 1 else _in_this_process(store)
        try:
            with closing(carried_out):
                _collect(store, carried_out, seen)
        except BaseException:
            with suppress(OSError):  # what was recorded so far can be read, also if the rest never follows
                store.finish()
            raise
        store.finish()
        return store.summary()


def _collect(store: _Store, attempts: Iterator[Attempt], seen: Seen) -> None:
    """Store attempts as they finish."""
    silent = 0
    for attempt in attempts:
        silent = 0 if is_answered(attempt) else silent + 1
        if silent >= GIVE_UP:
            reason = attempt.about["reason"]
            raise SimfoundryError(f"policy `{store.plan.contender.label}` does not respond: {reason}")
        if is_answered(attempt):
            store.add(attempt)
            seen(attempt, store.kept, len(store.done))


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Lock a folder in which only this recording may write."""
    folder.mkdir(parents=True, exist_ok=True)
    with locked_folder(folder, "is being written by another recording; wait for it, or choose another folder"):
        yield


class _Store:
    """The attempts of a recording that are finished, in memory and on disk."""

    def __init__(self, plan: RecordPlan, task: Task) -> None:
        self.plan, self._task = plan, task
        self.done: dict[int, Attempt] = {}
        self._starts: tuple[RolloutStart, ...] = ()
        self._flushed = 0  # the number of attempts in full shards
        self._shards = 0  # the number of full shards
        self._written: dict[int, tuple[int, ...]] = {}  # the attempts in each shard on disk
        _check_index(plan, task)
        self._read()

    @property
    def kept(self) -> int:
        """The number of demonstrations."""
        return sum(attempt.is_kept for attempt in self.done.values())

    def _read(self) -> None:
        folder = self.plan.folder
        for place in (folder, folder / SHARDS, folder / UNFINISHED):
            clear_staged_files(place)
        shards = shard_files(folder)
        for number, path in enumerate(shards):
            attempts = read_shard(path)
            indices = [attempt.index for attempt in attempts]
            first = len(self.done)
            if path.name != _shard_name(number) or indices != list(range(first, first + len(indices))):
                raise OutputError(f"{path} does not continue the shards before it; move {folder}, and record again")
            self.done |= {attempt.index: _without_arrays(attempt) for attempt in attempts}
            self._written[number] = tuple(indices)
            if number < len(shards) - 1 or sum(attempt.is_kept for attempt in attempts) >= SHARD:
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
        return AttemptJob.of(self.plan.document, self.plan.contender, self._start(index))

    def _start(self, index: int) -> RolloutStart:
        if index >= len(self._starts):
            needed = min(max(1, self.plan.count - self.kept), STARTS_AHEAD)
            count = min(index + needed, self.plan.max_attempts)
            self._starts = starts(self._task, count, self.plan.seed, Cache.default())
        return self._starts[index]

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


def _check_index(plan: RecordPlan, task: Task) -> None:
    """Compare the folder with the plan, and write its index if the folder is empty.

    Raises:
        OutputError: If the folder contains other files, or demonstrations of another task, policy or version.
    """
    path, wanted = plan.folder / INDEX, _index(plan, task)
    others = [one.name for one in plan.folder.iterdir() if one.name != INDEX and not one.name.startswith(f".{INDEX}.")]
    if others and not path.exists():
        raise OutputError(f"{plan.folder} contains other files, such as {min(others)}; choose another folder")
    there = read_index(path) if path.exists() else {}
    if not any(any((plan.folder / name).glob("*.npz")) for name in (SHARDS, UNFINISHED)):
        write_atomically(path, (json.dumps(wanted, indent=1, ensure_ascii=False) + "\n").encode())
        return
    for key, value in wanted.items():
        if there.get(key) != json.loads(json.dumps(value)):
            raise OutputError(
                f"{plan.folder} contains demonstrations with a different {_KEYS.get(key, f'`{key}`')}: "
                f"{there.get(key)!r}, not {value!r}; choose another folder"
            )


_KEYS = {
    "starts": "scene, goal or initial states (by their hash)",
    "policy_digest": "policy (its document, recording or code)",
    "engine_version": "version of MuJoCo",
}


def read_index(path: Path) -> dict[str, Any]:
    """Read the index of a recording.

    Raises:
        OutputError: If the file is not such an index.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["simfoundry"] != FORMAT:
            raise ValueError
    except FileNotFoundError:
        raise OutputError(f"{path.parent} does not contain demonstrations: {path.name} is missing") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is not an index of demonstrations in the format {FORMAT}") from None
    return dict(found)


def _index(plan: RecordPlan, task: Task) -> dict[str, Any]:
    """Return what all demonstrations of a folder have in common."""
    scene = task.scene
    initial, goals = SceneState.initial(scene), TypeAdapter(Condition)
    return {
        "simfoundry": FORMAT,
        "version": __version__,
        "engine": ENGINE,
        "engine_version": version(ENGINE),
        "task": task.name,
        "document": Path(os.path.relpath(plan.document.resolve(), plan.folder.resolve())).as_posix(),
        "starts": key_of_starts(task, plan.seed),
        "seed": plan.seed,
        "policy": plan.contender.label,
        "policy_digest": plan.contender.digest,
        "instruction": task.instruction,
        "control_hz": task.control_hz,
        "horizon": task.horizon,
        "robots": {name: scene.robot(name).kind for name in task.robots},
        "goal": goals.dump_python(task.goal, mode="json", by_alias=True),
        "subtasks": {name: goals.dump_python(s.goal, mode="json", by_alias=True) for name, s in task.subtasks.items()},
        "objects": list(initial.poses),
        "joints": list(initial.joints),
        "motions": list(initial.motions),
    }


def _in_this_process(store: _Store) -> Generator[Attempt]:
    try:
        while (job := store.next(set())) is not None:
            yield _raised(job, carry_out(job))
    finally:
        close()


def _in_workers(store: _Store, workers: int) -> Generator[Attempt]:
    # Each worker has a second process that replays, and the two take turns.
    pool = WorkerPool(workers, Limits.shared(SILENCE_S, 2 * workers))
    running: dict[int, AttemptJob] = {}
    try:
        while True:
            while len(running) < workers and (job := store.next(set(running))) is not None:
                running[job.index] = job
                pool.submit(job.index, f"{carry_out.__module__}:carry_out", job)
            if not running:
                return
            index, outcome = pool.next()
            yield _raised(running.pop(index), outcome)
    finally:
        pool.close(GRACE_S)


def _raised(job: AttemptJob, outcome: Attempt | SimfoundryError) -> Attempt:
    """Return an attempt, or raise the error that prevented it."""
    if isinstance(outcome, WorkerError):
        raise SimfoundryError(f"the worker process for attempt {job.index} {outcome.how}")
    if isinstance(outcome, SimfoundryError):
        raise outcome
    return outcome
