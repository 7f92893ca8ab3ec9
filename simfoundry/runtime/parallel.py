"""A parallel map that runs in this process if that is fast enough, and otherwise across the CPU cores."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from simfoundry.errors import SimfoundryError

T = TypeVar("T")
R = TypeVar("R")

SERIAL_TRIAL = 32  # Number of inputs processed serially before estimating the remaining time; enough for a stable mean

# Minimum amount of remaining work [s] that justifies starting processes, whose startup takes about 0.5 s.
STARTUP_S = 2.0

MAX_PROCESSES = 8  # Default maximum number of processes; with more, memory becomes the bottleneck

MAX_CHUNK = 32  # Maximum number of inputs per call, so that progress is reported regularly

SILENCE_S = 600.0  # Time limit for a chunk [s], far more than valid documents take


def map_parallel(
    function: Callable[[T], R],
    inputs: Sequence[T],
    progress: Callable[[int], object] = lambda done: None,
    startup_s: float = STARTUP_S,
    processes: int | None = None,
) -> list[R]:
    """Map ``function`` over ``inputs``, in this process if that is fast enough, and otherwise across the CPU cores.

    Args:
        function: A module-level function, or a partial of a module-level function, so that other processes can import
            it.
        inputs: The inputs of the function.
        progress: Callback that receives the number of completed inputs.
        startup_s: Minimum estimated time for the remaining inputs [s] that justifies starting processes.
        processes: Maximum number of processes.

    Returns:
        The results, in the order of the inputs.
    """
    processes = min(MAX_PROCESSES, usable_cores()) if processes is None else processes
    results: list[R] = []
    start = 0.0
    for k, value in enumerate(inputs, 1):
        results.append(function(value))
        progress(k)
        if k == 1:
            start = time.perf_counter()  # the first call includes the imports
        elif k >= SERIAL_TRIAL and processes > 1:
            mean_s = (time.perf_counter() - start) / (k - 1)
            if (len(inputs) - k) * mean_s > startup_s:
                break
    here = len(results)
    if here < len(inputs):
        results += _map_in_processes(function, inputs[here:], lambda done: progress(here + done), processes)
    return results


def _map_in_processes(
    function: Callable[[T], R], inputs: Sequence[T], progress: Callable[[int], object], processes: int
) -> list[R]:
    from simfoundry.runtime.workers import Limits, WorkerError, WorkerPool

    size = max(1, min(MAX_CHUNK, len(inputs) // (4 * processes)))
    chunks = [inputs[k : k + size] for k in range(0, len(inputs), size)]
    found: dict[int, list[R]] = {}
    pool = WorkerPool(min(processes, len(chunks)), Limits.shared(SILENCE_S, processes))
    try:
        for k, chunk in enumerate(chunks):
            pool.submit(k, f"{__name__}:map_chunk", function, chunk)
        for _ in chunks:
            k, result = pool.next()
            if isinstance(result, WorkerError):
                raise SimfoundryError(f"a worker process {result}; check whether the machine ran out of memory")
            found[k] = result
            progress(sum(map(len, found.values())))
    finally:
        pool.close()
    return [result for k in range(len(chunks)) for result in found[k]]


def map_chunk(function: Callable[[T], R], chunk: Sequence[T]) -> list[R]:
    """Map ``function`` over a chunk of inputs in a worker process."""
    return [function(value) for value in chunk]


def usable_cores() -> int:
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
