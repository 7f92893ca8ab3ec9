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

from simfoundry.runtime.workers import GRACE_S, Limits, Worker, WorkerError, WorkerPool, at_worker_exit, report_progress

HERE = "tests.runtime.test_workers"


def double(values: np.ndarray) -> np.ndarray:
    print("this goes to the log")
    os.write(1, b"and this\n")
    return values * 2


def pid() -> int:
    return os.getpid()


def segfault(text: str) -> None:
    report_progress("the first step")
    report_progress(text)
    print("about to die", file=sys.stderr, flush=True)
    ctypes.string_at(0)


def hang() -> None:
    report_progress("a long step")
    time.sleep(1000)


def flood() -> int:
    return len(bytearray(64 * 2**30))


def wrong() -> None:
    raise ValueError("no such thing")


def leave() -> None:
    os._exit(3)


def slow_but_alive() -> str:
    for _ in range(14):
        report_progress("working")
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
    with pytest.raises(WorkerError) as error:
        worker.call(f"{HERE}:segfault", "object `cup`", progress=heard.append)
    assert (
        error.value.how == "crashed (SIGSEGV); its last output was: about to die"
        and error.value.doing == "object `cup`"
    )
    assert heard == ["the first step", "object `cup`"]
    assert worker.call(f"{HERE}:pid") > 0  # a new process serves


@pytest.mark.slow  # 2 s: it waits for a timeout
def test_a_hang_is_ended(worker: Worker) -> None:
    before = worker.call(f"{HERE}:pid")
    worker.limits = Limits(2.0, worker.limits.memory)
    with pytest.raises(WorkerError) as error:
        worker.call(f"{HERE}:hang")
    assert error.value.how == "did not respond for 2 s" and error.value.doing == "a long step"
    assert not Path(f"/proc/{before}").exists()


@pytest.mark.slow  # 7 s: it waits for a timeout
def test_a_sign_of_life_is_enough(worker: Worker) -> None:
    worker.call(f"{HERE}:pid")
    worker.limits = Limits(5.0, worker.limits.memory)
    assert worker.call(f"{HERE}:slow_but_alive") == "done"


@pytest.mark.skipif(sys.platform == "win32", reason="memory is bounded on POSIX")
def test_memory_is_bounded(worker: Worker) -> None:
    with pytest.raises(WorkerError, match="exceeded its memory limit of 4 GiB"):
        worker.call(f"{HERE}:flood")


def test_what_is_raised_is_told(worker: Worker) -> None:
    with pytest.raises(WorkerError, match=r"failed \(ValueError: no such thing\)"):
        worker.call(f"{HERE}:wrong")
    with pytest.raises(WorkerError, match="exited with code 3"):
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
    report_progress("into the void")


def leave_a_mark(path: str) -> int:
    at_worker_exit(lambda: Path(path).write_text("closed"))
    return os.getpid()


def crash_once(mark: str) -> int:
    if not Path(mark).exists():
        Path(mark).touch()
        os._exit(3)
    return 7


_called: list[int] = []


def fail_unless_fresh() -> int:
    """Fail in a process that has been used before, as if it were short of memory."""
    _called.append(1)
    if len(_called) > 1:
        raise ValueError("could not allocate memory")
    return os.getpid()


def test_a_pool_outlives_crashes_and_repeats_what_it_is_asked_to() -> None:
    pool = WorkerPool(2, Limits(30.0, 4 * 2**30))
    try:
        for k in range(6):
            pool.submit(k, f"{HERE}:leave" if k == 2 else f"{HERE}:pid")
        results = dict(pool.next() for _ in range(6))
    finally:
        pool.close()
    assert isinstance(results[2], WorkerError) and results[2].how == "exited with code 3"
    assert all(isinstance(results[k], int) for k in (0, 1, 3, 4, 5))


def test_a_failed_call_is_made_again_if_asked(tmp_path: Path) -> None:
    pool = WorkerPool(1, Limits(30.0, 4 * 2**30))
    try:
        pool.submit("once", f"{HERE}:crash_once", str(tmp_path / "a"))
        pool.submit("twice", f"{HERE}:crash_once", str(tmp_path / "b"), attempts=2)
        results = dict(pool.next() for _ in range(2))
    finally:
        pool.close()
    assert isinstance(results["once"], WorkerError) and results["twice"] == 7


def test_a_failed_call_is_made_again_in_a_fresh_process() -> None:
    pool = WorkerPool(1, Limits(30.0, 4 * 2**30))
    try:
        for k in range(3):
            pool.submit(k, f"{HERE}:fail_unless_fresh", attempts=2)
        results = dict(pool.next() for _ in range(3))
    finally:
        pool.close()
    assert len(set(results.values())) == 3 and all(isinstance(each, int) for each in results.values())


def test_a_process_that_starts_while_its_pool_closes_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    closed, start = threading.Event(), Worker._start

    def start_late(worker: Worker) -> None:
        closed.wait(10.0)
        start(worker)

    monkeypatch.setattr(Worker, "_start", start_late)
    pool = WorkerPool(1, Limits(30.0, 4 * 2**30))
    pool.submit(0, "time:sleep", 0.01)
    time.sleep(0.2)  # the call is about to start its process
    threading.Timer(0.2, closed.set).start()
    pool.close()
    assert pool._workers[0]._process is None and not pool._threads[0].is_alive()


def test_exit_functions_run_if_the_worker_has_time(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    pool = WorkerPool(1, Limits(30.0, 4 * 2**30))
    pool.submit(0, f"{HERE}:leave_a_mark", str(mark))
    pool.next()
    pool.close(GRACE_S)
    assert mark.read_text() == "closed"
