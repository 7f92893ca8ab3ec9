"""Success rates of an augmentation, for each demonstration that was used, each task and each sub-goal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simfoundry.data.index import INDEX, facts_of_tasks, read_index
from simfoundry.data.store import read_shards
from simfoundry.evaluate.statistics.metrics import Rate


@dataclass(frozen=True)
class AugmentReport:
    """The outcome of an augmentation.

    Attributes:
        total: The success rate of all attempts.
        tasks: The success rate in each task, keyed by its document.
        sources: The success rate of the attempts that used a demonstration, keyed by its index.
        subgoals: The rate at which a sub-goal was achieved once it was begun, keyed by its name.
        failures: The number of failed attempts with each reason, most frequent first.
    """

    total: Rate
    tasks: Mapping[str, Rate]
    sources: Mapping[int, Rate]
    subgoals: Mapping[str, Rate]
    failures: Mapping[str, int] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the rates with their 95% intervals as plain data."""
        return {
            "success": _row(self.total),
            "tasks": [{"document": name, **_row(rate)} for name, rate in self.tasks.items()],
            "sources": [{"demonstration": index, **_row(rate)} for index, rate in self.sources.items()],
            "subgoals": [{"subgoal": name, **_row(rate)} for name, rate in self.subgoals.items()],
            "failures": dict(self.failures),
        }

    def lines(self) -> list[str]:
        """Return the rates as lines of a table, with one part for each kind of rate."""
        parts: list[tuple[str, Mapping[Any, Rate]]] = [("task", self.tasks), ("sub-goal", self.subgoals)]
        parts.append(("demonstration", self.sources))
        found = []
        for title, rates in parts:
            width = max(len(title), *(len(str(key)) for key in rates)) if rates else len(title)
            found += [f"{title:<{width}}  success", *(f"{key!s:<{width}}  {rate}" for key, rate in rates.items())]
        return found


def augment_report(folder: Path) -> AugmentReport:
    """Count the attempts in a folder that ``simfoundry augment`` wrote.

    Raises:
        OutputError: If the folder does not contain demonstrations.
    """
    tasks = facts_of_tasks(read_index(folder / INDEX))
    attempts = [attempt.about for _, found in read_shards(folder, with_arrays=False) for attempt in found]
    by_task: list[tuple[str, bool]] = []
    by_source: list[tuple[int, bool]] = []
    by_subgoal: list[tuple[str, bool]] = []
    failures: Counter[str] = Counter()
    for about in attempts:
        is_kept, segments = bool(about["kept"]), _segments(about)
        by_task.append((str(tasks[int(about["index"]) % len(tasks)]["document"]), is_kept))
        by_source += [(index, is_kept) for index in sorted({int(one["demonstration"]) for one in segments})]
        by_subgoal += [(str(one["subgoal"]), bool(one.get("achieved")) or is_kept) for one in segments]
        if not is_kept:
            failures[f"{about['end']}: {_kind(about)}"] += 1
    rates = _rates(by_source)
    return AugmentReport(
        total=Rate(sum(bool(about["kept"]) for about in attempts), len(attempts)),
        tasks=_rates(by_task),
        sources={index: rates[index] for index in sorted(rates)},
        subgoals=_rates(by_subgoal),
        failures=dict(failures.most_common()),
    )


def _segments(about: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    origin = about.get("origin", {})
    found = origin.get("segments", []) if isinstance(origin, Mapping) else []
    known = [one for one in found if isinstance(one, Mapping)] if isinstance(found, list) else []
    return [one for one in known if isinstance(one.get("demonstration"), int) and "subgoal" in one]


def _kind(about: Mapping[str, Any]) -> str:
    """Return the kind of a failure, which several attempts may share."""
    origin = about.get("origin", {})
    return str(origin.get("failure", about["reason"])) if isinstance(origin, Mapping) else str(about["reason"])


def _rates(found: Iterable[tuple[Any, bool]]) -> dict[Any, Rate]:
    of, done = Counter[Any](), Counter[Any]()
    for key, is_kept in found:
        of[key] += 1
        done[key] += is_kept
    return {key: Rate(done[key], count) for key, count in of.items()}


def _row(rate: Rate) -> dict[str, Any]:
    return {"attempts": rate.of, "successes": rate.done, "rate": rate.share, "interval": list(rate.interval)}
