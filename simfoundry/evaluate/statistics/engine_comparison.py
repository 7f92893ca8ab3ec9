"""Comparison of a policy from the same starts in two engines, to detect results that depend on the engine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from simfoundry.evaluate.statistics.metrics import mcnemar
from simfoundry.evaluate.statistics.records import is_result

Record = Mapping[str, Any]

APART = 2 / 25
"""Threshold on the difference in successes, as a share of the starts, above which engines disagree: two of the 25
rollouts of the paper's protocol, in which contacts that differ by rounding end differently (docs/evaluation.md).
"""

CHANCE = 1
"""Maximum difference in successes that counts as chance, however few starts there are."""


@dataclass(frozen=True)
class EngineComparison:
    """A policy on a task in two engines.

    ``first_only`` and ``second_only`` are the indices of the starts at which it succeeded in only one engine, out of
    ``pairs`` starts with a result in both; ``first_done`` and ``second_done`` count its successes; ``p`` is the p-value
    of the exact McNemar test.
    """

    task: str
    part: str
    step: str
    policy: str
    first: str
    second: str
    pairs: int
    first_done: int
    second_done: int
    first_only: tuple[int, ...]
    second_only: tuple[int, ...]
    p: float

    @property
    def disagrees(self) -> bool:
        """Return whether the engines differ by more than chance and rounding explain."""
        return abs(self.first_done - self.second_done) > max(CHANCE, APART * self.pairs)

    @property
    def title(self) -> str:
        """Title of the task."""
        return f"{self.task}: {self.step}" if self.step else self.task

    @property
    def sentence(self) -> str:
        """Description of the disagreement in one sentence."""
        return (
            f"{self.title} with {self.policy}: {self.first} and {self.second} disagree: {self.first_done} and "
            f"{self.second_done} of the same {self.pairs} starts succeed (p = {self.p:.3g}, exact McNemar test), so "
            f"the rate depends more on the engine than on the policy; compare the rollouts {_listed(self.differing)}"
        )

    @property
    def differing(self) -> tuple[int, ...]:
        """Indices of the starts with different results."""
        return tuple(sorted((*self.first_only, *self.second_only)))

    def to_json(self) -> dict[str, Any]:
        """Return a row of ``engines``."""
        return {**vars(self), "p": round(self.p, 6), "disagrees": self.disagrees}


def compare_engines(records: Iterable[Record]) -> list[EngineComparison]:
    """Compare all pairs of engines per task and policy, over the starts with a result in both."""
    groups: dict[tuple[str, str, str, str], dict[str, dict[tuple[int, str], Record]]] = {}
    for record in records:
        if is_result(record):
            key = (str(record["task"]), str(record["part"]), str(record["step"]), str(record["policy"]))
            starts = groups.setdefault(key, {}).setdefault(str(record["engine"]), {})
            starts[record["index"], record["start"]] = record
    found = []
    for key, engines in groups.items():
        for first, second in combinations(engines, 2):
            common = [start for start in engines[first] if start in engines[second]]
            if common:
                wins = [(bool(engines[first][s]["success"]), bool(engines[second][s]["success"])) for s in common]
                found.append(_compared(key, (first, second), [index for index, _ in common], wins))
    return found


def _compared(
    key: tuple[str, str, str, str], engines: tuple[str, str], starts: Sequence[int], wins: Sequence[tuple[bool, bool]]
) -> EngineComparison:
    only = tuple(k for k, (a, b) in zip(starts, wins, strict=True) if a and not b)
    other = tuple(k for k, (a, b) in zip(starts, wins, strict=True) if b and not a)
    done = (sum(a for a, _ in wins), sum(b for _, b in wins))
    return EngineComparison(*key, *engines, len(wins), *done, only, other, mcnemar(len(only), len(other)))


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))
