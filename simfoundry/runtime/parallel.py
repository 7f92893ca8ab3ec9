"""Parallel map: in this process if that is fast enough, otherwise across the CPU cores."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from simfoundry.errors import SimfoundryError

T = TypeVar("T")
R = TypeVar("R")

SERIAL_TRIAL = 32  # Number of inputs processed here before the remaining time is estimated; enough for a stable mean

# Shortest remaining work [s] for which processes are started; starting them and importing everything takes 0.5 s.
STARTUP_S = 2.0

MAX_PROCESSES = 8  # Default maximum number of processes; with more, memory runs out before time is gained

MAX_CHUNK = 32  # Maximum number of inputs per call, so that progress is visible

SILENCE_S = 600.0  # Maximum time for a chunk [s], far more than any valid document needs


def map_parallel(
    function: Callable[[T], R],
    inputs: Sequence[T],
    progress: Callable[[int], object] = lambda done: None,
    startup_s: float = STARTUP_S,
    processes: int | None = None,
) -> list[R]:
    """Map ``function`` over ``inputs``, here if that is fast enough, else across the cores; order is preserved.

    ``function`` must be a module-level function or a partial of one, so that other processes can import it.
    ``progress`` receives the number of completed inputs. Processes are started if several cores are available and the
    remaining inputs would take more than ``startup_s`` seconds here.
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
    done = 0
    pool = WorkerPool(min(processes, len(chunks)), Limits.shared(SILENCE_S, processes))
    try:
        for k, chunk in enumerate(chunks):
            pool.submit(k, f"{__name__}:map_chunk", function, chunk)
        for _ in chunks:
            k, result = pool.next()
            if isinstance(result, WorkerError):
                raise SimfoundryError(f"a worker process {result}; check whether the machine has run out of memory")
            found[k] = result
            done += len(chunks[k])
            progress(done)
    finally:
        pool.close()
    return [result for k in range(len(chunks)) for result in found[k]]


def map_chunk(function: Callable[[T], R], chunk: Sequence[T]) -> list[R]:
    """Map ``function`` over one chunk of inputs; this is the call that a worker receives."""
    return [function(value) for value in chunk]


def usable_cores() -> int:
    """Return the number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
