"""Success rates of tasks and their steps with intervals, computed from records of rollouts, for ``results.json``.

A rollout with an invalid answer of the policy has failed and counts as a rollout; one without an answer has no result:
it counts as missing and does not enter any rate.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from simfoundry import __version__
from simfoundry.evaluate.rollouts.rollout import RolloutEnd
from simfoundry.evaluate.statistics.engine_comparison import compare_engines
from simfoundry.evaluate.statistics.metrics import Rate
from simfoundry.evaluate.statistics.pools import comparisons, pools
from simfoundry.evaluate.statistics.records import is_result

VERSION = "results/2"

MANY = 12
"""Maximum number of tasks whose steps are listed in tables; four rows for each of a hundred cousins would be
too many.
"""


@dataclass(frozen=True)
class ScoreRow:
    """A task with a policy in an engine: ``success`` of the whole, ``subtasks`` of each step, and the ends of the
    rollouts.

    ``invalid`` rollouts failed by an invalid answer; ``missing`` requested rollouts have no result.
    """

    task: str
    part: str
    step: str
    engine: str
    policy: str
    success: Rate
    subtasks: Mapping[str, Rate]
    ends: Mapping[str, int]
    mean_steps: float | None
    """Control steps of the successful rollouts, None if there are none."""
    invalid: int
    missing: int

    @property
    def title(self) -> str:
        """Title of the task."""
        return {"whole": self.task, "alone": f"{self.task}: {self.step}", "onward": f"{self.task} from {self.step}"}[
            self.part
        ]

    @property
    def key(self) -> tuple[str, ...]:
        """Key shared by its records, as returned by :func:`cell_key`."""
        return self.task, self.part, self.step, self.engine, self.policy

    @property
    def exceptions(self) -> str:
        """Counts of invalid answers and missing rollouts as text; empty if there are none."""
        invalid = f"{self.invalid} by an invalid answer" if self.invalid else ""
        return ", ".join(filter(None, (invalid, f"{self.missing} missing" if self.missing else "")))

    @property
    def summary(self) -> str:
        """Success rate as text, with any invalid and missing rollouts."""
        rate = str(self.success) if self.success.of else "no result"
        return f"{rate}, {self.exceptions}" if self.exceptions else rate

    def to_json(self) -> dict[str, Any]:
        """Return a row of ``scores``, as read by `simfoundry correlate`; a single step is a task of its own there."""
        return {
            "task": f"{self.task}.{self.step}" if self.part == "alone" else self.task,
            **({"from": self.step} if self.part == "onward" else {}),
            "engine": self.engine,
            "policy": self.policy,
            "successes": self.success.done,
            "rollouts": self.success.of,
            "invalid": self.invalid,
            "missing": self.missing,
            "rate": round(self.success.share, 6) if self.success.of else None,
            "interval": [round(v, 6) for v in self.success.interval],
            "mean_steps": None if self.mean_steps is None else round(self.mean_steps, 2),
            "subtasks": {
                name: {"done": rate.done, "of": rate.of, "interval": [round(v, 6) for v in rate.interval]}
                for name, rate in self.subtasks.items()
            },
            "ends": dict(self.ends),
        }


def cells(records: Iterable[Mapping[str, Any]]) -> list[ScoreRow]:
    """Group the records by task, engine and policy, in their order."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for record in records:
        groups.setdefault(cell_key(record), []).append(record)
    return [_cell(key, found) for key, found in groups.items()]


def titles(found: Sequence[ScoreRow]) -> dict[str, dict[str, ScoreRow]]:
    """Arrange the cells by title and policy; the title names the engine if there are several."""
    several = len({cell.engine for cell in found}) > 1
    named: dict[str, dict[str, ScoreRow]] = {}
    for cell in found:
        named.setdefault(f"{cell.title} in {cell.engine}" if several else cell.title, {})[cell.policy] = cell
    return named


def cell_key(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the key of a record's cell: task, part, step, engine and policy."""
    return tuple(record[key] for key in ("task", "part", "step", "engine", "policy"))


def _cell(key: tuple[str, ...], every: list[Mapping[str, Any]]) -> ScoreRow:
    task, part, step, engine, policy = key
    found = [r for r in every if is_result(r)]
    asked = max(r["asked_rollouts"] for r in every)
    steps = [r["steps"] for r in found if r["success"]]
    names = list(dict.fromkeys(name for record in found for name in record["subtasks"]))
    return ScoreRow(
        task=task,
        part=part,
        step=step,
        engine=engine,
        policy=policy,
        success=Rate(sum(r["success"] for r in found), len(found)),
        subtasks={n: Rate(sum(r["subtasks"].get(n) is not None for r in found), len(found)) for n in names},
        ends=dict(sorted(Counter(r["end"] for r in found).items())),
        mean_steps=sum(steps) / len(steps) if steps else None,
        invalid=sum(r["end"] == RolloutEnd.INVALID for r in found),
        missing=max(0, asked - len(found)),
    )


def results(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the results of an evaluation as plain data; equal rollouts give equal bytes.

    ``rollouts`` counts those with a result, ``unanswered`` those tried without a result.
    """
    kept = [{key: value for key, value in r.items() if key not in ("timings", "simfoundry")} for r in records]
    return {
        "simfoundry": VERSION,
        "version": __version__,
        "scores": [cell.to_json() for cell in cells(records)],
        "pooled": [pool.to_json() for pool in pools(records)],
        "engines": [one.to_json() for one in compare_engines(records)],
        "comparisons": [one.to_json() for one in comparisons(records)],
        "rollouts": [r for r in kept if is_result(r)],
        "unanswered": [r for r in kept if not is_result(r)],
    }
