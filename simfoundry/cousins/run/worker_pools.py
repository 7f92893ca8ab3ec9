"""Worker pools that examine candidates in local processes or on a Ray cluster, with identical results.

A pool receives candidate indices and returns the candidates in order of completion.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol

from simfoundry.cousins.recipe.candidate import Candidate, Reason
from simfoundry.errors import MissingEngineError
from simfoundry.runtime.extras import install_line
from simfoundry.runtime.workers import Limits, WorkerError, WorkerPool

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


class LocalPool:
    """A pool of processes on this machine.

    If a process crashes or hangs, its candidate is retried once and then rejected.
    """

    def __init__(self, work: Work, size: int) -> None:
        self.work, self.size = work, size
        self._pool = WorkerPool(size, Limits.shared(SILENCE_S, size))

    def submit(self, index: int) -> None:
        """Submit the index of a candidate to examine."""
        self._pool.submit(index, f"{__name__}:line_of", self.work, index, attempts=2)

    def next(self) -> Candidate:
        """Wait until one of the submitted candidates has been examined, and return it."""
        index, result = self._pool.next()
        return failed(index, result.how) if isinstance(result, WorkerError) else Candidate.of(result)

    def close(self) -> None:
        """Stop the worker processes."""
        self._pool.close()


def failed(index: int, how: str) -> Candidate:
    """Return a candidate that was rejected because its process failed."""
    return Candidate(index, reasons=(Reason("failed", f"its process {how}"),))


class RayPool:
    """A pool of actors on a Ray cluster.

    The pool connects to the cluster at ``RAY_ADDRESS``, or starts a cluster on this machine. The paths of the recipe
    and the output folder must be valid on every node, for example on a shared file system.
    """

    def __init__(self, work: Work, size: int | None) -> None:
        try:
            import ray as module
        except ModuleNotFoundError:
            raise MissingEngineError(f"`--on ray` requires ray; install it with `{install_line('ray')}`") from None
        ray: Any = module
        self._ray, self._owns = ray, not ray.is_initialized()
        if self._owns:
            _connect(ray, size)
        self.size = size or max(1, int(ray.cluster_resources().get("CPU", 1)))
        remote = ray.remote(num_cpus=1, max_restarts=2, max_task_retries=1)(_Actor)
        self._idle: list[Any] = [remote.remote(work) for _ in range(self.size)]
        self._waiting: list[int] = []
        self._running: dict[Any, tuple[int, Any]] = {}

    def submit(self, index: int) -> None:
        """Submit the index of a candidate to examine."""
        self._waiting.append(index)
        self._hand_out()

    def next(self) -> Candidate:
        """Wait until one of the submitted candidates has been examined, and return it."""
        done, _ = self._ray.wait(list(self._running), num_returns=1)
        index, actor = self._running.pop(done[0])
        self._idle.append(actor)
        self._hand_out()
        try:
            return Candidate.of(self._ray.get(done[0]))
        except self._ray.exceptions.RayError as error:
            return failed(index, f"failed ({type(error).__name__}: {str(error).splitlines()[-1].strip()})")

    def close(self) -> None:
        """Stop the actors, and shut down Ray if this pool started it."""
        for actor in [*self._idle, *(actor for _, actor in self._running.values())]:
            self._ray.kill(actor)
        if self._owns:
            self._ray.shutdown()

    def _hand_out(self) -> None:
        while self._idle and self._waiting:
            actor, index = self._idle.pop(), self._waiting.pop(0)
            self._running[actor.line.remote(index)] = (index, actor)


class _Actor:
    """A worker process on a Ray cluster."""

    def __init__(self, work: Work) -> None:
        self.sampler = work.sampler()

    def line(self, index: int) -> str:
        return self.sampler(index).line()


def _connect(ray: Any, size: int | None) -> None:
    """Connect to the cluster at ``RAY_ADDRESS``, or start a cluster on this machine with this process's import path.

    Ray puts the driver's working directory first on the import path. In a checkout, this directory would shadow the
    installed package, so Ray is started from an empty folder.
    """
    import logging
    import sys
    from contextlib import chdir
    from tempfile import TemporaryDirectory

    paths = os.pathsep.join(str(Path(p).absolute()) for p in sys.path if p)
    local: dict[str, Any] = {"num_cpus": size or os.cpu_count(), "include_dashboard": False}
    local["runtime_env"] = {"env_vars": {"PYTHONPATH": paths}}
    with TemporaryDirectory(prefix="simfoundry-ray-") as empty, chdir(empty):
        options = {} if os.environ.get("RAY_ADDRESS") else local
        ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)


def open_pool(work: Work, where: str = "local", jobs: int | None = None) -> CandidatePool:
    """Open a worker pool.

    Args:
        work: Job of each worker.
        where: `ray` to use a Ray cluster. Any other value selects local processes.
        jobs: Number of workers. The default is one per core.
    """
    return RayPool(work, jobs) if where == "ray" else LocalPool(work, jobs or os.cpu_count() or 1)
