"""Commands for demonstrations: ``record`` and ``augment``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.api.ranges import RANGES
from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FOLDER, jobs_option, on_option, option, resumable, task_documents
from simfoundry.runtime.executors import Machines

if TYPE_CHECKING:
    from simfoundry.data.plan import RecordPlan, RecordSummary


@output.subcommand("record")
@click.argument("tasks", nargs=-1, required=True, type=ANY)
@option("-p", "--policy", metavar="POLICY", default="expert",
        help="Policy to record, as in `simfoundry eval`.")  # fmt: skip
@option("-n", "--count", type=click.IntRange(*RANGES["count"]), default=50, help="Number of demonstrations.")
@option("-o", "--out", type=NEW_FOLDER, default=Path("demos"))
@option("--seed", type=click.IntRange(*RANGES["seed"]), default=0, help="Seed for the initial states.")
@click.option("--max-attempts", type=click.IntRange(min=1),
              help="Maximum number of attempts. Default: four for each demonstration, and 16 more.")  # fmt: skip
@jobs_option(1)
@on_option
def record_command(
    tasks: tuple[Path, ...], policy: str, count: int, out: Path, seed: int, max_attempts: int | None,
    jobs: int | None, machines: Machines, as_json: bool,
) -> int:  # fmt: skip
    """Record demonstrations of tasks.

    TASKS are task documents, or folders that contain task documents, such as the output of `simfoundry cousins`. They
    take turns, and each attempt in a task starts from a different initial state. Attempts that succeed are replayed in
    another process, and kept if the trajectory is identical to the last bit. OUT contains shards of 25 demonstrations
    with their actions and states; images are rendered later, on replay. The demonstrations do not depend on --jobs and
    --on.

    Existing demonstrations are kept, so you can repeat the command to resume an interrupted run, or to record more with
    a larger COUNT.

    The exit code is 1 if there are too few demonstrations after the maximum number of attempts, or if a replay was not
    identical.
    """
    from simfoundry.api.demonstrations import record_plan, run_record

    plan = record_plan(task_documents(tasks), policy, out, count, seed, max_attempts)
    with output.progress_bar(as_json) as progress, resumable(out):
        summary = run_record(plan, jobs, machines, progress)
    return _print_summary(plan, summary, as_json)


def _print_summary(
    plan: RecordPlan, summary: RecordSummary, as_json: bool, more: Mapping[str, Any] | None = None,
    lines: Sequence[str] = (),
) -> int:  # fmt: skip
    """Print how many demonstrations there are, with more facts as JSON or as lines, and return the exit code."""
    from simfoundry.api.demonstrations import shortage

    count, out = plan.count, plan.folder
    is_short = summary.kept < count
    if as_json:
        listed = {"failures": dict(summary.failures), "reasons": dict(summary.reasons)}
        lost = {"not_reproduced": list(summary.not_reproduced)}
        counts = {"folder": str(out), "demonstrations": summary.kept, "asked": count, "attempts": summary.attempts}
        output.print_json({**counts, **listed, **lost, **(more or {})})
    else:
        for line in lines:
            click.echo(line)
        for index in summary.not_reproduced:
            click.echo(f"attempt {index} was not kept, because its replay was not identical", err=True)
        if is_short:
            click.echo(shortage(plan, summary), err=True)
        click.echo(f"{out}: {output.plural(summary.kept, 'demonstration')} in {summary.attempts} attempts")
    return output.FINDINGS if is_short or summary.not_reproduced else output.DONE


@output.subcommand("augment")
@click.argument("demos", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("tasks", nargs=-1, type=ANY)
@option("-n", "--count", type=click.IntRange(*RANGES["count"]), default=200, help="Number of demonstrations.")
@option("-o", "--out", type=NEW_FOLDER, default=Path("more"))
@click.option("--seed", type=click.IntRange(*RANGES["seed"]),
              help="Seed for the initial states. Default: that of the demonstrations, plus 1000.")  # fmt: skip
@option("--select", type=click.Choice(["object", "hand", "random"]), default="object",
        help="Order in which demonstrations are tried as the source of a segment: the one whose object stood closest "
             "first, the one whose segment starts closest to the hand first, or at random.")  # fmt: skip
@option("--bridge", type=click.Choice(["planned", "warped"]), default="planned",
        help="Motion between segments: planned around obstacles, or bent from the recorded one.")  # fmt: skip
@option("--noise", type=click.FloatRange(0, 0.1), default=0.0,
        help="Standard deviation of the noise that is added to joint targets [rad or m].")  # fmt: skip
@option("--use", type=click.IntRange(min=0), default=0,
        help="Number of demonstrations to use, the first ones, or 0 for all.")  # fmt: skip
@click.option("--max-attempts", type=click.IntRange(min=1),
              help="Maximum number of attempts. Default: four for each demonstration, and 16 more.")  # fmt: skip
@jobs_option(1)
@on_option
def augment_command(
    demos: Path, tasks: tuple[Path, ...], count: int, out: Path, seed: int | None, select: str, bridge: str,
    noise: float, use: int, max_attempts: int | None, jobs: int | None, machines: Machines, as_json: bool,
) -> int:  # fmt: skip
    """Generate demonstrations from recorded ones, in other initial states, scenes and tasks.

    DEMOS is a folder that `simfoundry record` wrote. TASKS are task documents, or folders that contain them, such as
    the output of `simfoundry cousins`; by default, they are the tasks of DEMOS. Each demonstration is divided into
    segments by the sub-tasks of its task. In a new initial state, segments are moved along with the objects that they
    refer to, and carried out one after another. Attempts that succeed are kept as in `simfoundry record`: replayed in
    another process, with the same bytes for any --jobs and --on.

    The success rates for each task, sub-goal and demonstration are printed at the end. Repeat the command to resume an
    interrupted run, or to generate more with a larger COUNT.

    The exit code is 1 if there are too few demonstrations after the maximum number of attempts, or if a replay was not
    identical.
    """
    from simfoundry.api.augmentation import augment_plan
    from simfoundry.api.demonstrations import run_record

    documents = task_documents(tasks) if tasks else []
    options: dict[str, str | int | float] = {"select": select, "bridge": bridge, "noise": noise, "use": use}
    plan = augment_plan(demos, documents, out, count, seed, options, max_attempts)
    with output.progress_bar(as_json) as progress, resumable(out):
        summary = run_record(plan, jobs, machines, progress)
    from simfoundry.augment.report import augment_report

    report = augment_report(out)
    return _print_summary(plan, summary, as_json, {"rates": report.to_json()}, report.lines())
