"""Verify specs and behaviours in every engine, and gather the results."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from simfoundry.backends import compile_scene
from simfoundry.backends.losses import Loss
from simfoundry.scene.model import Scene
from simfoundry.verify.behaviours import Behaviour, Measurement, Trial
from simfoundry.verify.compare import Comparison, compare
from simfoundry.verify.engines import Found, engine_called
from simfoundry.verify.process import TIMEOUT_S, Answer, Job, ask

Report = Callable[[str, int], None]
"""Hears which engine does what, and how many units of work it has done since."""


class Verdict(StrEnum):
    """What came out."""

    OK = "ok"
    KNOWN = "known"
    MISMATCH = "mismatch"
    FAILED = "failed"


@dataclass(frozen=True)
class Subject:
    """A scene to verify, its name in the table, and for each target the folder of its build and what that lost."""

    name: str
    scene: Scene
    builds: Mapping[str, Path]
    losses: Mapping[str, tuple[Loss, ...]]


@dataclass(frozen=True)
class Reading:
    """A subject in an engine: the comparison, or ``error`` where the engine could not load it."""

    subject: str
    engine: str
    comparison: Comparison | None
    error: str
    seconds: float

    @property
    def verdict(self) -> Verdict:
        """Whether every quantity is equal or known to be lost."""
        if self.comparison is None:
            return Verdict.FAILED
        if self.comparison.mismatches:
            return Verdict.MISMATCH
        return Verdict.KNOWN if self.comparison.covered else Verdict.OK

    def to_json(self) -> dict[str, Any]:
        """A plain mapping."""
        found = self.comparison
        details = {} if found is None else {
            "compared": found.compared,
            "mismatches": [d.to_json() for d in found.mismatches],
            "covered": [d.to_json() for d in found.covered],
            "stale": list(found.stale),
        }  # fmt: skip
        head = {"subject": self.subject, "engine": self.engine, "verdict": self.verdict.value, "error": self.error}
        return head | {"seconds": round(self.seconds, 3)} | details


@dataclass(frozen=True)
class Measured:
    """A behaviour in an engine: the value, or ``error``; ``reason`` where the engine is known to do otherwise."""

    behaviour: str
    engine: str
    value: float | None
    verdict: Verdict
    reason: str
    error: str

    def to_json(self) -> dict[str, Any]:
        """A plain mapping."""
        return asdict(self) | {"verdict": self.verdict.value}


def built(name: str, scene: Scene, targets: Iterable[str], folder: Path) -> Subject:
    """Compile a scene for the targets below ``folder``."""
    builds, losses = {}, {}
    for target in dict.fromkeys(targets):
        artifact = compile_scene(scene, target)
        artifact.write(folder / target)
        builds[target], losses[target] = folder / target, artifact.losses
    return Subject(name, scene, builds, losses)


def read_subjects(
    subjects: Sequence[Subject], engines: Sequence[Found], report: Report, workers: int = 1, timeout: float = TIMEOUT_S
) -> list[Reading]:
    """Every subject in every engine, engine by engine; ``workers`` engines at a time."""

    def one(found: Found) -> list[Reading]:
        engine = found.engine
        jobs = [Job(s.builds[engine.target]) for s in subjects]
        answers = ask(found.python, engine.name, jobs, timeout, lambda done: report(engine.name, 1))
        return [_reading(s, found, a) for s, a in zip(subjects, answers, strict=True)]

    with ThreadPoolExecutor(max(1, workers)) as pool:
        return [reading for readings in pool.map(one, engines) for reading in readings]


def _reading(subject: Subject, found: Found, answer: Answer) -> Reading:
    engine = found.engine
    if answer.facts is None:
        return Reading(subject.name, engine.name, None, answer.error or "told nothing", answer.seconds)
    comparison = compare(subject.scene, answer.facts, engine, subject.losses[engine.target])
    return Reading(subject.name, engine.name, comparison, "", answer.seconds)


def measure_behaviours(
    behaviours: Sequence[Behaviour], engines: Sequence[Found], report: Report, workers: int = 1,
    timeout: float = TIMEOUT_S,
) -> list[Measured]:  # fmt: skip
    """Every behaviour in every engine that steps."""

    def one(found: Found) -> list[Measured]:
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            return _Bench(found, Path(folder), report, timeout).measure(behaviours)

    with ThreadPoolExecutor(max(1, workers)) as pool:
        stepping = [found for found in engines if found.engine.steps]
        return [measured for results in pool.map(one, stepping) for measured in results]


class _Bench:
    """Runs the measurements of one engine: all trials that are asked for at a time go to one process."""

    def __init__(self, found: Found, folder: Path, report: Report, timeout: float) -> None:
        self.found, self.folder, self.report, self.timeout = found, folder, report, timeout
        self._trials = 0

    def measure(self, behaviours: Sequence[Behaviour]) -> list[Measured]:
        """All behaviours, in order."""
        running: dict[str, tuple[Measurement, Trial]] = {}
        for behaviour in behaviours:
            measurement = behaviour.measure()
            running[behaviour.name] = (measurement, next(measurement))
        results: dict[str, float | str] = {}
        while running:
            jobs = [self._job(trial) for _, trial in running.values()]
            answers = ask(self.found.python, self.found.engine.name, jobs, self.timeout)
            for (name, (measurement, _)), answer in zip(list(running.items()), answers, strict=True):
                outcome = _advance(measurement, answer)
                if isinstance(outcome, Trial):
                    running[name] = (measurement, outcome)
                    continue
                results[name] = outcome
                del running[name]
                self.report(self.found.engine.name, 1)
        return [judged(behaviour, self.found.engine.name, results[behaviour.name]) for behaviour in behaviours]

    def _job(self, trial: Trial) -> Job:
        self._trials += 1
        folder = self.folder / str(self._trials)
        compile_scene(trial.scene, self.found.engine.target).write(folder)
        return Job(folder, trial.run)


def _advance(measurement: Measurement, answer: Answer) -> Trial | float | str:
    """The next trial, the value, or what went wrong."""
    if answer.error:
        return answer.error
    try:
        return measurement.send(answer.moments)
    except StopIteration as done:
        return float(done.value)
    except ValueError as error:
        return str(error)


def judged(behaviour: Behaviour, engine: str, outcome: float | str) -> Measured:
    """A value held against the analytic one, and against what the engine is known to do."""
    if isinstance(outcome, str):
        return Measured(behaviour.name, engine, None, Verdict.FAILED, "", outcome)
    if abs(outcome - behaviour.expected) <= behaviour.tolerance:
        return Measured(behaviour.name, engine, outcome, Verdict.OK, "", "")
    known = engine_called(engine).band(behaviour.name)
    if known is not None and known.low <= outcome <= known.high:
        return Measured(behaviour.name, engine, outcome, Verdict.KNOWN, known.reason, "")
    return Measured(behaviour.name, engine, outcome, Verdict.MISMATCH, "", "")
