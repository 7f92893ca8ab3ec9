"""A training job: demonstrations in, a policy folder out, resumed after an interruption."""

from __future__ import annotations

import hashlib
import json
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from simfoundry import __version__
from simfoundry.data.attempt import ENGINE
from simfoundry.data.demonstrations import DemonstrationSet
from simfoundry.data.trajectory import TrajectorySampler
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.files import clear_staged_files, locked_folder, write_atomically
from simfoundry.runtime.workers import GRACE_S, Limits, WorkerError, WorkerPool, report_progress
from simfoundry.train.examples import ExampleReader, Examples
from simfoundry.train.fit import CHECKPOINT, FitOptions, Fitted, LossPoint, fit, seconds_per_step
from simfoundry.train.policy_files import (
    ABOUT,
    BaselineSpec,
    StoredBaseline,
    TrainingFacts,
    read_about,
    write_baseline,
)
from simfoundry.train.situations import InputLayout, input_layout

# The request and the chosen number of steps, and the loss curve, both beside the policy.
JOB, LOSSES = "training.json", "losses.json"

# Fraction of a time budget that is planned for steps; the rest is for reading demonstrations and writing checkpoints.
PLANNED = 0.9

# Time between two progress reports of a worker [s], and time without one after which it counts as stuck [s]: reading
# the demonstrations of a large recording without actions to convert takes minutes.
REPORT_S, SILENCE_S = 0.5, 3600.0

# Fewest steps of a training; fewer do not even reach the full learning rate.
MIN_STEPS = 20


@dataclass(frozen=True)
class TrainPlan:
    """A training to carry out.

    Attributes:
        folder: The output folder, which contains the policy afterwards.
        demonstrations: The recordings to learn from. Their tasks may differ in the scene and the instruction.
        options: The options. ``steps`` is an upper limit if ``minutes`` is set.
        minutes: The time budget [min], or None for no limit. The number of steps that it allows is measured once, when
            the training starts.
        count: The number of demonstrations to use, spread evenly over the recordings, or None for all.
        hz: The number of actions per second [Hz], or None for the control frequency of the tasks.
        executed: The number of actions that a rollout executes before the next prediction.
        flow_steps: The number of integration steps of a prediction.
        cameras: The cameras whose images are inputs instead of true poses.
        image_width: The width of these images [px].
    """

    folder: Path
    demonstrations: tuple[Path, ...]
    options: FitOptions = field(default_factory=FitOptions)
    minutes: float | None = None
    count: int | None = None
    hz: float | None = None
    executed: int = 8
    flow_steps: int = 10
    cameras: tuple[str, ...] = ()
    image_width: int = 64


@dataclass(frozen=True)
class TrainSummary:
    """A finished training.

    Attributes:
        spec: The description of the policy.
        losses: The loss curve.
        is_new: False if the policy had already been trained.
    """

    spec: BaselineSpec
    losses: tuple[LossPoint, ...]
    is_new: bool


# Callback that receives a text on what is being done, and the fraction of the training that is complete.
Progress = Callable[[str, float], None]


def train(plan: TrainPlan, progress: Progress = lambda text, share: None) -> TrainSummary:
    """Train a baseline, or return the one that is already in the folder.

    Raises:
        SimfoundryError: If there are no demonstrations, if they do not fit together, or if the folder cannot be used.
    """
    need_extra("train", "training")
    need_extra("expert", "training, which converts actions to poses of the hand")
    sets = [DemonstrationSet(folder) for folder in plan.demonstrations]
    chosen = _chosen(sets, plan.count)
    request = _request(plan, sets, chosen)
    with _writing(plan.folder):
        job = _read_job(plan.folder)
        if job is not None and job["request"] != request:
            raise OutputError(
                f"{plan.folder} contains a policy that was trained from other demonstrations or with other options; "
                "choose another folder"
            )
        if job is not None and (plan.folder / ABOUT).exists():
            return TrainSummary(read_about(plan.folder), read_losses(plan.folder), is_new=False)
        layout, examples, hz = _examples(sets, chosen, plan, progress)
        if job is None:
            job = {"request": request, "steps": _steps(plan, examples, layout, progress)}
            write_atomically(plan.folder / JOB, (json.dumps(job, indent=1) + "\n").encode())
        options = replace(plan.options, steps=int(job["steps"]))
        fitted = fit(
            examples, layout, options, plan.folder, lambda step, point: _report(progress, step, options, point)
        )
        spec = _spec(plan, _task_names(sets), request, layout, fitted, hz)
        losses = json.dumps([asdict(point) for point in fitted.losses], indent=1) + "\n"
        write_atomically(plan.folder / LOSSES, losses.encode())
        write_baseline(plan.folder, StoredBaseline(spec, fitted.weights, fitted.normalization))
        (plan.folder / CHECKPOINT).unlink(missing_ok=True)
        return TrainSummary(spec, fitted.losses, is_new=True)


def train_in_workers(
    plans: Mapping[str, TrainPlan], workers: int, progress: Progress = lambda text, share: None
) -> dict[str, TrainSummary]:
    """Carry out several trainings in parallel processes, and return their summaries by the keys of the plans.

    Raises:
        SimfoundryError: If a training fails. The others are finished first.
    """
    pool = WorkerPool(min(workers, len(plans)), Limits.shared(SILENCE_S, workers), _Shown(plans, progress))
    found: dict[str, TrainSummary] = {}
    failures: list[SimfoundryError] = []
    try:
        for key, plan in plans.items():
            pool.submit(key, f"{__name__}:_in_worker", plan)
        for _ in plans:
            key, outcome = pool.next()
            if isinstance(outcome, WorkerError):
                failures.append(SimfoundryError(f"the process that trains {key} {outcome.how}"))
            elif isinstance(outcome, SimfoundryError):
                failures.append(outcome)
            else:
                found[key] = outcome
    finally:
        pool.close(GRACE_S)
    if failures:
        raise failures[0]
    return {key: found[key] for key in plans}


class _Shown:
    """The combined progress of several trainings."""

    def __init__(self, plans: Mapping[str, TrainPlan], progress: Progress) -> None:
        self._shares, self._progress, self._lock = dict.fromkeys(plans, 0.0), progress, threading.Lock()

    def __call__(self, key: str, text: str) -> None:
        share, _, said = text.partition(" ")
        with self._lock:
            self._shares[key] = float(share)
            self._progress(f"{key}, {said}", sum(self._shares.values()) / len(self._shares))


def _in_worker(plan: TrainPlan) -> TrainSummary | SimfoundryError:
    """Train in a worker process. Errors are returned, because workers report exceptions without their type."""
    last = 0.0

    def report(text: str, share: float) -> None:
        nonlocal last
        if time.monotonic() - last > REPORT_S:
            last = time.monotonic()
            report_progress(f"{share} {text}")

    try:
        return train(plan, report)
    except SimfoundryError as error:
        return error
    except OSError as error:
        return OutputError(f"{error.filename or plan.folder}: {error.strerror or error}")


def _task_names(sets: Sequence[DemonstrationSet]) -> list[str]:
    return list(dict.fromkeys(str(about["task"]) for one in sets for about in one.tasks))


def read_losses(folder: Path) -> tuple[LossPoint, ...]:
    """Read the loss curve of a training.

    Raises:
        OutputError: If the file is missing or damaged.
    """
    try:
        rows = json.loads((folder / LOSSES).read_bytes())
        return tuple(LossPoint(int(r["step"]), float(r["train"]), r["validation"]) for r in rows)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{folder / LOSSES} is not the loss curve of a training; train the policy again") from None


def request_digest(plan: TrainPlan) -> str:
    """Return a digest of everything that determines the policy, except the measured number of steps."""
    sets = [DemonstrationSet(folder) for folder in plan.demonstrations]
    request = _request(plan, sets, _chosen(sets, plan.count))
    return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()[:8]


def _chosen(sets: Sequence[DemonstrationSet], count: int | None) -> list[list[int]]:
    """Return the positions of the demonstrations to use in each recording: the first ones, spread evenly.

    Raises:
        SimfoundryError: If there are too few demonstrations.
    """
    there = [len(one) for one in sets]
    wanted = sum(there) if count is None else count
    if not wanted or sum(there) < wanted:
        raise SimfoundryError(
            f"training needs {wanted or 'some'} demonstrations, but there are {sum(there)}; record more of them"
        )
    taken = [0] * len(sets)
    while sum(taken) < wanted:
        for k in sorted(range(len(sets)), key=lambda k: taken[k]):
            if taken[k] < there[k] and sum(taken) < wanted:
                taken[k] += 1
    return [list(range(n)) for n in taken]


def _request(plan: TrainPlan, sets: Sequence[DemonstrationSet], chosen: Sequence[Sequence[int]]) -> dict[str, Any]:
    """Return everything that determines the policy, except the measured number of steps."""
    learned = hashlib.sha256()
    for one, positions in zip(sets, chosen, strict=True):
        for k in positions:
            learned.update(f"{one[k].document.name} {one[k].about['starts']} {one[k].trajectory}\n".encode())
    return {
        "version": __version__,
        "torch": version("torch"),
        "demonstrations": learned.hexdigest()[:16],
        "count": sum(map(len, chosen)),
        "minutes": plan.minutes,
        "hz": plan.hz,
        "executed": plan.executed,
        "flow_steps": plan.flow_steps,
        "cameras": list(plan.cameras),
        "image_width": plan.image_width if plan.cameras else 0,
        "options": asdict(plan.options),
    }


def _examples(
    sets: Sequence[DemonstrationSet], chosen: Sequence[Sequence[int]], plan: TrainPlan, progress: Progress
) -> tuple[InputLayout, Examples, float]:
    """Read demonstrations, task by task.

    Returns:
        The layout of the input vector, the examples, and the number of actions per second [Hz].
    """
    by_task: dict[Path, list[tuple[DemonstrationSet, int]]] = {}
    for one, positions in zip(sets, chosen, strict=True):
        for k in positions:
            by_task.setdefault(one[k].document, []).append((one, k))
    tasks = {document: found[0][0].task_of(found[0][0][found[0][1]]) for document, found in by_task.items()}
    layout = input_layout(list(tasks.values()), plan.cameras, plan.image_width)
    rates = {task.control_hz for task in tasks.values()} if plan.hz is None else {plan.hz}
    if len(rates) > 1:
        listed = " and ".join(f"{rate:g}" for rate in sorted(rates))
        raise SimfoundryError(f"the tasks have control frequencies of {listed} Hz; choose one with --hz")
    (hz,) = rates
    parts: list[Examples] = []
    total = sum(map(len, by_task.values()))
    for document, found in by_task.items():
        with TrajectorySampler(tasks[document]) as sampler:
            reader = ExampleReader(tasks[document], layout, sampler, hz)
            for one, k in found:
                progress(f"reading demonstration {len(parts) + 1} of {total}", 0.0)
                parts.append(reader.read(one[k]))
    return layout, Examples.joined(parts), hz


def _steps(plan: TrainPlan, examples: Examples, layout: InputLayout, progress: Progress) -> int:
    """Return the number of steps: the requested one, or fewer if the time budget does not allow it."""
    if plan.minutes is None:
        return plan.options.steps
    progress("measuring the speed of this machine", 0.0)
    each = seconds_per_step(examples, layout, plan.options)
    return max(MIN_STEPS, min(plan.options.steps, math.floor(plan.minutes * 60 * PLANNED / each)))


def _report(progress: Progress, step: int, options: FitOptions, point: LossPoint | None) -> None:
    loss = "" if point is None else f", loss {point.train if point.validation is None else point.validation:.3f}"
    progress(f"step {step} of {options.steps}{loss}", step / options.steps)


def _spec(
    plan: TrainPlan,
    tasks: Sequence[str],
    request: Mapping[str, Any],
    layout: InputLayout,
    fitted: Fitted,
    hz: float,
) -> BaselineSpec:
    last = fitted.losses[-1]
    facts = TrainingFacts(
        tasks=tuple(tasks),
        demonstrations=request["count"],
        inputs=request["demonstrations"],
        seed=plan.options.seed,
        steps=last.step,
        loss=last.train if last.validation is None else last.validation,
        versions={"simfoundry": __version__, "torch": version("torch"), ENGINE: version(ENGINE)},
    )
    return BaselineSpec(
        robots=layout.robots,
        objects=layout.objects,
        joints=layout.joints,
        words=layout.words,
        cameras=layout.cameras,
        image_size=(layout.width, layout.height),
        chunk=plan.options.chunk,
        executed=min(plan.executed, plan.options.chunk),
        hz=hz,
        flow_steps=plan.flow_steps,
        width=plan.options.width,
        blocks=plan.options.blocks,
        training=facts,
    )


def _read_job(folder: Path) -> dict[str, Any] | None:
    """Read the request that a folder belongs to, or None if the folder is empty."""
    path = folder / JOB
    if not path.exists():
        foreign = sorted(one.name for one in folder.iterdir() if not one.name.startswith(f".{JOB}."))
        if foreign:
            raise OutputError(f"{folder} contains other files, such as {foreign[0]}; choose another folder")
        return None
    try:
        job = json.loads(path.read_bytes())
        return {"request": job["request"], "steps": int(job["steps"])}
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is not the description of a training; choose another folder") from None


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Lock a folder in which only this training may write."""
    folder.mkdir(parents=True, exist_ok=True)
    with locked_folder(folder, "is being written by another training; wait for it, or choose another folder"):
        clear_staged_files(folder)
        yield
