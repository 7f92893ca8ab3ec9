"""The evaluation report, a page with conditions, success rates, initial states, failures, and links to videos."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from simfoundry.evaluate.statistics.comparisons import compare_engines, compare_policies
from simfoundry.evaluate.statistics.metrics import Rate
from simfoundry.evaluate.statistics.records import is_result
from simfoundry.evaluate.statistics.results import (
    MANY,
    RatePool,
    ScoreRow,
    by_title,
    cell_key,
    cells,
    pools,
)
from simfoundry.reports.render import render

Record = Mapping[str, Any]

# Colors of rollouts that succeeded, failed, or have no result; they are readable in light and dark mode.
GOOD, BAD, UNKNOWN = "#2a8a55", "#c3453a", "#9aa4af"


@dataclass(frozen=True)
class RateCell:
    """A table cell that contains either a rate with its interval or a text. ``trouble`` is shown below it."""

    rate: Rate | None = None
    text: str = "–"
    trouble: str = ""


@dataclass(frozen=True)
class RateRow:
    """A table row for one task, or for one step of a task.

    Attributes:
        head: The heading of the row.
        each: The cells of the row, with one cell for each policy.
        count: The number of tasks that the row combines. It is not shown if it is 0.
        step: True if the row describes a step.
    """

    head: str
    each: Sequence[RateCell]
    count: int = 0
    step: bool = False


def page(records: Sequence[Record], title: str = "Evaluation") -> str:
    """Render the complete page."""
    by_cell: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        by_cell.setdefault(cell_key(record), []).append(record)
    named, pooled = by_title(cells(records)), pools(records)
    return render(
        "evaluation.html.j2",
        title=title,
        sources="'self'",
        facts=_conditions(records),
        pools={"policies": _policies(p.policy for p in pooled), "rows": list(_pool_rows(pooled))} if pooled else None,
        pairs=compare_policies(records),
        policies=_policies(policy for here in named.values() for policy in here),
        tasks=list(_task_rows(named)),
        engines=sorted(compare_engines(records), key=lambda one: not one.disagrees),
        each=[(name, [(cell, by_cell[cell.key]) for cell in here.values()]) for name, here in named.items()],
        many=len(named) > MANY,
        grids_of=_grids,
        explain=_explanation,
    )


def _policies(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


def _conditions(records: Sequence[Record]) -> dict[str, str]:
    """Return the conditions of the evaluation: versions, engines, robots, seeds, and counts."""
    robots = sorted({f"{name}: {kind}" for r in records for name, kind in r["robots"].items()})
    recipes = sorted({r["cousin"]["recipe"] for r in records if r.get("cousin")})
    return {
        "SimFoundry": _listed(r["version"] for r in records),
        "engine": _listed(f"{r['engine']} {r['engine_version']}" for r in records),
        "robot": ", ".join(robots),
        "seed": _listed(str(r["seed"]) for r in records),
        "tasks": str(len({(r["task"], r["part"], r["step"]) for r in records})),
        "policies": _listed(r["policy"] for r in records),
        "rollouts": str(sum(map(is_result, records))),
        "control": _listed(f"{r['control_hz']:g} Hz" for r in records),
        "noise and latency": _listed(_disturbances(r) for r in records if r.get("disturbances")),
        "cousins of": ", ".join(recipes),
    }


def _disturbances(record: Record) -> str:
    """Return the disturbances of a task, such as `action.latency 0.03`."""
    sections = record["disturbances"].items()
    return ", ".join(f"{section}.{key} {value:g}" for section, entries in sections for key, value in entries.items())


def _listed(words: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(words))


def _task_rows(named: Mapping[str, Mapping[str, ScoreRow]]) -> Iterator[RateRow]:
    policies = _policies(policy for here in named.values() for policy in here)
    for name, here in named.items():
        found = {p: RateCell(c.success if c.success.of else None, "no result", c.exceptions) for p, c in here.items()}
        yield RateRow(name, [found.get(policy, RateCell()) for policy in policies])
        steps = dict.fromkeys(s for cell in here.values() for s in cell.subtasks) if len(named) <= MANY else ()
        yield from _step_rows(steps, here, policies)


def _pool_rows(found: Sequence[RatePool]) -> Iterator[RateRow]:
    """Yield the table rows for all tasks combined and for each of their steps."""
    policies = _policies(pool.policy for pool in found)
    for name, here in by_title(found).items():
        tasks = max(len(pool.counts) for pool in here.values())
        yield RateRow(name, [RateCell(here[p].rate) if p in here else RateCell() for p in policies], tasks)
        if not all(pool.is_balanced for pool in here.values()):
            alike = [RateCell(None, here[p].stratified_text) if p in here else RateCell() for p in policies]
            yield RateRow("tasks weighted equally", alike, step=True)
        yield from _step_rows(dict.fromkeys(s for pool in here.values() for s in pool.subtasks), here, policies)


def _step_rows(
    steps: Iterable[str], here: Mapping[str, ScoreRow] | Mapping[str, RatePool], policies: Sequence[str]
) -> Iterator[RateRow]:
    for step in steps:
        each = [RateCell(here[p].subtasks.get(step)) if p in here else RateCell() for p in policies]
        yield RateRow(step, each, step=True)


def _grids(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return a grid for each object with a randomized initial position."""
    return [_grid(name, records) for name in dict.fromkeys(name for record in records for name in record["cells"])]


def _grid(name: str, records: Sequence[Record]) -> dict[str, Any]:
    """Return the grid of an object's initial positions.

    The x axis points up and the y axis points to the left, as seen from the robot.
    """
    here = [record for record in records if name in record["cells"]]
    region = here[0]["regions"][name]
    cells_ = [
        {
            "index": record["index"],
            "row": record["cells"][name][0],
            "column": record["cells"][name][1],
            "why": _explanation(record),
            "color": (GOOD if record["success"] else BAD) if is_result(record) else UNKNOWN,
        }
        for record in here
    ]
    rows, columns = (max(record["grid"][k] for record in here) for k in (0, 1))
    return {"name": name, "rows": rows, "columns": columns, "x": region["x"], "y": region["y"], "cells": cells_}


def _explanation(record: Record) -> str:
    """Explain how a rollout ended, including the goals that its final state does not satisfy."""
    if record["success"]:
        return f"success after {record['steps']} steps"
    unmet = f"; at the end: {record['unmet']}" if record.get("unmet") and is_result(record) else ""
    return f"{record['reason'] or record['end']}{unmet}"
