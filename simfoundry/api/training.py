"""Training of policies: from a task to an evaluated policy, resumed stage by stage."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.api.ranges import RANGES, check_ranges
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import LOCAL, Machines, worker_count

if TYPE_CHECKING:
    from simfoundry.api.evaluation import Evaluation
    from simfoundry.evaluate.statistics.metrics import Rate
    from simfoundry.train.fit import FitOptions
    from simfoundry.train.job import TrainPlan, TrainSummary

# The smallest and the largest value of each numeric option, in Python and on the command line.
# The parts of the output folder.
COUSINS, DEMONSTRATIONS, AUGMENTED, POLICIES, EVALUATION = (
    "cousins", "demonstrations", "augmented", "policies", "evaluation",
)  # fmt: skip
REPORT, PAGE = "report.json", "report.html"

# Fraction of several tasks that is kept for the evaluation, and the largest number of these tasks.
HELD_OUT, MOST_HELD_OUT = 0.2, 25

# Number of demonstrations to record by default.
DEMONSTRATED = 200

# Callback that receives a text and the fraction of the current stage that is complete.
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class TrainingRun:
    """A training from the beginning to the evaluation.

    Attributes:
        sources: What to learn from: tasks, folders of tasks such as those of cousins, one recipe of cousins, or folders
            of demonstrations.
        folder: The output folder.
        options: The options of the training. Its seed is replaced by each of ``seeds``.
        seeds: The seeds of the trainings, which give one policy each.
        minutes: The time budget of each training [min], or None.
        count: The number of demonstrations; None for :data:`DEMONSTRATED`, or for all that are already recorded.
        augment: The number of demonstrations to generate from the recorded ones, and to learn from; or None.
        policy: The policy that demonstrates.
        record_seed: The seed of the initial states of the demonstrations.
        tasks: The tasks to evaluate, or folders of them; by default, the single task, or tasks that are held out.
        rollouts: The number of rollouts of each task, or None for 25 rollouts in total, but at least one of each task.
        eval_seed: The seed of the initial states of the evaluation.
        cousins: The number of cousins of a recipe, or None for the number in the recipe.
        commercial_only: Whether to refuse models that may not be used commercially for cousins.
        jobs: The number of parallel processes, or None for one on this machine and one per CPU of a cluster.
        machines: The machines that make cousins and run rollouts. Trainings run on this machine.
        video: Whether to record videos of the evaluation.
        cameras: The cameras whose images are inputs instead of true poses.
        image_width: The width of these images [px].
    """

    sources: tuple[Path, ...]
    folder: Path
    options: FitOptions
    seeds: tuple[int, ...] = (0,)
    minutes: float | None = None
    count: int | None = None
    augment: int | None = None
    policy: str = "expert"
    record_seed: int = 0
    tasks: tuple[Path, ...] = ()
    rollouts: int | None = None
    eval_seed: int = 1
    cousins: int | None = None
    commercial_only: bool = False
    jobs: int | None = None
    machines: Machines = LOCAL
    video: bool = True
    cameras: tuple[str, ...] = ()
    image_width: int = 64


@dataclass(frozen=True)
class Trained:
    """The result of a training run.

    Attributes:
        folder: The output folder.
        policies: The folder of each policy, keyed by its label.
        summaries: What each training reported, keyed by label.
        evaluation: The rollouts of all policies.
        report: The content of ``report.json``.
    """

    folder: Path
    policies: Mapping[str, Path]
    summaries: Mapping[str, TrainSummary]
    evaluation: Evaluation
    report: Mapping[str, Any]

    @property
    def rates(self) -> dict[str, Rate]:
        """The success rate of each policy over all rollouts, keyed by label."""
        from simfoundry.evaluate.statistics.metrics import Rate
        from simfoundry.evaluate.statistics.records import is_result

        found = {}
        for label in self.policies:
            done = [
                record["success"]
                for record in self.evaluation.records
                if record["policy"] == label and is_result(record)
            ]
            found[label] = Rate(sum(done), len(done))
        return found


@dataclass(frozen=True)
class _Material:
    """The recordings to learn from, and the tasks to evaluate.

    Attributes:
        demonstrations: The recordings to learn from.
        tasks: The tasks to evaluate.
        count: The number of demonstrations to use, or None for all.
        augmentation: The content of the report about the augmentation, or None without one.
    """

    demonstrations: tuple[Path, ...]
    tasks: tuple[Path, ...]
    count: int | None
    augmentation: Mapping[str, Any] | None = None


def train_policy(
    task: str | Path | Sequence[str | Path],
    policy: str = "expert",
    *,
    out: str | Path = "build/train",
    count: int | None = None,
    augment: int | None = None,
    steps: int = 10_000,
    minutes: float | None = None,
    seeds: Sequence[int] = (0,),
    rollouts: int | None = None,
    jobs: int | None = None,
    on: str = "local",
    video: bool = False,
) -> Trained:
    """Record demonstrations of a task, train a baseline on them, and evaluate it.

    Example: ``train_policy("stack.task.yaml", count=50, minutes=5)``.

    Stages that are already complete in ``out`` are not repeated. To resume an interrupted run, make the same call
    again.

    Args:
        task: A task, a folder of tasks, a recipe of cousins, a folder of demonstrations, or several of them.
        policy: The policy that demonstrates, named as on the command line.
        out: Output folder.
        count: Number of demonstrations; by default, 200, or all that are already recorded.
        augment: Number of demonstrations to generate from the recorded ones, and to learn from; by default, none.
        steps: Maximum number of optimization steps.
        minutes: Time budget for each training [min].
        seeds: Seeds of the trainings; each gives one policy.
        rollouts: Number of rollouts of each task and policy; by default, 25 in total.
        jobs: Number of parallel processes; by default, one on this machine, and one per CPU of a Ray cluster.
        on: Where to make cousins and run rollouts: ``local``, ``ray`` or ``ray:ADDRESS``. Trainings run locally.
        video: Whether to record videos of the rollouts.

    Raises:
        SpecError: If a document has errors.
        SimfoundryError: If an option is invalid, or if a stage fails.
    """
    from simfoundry.train.fit import FitOptions

    given = {"count": count, "steps": steps, "rollouts": rollouts, "jobs": jobs}
    check_ranges([*given.items(), ("count", augment), *(("seed", seed) for seed in seeds)])
    sources = tuple(Path(one) for one in ([task] if isinstance(task, str | Path) else task))
    options = FitOptions(steps=steps)
    run = TrainingRun(
        sources,
        Path(out),
        options,
        tuple(seeds),
        minutes,
        count,
        augment,
        policy,
        rollouts=rollouts,
        jobs=jobs,
        machines=Machines.parse(on),
        video=video,
    )
    return run_training(run)


def run_training(run: TrainingRun, progress: Progress = lambda text, share: None) -> Trained:
    """Carry out the stages of a training that are not complete yet."""
    from simfoundry.runtime.extras import need_extra

    need_extra("train", "training")
    if len(set(run.seeds)) < len(run.seeds) or not run.seeds:
        raise SimfoundryError("the seeds of the trainings must differ; name at least one")
    run.folder.mkdir(parents=True, exist_ok=True)
    material = _material(run, progress)
    plans = _plans(run, material)
    summaries = _train_all(run, plans, progress)
    policies = {label: plan.folder for label, plan in plans.items()}
    evaluation = _evaluate(run, material, policies, progress)
    report = _write_report(run, material, policies, summaries, evaluation)
    return Trained(run.folder, policies, summaries, evaluation, report)


def _material(run: TrainingRun, progress: Progress) -> _Material:
    """Record the demonstrations, and choose the tasks to evaluate."""
    from simfoundry.data.index import INDEX

    recorded = [source for source in run.sources if (source / INDEX).is_file()]
    if recorded and len(recorded) < len(run.sources):
        raise SimfoundryError("tasks and folders of demonstrations cannot be combined; record the tasks first")
    chosen = _task_files(run.tasks)
    if recorded:
        return _augmented(run, _Material(tuple(recorded), chosen or _recorded_tasks(recorded), run.count), progress)
    learned = _documents(run, progress)
    if not chosen:
        held_out = min(MOST_HELD_OUT, round(HELD_OUT * len(learned)))
        chosen = learned[len(learned) - held_out :] or learned
        learned = learned[: len(learned) - held_out]
    _record(run, learned, progress)
    material = _Material((run.folder / DEMONSTRATIONS,), chosen, run.count or DEMONSTRATED)
    return _augmented(run, material, progress)


def _augmented(run: TrainingRun, material: _Material, progress: Progress) -> _Material:
    """Generate demonstrations if the run asks for them, and learn from these."""
    if run.augment is None:
        return material
    from simfoundry.api.augmentation import generate

    if len(material.demonstrations) > 1:
        raise SimfoundryError("several folders of demonstrations cannot be augmented together; name one of them")
    (source,), out, use = material.demonstrations, run.folder / AUGMENTED, material.count or 0
    facts = generate(source, out, run.augment, use, run.jobs, run.machines, lambda t, s: progress(f"augment: {t}", s))
    return _Material((out,), material.tasks, run.augment, {"folder": AUGMENTED, **facts})


def _task_files(paths: Sequence[Path]) -> tuple[Path, ...]:
    from simfoundry.cousins.run.review import usable_tasks

    return tuple(usable_tasks(paths)[0])


def _recorded_tasks(folders: Sequence[Path]) -> tuple[Path, ...]:
    from simfoundry.data.demonstrations import read_demonstrations

    sets = [(folder, read_demonstrations(folder)) for folder in folders]
    found = [(folder / str(about["document"])).resolve() for folder, one in sets for about in one.tasks]
    return tuple(dict.fromkeys(found))


def _documents(run: TrainingRun, progress: Progress) -> tuple[Path, ...]:
    """Return the task documents of the sources. Cousins of a recipe are made first."""
    recipes = [source for source in run.sources if source.name.endswith(".cousins.yaml")]
    if not recipes:
        return _task_files(run.sources)
    if len(run.sources) > 1:
        raise SimfoundryError("a recipe cannot be combined with other sources; make its cousins first")
    from simfoundry.api.cousins import make_cousins

    jobs, folder, strict = worker_count(run.machines, run.jobs), run.folder / COUSINS, run.commercial_only
    found = make_cousins(recipes[0], folder, run.cousins, jobs, run.machines, progress, commercial_only=strict)
    if not found:
        raise SimfoundryError(f"{recipes[0]} does not have a task as its twin, so that its cousins cannot be learned")
    return tuple(found)


def _record(run: TrainingRun, documents: Sequence[Path], progress: Progress) -> None:
    from simfoundry.api.demonstrations import record_plan, run_record, shortage

    folder = run.folder / DEMONSTRATIONS
    count = run.count or DEMONSTRATED
    plan = record_plan(documents, run.policy, folder, count, run.record_seed)
    summary = run_record(plan, run.jobs, run.machines, lambda text, share: progress(f"record: {text}", share))
    if summary.kept < count:
        raise SimfoundryError(shortage(plan, summary))


def _plans(run: TrainingRun, material: _Material) -> dict[str, TrainPlan]:
    """Return the trainings, keyed by the label of their policies.

    The folder of a policy contains a digest of everything that determines it, so that a run with other options trains
    another policy instead of replacing it.
    """
    from dataclasses import replace

    from simfoundry.train.job import TrainPlan, request_digest

    plans = {}
    for seed in run.seeds:
        plan = TrainPlan(
            folder=run.folder,
            demonstrations=material.demonstrations,
            options=replace(run.options, seed=seed),
            minutes=run.minutes,
            count=material.count,
            cameras=run.cameras,
            image_width=run.image_width,
        )
        name = f"seed_{seed}"
        plans[name] = replace(plan, folder=run.folder / POLICIES / f"{name}_{request_digest(plan)}")
    return plans


def _train_all(run: TrainingRun, plans: Mapping[str, TrainPlan], progress: Progress) -> dict[str, TrainSummary]:
    """Train the policies, in parallel if there are several processes."""
    from simfoundry.train.job import train as train_one
    from simfoundry.train.job import train_in_workers

    jobs = run.jobs or 1
    if jobs > 1 and len(plans) > 1:
        return train_in_workers(plans, jobs, lambda text, share: progress(f"train: {text}", share))
    found = {}
    for k, (label, plan) in enumerate(plans.items()):

        def shown(text: str, share: float, k: int = k, label: str = label) -> None:
            progress(f"train {label}: {text}", (k + share) / len(plans))

        found[label] = train_one(plan, shown)
    return found


def _evaluate(run: TrainingRun, material: _Material, policies: Mapping[str, Path], progress: Progress) -> Evaluation:
    from simfoundry.api.evaluation import run_plan
    from simfoundry.evaluate.entries import TaskEntry, contenders
    from simfoundry.evaluate.run import EvaluationPlan, prepare

    least, most = RANGES["rollouts"]
    rollouts = run.rollouts or min(most, max(least, -(-MOST_HELD_OUT // len(material.tasks))))
    entries = tuple(TaskEntry(path) for path in material.tasks)
    named = contenders(tuple(f"{label}=baseline:{folder}" for label, folder in policies.items()))
    digest = _digest([*(one.digest for one in named), *map(str, material.tasks), rollouts, run.eval_seed])
    folder = run.folder / EVALUATION / digest
    plan = EvaluationPlan(folder, entries, tuple(named), rollouts, run.eval_seed, video=run.video)
    prepare(plan, lambda name, done, of: progress(f"initial states of {name}", done / of))
    return run_plan(plan, run.jobs, run.machines, lambda text, share: progress(f"evaluate: {text}", share))


def _digest(facts: Sequence[object]) -> str:
    import hashlib

    return hashlib.sha256(json.dumps(facts, default=str).encode()).hexdigest()[:8]


def _write_report(
    run: TrainingRun,
    material: _Material,
    policies: Mapping[str, Path],
    summaries: Mapping[str, TrainSummary],
    evaluation: Evaluation,
) -> dict[str, Any]:
    from simfoundry.reports.training import training_page
    from simfoundry.runtime.files import write_atomically

    report = {
        "simfoundry": "training/1",
        "sources": [str(source) for source in run.sources],
        "demonstrations": [str(folder) for folder in material.demonstrations],
        "augmentation": material.augmentation,
        "policies": {
            label: {
                "folder": folder.relative_to(run.folder).as_posix(),
                **summaries[label].spec.training.model_dump(mode="json"),
                "losses": [asdict(point) for point in summaries[label].losses],
            }
            for label, folder in policies.items()
        },
        "evaluation": evaluation.folder.relative_to(run.folder).as_posix(),
        "seen_starts": _seen_starts(material, evaluation),
        **{key: evaluation.results[key] for key in ("scores", "pooled")},
    }
    text = json.dumps(report, indent=1, ensure_ascii=False) + "\n"
    write_atomically(run.folder / REPORT, text.encode())
    write_atomically(run.folder / PAGE, training_page(report, evaluation.records).encode())
    return report


def _seen_starts(material: _Material, evaluation: Evaluation) -> int:
    """Return the number of rollouts whose exact initial state is that of a demonstration in the same task."""
    from simfoundry.data.demonstrations import read_demonstrations

    seen = {
        (one[k].about["task"], one[k].start.digest)
        for one in map(read_demonstrations, material.demonstrations)
        for k in range(len(one))
    }
    return sum((record["task"], record["start"]) in seen for record in evaluation.records)
