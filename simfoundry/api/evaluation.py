"""Policy rollouts on tasks, and their combined results."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.api.ranges import check_ranges
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import LOCAL, Machines, worker_count

if TYPE_CHECKING:
    from simfoundry.evaluate.run import EvaluationPlan, RolloutOutcome

# The smallest and the largest value of each numeric option, in Python and on the command line.


@dataclass(frozen=True)
class Evaluation:
    """The results of an evaluation.

    Attributes:
        folder: Output folder with the rollout records, ``results.json`` and a report.
        records: One record per rollout.
        results: Content of ``results.json``.
        missing: Number of rollouts without a result.
        troubles: Messages that describe policy failures.
    """

    folder: Path
    records: tuple[dict[str, Any], ...]
    results: dict[str, Any]
    missing: int
    troubles: tuple[str, ...]

    @property
    def success(self) -> dict[tuple[str, str], float]:
        """The success rate for each (task, policy) pair. Pairs without results are omitted."""
        from simfoundry.evaluate.statistics.results import cells

        return {(cell.title, cell.policy): cell.success.share for cell in cells(self.records) if cell.success.of}

    @property
    def report(self) -> Path:
        """The path of the HTML report, which shows initial states, failures and videos."""
        return self.folder / "report.html"


def evaluate(
    tasks: str | Path | Sequence[str | Path],
    policies: str | Sequence[str],
    *,
    out: str | Path = "build/eval",
    rollouts: int = 25,
    seed: int = 0,
    engine: str = "mujoco",
    video: bool = False,
    jobs: int | None = None,
    on: str = "local",
) -> Evaluation:
    """Evaluate policies on tasks, all from the same initial states.

    Example: ``evaluate("stack.task.yaml", "expert", rollouts=3)``.

    Rollouts that are already in ``out`` are not repeated. To resume an interrupted run, make the same call again.

    Args:
        tasks: One or more task documents.
        policies: One or more policies, named as on the command line: ``random``, ``expert``, ``python:module:Class``,
            or ``openpi:host:port?...``.
        out: Output folder.
        rollouts: Number of rollouts for each task and policy.
        seed: Seed for the initial states.
        engine: Simulator in which to run the rollouts.
        video: Whether to record videos.
        jobs: Number of parallel processes; by default, one on this machine, and one per CPU of a Ray cluster.
        on: Where to run: ``local``, ``ray`` or ``ray:ADDRESS``.

    Raises:
        SpecError: If a task document has errors.
        SimfoundryError: If no task or policy is specified, a policy is invalid, or an option is out of range.
    """
    from simfoundry.evaluate.entries import TaskEntry, contenders
    from simfoundry.evaluate.run import EvaluationPlan, prepare

    files = [tasks] if isinstance(tasks, str | Path) else tasks
    entries = tuple(TaskEntry(Path(file)) for file in files)
    named = contenders((policies,) if isinstance(policies, str) else tuple(policies))
    if not entries or not named:
        raise SimfoundryError(f"no {'policy' if entries else 'task'} is specified; pass at least one")
    check_ranges([("rollouts", rollouts), ("seed", seed), ("jobs", jobs)])
    plan = EvaluationPlan(Path(out), entries, tuple(named), rollouts, seed, (engine,), video=video)
    machines = Machines.parse(on)
    prepare(plan)
    return run_plan(plan, jobs, machines)


# `simfoundry.evaluate` is also a subpackage. Its modules are attributes of the function as well, because Python looks
# them up there for `import simfoundry.evaluate.gym as gym`.
evaluate.__dict__ = vars(sys.modules["simfoundry.evaluate"])


def run_plan(
    plan: EvaluationPlan,
    jobs: int | None,
    machines: Machines = LOCAL,
    progress: Callable[[str, float], None] = lambda name, share: None,
) -> Evaluation:
    """Execute a plan.

    ``progress`` is called with the current score of a policy and the fraction of rollouts that are complete.
    """
    from simfoundry.evaluate.run import pending, run
    from simfoundry.evaluate.statistics.records import read_all
    from simfoundry.evaluate.statistics.results import results
    from simfoundry.reports.evaluation import page
    from simfoundry.runtime.files import write_atomically

    troubles: list[str] = []
    won: dict[str, list[int]] = {}

    def count(outcome: RolloutOutcome, done: int, of: int) -> None:
        label = outcome.job.contender.label
        label += f" in {outcome.job.engine}" if len(plan.engines) > 1 else ""
        tally = won.setdefault(label, [0, 0])
        if outcome.answered:
            tally[0] += outcome.record["success"]
            tally[1] += 1
        if outcome.trouble:
            verdict = "counts as failed" if outcome.answered else "is missing"
            troubles.append(f"{label}, rollout {outcome.job.index} {verdict}: {outcome.trouble}")
        progress(f"{label} {tally[0]}/{tally[1]}", done / of)

    run(plan, count, worker_count(machines, jobs), machines)
    records = tuple(record for _, record in read_all(plan.folder))
    found = Evaluation(plan.folder, records, results(records), len(pending(plan)), tuple(troubles))
    text = json.dumps(found.results, indent=1, ensure_ascii=False) + "\n"
    write_atomically(plan.folder / "results.json", text.encode())
    write_atomically(found.report, page(records).encode())
    return found
