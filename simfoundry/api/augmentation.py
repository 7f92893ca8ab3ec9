"""Augmentation of demonstrations: many new ones from a few."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.api.demonstrations import Progress, demonstrations, record_plan, run_record, shortage
from simfoundry.api.ranges import check_ranges
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import Machines

if TYPE_CHECKING:
    from simfoundry.data.demonstrations import DemonstrationSet
    from simfoundry.data.plan import RecordPlan

# Difference between the default seed of the new initial states and that of the demonstrations. It is large, so that the
# states also differ from those of an evaluation with one of the next seeds.
UNSEEN = 1000


def augment_demonstrations(
    folder: str | Path,
    tasks: str | Path | Sequence[str | Path] = (),
    *,
    out: str | Path = "more",
    count: int = 200,
    seed: int | None = None,
    select: str = "object",
    bridge: str = "planned",
    noise: float = 0.0,
    use: int = 0,
    max_attempts: int | None = None,
    jobs: int | None = None,
    on: str = "local",
) -> DemonstrationSet:
    """Generate demonstrations from recorded ones, in other initial states, scenes and tasks.

    Example: ``augment_demonstrations("demos", count=200)``.

    Demonstrations that are already in ``out`` are kept. To resume an interrupted run, make the same call again.

    Args:
        folder: A folder of demonstrations.
        tasks: Tasks, or folders of tasks such as those of cousins; by default, the tasks of the demonstrations.
        out: Output folder.
        count: Number of demonstrations to generate.
        seed: Seed for the initial states; by default, that of the demonstrations plus 1000.
        select: The order in which demonstrations are tried as the source of a segment: ``object``, ``hand`` or
            ``random``.
        bridge: The motion between segments: ``planned`` around obstacles, or ``warped`` from the recorded one.
        noise: Standard deviation of the noise that is added to joint targets [rad or m].
        use: Number of demonstrations to use, the first ones, or 0 for all.
        max_attempts: Maximum number of attempts; by default, four for each demonstration, and 16 more.
        jobs: Number of parallel processes; by default, one on this machine, and one per CPU of a Ray cluster.
        on: Where to run: ``local``, ``ray`` or ``ray:ADDRESS``.

    Raises:
        SpecError: If a task document has errors.
        SimfoundryError: If an option is invalid, or if there are too few successful attempts.
    """
    from simfoundry.cousins.run.review import usable_tasks

    check_ranges([("count", count), ("seed", seed), ("jobs", jobs)])
    paths = [Path(one) for one in ([tasks] if isinstance(tasks, str | Path) else tasks)]
    documents = usable_tasks(paths)[0] if paths else ()
    options: dict[str, str | int | float] = {"select": select, "bridge": bridge, "noise": noise, "use": use}
    plan = augment_plan(Path(folder), documents, Path(out), count, seed, options, max_attempts)
    summary = run_record(plan, jobs, Machines.parse(on), lambda text, share: None)
    if summary.kept < count:
        raise SimfoundryError(shortage(plan, summary))
    return demonstrations(out)


def augment_plan(
    folder: Path,
    documents: Sequence[Path],
    out: Path,
    count: int,
    seed: int | None = None,
    options: Mapping[str, str | int | float] | None = None,
    max_attempts: int | None = None,
) -> RecordPlan:
    """Return the plan of an augmentation, which is a recording of the policy ``augment`` with its options.

    Raises:
        SimfoundryError: If there are no demonstrations, if an option is invalid, or if the initial states are those of
            the demonstrations.
    """
    from simfoundry.augment.options import AugmentOptions

    if "?" in str(folder):
        raise SimfoundryError(f"the name of the folder {folder} contains `?`, which separates options; rename it")
    found = demonstrations(folder)
    if folder.resolve() == out.resolve():
        raise SimfoundryError(f"{out} contains the demonstrations to augment; choose another output folder")
    known = {int(head["seed"]) for head in found.heads}
    own = list(dict.fromkeys((folder / str(about["document"])).resolve() for about in found.tasks))
    chosen = list(documents) or [_relative(path) for path in own]
    seed = max(known, default=0) + UNSEEN if seed is None else seed
    if seed in known and {path.resolve() for path in chosen} & set(own):
        raise SimfoundryError(
            f"with seed {seed}, the initial states would be those of the demonstrations in {folder}; choose another one"
        )
    policy = f"augment:{folder}?{AugmentOptions.parse(options or {}).query}"
    return record_plan(chosen, policy, out, count, seed, max_attempts, source=folder)


def generate(
    source: Path, out: Path, count: int, use: int, jobs: int | None, machines: Machines, progress: Progress
) -> dict[str, Any]:
    """Augment the first ``use`` demonstrations in a folder, and return the counts and success rates as plain data.

    Raises:
        SimfoundryError: If there are too few successful attempts.
    """
    from simfoundry.augment.report import augment_report

    plan = augment_plan(source, (), out, count, options={"use": use})
    summary = run_record(plan, jobs, machines, progress)
    if summary.kept < count:
        raise SimfoundryError(shortage(plan, summary))
    counts = {"demonstrations": summary.kept, "attempts": summary.attempts}
    return {**counts, **augment_report(out).to_json()}


def _relative(path: Path) -> Path:
    """Return a path relative to the current folder if it is inside."""
    here = Path.cwd().resolve()
    return path.relative_to(here) if path.is_relative_to(here) else path
