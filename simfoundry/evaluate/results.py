"""Records of rollouts as success rates of tasks and of their steps, with intervals: what ``results.json`` holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from simfoundry import __version__
from simfoundry.evaluate.metrics import wilson

VERSION = "results/1"


@dataclass(frozen=True)
class Rate:
    """How often something was done: ``done`` of ``of``."""

    done: int
    of: int

    @property
    def share(self) -> float:
        """The rate in [0, 1]; 0 where nothing was tried."""
        return self.done / self.of if self.of else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the rate."""
        return wilson(self.done, self.of)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.done}/{self.of}  {self.share:.0%} ({low:.0%} to {high:.0%})"


@dataclass(frozen=True)
class Cell:
    """A task with a policy: ``success`` of the whole, ``subtasks`` of each step, and how the rollouts ended."""

    task: str
    part: str
    step: str
    policy: str
    success: Rate
    subtasks: Mapping[str, Rate]
    ends: Mapping[str, int]
    mean_steps: float | None
    """Control steps of the rollouts that succeeded, None where none did."""

    @property
    def title(self) -> str:
        """The task in words."""
        return {"whole": self.task, "alone": f"{self.task}: {self.step}", "onward": f"{self.task} from {self.step}"}[
            self.part
        ]

    def to_json(self) -> dict[str, Any]:
        """A row of ``scores``, as `simfoundry correlate` reads it; a step alone is a task of its own there."""
        return {
            "task": f"{self.task}.{self.step}" if self.part == "alone" else self.task,
            **({"from": self.step} if self.part == "onward" else {}),
            "policy": self.policy,
            "successes": self.success.done,
            "rollouts": self.success.of,
            "rate": round(self.success.share, 6),
            "interval": [round(v, 6) for v in self.success.interval],
            "mean_steps": None if self.mean_steps is None else round(self.mean_steps, 2),
            "subtasks": {
                name: {"done": rate.done, "of": rate.of, "interval": [round(v, 6) for v in rate.interval]}
                for name, rate in self.subtasks.items()
            },
            "ends": dict(self.ends),
        }


def cells(records: Iterable[Mapping[str, Any]]) -> list[Cell]:
    """The records by task and policy, in their order."""
    groups: dict[tuple[str, str, str, str], list[Mapping[str, Any]]] = {}
    for record in records:
        key = (record["task"], record["part"], record["step"], record["policy"])
        groups.setdefault(key, []).append(record)
    return [_cell(*key, found) for key, found in groups.items()]


def _cell(task: str, part: str, step: str, policy: str, found: list[Mapping[str, Any]]) -> Cell:
    steps = [r["steps"] for r in found if r["success"]]
    names = list(dict.fromkeys(name for record in found for name in record["subtasks"]))
    return Cell(
        task=task,
        part=part,
        step=step,
        policy=policy,
        success=Rate(sum(r["success"] for r in found), len(found)),
        subtasks={n: Rate(sum(r["subtasks"].get(n) is not None for r in found), len(found)) for n in names},
        ends=dict(sorted(Counter(r["end"] for r in found).items())),
        mean_steps=sum(steps) / len(steps) if steps else None,
    )


def results(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All of an evaluation as plain data; the same rollouts give the same bytes."""
    return {
        "simfoundry": VERSION,
        "version": __version__,
        "scores": [cell.to_json() for cell in cells(records)],
        "rollouts": [{key: value for key, value in r.items() if key not in ("timings", "simfoundry")} for r in records],
    }
