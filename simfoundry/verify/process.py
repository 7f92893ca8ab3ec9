"""Reader processes for engines, so that a crash or hang becomes an error result instead of ending the run."""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import simfoundry
from simfoundry.verify.readback import Moment, WorldReadback

_PACKAGE = Path(simfoundry.__file__).resolve().parent

# Only this package is passed on: its folder may contain packages for another Python version.
_START = (
    "import importlib.util as u, sys; i, d = sys.argv[1:3]; "
    "s = u.spec_from_file_location('simfoundry', i, submodule_search_locations=[d]); "
    "m = sys.modules['simfoundry'] = u.module_from_spec(s); s.loader.exec_module(m); "
    "from simfoundry.verify.reader import main; sys.exit(main(sys.argv[3:]))"
)

PROBE_S = 60.0
"""Timeout for an interpreter to report its installed modules [s]; exceeded only if it hangs."""
TIMEOUT_S = 180.0
"""Timeout for an engine to process one build, including its startup [s]."""


@dataclass(frozen=True)
class Run:
    """The duration of a run [s], and the interval between its samples [s]."""

    seconds: float
    every: float


@dataclass(frozen=True)
class EngineJob:
    """A build folder to load and, if ``run`` is set, to simulate; ``loader`` overrides the build's own loader."""

    build: Path
    run: Run | None = None
    loader: Path | None = None

    def line(self) -> str:
        """Return the job as a line of input for the reader."""
        run = None if self.run is None else {"seconds": self.run.seconds, "every": self.run.every}
        build, loader = self.build.resolve(), (self.loader or self.build / "load.py").resolve()
        return json.dumps({"build": str(build), "loader": str(loader), "run": run}) + "\n"


@dataclass(frozen=True)
class EngineAnswer:
    """The result of a job: a read-back or the samples of a run, or the ``error``."""

    facts: WorldReadback | None
    moments: tuple[Moment, ...]
    error: str
    seconds: float


def command(python: Path, *arguments: str) -> list[str]:
    """Return the command that runs this package's reader in another interpreter."""
    return [str(python), "-c", _START, str(_PACKAGE / "__init__.py"), str(_PACKAGE), *arguments]


def ask_probe(python: Path, modules: Sequence[str]) -> dict[str, str]:
    """Return the versions of the given ``module:distribution`` entries that an interpreter can find."""
    done = subprocess.run(
        command(python, "--probe", *modules), capture_output=True, text=True, timeout=PROBE_S, check=True
    )
    found: dict[str, str] = json.loads(done.stdout)
    return found


def ask(
    python: Path,
    readback: Path,
    jobs: Sequence[EngineJob],
    timeout: float = TIMEOUT_S,
    report: Callable[[int], None] = lambda done: None,
) -> list[EngineAnswer]:
    """Run jobs with the engine of a ``readback.py`` and return the answers in order.

    ``report`` receives the number of completed jobs. One process serves all jobs. If it dies or hangs, the answer of
    the current job says so, and a new process continues with the next job.
    """
    answers: list[EngineAnswer] = []
    while len(answers) < len(jobs):
        for answer in _serve(python, readback, jobs[len(answers) :], timeout):
            answers.append(answer)
            report(len(answers))
    return answers


def _serve(python: Path, readback: Path, jobs: Sequence[EngineJob], timeout: float) -> Iterator[EngineAnswer]:
    """Yield the answers of one process, up to and including the job at which it failed."""
    with tempfile.TemporaryFile() as log:
        serve = command(python, str(readback.resolve()))
        process = subprocess.Popen(serve, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True)
        assert process.stdin is not None and process.stdout is not None
        lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=_listen, args=(process.stdout, lines), daemon=True).start()
        try:
            for job in jobs:
                answer, alive = _one(process, lines, job, timeout, log)
                yield answer
                if not alive:
                    return
        finally:
            process.kill()
            process.wait()


def _one(
    process: subprocess.Popen[str], lines: queue.SimpleQueue[str | None], job: EngineJob, timeout: float, log: IO[bytes]
) -> tuple[EngineAnswer, bool]:
    """Return the answer to a job, and true if the process can accept another."""
    start = time.monotonic()
    try:
        assert process.stdin is not None
        process.stdin.write(job.line())
        process.stdin.flush()
        line = lines.get(timeout=timeout)
    except queue.Empty:
        return _failure(f"did not respond within {timeout:g} s", log, start), False
    except OSError:  # a broken pipe: the process died before it read the job
        line = None
    if line is None:
        return _failure(_how_it_ended(process), log, start), False
    data = json.loads(line)
    seconds = time.monotonic() - start
    if "error" in data:
        return EngineAnswer(None, (), data["error"], seconds), True
    return _decoded(data, seconds), True


def _decoded(data: dict[str, Any], seconds: float) -> EngineAnswer:
    facts = None if data["facts"] is None else WorldReadback.from_json(data["facts"])
    return EngineAnswer(facts, tuple(Moment.from_json(m) for m in data["moments"]), "", seconds)


def _listen(stream: IO[str], lines: queue.SimpleQueue[str | None]) -> None:
    for line in stream:
        lines.put(line)
    lines.put(None)


def _how_it_ended(process: subprocess.Popen[str]) -> str:
    code = process.wait()
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"crashed: {signal.Signals(-code).name}"
    except ValueError:
        return f"crashed: signal {-code}"


def _failure(what: str, log: IO[bytes], start: float) -> EngineAnswer:
    """Return the answer of an engine that failed, with the last line that it printed."""
    log.seek(0)
    said = [line.strip() for line in log.read().decode(errors="replace").splitlines() if line.strip()]
    last = f"; its last output was: {said[-1][:200]}" if said else ""
    return EngineAnswer(None, (), what + last, time.monotonic() - start)
