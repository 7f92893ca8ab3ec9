"""Every scene and task of ``specs/``, in both simulators: ``python -m tests.corpora.specs``.

Each scene settles from its own poses and compiles for every target. Each task is set up as it starts, as each of its
steps starts, and as it ends, and must stand still in all of them: a goal that cannot rest cannot be reached. Prints two
tables; exit code 1 if a bar is missed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from simfoundry.backends import BACKENDS, compile_scene
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.predicate import Call, parse_call, texts
from simfoundry.spec.models.scene import Place, SceneSpec
from simfoundry.spec.models.task import Start, TaskSpec, with_starts
from simfoundry.worlds import open_world
from simfoundry.worlds.rest import is_ball
from simfoundry.worlds.settle import SettleResult, settle
from tests.specs.documents import SCENES, TASKS, lowered, name_of, task_at

ENGINES = ("mujoco", "pybullet")
MAX_DRIFT_M, MAX_TILT_DEG = 0.002, 1.0

AT_THE_END: Mapping[str, Mapping[str, dict[str, object]]] = {
    "marker_in_cup": {"marker": {"rpy_deg": (0.0, 90.0, 0.0)}},
    "red_marker_in_blue_cup": {"red_marker": {"rpy_deg": (0.0, 90.0, 0.0)}},
    "serve_fruits": {"banana": {"local_xy": (0.0, 0.035), "yaw_deg": 0.0}, "apple": {"local_xy": (0.0, -0.04)}},
    "clear_table": {
        "cube": {"local_xy": (-0.07, -0.1)},
        "grapes": {"local_xy": (0.06, -0.1)},
        "cup": {"local_xy": (0.06, 0.1)},
        "marker": {"local_xy": (0.0, 0.0), "yaw_deg": 90.0},
        "baseball": {"local_xy": (-0.078, 0.118)},
    },
    "orange_cup_on_organizer": {"orange_cup": {"local_xy": (0.0, 0.05)}},
    "tennis_ball_on_organizer": {"tennis_ball": {"local_xy": (0.0, 0.05)}},
    "store_marker": {"marker": {"yaw_deg": 90.0}},
}
"""How the things of a goal lie at the end, where they do not lie in the middle as they lay on the desk."""


@dataclass(frozen=True)
class Rest:
    """How far the worst of the things moved [m] and tilted [deg] on settling, and what else went wrong."""

    drift: float
    tilt: float
    problems: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether everything stands still."""
        return not self.problems and self.drift <= MAX_DRIFT_M and self.tilt <= MAX_TILT_DEG

    def __str__(self) -> str:
        return f"{self.drift * 1000:.1f} mm {self.tilt:.1f} deg" + ("" if self.passed else " (!)")


def main() -> int:
    """Prove all specs; returns the exit code."""
    failures: list[str] = []
    simulators = "".join(f"{engine:>18}" for engine in ENGINES)
    print(f"{'scene':<18}{'things':>7}{'joints':>7}{'kg':>7}{simulators}  losses {' '.join(BACKENDS.names())}")
    for path in SCENES:
        _scene(path, failures)
    print(f"\n{'task':<28}{'steps':>6}{'starts at rest':>16}{'end: mujoco':>18}{'end: pybullet':>18}")
    for path in TASKS:
        _task(path, failures)
    print("\n".join(["", *failures] if failures else ["", "every bar is met"]))
    return 1 if failures else 0


def _scene(path: Path, failures: list[str]) -> None:
    """One row: a scene at rest in both simulators, compiled for every target."""
    failures += [f"{path.name}: {d.code} {d.message}" for d in load(path).all_findings()]
    scene = lowered(path)
    rests = [_rest(scene, engine) for engine in ENGINES]
    failures += [f"{path.name} in {e}: {p}" for e, r in zip(ENGINES, rests, strict=True) for p in _faults(r)]
    losses = " ".join(f"{len(compile_scene(scene, target).losses):>{len(target)}}" for target in BACKENDS.names())
    free = [o for o in scene.objects if not o.fixed]
    mass = sum(link.mass for o in free for link in o.links)
    joints = sum(len(o.joints) for o in scene.objects)
    cells = "".join(f"{rest!s:>18}" for rest in rests)
    print(f"{name_of(path):<18}{len(free):>7}{joints:>7}{mass:>7.2f}{cells}         {losses}", flush=True)


def _task(path: Path, failures: list[str]) -> None:
    """One row: the starts and the end of a task, at rest."""
    _, task = task_at(path)
    starts = {"start": task.start} | {n: s.start for n, s in task.subtasks.items() if s.start is not None}
    resting = 0
    for name, start in starts.items():
        try:
            faults = _faults(_rest(set_up(path, [task.start, start]), "mujoco"))
        except SpecError as error:
            faults = [d.message for d in error.diagnostics]
        resting += not faults
        failures += [f"{path.name}, {name}: {fault}" for fault in faults]
    cells = ""
    for engine in ENGINES:
        try:
            rest = _rest(set_up(path, [task.start, end_of(path.name.split(".")[0], task)]), engine)
            failures += [f"{path.name}, end in {engine}: {fault}" for fault in _faults(rest)]
            cells += f"{rest!s:>18}"
        except SpecError as error:
            failures += [f"{path.name}, end: {d.message}" for d in error.diagnostics]
            cells += f"{'cannot be placed':>18}"
    print(f"{name_of(path):<28}{len(task.subtasks):>6}{f'{resting} of {len(starts)}':>16}{cells}", flush=True)


def set_up(path: Path, starts: list[Start | None]) -> Scene:
    """The lowered scene of a task with what its starts change."""
    loaded, task = task_at(path)
    scene: Loaded = load(loaded.file(task.scene))
    assert isinstance(scene.spec, SceneSpec)
    spec = with_starts(scene.spec, [start for start in starts if start is not None])
    carried = [(n, o.place.on or o.place.inside or "") for n, o in spec.objects.items() if o.place is not None]
    relations = tuple(f"OnTop({name}, {carrier.partition('.')[0]})" for name, carrier in carried)
    return lower(replace(scene, spec=spec.model_copy(update={"relations": relations})))


def end_of(name: str, task: TaskSpec) -> Start:
    """A state in which the goal holds: each thing is put on or in what the goal says, with its joints as they start."""
    calls = [parse_call(text) for text, _ in texts(task.goal)]
    more = AT_THE_END.get(name, {})
    moving = [c for c in calls if c.predicate in ("OnTop", "Inside")]
    return Start(place={c.args[0]: _place(c, more.get(c.args[0], {})) for c in moving})


def _place(call: Call, more: dict[str, object]) -> Place:
    word = "inside" if call.predicate == "Inside" else "on"
    return Place.model_validate({word: call.args[1], **more})


def _rest(scene: Scene, engine: str) -> Rest:
    """What settling does to a scene. A ball may roll in what holds it, because nothing here resists rolling."""
    with open_world(scene, engine) as world:
        settled: SettleResult = settle(world)
    balls = {o.name for o in scene.objects if is_ball(o)}
    steady = [o for o in settled.objects if o.name not in balls]
    problems = [f"{o.name} {problem}" for o in steady for problem in o.problems]
    problems += [f"{o.name} left what held it" for o in settled.objects if o.name in balls and not o.support_kept]
    drift, tilt = max((o.drift for o in steady), default=0.0), max((o.tilt_deg for o in steady), default=0.0)
    return Rest(drift, tilt, tuple(problems))


def _faults(rest: Rest) -> list[str]:
    if rest.passed:
        return []
    return [*rest.problems] or [f"the worst moved {rest.drift * 1000:.1f} mm and tilted {rest.tilt:.1f} deg"]


if __name__ == "__main__":
    sys.exit(main())
