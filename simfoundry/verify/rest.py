"""Comparison of resting states: each scene runs for two seconds in every engine and must come to rest in the same
state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from simfoundry.geometry.shapes import Sphere
from simfoundry.scene.model import JointType, Scene
from simfoundry.verify.engines import InstalledEngine
from simfoundry.verify.process import TIMEOUT_S, Run, ask
from simfoundry.verify.readback import Moment, pose_of
from simfoundry.verify.run import ProofStatus, Report, SceneBuilds

LEFT_ALONE = Run(2.0, 2.0)
"""Simulated time [s], in which an unstable object falls over."""

NEAR_MM, NEAR_DEG = 1.0, 0.5
"""Maximum deviation of an engine from the median state, so that any two are within 2 mm and 1 degree."""


@dataclass(frozen=True)
class RestResult:
    """The resting state of a scene in one engine, compared with the engine that is closest to all others.

    ``mm`` and ``deg`` are the deviations of ``worst``, an object or a joint.
    """

    subject: str
    engine: str
    mm: float
    deg: float
    worst: str
    verdict: ProofStatus
    error: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping."""
        return asdict(self) | {"verdict": self.verdict.value}


@dataclass(frozen=True)
class _Place:
    """The resting place of an object or joint: a point [m], and an orientation or an angle [rad]."""

    point: tuple[float, ...]
    q: tuple[float, ...] | None = None
    angle: float = 0.0

    def apart(self, other: _Place) -> tuple[float, float]:
        """Return the distance to another place in millimeters and degrees."""
        mm = 1000 * float(np.linalg.norm(np.subtract(self.point, other.point)))
        turned = abs(self.angle - other.angle)
        if self.q is not None and other.q is not None:
            turned = pose_of((0, 0, 0, *self.q)).angle_to(pose_of((0, 0, 0, *other.q)))
        return mm, math.degrees(turned)


def settle_subjects(
    subjects: Sequence[SceneBuilds],
    engines: Sequence[InstalledEngine],
    report: Report,
    workers: int = 1,
    timeout: float = TIMEOUT_S,
) -> list[RestResult]:
    """Run every scene with movable objects in every engine that can step; return nothing if there is only one."""
    moving = [s for s in subjects if _moves(s.scene)]
    stepping = [f for f in engines if f.engine.spec.steps]
    if len(stepping) < 2 or not moving:
        return []

    def one(found: InstalledEngine) -> list[Moment | str]:
        engine = found.engine
        jobs = [engine.job(s.builds[engine.name], LEFT_ALONE) for s in moving]
        answers = ask(found.python, engine.readback, jobs, timeout, lambda done: report(engine.name, 1))
        return [a.moments[-1] if a.moments else a.error for a in answers]

    with ThreadPoolExecutor(max(1, workers)) as pool:
        ends = list(pool.map(one, stepping))
    names = [f.engine.name for f in stepping]
    by_scene = [dict(zip(names, column, strict=True)) for column in zip(*ends, strict=True)]
    return [r for s, last in zip(moving, by_scene, strict=True) for r in judge_rest(s, last)]


def judge_rest(subject: SceneBuilds, ends: Mapping[str, Moment | str]) -> list[RestResult]:
    """Return a result for each engine; ``ends`` has their last samples or errors."""
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
        results.append(
            RestResult(subject.name, name, *apart[worst], worst, ProofStatus.OK if near else ProofStatus.MISMATCH)
        )
    return results


def _moves(scene: Scene) -> bool:
    return bool(_things(scene))


def _things(scene: Scene) -> list[str]:
    """Return the free objects, and the joints with exactly one degree of freedom."""
    one = (JointType.REVOLUTE, JointType.CONTINUOUS, JointType.PRISMATIC)
    free = [o.name for o in scene.objects if not o.fixed]
    return free + [f"{o.name}.{j.name}" for o in scene.objects for j in o.joints if j.type in one]


def _places(scene: Scene, end: Moment) -> dict[str, _Place]:
    places = {}
    for item in scene.objects:
        if not item.fixed:
            # A ball has no up side, so it may have rolled in place.
            ball = all(isinstance(c.geometry, Sphere) for link in item.links for c in link.colliders)
            pose = end.poses[item.name]
            places[item.name] = _Place(pose[:3], None if ball else pose[3:])
        for joint in item.joints:
            name = f"{item.name}.{joint.name}"
            if joint.type is JointType.PRISMATIC:
                places[name] = _Place((end.joints[name],))
            elif name in end.joints:
                places[name] = _Place((0.0,), angle=end.joints[name])
    return places


def _medoid(places: Sequence[_Place]) -> _Place:
    """Return the place with the smallest total distance to all others."""
    return min(places, key=lambda p: sum(sum(p.apart(other)) for other in places))
