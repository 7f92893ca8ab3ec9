"""One function mapped over many inputs: in this process while that is quick, else over the cores."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from simfoundry.errors import SimfoundryError

T = TypeVar("T")
R = TypeVar("R")

SERIAL_TRIAL = 32
"""Inputs that are mapped in this process before the time for the others is estimated: enough for a stable mean."""

STARTUP_S = 2.0
"""Work shorter than this is not worth starting processes for: until they have imported everything, 0.5 s pass [s]."""

MAX_PROCESSES = 8
"""Upper bound of processes by default; beyond it, memory is short before time is gained."""

MAX_CHUNK = 32
"""Inputs that one call maps at most, so that progress is seen."""

SILENCE_S = 600.0
"""Longest time that a chunk may take [s]: far more than documents of any legal size need."""


def map_parallel(
    function: Callable[[T], R],
    inputs: Sequence[T],
    progress: Callable[[int], object] = lambda done: None,
    startup_s: float = STARTUP_S,
    processes: int | None = None,
) -> list[R]:
    """Map ``function`` over ``inputs``, in this process while that is quick, else over the cores; keeps the order.

    ``function`` is a function of a module, or a partial of one, so that other processes can import it. ``progress``
    gets the number of inputs that are done. Processes are started if the rest would take more than ``startup_s``
    seconds here and there are cores for them.
    """
    processes = min(MAX_PROCESSES, usable_cores()) if processes is None else processes
    results: list[R] = []
    start = 0.0
    for k, value in enumerate(inputs, 1):
        results.append(function(value))
        progress(k)
        if k == 1:
            start = time.perf_counter()  # the first also pays for imports
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
                raise SimfoundryError(f"a process that did part of the work {result}; is the memory full?")
            found[k] = result
            done += len(chunks[k])
            progress(done)
    finally:
        pool.close()
    return [result for k in range(len(chunks)) for result in found[k]]


def map_chunk(function: Callable[[T], R], chunk: Sequence[T]) -> list[R]:
    """Map ``function`` over one chunk of inputs: the call that a worker gets."""
    return [function(value) for value in chunk]


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
