"""A crash, a hang or a flood of memory in another process is an answer here, and the next call is served."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from simfoundry.runtime.subprocess_worker import FailedError, Limits, Worker, say

HERE = "tests.runtime.test_subprocess_worker"


def double(values: np.ndarray) -> np.ndarray:
    print("this goes to the log")
    os.write(1, b"and this\n")
    return values * 2


def pid() -> int:
    return os.getpid()


def segfault(text: str) -> None:
    say("the first step")
    say(text)
    print("about to die", file=sys.stderr, flush=True)
    ctypes.string_at(0)


def hang() -> None:
    say("a long step")
    time.sleep(1000)


def flood() -> int:
    return len(bytearray(64 * 2**30))


def wrong() -> None:
    raise ValueError("no such thing")


def leave() -> None:
    os._exit(3)


def slow_but_alive() -> str:
    for _ in range(6):
        say("working")
        time.sleep(0.5)
    return "done"


@pytest.fixture
def worker() -> Iterator[Worker]:
    made = Worker(Limits(30.0, 4 * 2**30))
    yield made
    made.close()


def test_calls_are_served_by_one_process(worker: Worker) -> None:
    values = np.arange(300_000.0).reshape(-1, 3)
    np.testing.assert_array_equal(worker.call(f"{HERE}:double", values), values * 2)
    first = worker.call(f"{HERE}:pid")
    assert first != os.getpid() and worker.call(f"{HERE}:pid") == first


def test_a_crash_is_told_with_what_was_done(worker: Worker) -> None:
    heard: list[str] = []
    with pytest.raises(FailedError) as error:
        worker.call(f"{HERE}:segfault", "object `cup`", hear=heard.append)
    assert error.value.how == "crashed (SIGSEGV); it said: about to die" and error.value.doing == "object `cup`"
    assert heard == ["the first step", "object `cup`"]
    assert worker.call(f"{HERE}:pid") > 0  # a new process serves


def test_a_hang_is_ended(worker: Worker) -> None:
    before = worker.call(f"{HERE}:pid")
    worker.limits = Limits(1.0, worker.limits.memory)
    with pytest.raises(FailedError) as error:
        worker.call(f"{HERE}:hang")
    assert error.value.how == "gave no sign of life for 1 s" and error.value.doing == "a long step"
    assert not Path(f"/proc/{before}").exists()


def test_a_sign_of_life_is_enough(worker: Worker) -> None:
    worker.call(f"{HERE}:pid")
    worker.limits = Limits(2.0, worker.limits.memory)
    assert worker.call(f"{HERE}:slow_but_alive") == "done"


@pytest.mark.skipif(sys.platform == "win32", reason="memory is bounded on POSIX")
def test_memory_is_bounded(worker: Worker) -> None:
    with pytest.raises(FailedError, match="ran out of the 4 GiB of memory that it may use"):
        worker.call(f"{HERE}:flood")


def test_what_is_raised_is_told(worker: Worker) -> None:
    with pytest.raises(FailedError, match=r"broke \(ValueError: no such thing\)"):
        worker.call(f"{HERE}:wrong")
    with pytest.raises(FailedError, match="ended with exit code 3"):
        worker.call(f"{HERE}:leave")


def test_a_process_that_died_between_calls_is_started_anew(worker: Worker) -> None:
    first = worker.call(f"{HERE}:pid")
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert worker.call(f"{HERE}:pid") != first


def test_threads_take_turns(worker: Worker) -> None:
    results: dict[int, float] = {}

    def ask(k: int) -> None:
        results[k] = float(worker.call(f"{HERE}:double", np.array([float(k)]))[0])

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == {k: 2.0 * k for k in range(8)}


def test_nothing_is_said_where_nobody_asked() -> None:
    say("into the void")
