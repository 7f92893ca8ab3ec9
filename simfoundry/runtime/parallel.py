"""The same work on many things: in this process while that is quick, else over the cores."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from simfoundry.errors import SimfoundryError

T = TypeVar("T")
R = TypeVar("R")

TRIAL = 32
"""So many things are done here before the time for the others is estimated."""

WORTH_S = 2.0
"""Work for less than this is not worth starting processes for: until they have imported all, 0.5 s pass [s]."""

MOST = 8
"""The most processes."""


def spread(
    work: Callable[[T], R],
    things: Sequence[T],
    progress: Callable[[int], object] = lambda done: None,
    worth_s: float = WORTH_S,
    processes: int | None = None,
) -> list[R]:
    """What ``work`` gives for each thing, in their order.

    ``work`` is a function of a module, so that other processes can import it. ``progress`` hears how many are done.
    Processes are started where the rest would take more than ``worth_s`` seconds here and there are cores for them.
    """
    processes = min(MOST, _cores()) if processes is None else processes
    results: list[R] = []
    start = 0.0
    for k, thing in enumerate(things, 1):
        results.append(work(thing))
        progress(k)
        if k == 1:
            start = time.perf_counter()  # the first also pays for imports
        elif k >= TRIAL and processes > 1 and (len(things) - k) * (time.perf_counter() - start) / (k - 1) > worth_s:
            break
    here = len(results)
    if here < len(things):
        results += _spread(work, things[here:], lambda done: progress(here + done), processes)
    return results


def _spread(work: Callable[[T], R], things: Sequence[T], progress: Callable[[int], object], processes: int) -> list[R]:
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    chunk = max(1, min(32, len(things) // (4 * processes)))
    context = multiprocessing.get_context("spawn")  # safe beside threads, and the same on every system
    pool = ProcessPoolExecutor(min(processes, len(things)), context, _leave_interrupts_to_the_parent)
    results: list[R] = []
    try:
        for result in pool.map(work, things, chunksize=chunk):
            results.append(result)
            progress(len(results))
    except BrokenProcessPool:
        raise SimfoundryError("a process that checked documents was ended from outside; is the memory full?") from None
    finally:
        pool.shutdown(cancel_futures=True)
    return results


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
