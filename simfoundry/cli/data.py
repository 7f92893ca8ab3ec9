"""Commands for demonstrations: ``record``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.api.ranges import RANGES
from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FOLDER, jobs_option, on_option, option, resumable, task_documents
from simfoundry.runtime.executors import Machines


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
    from simfoundry.api.demonstrations import record_plan, run_record, shortage

    plan = record_plan(task_documents(tasks), policy, out, count, seed, max_attempts)
    with output.progress_bar(as_json) as progress, resumable(out):
        summary = run_record(plan, jobs, machines, progress)
    is_short = summary.kept < count
    if as_json:
        listed = {"failures": dict(summary.failures), "reasons": dict(summary.reasons)}
        lost = {"not_reproduced": list(summary.not_reproduced)}
        counts = {"folder": str(out), "demonstrations": summary.kept, "asked": count, "attempts": summary.attempts}
        output.print_json({**counts, **listed, **lost})
    else:
        for index in summary.not_reproduced:
            click.echo(f"attempt {index} was not kept, because its replay was not identical", err=True)
        if is_short:
            click.echo(shortage(plan, summary), err=True)
        click.echo(f"{out}: {output.plural(summary.kept, 'demonstration')} in {summary.attempts} attempts")
    return output.FINDINGS if is_short or summary.not_reproduced else output.DONE
