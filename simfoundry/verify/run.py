"""Verification runs: read-back and behaviors in every engine."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import Loss
from simfoundry.scene.model import Scene
from simfoundry.targets.compile import target_files
from simfoundry.verify.behaviors import Behavior, Measurement, Trial
from simfoundry.verify.compare import ReadbackComparison, compare
from simfoundry.verify.engines import InstalledEngine, VerifyEngine
from simfoundry.verify.process import TIMEOUT_S, EngineAnswer, EngineJob, ask

Report = Callable[[str, int], None]
"""Callback that receives the current activity of an engine and the number of work units completed since."""


class ProofStatus(StrEnum):
    """The result of a comparison."""

    OK = "ok"
    KNOWN = "known"
    MISMATCH = "mismatch"
    FAILED = "failed"


@dataclass(frozen=True)
class SceneBuilds:
    """A scene to verify, its name in the table, and for each engine the build that it reads with its losses.

    The losses are those of the backend; the engine's loader may restore some of the features.
    """

    name: str
    scene: Scene
    builds: Mapping[str, Path]
    losses: Mapping[str, tuple[Loss, ...]]


@dataclass(frozen=True)
class ReadbackResult:
    """The read-back of a scene in an engine: the comparison, or the ``error`` if it could not be loaded."""

    subject: str
    engine: str
    comparison: ReadbackComparison | None
    error: str
    seconds: float

    @property
    def verdict(self) -> ProofStatus:
        """The worst result: an unexplained difference, a known loss, or neither."""
        if self.comparison is None:
            return ProofStatus.FAILED
        if self.comparison.mismatches:
            return ProofStatus.MISMATCH
        return ProofStatus.KNOWN if self.comparison.covered else ProofStatus.OK

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping."""
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
class BehaviorResult:
    """A behavior in an engine: the value or ``error``; ``reason`` explains a known deviation of the engine."""

    behavior: str
    engine: str
    value: float | None
    verdict: ProofStatus
    reason: str
    error: str

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping."""
        return asdict(self) | {"verdict": self.verdict.value}


def built(name: str, scene: Scene, engines: Iterable[VerifyEngine], folder: Path) -> SceneBuilds:
    """Compile a scene for engines below ``folder``; engines that use the same build share it."""
    builds: dict[str, Path] = {}
    losses: dict[str, tuple[Loss, ...]] = {}
    compiled: dict[str, Artifact] = {}
    for engine in engines:
        target = engine.build
        if target.name not in compiled:
            compiled[target.name] = target_files(scene, target)
            compiled[target.name].write(folder / target.name)
        builds[engine.name], losses[engine.name] = folder / target.name, compiled[target.name].losses
    return SceneBuilds(name, scene, builds, losses)


def read_subjects(
    subjects: Sequence[SceneBuilds],
    engines: Sequence[InstalledEngine],
    report: Report,
    workers: int = 1,
    timeout: float = TIMEOUT_S,
) -> list[ReadbackResult]:
    """Read every scene in every engine, engine by engine, with ``workers`` engines in parallel."""

    def one(found: InstalledEngine) -> list[ReadbackResult]:
        engine = found.engine
        jobs = [engine.job(s.builds[engine.name]) for s in subjects]
        answers = ask(found.python, engine.readback, jobs, timeout, lambda done: report(engine.name, 1))
        return [_reading(s, found, a) for s, a in zip(subjects, answers, strict=True)]

    with ThreadPoolExecutor(max(1, workers)) as pool:
        return [reading for readings in pool.map(one, engines) for reading in readings]


def _reading(subject: SceneBuilds, found: InstalledEngine, answer: EngineAnswer) -> ReadbackResult:
    engine = found.engine
    if answer.facts is None:
        return ReadbackResult(subject.name, engine.name, None, answer.error or "told nothing", answer.seconds)
    comparison = compare(subject.scene, answer.facts, engine, subject.losses[engine.name])
    return ReadbackResult(subject.name, engine.name, comparison, "", answer.seconds)


def measure_behaviors(
    behaviors: Sequence[Behavior], engines: Sequence[InstalledEngine], report: Report, workers: int = 1,
    timeout: float = TIMEOUT_S,
) -> list[BehaviorResult]:  # fmt: skip
    """Measure every behavior in every engine that can step."""

    def one(found: InstalledEngine) -> list[BehaviorResult]:
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            return _Bench(found, Path(folder), report, timeout).measure(behaviors)

    with ThreadPoolExecutor(max(1, workers)) as pool:
        stepping = [found for found in engines if found.engine.spec.steps]
        return [measured for results in pool.map(one, stepping) for measured in results]


class _Bench:
    """Runs the measurements of one engine; concurrent trials go to one process."""

    def __init__(self, found: InstalledEngine, folder: Path, report: Report, timeout: float) -> None:
        self.found, self.folder, self.report, self.timeout = found, folder, report, timeout
        self._trials = 0

    def measure(self, behaviors: Sequence[Behavior]) -> list[BehaviorResult]:
        """Measure all behaviors, in order."""
        running: dict[str, tuple[Measurement, Trial]] = {}
        for behavior in behaviors:
            measurement = behavior.measure()
            running[behavior.name] = (measurement, next(measurement))
        results: dict[str, float | str] = {}
        while running:
            jobs = [self._job(trial) for _, trial in running.values()]
            answers = ask(self.found.python, self.found.engine.readback, jobs, self.timeout)
            for (name, (measurement, _)), answer in zip(list(running.items()), answers, strict=True):
                outcome = _advance(measurement, answer)
                if isinstance(outcome, Trial):
                    running[name] = (measurement, outcome)
                    continue
                results[name] = outcome
                del running[name]
                self.report(self.found.engine.name, 1)
        return [judge_result(behavior, self.found.engine, results[behavior.name]) for behavior in behaviors]

    def _job(self, trial: Trial) -> EngineJob:
        self._trials += 1
        engine = self.found.engine
        folder = self.folder / str(self._trials) / engine.build.name
        target_files(trial.scene, engine.build).write(folder)
        return engine.job(folder, trial.run)


def _advance(measurement: Measurement, answer: EngineAnswer) -> Trial | float | str:
    """Return the next trial, the measured value, or the error."""
    if answer.error:
        return answer.error
    try:
        return measurement.send(answer.moments)
    except StopIteration as done:
        return float(done.value)
    except ValueError as error:
        return str(error)


def judge_result(behavior: Behavior, engine: VerifyEngine, outcome: float | str) -> BehaviorResult:
    """Compare a value with the analytic one and with the known deviation of the engine."""
    if isinstance(outcome, str):
        return BehaviorResult(behavior.name, engine.name, None, ProofStatus.FAILED, "", outcome)
    if abs(outcome - behavior.expected) <= engine.behavior_tolerance(behavior.name, behavior.tolerance):
        return BehaviorResult(behavior.name, engine.name, outcome, ProofStatus.OK, "", "")
    known = engine.band(behavior.name)
    if known is not None and known.low <= outcome <= known.high:
        return BehaviorResult(behavior.name, engine.name, outcome, ProofStatus.KNOWN, known.reason, "")
    return BehaviorResult(behavior.name, engine.name, outcome, ProofStatus.MISMATCH, "", "")
