"""Reader processes for engines, which turn a crash or hang into an error result instead of ending the run.

:func:`main` runs in an engine's process. Its argument is the ``readback.py`` of a target. Each job is a line of JSON on
standard input, ``{"build": FOLDER, "loader": FILE, "run": null | {"seconds": s, "every": s}}``. Each result is a line
of JSON on standard output, ``{"facts": …, "moments": […]}`` or ``{"error": …}``. The engine's output goes to standard
error. With ``--probe``, :func:`main` prints a line of JSON with the version of each given package that its interpreter
can import.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import IO, Any

import simfoundry
from simfoundry.runtime.plugins import import_file
from simfoundry.verify.readback import Moment, Session, WorldReadback

_PACKAGE = Path(simfoundry.__file__).resolve().parent

# Only this package is made importable, because its folder may contain packages for another Python version.
_START = (
    "import importlib.util as u, sys; i, d = sys.argv[1:3]; "
    "s = u.spec_from_file_location('simfoundry', i, submodule_search_locations=[d]); "
    "m = sys.modules['simfoundry'] = u.module_from_spec(s); s.loader.exec_module(m); "
    "from simfoundry.verify.process import main; sys.exit(main(sys.argv[3:]))"
)

# Time limit [s] for an interpreter to report its installed modules; only a hanging interpreter exceeds this limit.
PROBE_S = 60.0
# Time limit [s] for an engine to process one build, including the engine's startup.
TIMEOUT_S = 180.0


@dataclass(frozen=True)
class Run:
    """The duration of a simulation [s] and the interval between its samples [s]."""

    seconds: float
    every: float


@dataclass(frozen=True)
class EngineJob:
    """A build folder to load and, if ``run`` is set, to simulate. ``loader`` overrides the build's own loader."""

    build: Path
    run: Run | None = None
    loader: Path | None = None

    def line(self) -> str:
        """Return the job as a line of input for the reader process."""
        run = None if self.run is None else asdict(self.run)
        build, loader = self.build.resolve(), (self.loader or self.build / "load.py").resolve()
        return json.dumps({"build": str(build), "loader": str(loader), "run": run}) + "\n"


@dataclass(frozen=True)
class EngineAnswer:
    """The result of a job, which is a read-back, the samples of a run, or an ``error``."""

    facts: WorldReadback | None
    moments: tuple[Moment, ...]
    error: str
    seconds: float


def command(python: Path, *arguments: str) -> list[str]:
    """Return the command that runs this package's reader in another interpreter."""
    return [str(python), "-c", _START, str(_PACKAGE / "__init__.py"), str(_PACKAGE), *arguments]


def ask_probe(python: Path, modules: Sequence[str]) -> dict[str, str]:
    """Return the version of each ``module:distribution`` entry that another interpreter can find."""
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
    """Run jobs in an engine and return the answers in job order.

    A single process handles all jobs. If it dies or hangs, the answer to the current job contains this error, and a new
    process continues with the next job.

    Args:
        python: The interpreter in which the engine is installed.
        readback: The ``readback.py`` of the engine's target.
        jobs: The jobs to run.
        timeout: The maximum time per job [s].
        report: A callback that receives the number of completed jobs.
    """
    answers: list[EngineAnswer] = []
    while len(answers) < len(jobs):
        for answer in _serve(python, readback, jobs[len(answers) :], timeout):
            answers.append(answer)
            report(len(answers))
    return answers


def _serve(python: Path, readback: Path, jobs: Sequence[EngineJob], timeout: float) -> Iterator[EngineAnswer]:
    """Yield the answers from one process, ending with the first job that failed in it, if any."""
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
    """Return the answer to a job, and a flag that is True if the process can accept another job."""
    start = time.monotonic()
    try:
        assert process.stdin is not None
        process.stdin.write(job.line())
        process.stdin.flush()
        line = lines.get(timeout=timeout)
    except queue.Empty:
        return _failure(f"did not respond within {timeout:g} s", log, start), False
    except OSError:  # a broken pipe, because the process died before it read the job
        line = None
    if line is None:
        return _failure(_how_it_ended(process), log, start), False
    data = {"facts": None, "moments": [], "error": ""} | json.loads(line)
    facts = None if data["facts"] is None else WorldReadback.from_json(data["facts"])
    moments = tuple(Moment.from_json(moment) for moment in data["moments"])
    return EngineAnswer(facts, moments, data["error"], time.monotonic() - start), True


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
    """Return the answer for an engine that failed, including the last line of its output."""
    log.seek(0)
    said = [line.strip() for line in log.read().decode(errors="replace").splitlines() if line.strip()]
    last = f"; its last output was: {said[-1][:200]}" if said else ""
    return EngineAnswer(None, (), what + last, time.monotonic() - start)


def main(arguments: list[str]) -> int:
    """Answer all jobs and return the exit status, which is 0 unless the arguments are invalid."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # engines print to standard output, which is reserved for answers
    if arguments[:1] == ["--probe"]:
        print(json.dumps(probe(arguments[1:])), file=answers, flush=True)
        return 0
    readback = import_file(Path(arguments[0]))
    for line in sys.stdin:
        print(json.dumps(answer(readback, json.loads(line))), file=answers, flush=True)
    return 0


def probe(packages: list[str]) -> dict[str, str]:
    """Return the versions of the available ``module:distribution`` entries without importing any of them."""
    found = {}
    for entry in packages:
        module, _, distribution = entry.partition(":")
        try:
            if importlib.util.find_spec(module) is None:
                continue
            found[entry] = importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            found[entry] = "unknown"
        except (ImportError, ValueError):
            continue
    return found


def answer(readback: ModuleType, job: dict[str, Any]) -> dict[str, Any]:
    """Return an engine's read-back of a build, or the samples of a run."""
    session: Session | None = None
    try:
        build = Path(job["build"])
        session = readback.open_build(build, import_file(Path(job["loader"]), build / "load.py"))
        moments = [] if job["run"] is None else run(session, **job["run"])
        return {"facts": None if moments else session.read().to_json(), "moments": moments}
    except Exception as error:  # any error in the engine becomes the answer
        return {"error": f"{type(error).__name__}: {error}"}
    finally:
        if session is not None:
            session.close()


def run(session: Session, seconds: float, every: float) -> list[dict[str, Any]]:
    """Simulate a build and return samples of its state.

    The first sample is taken at the start. The others follow about every ``every`` seconds, at whole time steps.
    """
    steps, stride = round(seconds / session.timestep), max(1, round(every / session.timestep))
    moments = [session.moment(0.0).to_json()]
    for k in range(1, steps + 1):
        session.step()
        if k % stride == 0 or k == steps:
            moments.append(session.moment(k * session.timestep).to_json())
    return moments
