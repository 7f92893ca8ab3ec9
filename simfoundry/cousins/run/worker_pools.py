"""Worker pools that examine candidates, on this machine or on a Ray cluster, with identical results.

A pool receives candidate indices and returns the candidates in order of completion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, Protocol

from simfoundry.cousins.recipe.candidate import Candidate, Reason
from simfoundry.runtime.executors import ATTEMPTS, LOCAL, Executor, JobLimits, Machines, open_executor
from simfoundry.runtime.workers import WorkerError

# Timeout for examining a candidate [s]. For the first candidate of each process, this includes the process startup.
SILENCE_S = 600.0


@dataclass(frozen=True)
class Work:
    """The job of a worker process: create a sampler and call it for each candidate.

    The sampler is created by calling ``factory`` (``module:name``) with ``arguments``.
    """

    factory: str
    arguments: tuple[Any, ...] = ()

    def sampler(self) -> Callable[[int], Candidate]:
        """Create the function that returns the candidate with a given index."""
        made: Callable[[int], Candidate] = resolve_name(self.factory)(*self.arguments)
        return made


# The sampler of this worker process, created for its first candidate. A worker process serves only one run.
_SAMPLERS: dict[Work, Callable[[int], Candidate]] = {}


def line_of(work: Work, index: int) -> str:
    """Examine a candidate and return it as a single line of text. This format is used between processes."""
    if work not in _SAMPLERS:
        _SAMPLERS[work] = work.sampler()
    return _SAMPLERS[work](index).line()


class CandidatePool(Protocol):
    """A pool that examines up to ``size`` candidates concurrently."""

    size: int

    def submit(self, index: int) -> None:
        """Submit the index of a candidate to examine."""

    def next(self) -> Candidate:
        """Wait until one of the submitted candidates has been examined, and return it."""

    def close(self) -> None:
        """Stop all workers, including those that are busy."""


class ExecutorPool:
    """A pool of worker processes, on this machine or on a Ray cluster.

    If a process crashes or hangs, its candidate is retried once and then rejected.
    """

    def __init__(self, work: Work, executor: Executor) -> None:
        self.work, self.size, self._executor = work, executor.size, executor

    def submit(self, index: int) -> None:
        """Submit the index of a candidate to examine."""
        self._executor.submit(index, f"{__name__}:line_of", self.work, index, attempts=ATTEMPTS)

    def next(self) -> Candidate:
        """Wait until one of the submitted candidates has been examined, and return it."""
        index, result = self._executor.next()
        if isinstance(result, WorkerError):
            return Candidate(index, reasons=(Reason("failed", f"its process {result.how}"),))
        return Candidate.of(result)

    def close(self) -> None:
        """Stop the worker processes."""
        self._executor.close()


def open_pool(work: Work, machines: Machines = LOCAL, jobs: int | None = None) -> CandidatePool:
    """Open a worker pool.

    Args:
        work: Job of each worker.
        machines: The machines to use.
        jobs: Number of workers. The default is one per core.
    """
    return ExecutorPool(work, open_executor(machines, jobs, JobLimits(SILENCE_S), isolated=True))
