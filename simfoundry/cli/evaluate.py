"""Commands that evaluate policies: ``eval``, ``correlate``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.api.ranges import RANGES
from simfoundry.cli import output
from simfoundry.cli.options import (
    ANY,
    NEW_FILE,
    NEW_FOLDER,
    WorldName,
    jobs_option,
    on_option,
    option,
    resumable,
    task_documents,
)
from simfoundry.cli.options import shard as shard_of
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import Machines

if TYPE_CHECKING:
    from rich.console import Console

    from simfoundry.api.evaluation import Evaluation
    from simfoundry.evaluate.entries import TaskEntry
    from simfoundry.evaluate.run import EvaluationPlan
    from simfoundry.evaluate.statistics.correlation import Interval, RateAgreement, Score
    from simfoundry.evaluate.statistics.sensitivity import SensitivityTable

# Maximum number of problems, and of comparisons, printed as sentences, so that they fit on a screen with the table.
SENTENCES = 10


@output.subcommand("eval")
@click.argument("tasks", nargs=-1, required=True, type=ANY)
@click.option("-p", "--policy", "policies", multiple=True, required=True, metavar="[NAME=]POLICY",
              help="Policy to evaluate: random, expert, replay:FILE, baseline:FOLDER, python:MODULE:CLASS, a "
                   ".policy.yaml file, or a server such as openpi:localhost:8000?action_space=joint_position. May be "
                   "repeated.")  # fmt: skip
@option("-o", "--out", type=NEW_FOLDER, default=Path("build/eval"))
@option("-n", "--rollouts", type=click.IntRange(*RANGES["rollouts"]), default=25,
        help="Number of rollouts for each task.")  # fmt: skip
@option("--seed", type=click.IntRange(*RANGES["seed"]), default=0, help="Seed for the initial states.")
@option("--world", "worlds", multiple=True, type=WorldName(), default=["mujoco"],
        help="Run in this engine; repeat the option to compare two engines.")  # fmt: skip
@click.option("--from", "onward", metavar="STEP", help="Start at this step and require the goal of the task.")
@click.option("--step", "alone", metavar="STEP", help="Start at this step and require only the goal of this step.")
@click.option("--subtasks", is_flag=True, help="Also run each step that defines its own initial state.")
@click.option("--video/--no-video", default=None,
              help="Record a video of each rollout. Default: only if rendering is possible.")  # fmt: skip
@click.option("--camera", "cameras", multiple=True,
              help="Record videos from this camera; may be repeated. Default: the scene's first.")  # fmt: skip
@jobs_option(1)
@on_option
@click.option("--shard", callback=shard_of, default="1/1", metavar="I/N",
              help="Run every N-th rollout, starting with the I-th.")  # fmt: skip
@click.option("--require", type=click.FloatRange(0, 1), help="Exit with code 1 if a success rate is below this value.")
def eval_command(
    tasks: tuple[Path, ...], policies: tuple[str, ...], out: Path, rollouts: int, seed: int, worlds: tuple[str, ...],
    onward: str | None, alone: str | None, subtasks: bool, video: bool | None, cameras: tuple[str, ...],
    jobs: int | None, machines: Machines, shard: tuple[int, int], require: float | None, as_json: bool,
) -> int:  # fmt: skip
    """Evaluate policies on tasks.

    TASKS are task documents, or folders that contain task documents. All policies start from the same initial states;
    each object starts in a different cell of its grid in each rollout.

    OUT contains one file per rollout. OUT/results.json contains the results, which `simfoundry correlate` can read, and
    OUT/report.html shows the initial states and the videos. Finished rollouts are not repeated, so you can repeat the
    command to resume an interrupted run. Shards that write to the same folder are combined there. With `--world mujoco
    --world pybullet`, both engines use the same initial states, and the report lists the rollouts in which they
    disagree.

    If a policy responds with an error or an invalid action, the rollout fails. If a policy does not respond, the
    rollout is missing: it is not included in any success rate, and the same command tries it again.

    The exit code is 1 if rollouts are missing or if a success rate is below --require.
    """
    from simfoundry.api.evaluation import run_plan
    from simfoundry.evaluate.entries import contenders
    from simfoundry.evaluate.run import EvaluationPlan, prepare

    if sum((onward is not None, alone is not None, subtasks)) > 1:
        raise SimfoundryError("--from, --step and --subtasks are mutually exclusive")
    plan = EvaluationPlan(
        folder=out,
        entries=tuple(_entries(tasks, onward, alone, subtasks)),
        contenders=tuple(contenders(policies)),
        rollouts=rollouts,
        seed=seed,
        engines=tuple(dict.fromkeys(worlds)),
        shard=(shard[0] - 1, shard[1]),
        cameras=cameras or None,
        video=can_film(worlds) if video is None else video,
    )
    with output.progress_bar(as_json) as progress, resumable(out):
        prepare(plan, lambda name, done, of: progress(f"initial states of {name}", done / of))
        evaluation = run_plan(plan, jobs, machines, progress)
    return _print_report(plan, evaluation, require, as_json)


def can_film(worlds: Sequence[str]) -> bool:
    """Return True if videos can be rendered. Otherwise, print the reason. PyBullet does not need a GL driver."""
    from simfoundry.render.gl import Engine, choose_engine

    if "mujoco" not in worlds or choose_engine() is not Engine.RAYCAST:
        return True
    message = "no videos: MuJoCo could not find a GL driver; run `simfoundry doctor` to see how to install one"
    click.echo(message, err=True)
    return False


def _entries(tasks: Sequence[Path], onward: str | None, alone: str | None, subtasks: bool) -> Iterator[TaskEntry]:
    from simfoundry.evaluate.entries import TaskEntry, TaskPart

    for path in task_documents(tasks):
        if onward is not None or alone is not None:
            yield TaskEntry(path, TaskPart.ONWARD if onward is not None else TaskPart.ALONE, onward or alone or "")
            continue
        yield TaskEntry(path)
        if subtasks:
            steps = TaskEntry(path).load().subtasks.values()
            yield from (TaskEntry(path, TaskPart.ALONE, step.name) for step in steps if step.starts_itself)


def _print_report(plan: EvaluationPlan, evaluation: Evaluation, require: float | None, as_json: bool) -> int:
    from simfoundry.evaluate.statistics.results import cells

    missing, troubles = evaluation.missing, evaluation.troubles
    low = [c for c in cells(evaluation.records) if require is not None and c.success.of and c.success.share < require]
    if as_json:
        extra = {"missing": missing, "troubles": list(troubles), "report": str(evaluation.report)}
        output.print_json({**evaluation.results, **extra})
    else:
        _print_rates(evaluation.records)
        for trouble in troubles[:SENTENCES]:
            click.echo(trouble, err=True)
        if (more := len(troubles) - SENTENCES) > 0:
            click.echo(f"and {more} more; {plan.folder / 'results.json'} contains all of them", err=True)
        if missing:
            click.echo(f"{missing} rollouts are missing; repeat the command to run them", err=True)
        for cell in low:
            where = f"{cell.policy} in {cell.engine}" if len(plan.engines) > 1 else cell.policy
            click.echo(f"{cell.title} with {where}: {cell.success.share:.0%} is below {require:.0%}", err=True)
        click.echo(f"{evaluation.report}")
    return output.FINDINGS if missing or low else output.DONE


def _print_rates(records: Sequence[Mapping[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Column, Table

    from simfoundry.evaluate.statistics.results import MANY, by_title, cells

    found = cells(records)
    policies = list(dict.fromkeys(cell.policy for cell in found))
    table = Table(*(Column(title, no_wrap=True) for title in ("task", *policies)), box=None, pad_edge=False)
    for name, here in by_title(found).items():
        table.add_row(name, *(here[p].summary if p in here else "" for p in policies))
        steps = dict.fromkeys(s for cell in here.values() for s in cell.subtasks)
        for step in steps if len(by_title(found)) <= MANY else ():
            each = (here[p].subtasks.get(step) if p in here else None for p in policies)
            rates = (f"{rate.done}/{rate.of}" if rate is not None else "" for rate in each)
            table.add_row(f"  {step}", *rates, style="dim")
    console = Console()
    console.print(table)
    _print_pools(console, records)


def _print_pools(console: Console, records: Sequence[Mapping[str, Any]]) -> None:
    """Print the success rates over all tasks, and the significance of the differences between policies."""
    from rich.table import Column, Table

    from simfoundry.evaluate.statistics.comparisons import compare_engines, compare_policies
    from simfoundry.evaluate.statistics.results import by_title, pools

    found = pools(records)
    if found:
        policies = list(dict.fromkeys(pool.policy for pool in found))
        table = Table(*(Column(title, overflow="fold") for title in ("together", *policies)), box=None, pad_edge=False)
        for name, here in by_title(found).items():
            tasks = max(len(pool.counts) for pool in here.values())
            table.add_row(f"{name} ({tasks})", *(str(here[p].rate) if p in here else "" for p in policies))
            if not all(pool.is_balanced for pool in here.values()):
                alike = (here[p].stratified_text if p in here else "" for p in policies)
                table.add_row("  tasks weighted equally", *alike, style="dim")
        console.print()
        console.print(table)
    sentences = [pair.sentence for pair in compare_policies(records)]
    for sentence in sentences[:SENTENCES]:
        console.print(sentence, markup=False, soft_wrap=True)
    if len(sentences) > SENTENCES:
        console.print(f"{len(sentences) - SENTENCES} more pairs of policies are in the report")
    for comparison in compare_engines(records):
        if comparison.disagrees:
            console.print(comparison.sentence, markup=False, soft_wrap=True)


@output.subcommand(force=True)
@click.argument("real", type=ANY)
@click.argument("sim", nargs=-1, required=True, type=ANY)
@option("--rollouts", type=click.IntRange(min=1), default=25,
        help="Number of rollouts to assume for a rate without a count.")  # fmt: skip
@option("--draws", type=click.IntRange(1, 100_000), default=2000,
        help="Number of samples used to compute the intervals.")  # fmt: skip
@option("--seed", type=click.IntRange(min=0), default=0, help="Seed for sampling.")
@click.option("--svg", type=NEW_FILE, help="Write the scatter plot to this file.")
@click.option("--by", type=click.Choice(["vary"]),
              help="Instead, correlate success rates with the values that a recipe varies.")  # fmt: skip
@click.option("--page", type=NEW_FILE, help="With --by: write the tables as an HTML page to this file.")
def correlate_command(
    real: Path, sim: tuple[Path, ...], rollouts: int, draws: int, seed: int, svg: Path | None, by: str | None,
    page: Path | None, force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Compare simulated success rates with real ones by Pearson's r and MMRV, separately for each task.

    REAL and SIM are results from `simfoundry eval`, or CSV tables with task, policy, and either a rate or the number of
    successes and rollouts. Each SIM is compared with REAL on the tasks and policies that both contain. The 95%
    intervals in parentheses are computed by sampling the rates from their posteriors and resampling the policies. r is
    undefined if all policies have the same success rate.

    With `--by vary`, REAL is the output folder of `simfoundry cousins`, and SIM are results of `simfoundry eval` on
    that folder. For each value that the recipe varies, the table contains Spearman's rank correlation with the success
    rate of a cousin, its 95% interval, and a p-value that is corrected for the number of values.
    """
    from simfoundry.evaluate.statistics import correlation

    if by is not None:
        if svg is not None:
            raise SimfoundryError("--svg draws success rates in simulation and reality; use --page with --by")
        _correlate_values(real, sim, draws, seed, page, force, as_json)
        return
    if page is not None:
        raise SimfoundryError("--page requires --by vary; use --svg for a scatter plot")
    output.protect_output(svg, [real, *sim], force)
    truth = correlation.read_scores(real)
    if len(engines := correlation.by_engine(truth)) > 1:
        raise SimfoundryError(f"{real} contains results from {' and '.join(engines)}; pass only real results")
    tables: dict[str, list[Score]] = {}
    for name, path in zip(_table_names(sim), sim, strict=True):
        each = correlation.by_engine(correlation.read_scores(path))
        tables |= {f"{name} in {engine}" if len(each) > 1 else name: table for engine, table in each.items()}
    how = correlation.Draws(count=draws, rollouts=rollouts, seed=seed)
    found = {name: correlation.agreements(truth, table, how) for name, table in tables.items()}
    missing = {name: correlation.left_out(truth, table) for name, table in tables.items()}
    said = {name: correlation.reservations([*truth, *table]) for name, table in tables.items()}
    if svg is not None:
        from simfoundry.reports.correlation import scatter

        output.write_text(svg, scatter(found))
    if as_json:
        output.print_json({name: _agreement_json(one, missing[name], said[name]) for name, one in found.items()})
        return
    _print_agreements(found, missing, said)
    if svg is not None:
        click.echo(f"\nwrote {svg}")


def _correlate_values(
    cousins: Path, results: Sequence[Path], draws: int, seed: int, page: Path | None, force: bool, as_json: bool
) -> None:
    """Print how success rates depend on the values of cousins."""
    from simfoundry.evaluate.statistics.sensitivity import read_rollouts, read_varied, sensitivities

    output.protect_output(page, [cousins, *results], force)
    varied = read_varied(cousins)
    tables = sensitivities(varied, [r for path in results for r in read_rollouts(path)], draws, seed)
    if page is not None:
        from simfoundry.reports.sensitivity import sensitivity_page

        output.write_text(page, sensitivity_page(varied.recipe, tables))
    if as_json:
        output.print_json({"recipe": varied.recipe, "tables": [table.to_json() for table in tables]})
        return
    _print_sensitivities(tables)
    if page is not None:
        click.echo(f"\nwrote {page}")


def _print_sensitivities(tables: Sequence[SensitivityTable]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    for one in tables:
        shown = Table(title=one.title, title_justify="left", box=None, pad_edge=False)
        for title in ("value", "from", "to", "correlation", "p"):
            shown.add_column(title, no_wrap=True)
        for n in one.numbers:
            p = "" if n.p is None else f"{n.p:.3f}"
            shown.add_row(n.name, f"{n.low:.4g}", f"{n.high:.4g}", _with_interval(n.correlation, n.interval), p)
        if one.numbers:
            console.print(shown)
        chosen = Table("value", "choice", "cousins", "success", box=None, pad_edge=False)
        for c in one.choices:
            chosen.add_row(c.name, escape(c.value), str(c.cousins), str(c.rate))
        if one.choices:
            console.print(chosen)


def _table_names(sim: Sequence[Path]) -> list[str]:
    short = [path.stem if path.suffix else path.name for path in sim]
    names = short if len(set(short)) == len(sim) else [str(path) for path in sim]
    if len(set(names)) < len(sim):
        raise SimfoundryError("the same table was passed twice")
    return names


def _agreement_json(found: Sequence[RateAgreement], missing: list[str], said: list[str]) -> dict[str, Any]:
    from dataclasses import asdict

    from simfoundry.evaluate.statistics.correlation import mean_agreement

    r, violation = mean_agreement(found)
    mean = {"pearson": r, "mmrv": violation}
    return {"tasks": [asdict(a) for a in found], "mean": mean, "not_in_both": missing, "reservations": said}


def _print_agreements(
    found: Mapping[str, Sequence[RateAgreement]], missing: Mapping[str, list[str]], said: Mapping[str, list[str]]
) -> None:
    from rich.console import Console
    from rich.table import Column, Table

    from simfoundry.evaluate.statistics.correlation import mean_agreement

    console = Console()
    for name, one in found.items():
        columns = (Column(title, no_wrap=True) for title in ("task", "policies", "Pearson r", "MMRV"))
        table = Table(*columns, title=name, title_justify="left", box=None, pad_edge=False)
        for a in one:
            r, violation = _with_interval(a.pearson, a.pearson_interval), _with_interval(a.mmrv, a.mmrv_interval)
            table.add_row(a.task, str(len(a.policies)), r, violation)
        table.add_row("mean", "", *(_with_interval(mean, None) for mean in mean_agreement(one)), style="bold")
        console.print(table)
        if missing[name]:
            console.print(f"not in both tables: {', '.join(missing[name])}", markup=False, soft_wrap=True)
        for sentence in said[name]:
            console.print(sentence, markup=False, soft_wrap=True)


def _with_interval(value: float | None, interval: Interval | None) -> str:
    figure = "undefined" if value is None else f"{value:.3f}"
    return figure if interval is None or value is None else f"{figure} ({interval[0]:.3f} to {interval[1]:.3f})"
