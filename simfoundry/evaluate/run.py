"""Run the missing rollouts of an evaluation, in this process or in several worker processes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

from simfoundry import __version__
from simfoundry.assets.cache import Cache
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.entries import Contender, ExpertChoice, OpenPolicies, TaskEntry, TaskPart
from simfoundry.evaluate.policies.base import ImageSize, PolicyError
from simfoundry.evaluate.resets.starts import RolloutStart, starts
from simfoundry.evaluate.rollouts.control import check_cameras
from simfoundry.evaluate.rollouts.rollout import RolloutEnd, Video, rollout
from simfoundry.evaluate.rollouts.videos import side_by_side, whole_picture, write_video
from simfoundry.evaluate.statistics.records import RecordSlot, check_layout, is_result
from simfoundry.evaluate.statistics.results import cousin_of
from simfoundry.evaluate.task import Task, need_robots
from simfoundry.runtime.executors import LOCAL, JobLimits, Machines, carry_out_jobs, open_executor
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.workers import WorkerError, at_worker_exit
from simfoundry.scene.robot import FILES_ONLY, Robot
from simfoundry.spec.yaml.write import to_data
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World

# Number of consecutive rollouts without a response after which a policy's remaining rollouts are skipped. Otherwise, a
# stopped server would delay each of them by its full `timeout`.
GIVE_UP = 3

# Maximum time without progress [s]; a policy may load a checkpoint and compile it before its first response.
SILENCE_S = 900.0

LIMITS = JobLimits(SILENCE_S)

# Number of control steps between two video frames: five frames per second at 15 Hz.
FRAME_EVERY = 3


@dataclass(frozen=True)
class EvaluationPlan:
    """The tasks, policies and options of an evaluation.

    ``shard`` is a pair (i, n) that selects every n-th rollout, starting with rollout i, which is counted from 0.
    ``cameras`` lists the cameras whose images are recorded as videos.
    """

    folder: Path
    entries: tuple[TaskEntry, ...]
    contenders: tuple[Contender, ...]
    rollouts: int = 25
    seed: int = 0
    engines: tuple[str, ...] = ("mujoco",)
    shard: tuple[int, int] = (0, 1)
    cameras: tuple[str, ...] | None = None
    video: bool = True


@dataclass(frozen=True)
class RolloutJob:
    """A single rollout of an evaluation plan."""

    entry: TaskEntry
    contender: Contender
    index: int
    engine: str


@dataclass(frozen=True)
class RolloutOutcome:
    """The outcome of a job, including its record."""

    job: RolloutJob
    record: dict[str, Any]

    @property
    def answered(self) -> bool:
        """True if the policy responded, even if the response was invalid.

        Otherwise, the rollout has no result.
        """
        return is_result(self.record)

    @property
    def trouble(self) -> str:
        """The policy error that ended the rollout, or an empty string if all responses were valid."""
        return str(self.record["reason"]) if self.record["end"] in (RolloutEnd.INVALID, RolloutEnd.NO_ANSWER) else ""


# Callback that receives the outcome of each job, the number of finished jobs, and the total number of jobs.
Seen = Callable[[RolloutOutcome, int, int], None]


def task_key(entry: TaskEntry, task: Task) -> str:
    """Return the name of a task's folder.

    The name includes the step if only a part of the task is evaluated.
    """
    mark = {TaskPart.WHOLE: "", TaskPart.ALONE: ".", TaskPart.ONWARD: "+"}[entry.part]
    return f"{task.name}{mark}{entry.step}"


def jobs(plan: EvaluationPlan) -> list[RolloutJob]:
    """List all rollouts in the plan's shard, ordered by task, engine, policy and initial state."""
    first, of = plan.shard
    every = product(plan.entries, plan.engines, plan.contenders, range(plan.rollouts))
    return [RolloutJob(entry, contender, k, engine) for entry, engine, contender, k in every][first::of]


def prepare(plan: EvaluationPlan, progress: Callable[[str, int, int], None] | None = None) -> None:
    """Load every task and find its initial states.

    This is done before the first rollout so that errors are reported early.
    """
    check_layout(plan.folder)
    if any(isinstance(contender.choice(), ExpertChoice) for contender in plan.contenders):
        need_extra("expert", "policy `expert`")
    cache, keys = Cache.default(), set[str]()
    for entry in plan.entries:
        task = entry.load(cache)
        if (key := task_key(entry, task)) in keys:
            raise SimfoundryError(f"two tasks have the name `{key}`; specify each task only once")
        keys.add(key)
        need_robots(task)
        starts(task, plan.rollouts, plan.seed, cache, None if progress is None else partial(progress, task.name))


def pending(plan: EvaluationPlan) -> list[RolloutJob]:
    """List the jobs for which there is no record yet.

    Raises:
        OutputError: If an existing record belongs to a different evaluation.
    """
    return [job for job in jobs(plan) if not _is_done(plan, job)]


def run(plan: EvaluationPlan, seen: Seen, workers: int | None = 1, machines: Machines = LOCAL) -> list[RolloutOutcome]:
    """Run the pending jobs.

    If a policy stops responding, its remaining jobs are skipped.
    """
    waiting, silent = pending(plan), Counter[str]()
    outcomes: list[RolloutOutcome] = []
    todo = iter(waiting)

    def next_job() -> RolloutJob | None:
        return next((job for job in todo if silent[job.contender.label] < GIVE_UP), None)

    if not waiting:
        return []
    count = 1 if len(waiting) == 1 and not machines.is_ray else workers
    executor = open_executor(machines, count, LIMITS, any(contender.is_foreign for contender in plan.contenders))
    with closing(carry_out_jobs(executor, f"{__name__}:carry_out_in_worker", next_job, plan)) as finished:
        for job, outcome in finished:
            if isinstance(outcome, WorkerError):
                name = f"rollout {job.index} of {job.entry.path.name}"
                raise SimfoundryError(f"the worker process for {name} {outcome.how}")
            if isinstance(outcome, SimfoundryError):
                raise outcome
            label = job.contender.label
            silent[label] = 0 if outcome.answered else silent[label] + 1
            outcomes.append(outcome)
            seen(outcome, len(outcomes), len(waiting))
    return outcomes


def carry_out_in_worker(plan: EvaluationPlan, job: RolloutJob) -> RolloutOutcome | SimfoundryError:
    """Run one job in a worker process.

    The policies and the world of the process are closed when the pool shuts down.
    """
    at_worker_exit(_close)
    try:
        return carry_out(plan, job)
    except SimfoundryError as error:
        return error


def carry_out(plan: EvaluationPlan, job: RolloutJob) -> RolloutOutcome:
    """Run one rollout and write its record."""
    setting = _setting(job.entry, plan.rollouts, plan.seed, job.engine)
    start, slot = setting.starts[job.index], _slot(plan, job, setting.task)
    conditions = {key: value for key, value in _conditions(job, setting.task, start).items() if value is not None}
    about = {**conditions, **_about(plan, setting.task, start, job.engine)}
    try:
        policy = _POLICIES.policy(job.contender, setting.task, setting.judge)
    except PolicyError as error:
        return RolloutOutcome(job, slot.write_missing(str(error), about))
    video = _video(plan, setting.task)
    result = rollout(setting.task, start, policy, setting.world, setting.judge, video)
    if not result.success:
        about["unmet"] = setting.judge(setting.task.goal, result.final).why
    if any(result.frames.values()):
        about["video"] = slot.video.relative_to(plan.folder).as_posix()
        images = [side_by_side(row) for row in zip(*result.frames.values(), strict=True)]
        write_video(slot.video, images, setting.task.control_hz / FRAME_EVERY)
    return RolloutOutcome(job, slot.write(result, about, policy.action_space))


def _about(plan: EvaluationPlan, task: Task, start: RolloutStart, engine: str) -> dict[str, Any]:
    """Return the context that is stored in a record in addition to the conditions of the rollout."""
    cousin = cousin_of(task)
    return {
        "version": __version__,
        "engine_version": version(engine),
        "seed": start.seed,
        "asked_rollouts": plan.rollouts,
        "instruction": task.instruction,
        "robots": {name: _model_name(task.scene.robot(name)) for name in task.robots},
        "control_hz": task.control_hz,
        "horizon": task.horizon,
        **({"cousin": cousin} if cousin else {}),
        "grid": list(task.reset.grid),
        "regions": {name: {"x": list(r.x), "y": list(r.y)} for name, r in task.reset.objects.items()},
        "cells": {name: list(cell) for name, cell in start.cells.items()},
    }


def _model_name(robot: Robot) -> str:
    """Return the robot's name in the document.

    If it has no name, the file name of its model is returned.
    """
    return robot.kind if robot.kind != FILES_ONLY else next(iter(robot.models.values())).file.name


def _is_done(plan: EvaluationPlan, job: RolloutJob) -> bool:
    setting = _setting(job.entry, plan.rollouts, plan.seed, job.engine)
    slot = _slot(plan, job, setting.task)
    record = slot.read()
    if record is None:
        return False
    for key, value in _conditions(job, setting.task, setting.starts[job.index]).items():
        if record.get(key) != value:
            what = "policy (its document, recording or code)" if key == "asked" else key
            raise OutputError(
                f"{slot.path} belongs to a different evaluation: its {what} is {record.get(key)!r}, not {value!r}; "
                "choose a different folder, or remove this one"
            )
    return True


def _conditions(job: RolloutJob, task: Task, start: RolloutStart) -> dict[str, Any]:
    """Return the conditions of a rollout, None if there are none of a kind.

    Rollouts under identical conditions are bit-identical.
    """
    return {
        "task": task.name,
        "part": str(job.entry.part),
        "step": job.entry.step,
        "policy": job.contender.label,
        "asked": job.contender.digest,
        "engine": job.engine,
        "start": start.digest,
        "disturbances": to_data(task.disturbances) or None,
    }


def _slot(plan: EvaluationPlan, job: RolloutJob, task: Task) -> RecordSlot:
    return RecordSlot(plan.folder, task_key(job.entry, task), job.contender.label, job.engine, job.index)


def _video(plan: EvaluationPlan, task: Task) -> Video | None:
    names = tuple(camera.name for camera in task.scene.cameras[:1]) if plan.cameras is None else plan.cameras
    if not plan.video or not names:
        return None
    check_cameras(task.scene, dict.fromkeys(names, ImageSize(1, 1)), "the video")
    shapes = {c.name: c for c in (*task.scene.cameras, *(mounted.camera for mounted in task.scene.mounted))}
    return Video({name: whole_picture(shapes[name].width, shapes[name].height) for name in names}, FRAME_EVERY)


@dataclass(frozen=True)
class _Setting:
    """The task, initial states, world and judge that all rollouts of a task share within a process."""

    task: Task
    starts: tuple[RolloutStart, ...]
    world: World
    judge: Any


@lru_cache(maxsize=1)
def _setting(entry: TaskEntry, rollouts: int, seed: int, engine: str) -> _Setting:
    """Return the setting of a task, which is created if it is not cached."""
    from simfoundry.predicates import Judge

    task = entry.load(Cache.default())
    found = starts(task, rollouts, seed, Cache.default())
    return _Setting(task, found, open_world(task.scene, engine), Judge(task.scene))


# Policies that are open in this process; connections are kept open as long as possible.
_POLICIES = OpenPolicies()


def _close() -> None:
    _POLICIES.close()
    _setting.cache_clear()
