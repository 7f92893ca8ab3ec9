"""``simfoundry correlate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.cli.options import ANY, NEW_FILE
from simfoundry.cli.output import CannotError, print_json, subcommand

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from simfoundry.evaluate.statistics.correlation import Interval, RateAgreement, Score


@subcommand(force=True)
@click.argument("real", type=ANY)
@click.argument("sim", nargs=-1, required=True, type=ANY)
@click.option(
    "--rollouts", type=click.IntRange(min=1), default=25, show_default=True,
    help="Number of rollouts to assume for a rate without a count.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(1, 100_000), default=2000, show_default=True,
    help="Number of samples for the intervals.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the sampling.")
@click.option("--svg", type=NEW_FILE, help="Write the scatter plot to this file.")
def command(
    real: Path,
    sim: tuple[Path, ...],
    rollouts: int,
    draws: int,
    seed: int,
    svg: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Compare simulated success rates with real ones by Pearson's r and MMRV, task by task.

    REAL and SIM are tables (CSV with task, policy and rate, or successes and rollouts) or results of `simfoundry eval`.
    Each SIM is compared with REAL over the tasks and policies that both contain. The brackets are 95 % intervals, from
    rates sampled from their posteriors and resampled policies. r is undefined if all policies succeed equally often.
    """
    from simfoundry.evaluate.statistics.correlation import (
        Draws,
        agreements,
        by_engine,
        left_out,
        read_scores,
        reservations,
    )

    if svg is not None:
        from simfoundry.runtime.files import ensure_replaceable

        ensure_replaceable(svg, [real, *sim], force)
    truth = read_scores(real)
    if len(engines := by_engine(truth)) > 1:
        raise CannotError(f"{real} has results of {' and '.join(engines)}; pass one table of real results")
    tables: dict[str, list[Score]] = {}
    for name, path in zip(_names(sim), sim, strict=True):
        each = by_engine(read_scores(path))
        tables |= {f"{name} in {engine}" if len(each) > 1 else name: table for engine, table in each.items()}
    how = Draws(count=draws, rollouts=rollouts, seed=seed)
    found = {name: agreements(truth, table, how) for name, table in tables.items()}
    missing = {name: left_out(truth, table) for name, table in tables.items()}
    said = {name: reservations([*truth, *table]) for name, table in tables.items()}
    if svg is not None:
        from simfoundry.reports.correlation import scatter
        from simfoundry.runtime.files import write_atomically

        write_atomically(svg, scatter(found).encode())
    if as_json:
        print_json({name: {**_json(one, missing[name]), "reservations": said[name]} for name, one in found.items()})
        return
    _print(found, missing, said)
    if svg is not None:
        click.echo(f"\nwrote {svg}")


def _names(sim: Sequence[Path]) -> list[str]:
    names = [path.stem if path.suffix else path.name for path in sim]
    if len(set(names)) < len(names):
        names = [str(path) for path in sim]
    if len(set(names)) < len(names):
        raise CannotError("the same table is given twice")
    return names


def _json(found: Sequence[RateAgreement], missing: list[str]) -> dict[str, Any]:
    from dataclasses import asdict

    from simfoundry.evaluate.statistics.correlation import mean_agreement

    r, violation = mean_agreement(found)
    return {"tasks": [asdict(a) for a in found], "mean": {"pearson": r, "mmrv": violation}, "not_in_both": missing}


def _print(
    found: Mapping[str, Sequence[RateAgreement]], missing: Mapping[str, list[str]], said: Mapping[str, list[str]]
) -> None:
    from rich.console import Console
    from rich.table import Table

    from simfoundry.evaluate.statistics.correlation import mean_agreement

    console = Console()
    for name, one in found.items():
        table = Table(title=name, title_justify="left", box=None, pad_edge=False)
        for title in ("task", "policies", "Pearson r", "MMRV"):
            table.add_column(title, no_wrap=True)
        for a in one:
            table.add_row(
                a.task,
                str(len(a.policies)),
                _with_interval(a.pearson, a.pearson_interval),
                _with_interval(a.mmrv, a.mmrv_interval),
            )
        r, violation = mean_agreement(one)
        table.add_row("mean", "", _with_interval(r, None), _with_interval(violation, None), style="bold")
        console.print(table)
        if missing[name]:
            console.print(f"not in both tables: {', '.join(missing[name])}", markup=False, soft_wrap=True)
        for sentence in said[name]:
            console.print(sentence, markup=False, soft_wrap=True)


def _with_interval(value: float | None, interval: Interval | None) -> str:
    figure = "undefined" if value is None else f"{value:.3f}"
    return figure if interval is None or value is None else f"{figure} ({interval[0]:.3f} to {interval[1]:.3f})"
