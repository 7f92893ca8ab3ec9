"""Executors, which run the jobs of a batch command in this process, in local worker processes, or on a Ray cluster.

An :class:`Executor` calls module-level functions by name, and returns results in order of completion. Jobs must not
depend on where they run, so that the results are the same everywhere.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, Protocol, TypeVar

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.parallel import usable_cores
from simfoundry.runtime.workers import GRACE_S, Limits, WorkerPool, run_exit_functions

J = TypeVar("J")

# The smallest and the largest number of workers, in Python and on the command line.
JOBS = (1, 256)

# Number of calls to make for a job whose process crashes, hangs or runs out of memory.
ATTEMPTS = 2


class Executor(Protocol):
    """Workers that execute up to ``size`` calls concurrently."""

    size: int

    def submit(self, key: Any, function: str, *arguments: Any, attempts: int = 1) -> None:
        """Queue a call to ``module:function``. If the call fails, it is retried, up to ``attempts`` calls in total."""

    def next(self) -> tuple[Any, Any]:
        """Wait for a call to finish, and return its key and either its result or a ``WorkerError``."""

    def close(self, grace_s: float = 0.0) -> None:
        """Stop all workers, even if they are busy. Idle workers have ``grace_s`` seconds to run exit functions."""


class SerialExecutor:
    """An executor that runs each call in this process when its result is requested. Exceptions are raised."""

    def __init__(self) -> None:
        self.size = 1
        self._calls: deque[tuple[Any, str, tuple[Any, ...]]] = deque()

    def submit(self, key: Any, function: str, *arguments: Any, attempts: int = 1) -> None:
        """Queue a call to ``module:function``."""
        self._calls.append((key, function, arguments))

    def next(self) -> tuple[Any, Any]:
        """Execute the next call, and return its key and its result."""
        key, function, arguments = self._calls.popleft()
        return key, resolve_name(function)(*arguments)

    def close(self, grace_s: float = 0.0) -> None:
        """Run the exit functions that the calls have registered."""
        run_exit_functions()


@dataclass(frozen=True)
class Machines:
    """The machines that run the jobs of a command: this one, or a Ray cluster.

    Attributes:
        is_ray: True for a Ray cluster.
        address: The address of the cluster. If it is empty, ``RAY_ADDRESS`` is used; if that is not set either, a
            cluster is started on this machine.
    """

    is_ray: bool = False
    address: str = ""

    @classmethod
    def parse(cls, text: str) -> Machines:
        """Parse ``local``, ``ray`` or ``ray:ADDRESS``.

        Raises:
            SimfoundryError: If the text has another form.
        """
        match = re.fullmatch(r"local|ray(?::(\S+))?", text)
        if match is None:
            raise SimfoundryError(
                f"expected `local`, `ray` or `ray:ADDRESS`, such as `ray:10.0.0.1:6379`, not `{text}`"
            )
        return cls(text != "local", match[1] or "")


LOCAL = Machines()


def worker_count(machines: Machines, jobs: int | None) -> int | None:
    """Return the number of workers of commands whose default is one on this machine, or None for one per CPU."""
    return 1 if jobs is None and not machines.is_ray else jobs


@dataclass(frozen=True)
class JobLimits:
    """The limits of a job.

    Attributes:
        seconds: The maximum time between progress reports [s].
        processes: The number of processes of a worker, which share its memory.
    """

    seconds: float
    processes: int = 1

    def on_machine(self, workers: int) -> Limits:
        """Return the limits on a machine with a number of workers."""
        return Limits.shared(self.seconds, self.processes * workers)


def open_executor(machines: Machines, workers: int | None, limits: JobLimits, isolated: bool = False) -> Executor:
    """Open an executor.

    Args:
        machines: The machines to use.
        workers: The number of workers. By default, one per usable core of this machine or of the cluster.
        limits: The limits of each job.
        isolated: Whether to use a worker process also for a single local worker, so that a crash is only an error.

    Raises:
        MissingEngineError: If Ray is required, but not installed.
        SimfoundryError: If the cluster cannot be reached.
    """
    if machines.is_ray:
        from simfoundry.runtime.ray_executor import RayExecutor

        return RayExecutor(machines.address, workers, limits)
    count = usable_cores() if workers is None else workers
    return SerialExecutor() if count == 1 and not isolated else WorkerPool(count, limits.on_machine(count))


def carry_out_jobs(
    executor: Executor, function: str, next_job: Callable[[], J | None], *arguments: Any
) -> Generator[tuple[J, Any]]:
    """Keep an executor busy until there are no more jobs, and close it.

    Args:
        executor: The executor.
        function: The function to call for each job, as ``module:function``.
        next_job: A function that returns the next job to start, or None if no job should start now. It is called again
            whenever a job has finished.
        *arguments: Arguments to pass before the job.

    Yields:
        Each job with its result or a ``WorkerError``, in order of completion.
    """
    running = 0
    try:
        while True:
            while running < executor.size and (job := next_job()) is not None:
                executor.submit(job, function, *arguments, job, attempts=ATTEMPTS)
                running += 1
            if not running:
                return
            finished, outcome = executor.next()
            running -= 1
            yield finished, outcome
    finally:
        executor.close(GRACE_S)
