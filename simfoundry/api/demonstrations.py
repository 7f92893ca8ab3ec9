"""Recording and reading of demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.api.ranges import check_ranges
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import Machines, worker_count

if TYPE_CHECKING:
    from simfoundry.data.demonstrations import DemonstrationSet
    from simfoundry.data.plan import RecordPlan, RecordSummary
    from simfoundry.data.shards import Attempt

# The smallest and the largest value of each numeric option, in Python and on the command line.


def default_attempts(count: int) -> int:
    """Return the default maximum number of attempts: enough for a policy that succeeds in one attempt out of four."""
    return 4 * count + 16


def record(
    task: str | Path | Sequence[str | Path],
    policy: str = "expert",
    *,
    out: str | Path = "demos",
    count: int = 50,
    seed: int = 0,
    max_attempts: int | None = None,
    jobs: int | None = None,
    on: str = "local",
) -> DemonstrationSet:
    """Record demonstrations of a task, or of several tasks that take turns, starting from different initial states.

    Example: ``record("stack.task.yaml", count=10)``.

    Demonstrations that are already in ``out`` are kept. To resume an interrupted recording, make the same call again.

    Args:
        task: A task document, a folder that contains task documents, such as the output of ``simfoundry cousins``, or
            several of them.
        policy: The policy, named as on the command line.
        out: Output folder.
        count: Number of demonstrations.
        seed: Seed for the initial states.
        max_attempts: Maximum number of attempts; by default, four for each demonstration, and 16 more.
        jobs: Number of parallel processes; by default, one on this machine, and one per CPU of a Ray cluster.
        on: Where to run: ``local``, ``ray`` or ``ray:ADDRESS``.

    Raises:
        SpecError: If the task document has errors.
        SimfoundryError: If a policy or an option is invalid, or if there are too few successful attempts.
    """
    from simfoundry.cousins.run.review import usable_tasks
    from simfoundry.data.record import record as run

    check_ranges([("count", count), ("seed", seed), ("jobs", jobs)])
    paths = [Path(one) for one in ([task] if isinstance(task, str | Path) else task)]
    documents, _ = usable_tasks(paths)
    plan = record_plan(documents, policy, Path(out), count, seed, max_attempts)
    machines = Machines.parse(on)
    summary = run(plan, workers=worker_count(machines, jobs), machines=machines)
    if summary.kept < count:
        raise SimfoundryError(shortage(plan, summary))
    return demonstrations(out)


def record_plan(
    documents: Sequence[Path], policy: str, out: Path, count: int, seed: int = 0, max_attempts: int | None = None,
    source: Path | None = None,
) -> RecordPlan:  # fmt: skip
    """Return the plan of a recording."""
    from simfoundry.data.plan import RecordPlan
    from simfoundry.evaluate.entries import contenders

    (contender,) = contenders((policy,))
    return RecordPlan(out, tuple(documents), contender, count, max_attempts or default_attempts(count), seed, source)


def shortage(plan: RecordPlan, summary: RecordSummary) -> str:
    """Explain in one sentence why there are fewer demonstrations than requested."""
    ends = "; ".join(f"{count} ended with `{end}` ({summary.reasons[end]})" for end, count in summary.failures.items())
    return (
        f"{summary.kept} of {plan.count} demonstrations were recorded in {summary.attempts} attempts of "
        f"`{plan.contender.label}`: {ends}; use a better policy, or increase `--max-attempts`"
    )


def demonstrations(folder: str | Path) -> DemonstrationSet:
    """Open recorded demonstrations.

    Example: ``for demonstration in demonstrations("demos"): print(demonstration.actions.shape)``.

    Raises:
        SimfoundryError: If the folder does not contain demonstrations.
    """
    from simfoundry.data.demonstrations import read_demonstrations

    return read_demonstrations(Path(folder))


# Callback that receives a text with the current counts, and the fraction of demonstrations that are complete.
Progress = Callable[[str, float], None]


def run_record(plan: RecordPlan, jobs: int | None, machines: Machines, progress: Progress) -> RecordSummary:
    """Execute a plan."""
    from simfoundry.data.record import record as run

    def seen(_: Attempt, kept: int, of: int) -> None:
        progress(f"{kept} demonstrations, {of} attempts", kept / plan.count)

    return run(plan, seen, worker_count(machines, jobs), machines)
