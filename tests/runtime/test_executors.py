"""One way to run jobs: the same results in this process, in worker processes, and on a Ray cluster."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from simfoundry.errors import MissingEngineError, SimfoundryError
from simfoundry.runtime.executors import JobLimits, Machines, SerialExecutor, carry_out_jobs, open_executor
from simfoundry.runtime.ray_executor import RayExecutor
from simfoundry.runtime.workers import WorkerError, at_worker_exit
from tests.cli.command import run
from tests.conftest import REPOSITORY

HERE = "tests.runtime.test_executors"
LIMITS = JobLimits(seconds=60.0)
closed: list[str] = []


def triple(offset: int, number: int) -> int:
    at_worker_exit(note_exit)
    return 3 * number + offset


def note_exit() -> None:
    closed.append("closed")


def dies_once(mark: str, number: int) -> int:
    with suppress(FileExistsError):
        os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.parametrize("workers", [1, 2])
def test_jobs_are_carried_out_and_the_executor_is_closed(workers: int) -> None:
    executor = open_executor(Machines(), workers, LIMITS)
    assert isinstance(executor, SerialExecutor) == (workers == 1)
    todo, running, most = list(range(7)), set[int](), 0

    def next_job() -> int | None:
        nonlocal most
        if todo:
            running.add(todo[0])
            most = max(most, len(running))
            return todo.pop(0)
        return None

    closed.clear()
    found = {}
    for job, outcome in carry_out_jobs(executor, f"{HERE}:triple", next_job, 5):
        running.discard(job)
        found[job] = outcome
    assert found == {k: 3 * k + 5 for k in range(7)} and most == workers
    assert closed == ["closed"] * (workers == 1)  # workers have closed in their own processes


def test_a_job_whose_process_dies_is_repeated(tmp_path: Path) -> None:
    todo = [1, 2]
    executor = open_executor(Machines(), 2, LIMITS)
    jobs = carry_out_jobs(executor, f"{HERE}:dies_once", lambda: todo.pop() if todo else None, str(tmp_path / "mark"))
    assert dict(jobs) == {1: 1, 2: 2}


def test_an_isolated_job_cannot_end_this_process() -> None:
    executor = open_executor(Machines(), 1, LIMITS, isolated=True)
    executor.submit("key", "os:_exit", 3)
    key, outcome = executor.next()
    executor.close()
    assert key == "key" and isinstance(outcome, WorkerError) and outcome.how == "exited with code 3"


def test_machines_are_parsed() -> None:
    assert [Machines.parse(t) for t in ("local", "ray", "ray:10.0.0.1:6379", "ray:ray://head:10001")] == [
        Machines(), Machines(True), Machines(True, "10.0.0.1:6379"), Machines(True, "ray://head:10001"),
    ]  # fmt: skip
    for text in ("", "Ray", "ray:", "local:3", "slurm", "ray:a b"):
        with pytest.raises(SimfoundryError, match="expected `local`, `ray` or `ray:ADDRESS`"):
            Machines.parse(text)
    result = run("record", str(REPOSITORY), "--on", "slurm")
    assert result.code == 2 and "expected `local`, `ray` or `ray:ADDRESS`" in result.err


def test_without_ray_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingEngineError) as caught:
        open_executor(Machines(True), None, LIMITS)
    assert str(caught.value) == "`--on ray` requires ray; install it with `pip install 'simfoundry[ray]'`"


def test_a_cluster_that_does_not_exist_is_named() -> None:
    pytest.importorskip("ray", reason="Ray is not installed")
    with pytest.raises(SimfoundryError, match=r"cannot connect to the Ray cluster at `127\.0\.0\.1:9`: .*refused"):
        RayExecutor("127.0.0.1:9", 1, LIMITS)


ON_RAY = """
from simfoundry.runtime.executors import JobLimits, Machines, open_executor
executor = open_executor(Machines.parse("ray"), 1, JobLimits(60.0))
executor.submit(1, "tests.runtime.test_executors:triple", 0, 4)
executor.submit(2, "os:_exit", 3)
print([executor.next() for _ in range(2)])
executor.close()
"""


@pytest.mark.slow
def test_processes_of_ray_import_what_is_installed_and_not_what_lies_around(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed")
    decoy = tmp_path / "checkout" / "simfoundry"
    decoy.mkdir(parents=True)
    (decoy / "__init__.py").write_text("raise ImportError('this is not what is installed')")
    script = tmp_path / "bin" / "simfoundry"
    script.parent.mkdir()
    script.write_text(ON_RAY)
    path = os.pathsep.join([str(REPOSITORY), *(p for p in sys.path if "site-packages" in p or "ray" in Path(p).name)])
    env = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, cwd=decoy.parent, env=env, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "[(1, 12), (2, WorkerError('exited with code 3'))]"), (
        done.stderr
    )
