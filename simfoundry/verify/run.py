"""Verification runs, which read back scenes and measure behaviors in every engine."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.losses import Loss
from simfoundry.geometry.shapes import Sphere
from simfoundry.scene.model import JointType, Scene
from simfoundry.targets.compile import target_files
from simfoundry.verify.behaviors import Behavior, Measurement, Trial
from simfoundry.verify.compare import ReadbackComparison, compare
from simfoundry.verify.engines import InstalledEngine, VerifyEngine
from simfoundry.verify.process import TIMEOUT_S, EngineAnswer, EngineJob, Run, ask
from simfoundry.verify.readback import Moment, pose_of

# A callback that receives an engine's current activity and the number of work units completed since the last call.
Report = Callable[[str, int], None]
Engines = Sequence[InstalledEngine]
T = TypeVar("T")


class ProofStatus(StrEnum):
    """The result of a comparison."""

    OK = "ok"
    KNOWN = "known"
    MISMATCH = "mismatch"
    FAILED = "failed"


@dataclass(frozen=True)
class SceneBuilds:
    """A scene to verify, with its name in the tables and its build and losses for each engine.

    The losses come from the backend. An engine's loader may restore some of the lost features.
    """

    name: str
    scene: Scene
    builds: Mapping[str, Path]
    losses: Mapping[str, tuple[Loss, ...]]


@dataclass(frozen=True)
class ReadbackResult:
    """The comparison of a scene with its read-back from an engine, or the ``error`` if it could not be loaded."""

    subject: str
    engine: str
    comparison: ReadbackComparison | None
    error: str
    seconds: float

    @property
    def verdict(self) -> ProofStatus:
        """The most severe result, which is an unexplained difference, a known loss, or neither."""
        if self.comparison is None:
            return ProofStatus.FAILED
        if self.comparison.mismatches:
            return ProofStatus.MISMATCH
        return ProofStatus.KNOWN if self.comparison.covered else ProofStatus.OK

    def to_json(self) -> dict[str, Any]:
        """Return the data as a plain mapping."""
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
    """The value measured for a behavior in an engine, or the ``error`` if the measurement failed.

    ``reason`` explains a known deviation.
    """

    behavior: str
    engine: str
    value: float | None
    verdict: ProofStatus
    reason: str
    error: str


def built(name: str, scene: Scene, engines: Iterable[VerifyEngine], folder: Path) -> SceneBuilds:
    """Compile a scene for ``engines`` into ``folder``. Engines that read the same build share it.

    Native data is left out, because it may merge bodies that the scene has.
    """
    scene = replace(scene, native=None)
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


def _in_each(engines: Engines, workers: int, work: Callable[[InstalledEngine], list[T]]) -> list[list[T]]:
    """Return the results of ``work`` for each engine, running up to ``workers`` engines in parallel."""
    with ThreadPoolExecutor(max(1, workers)) as pool:
        return list(pool.map(work, engines))


def _answers(
    found: InstalledEngine, subjects: Sequence[SceneBuilds], report: Report, timeout: float, run: Run | None = None
) -> list[EngineAnswer]:
    """Return an engine's answers for the builds of all subjects."""
    jobs = [found.engine.job(subject.builds[found.engine.name], run) for subject in subjects]
    return ask(found.python, found.engine.readback, jobs, timeout, lambda done: report(found.engine.name, 1))


def read_subjects(
    subjects: Sequence[SceneBuilds], engines: Engines, report: Report, workers: int = 1, timeout: float = TIMEOUT_S
) -> list[ReadbackResult]:
    """Read back every scene in every engine, with up to ``workers`` engines in parallel."""

    def one(found: InstalledEngine) -> list[ReadbackResult]:
        answers = _answers(found, subjects, report, timeout)
        return [_reading(s, found.engine, a) for s, a in zip(subjects, answers, strict=True)]

    return list(chain.from_iterable(_in_each(engines, workers, one)))


def _reading(subject: SceneBuilds, engine: VerifyEngine, answer: EngineAnswer) -> ReadbackResult:
    if answer.facts is None:
        error = answer.error or "the engine returned no read-back"
        return ReadbackResult(subject.name, engine.name, None, error, answer.seconds)
    comparison = compare(subject.scene, answer.facts, engine, subject.losses[engine.name])
    return ReadbackResult(subject.name, engine.name, comparison, "", answer.seconds)


def measure_behaviors(
    behaviors: Sequence[Behavior], engines: Engines, report: Report, workers: int = 1, timeout: float = TIMEOUT_S
) -> list[BehaviorResult]:
    """Measure every behavior in every engine that supports stepping, with up to ``workers`` engines in parallel."""

    def one(found: InstalledEngine) -> list[BehaviorResult]:
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            return _Bench(found, Path(folder), report, timeout).measure(behaviors)

    return list(chain.from_iterable(_in_each([f for f in engines if f.engine.spec.steps], workers, one)))


class _Bench:
    """A bench that runs the measurements in one engine. Concurrent trials share a process."""

    def __init__(self, found: InstalledEngine, folder: Path, report: Report, timeout: float) -> None:
        self.found, self.folder, self.report, self.timeout = found, folder, report, timeout
        self._trials = 0

    def measure(self, behaviors: Sequence[Behavior]) -> list[BehaviorResult]:
        """Measure all behaviors, in order."""
        measurements = {behavior.name: behavior.measure() for behavior in behaviors}
        outcomes: dict[str, Trial | float | str] = {name: next(each) for name, each in measurements.items()}
        while trials := {name: each for name, each in outcomes.items() if isinstance(each, Trial)}:
            jobs = [self._job(trial) for trial in trials.values()]
            answers = ask(self.found.python, self.found.engine.readback, jobs, self.timeout)
            for name, answer in zip(trials, answers, strict=True):
                outcomes[name] = _advance(measurements[name], answer)
                if not isinstance(outcomes[name], Trial):
                    self.report(self.found.engine.name, 1)
        results = {name: each for name, each in outcomes.items() if not isinstance(each, Trial)}
        return [judge_result(behavior, self.found.engine, results[behavior.name]) for behavior in behaviors]

    def _job(self, trial: Trial) -> EngineJob:
        self._trials += 1
        engine = self.found.engine
        folder = self.folder / str(self._trials) / engine.build.name
        target_files(trial.scene, engine.build).write(folder)
        return engine.job(folder, trial.run)


def _advance(measurement: Measurement, answer: EngineAnswer) -> Trial | float | str:
    """Return the next trial, the measured value, or the error if the measurement failed."""
    if answer.error:
        return answer.error
    try:
        return measurement.send(answer.moments)
    except StopIteration as done:
        return float(done.value)
    except ValueError as error:
        return str(error)


def judge_result(behavior: Behavior, engine: VerifyEngine, outcome: float | str) -> BehaviorResult:
    """Compare a measured value with the analytic value and with the engine's known deviation."""
    profile, name = engine.target.profile, behavior.name
    if isinstance(outcome, str):
        return BehaviorResult(name, engine.name, None, ProofStatus.FAILED, "", outcome)
    tolerance, known = profile.tolerances.get(name), profile.behaviors.get(name)
    if abs(outcome - behavior.expected) <= (behavior.tolerance if tolerance is None else tolerance.value):
        return BehaviorResult(name, engine.name, outcome, ProofStatus.OK, "", "")
    if known is not None and known.low <= outcome <= known.high:
        return BehaviorResult(name, engine.name, outcome, ProofStatus.KNOWN, known.reason, "")
    return BehaviorResult(name, engine.name, outcome, ProofStatus.MISMATCH, "", "")


# The simulated duration [s], which is long enough for an unstable object to fall over.
LEFT_ALONE = Run(2.0, 2.0)

# Maximum deviation of an engine from the median state, which limits any two engines to within 2 mm and 1 degree.
NEAR_MM, NEAR_DEG = 1.0, 0.5


@dataclass(frozen=True)
class RestResult:
    """The resting state of a scene in one engine, compared with the engine that is closest to all others.

    ``mm`` and ``deg`` are the deviations of ``worst``, which is the object or joint with the largest deviation.
    """

    subject: str
    engine: str
    mm: float
    deg: float
    worst: str
    verdict: ProofStatus
    error: str = ""


@dataclass(frozen=True)
class _Place:
    """The resting state of an object or a joint.

    It consists of a point [m], and of a rotation that is a quaternion or an angle [rad].
    """

    point: tuple[float, ...]
    q: tuple[float, ...] | None = None
    angle: float = 0.0

    def apart(self, other: _Place) -> tuple[float, float]:
        """Return the distance to another resting place in millimeters and degrees."""
        mm = 1000 * float(np.linalg.norm(np.subtract(self.point, other.point)))
        turned = abs(self.angle - other.angle)
        if self.q is not None and other.q is not None:
            turned = pose_of((0, 0, 0, *self.q)).angle_to(pose_of((0, 0, 0, *other.q)))
        return mm, math.degrees(turned)


def settle_subjects(
    subjects: Sequence[SceneBuilds], engines: Engines, report: Report, workers: int = 1, timeout: float = TIMEOUT_S
) -> list[RestResult]:
    """Simulate every scene with movable objects in every engine that supports stepping.

    Returns an empty list if fewer than two engines support stepping.
    """
    moving = [s for s in subjects if _things(s.scene)]
    stepping = [f for f in engines if f.engine.spec.steps]
    if len(stepping) < 2 or not moving:
        return []

    def one(found: InstalledEngine) -> list[Moment | str]:
        return [a.moments[-1] if a.moments else a.error for a in _answers(found, moving, report, timeout, LEFT_ALONE)]

    ends = _in_each(stepping, workers, one)
    names = [f.engine.name for f in stepping]
    by_scene = [dict(zip(names, column, strict=True)) for column in zip(*ends, strict=True)]
    return [r for s, last in zip(moving, by_scene, strict=True) for r in judge_rest(s, last)]


def judge_rest(subject: SceneBuilds, ends: Mapping[str, Moment | str]) -> list[RestResult]:
    """Return a result for each engine. ``ends`` contains the last sample from each engine, or its error."""
    places = {name: _places(subject.scene, end) for name, end in ends.items() if isinstance(end, Moment)}
    things = _things(subject.scene)
    middle = {thing: _medoid([p[thing] for p in places.values()]) for thing in things} if places else {}
    results = []
    for name, end in ends.items():
        if isinstance(end, str):
            results.append(RestResult(subject.name, name, math.nan, math.nan, "", ProofStatus.FAILED, end))
            continue
        apart = {thing: places[name][thing].apart(middle[thing]) for thing in things}
        worst = max(things, key=lambda t: max(apart[t][0] / NEAR_MM, apart[t][1] / NEAR_DEG))
        near = all(mm <= NEAR_MM and deg <= NEAR_DEG for mm, deg in apart.values())
        verdict = ProofStatus.OK if near else ProofStatus.MISMATCH
        results.append(RestResult(subject.name, name, *apart[worst], worst, verdict))
    return results


def _things(scene: Scene) -> list[str]:
    """Return the names of the free objects and of the joints with exactly one degree of freedom."""
    free = [o.name for o in scene.objects if not o.fixed]
    return free + [f"{o.name}.{j.name}" for o in scene.objects for j in o.joints if j.has_axis]


def _places(scene: Scene, end: Moment) -> dict[str, _Place]:
    places = {}
    for item in scene.objects:
        if not item.fixed:
            # A ball looks the same from all sides, so its rotation is ignored.
            ball = all(isinstance(c.geometry, Sphere) for link in item.links for c in link.colliders)
            pose = end.poses[item.name]
            places[item.name] = _Place(pose[:3], None if ball else pose[3:])
        for joint in (joint for joint in item.joints if joint.has_axis):
            name, slides = f"{item.name}.{joint.name}", joint.type is JointType.PRISMATIC
            places[name] = _Place((end.joints[name],)) if slides else _Place((0.0,), angle=end.joints[name])
    return places


def _medoid(places: Sequence[_Place]) -> _Place:
    """Return the place with the smallest total distance to all other places."""
    return min(places, key=lambda p: sum(sum(p.apart(other)) for other in places))
