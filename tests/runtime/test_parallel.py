"""Results, order and failures of work that is spread over processes."""

from __future__ import annotations

import os
import time

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.runtime import parallel
from simfoundry.runtime.parallel import SERIAL_TRIAL, map_parallel


def process_and_square(number: int) -> tuple[int, int]:
    time.sleep(0.002)
    return os.getpid(), number * number


PARENT = os.environ.setdefault("SIMFOUNDRY_TEST_PARENT", str(os.getpid()))


def dies_elsewhere(number: int) -> int:
    time.sleep(0.002)
    if str(os.getpid()) != PARENT:
        os._exit(1)
    return number


def test_processes_give_what_one_gives_in_the_same_order() -> None:
    heard: list[int] = []
    results = map_parallel(process_and_square, range(SERIAL_TRIAL + 200), heard.append, startup_s=0.01, processes=2)
    assert [square for _, square in results] == [n * n for n in range(SERIAL_TRIAL + 200)]
    assert heard == sorted(set(heard)) and heard[-1] == SERIAL_TRIAL + 200
    assert {pid for pid, _ in results[:SERIAL_TRIAL]} == {os.getpid()}
    assert os.getpid() not in {pid for pid, _ in results[SERIAL_TRIAL:]}


def test_no_process_is_started_for_little_work_or_on_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "_map_in_processes", lambda *_: pytest.fail("processes were started"))
    assert len(map_parallel(process_and_square, range(300), processes=8)) == 300
    assert len(map_parallel(process_and_square, range(100), startup_s=0.0, processes=1)) == 100
    assert (
        len(map_parallel(process_and_square, range(SERIAL_TRIAL - 1), startup_s=0.0, processes=8)) == SERIAL_TRIAL - 1
    )
    assert map_parallel(process_and_square, []) == []


def test_a_process_that_is_killed_is_a_sentence() -> None:
    with pytest.raises(SimfoundryError, match="exited with code 1"):
        map_parallel(dies_elsewhere, range(SERIAL_TRIAL + 50), startup_s=0.0, processes=2)
