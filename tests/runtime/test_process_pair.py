"""Work in a process beside this one gives the same results as here, and its failures cost nothing but time."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from simfoundry.runtime.process_pair import ProcessPair


def pid(seconds: float = 0.0) -> int:
    time.sleep(seconds)
    return os.getpid()


def leave_other_process(here: int) -> str:
    if os.getpid() != here:
        os._exit(3)
    return "here"


def wrong() -> None:
    raise ValueError("no such thing")


@pytest.fixture(scope="module")
def pair() -> Iterator[ProcessPair]:
    with ProcessPair() as pair:
        pair.start((__name__,))
        deadline = time.monotonic() + 30
        while pair.run(pid) == os.getpid() and time.monotonic() < deadline:
            time.sleep(0.01)
        yield pair


def test_calls_run_here_until_the_other_process_is_started() -> None:
    with ProcessPair() as alone, ThreadPoolExecutor(2) as threads:
        both = threading.Barrier(2)  # neither waits for the other
        assert list(threads.map(lambda _: alone.run(both.wait), range(2))) in ([0, 1], [1, 0])
        assert alone.run(pid) == os.getpid() and alone.size == 1


def test_two_calls_run_at_once(pair: ProcessPair) -> None:
    with ThreadPoolExecutor(2) as threads:
        used = set(threads.map(lambda _: pair.run(partial(pid, 0.2)), range(2)))
    assert len(used) == 2 and os.getpid() in used


def test_what_is_left_to_the_other_process_waits_for_it(pair: ProcessPair) -> None:
    with ThreadPoolExecutor(2) as threads:
        busy = threads.submit(pair.run, partial(pid, 0.3))
        time.sleep(0.1)
        assert pair.run(pid, beside=True) == busy.result() != os.getpid()


def test_nothing_waits_for_a_process_that_does_not_start() -> None:
    with ProcessPair() as alone:
        alone.start(("no_such_module",))
        assert alone.run(pid, beside=True) == os.getpid()


@pytest.mark.usefixtures("pair")
def test_a_process_that_is_not_needed_ends() -> None:
    before = children()
    for _ in range(10):
        with ProcessPair() as unused:
            unused.start(("json",))
    assert children() == before != set()


def children() -> set[str]:
    """The processes that this one has started and that have not ended."""
    return {pid for file in Path("/proc/self/task").glob("*/children") for pid in file.read_text().split()}


def test_errors_are_raised_and_crashes_are_made_up_for(pair: ProcessPair) -> None:
    with pytest.raises(ValueError, match="no such thing"):
        pair.run(wrong)
    assert pair.run(partial(leave_other_process, os.getpid())) == "here"
    assert pair.run(pid) != os.getpid(), "the other process was started again"
