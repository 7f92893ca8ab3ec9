"""Paired comparisons from the same starts: of two policies in one engine, and of a policy in two engines.

The second detects results that depend on the engine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from simfoundry.evaluate.statistics.metrics import holm, mcnemar, sign_flip
from simfoundry.evaluate.statistics.records import is_result

Record = Mapping[str, Any]


@dataclass(frozen=True)
class PolicyComparison:
    """Two policies over the same starts in one engine.

    ``first_only`` and ``second_only`` count the starts at which only one of them succeeded; ``p`` is the p-value of the
    exact McNemar test, ``p_holm`` the same corrected for the number of comparisons (Holm). ``progress`` is the mean
    difference in the share of sub-tasks done, first minus second, ``p_progress`` the p-value of a paired permutation
    test on it; both are None if no task has sub-tasks.
    """

    first: str
    second: str
    engine: str
    part: str
    pairs: int
    both: int
    first_only: int
    second_only: int
    p: float
    p_holm: float
    progress: float | None
    p_progress: float | None

    @property
    def sentence(self) -> str:
        """Description of the comparison in one sentence."""
        parts = {"whole": "", "alone": " of single steps", "onward": " from a step on"}
        text = (
            f"{self.first} and {self.second} from the same {self.pairs} starts{parts[self.part]} in {self.engine}: "
            f"only {self.first} succeeds in {self.first_only}, only {self.second} in {self.second_only}; "
            f"p = {self.p_holm:.3g} (exact McNemar test, Holm)"
        )
        if self.progress is None or self.p_progress is None:
            return text
        return f"{text}; sub-tasks done {self.progress:+.0%}, p = {self.p_progress:.3g} (paired permutation test)"

    def to_json(self) -> dict[str, Any]:
        """Return a row of ``comparisons``."""
        return {k: round(v, 6) if isinstance(v, float) else v for k, v in vars(self).items()}


def compare_policies(records: Iterable[Record]) -> list[PolicyComparison]:
    """Compare all pairs of policies over the starts with a result for both; pairs without a common start are skipped.

    A pair is one start of one task in one engine, identical for both policies to the last bit. Success is binary, so
    the exact paired test is McNemar's: under the null hypothesis each start at which the two differ is a fair coin
    toss. The share of sub-tasks done has more than two values, so it is tested by permuting the signs of the
    differences.
    """
    by_policy: dict[tuple[str, str, str], dict[tuple[Any, ...], Record]] = {}
    for record in records:
        if is_result(record):
            start = (record["task"], record["step"], record["index"], record["start"])
            by_policy.setdefault((record["part"], record["engine"], record["policy"]), {})[start] = record
    found = []
    for part, engine in dict.fromkeys((part, engine) for part, engine, _ in by_policy):
        policies = [p for a, b, p in by_policy if (a, b) == (part, engine)]
        for first, second in combinations(policies, 2):
            mine, other = by_policy[part, engine, first], by_policy[part, engine, second]
            pairs = [(mine[start], other[start]) for start in mine if start in other]
            if pairs:
                found.append(_policies_compared(first, second, engine, part, pairs))
    corrected = holm([c.p for c in found])
    return [PolicyComparison(**{**vars(c), "p_holm": p}) for c, p in zip(found, corrected, strict=True)]


def _policies_compared(
    first: str, second: str, engine: str, part: str, pairs: Sequence[tuple[Record, Record]]
) -> PolicyComparison:
    wins = [(bool(a["success"]), bool(b["success"])) for a, b in pairs]
    only, other = sum(a and not b for a, b in wins), sum(b and not a for a, b in wins)
    shares = [_progress(a) - _progress(b) for a, b in pairs if a["subtasks"] and b["subtasks"]]
    return PolicyComparison(
        first=first,
        second=second,
        engine=engine,
        part=part,
        pairs=len(pairs),
        both=sum(a and b for a, b in wins),
        first_only=only,
        second_only=other,
        p=mcnemar(only, other),
        p_holm=1.0,
        progress=sum(shares) / len(shares) if shares else None,
        p_progress=sign_flip(shares) if shares else None,
    )


def _progress(record: Record) -> float:
    """Return the share of sub-tasks that were done."""
    done = record["subtasks"]
    return sum(step is not None for step in done.values()) / len(done)


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
                found.append(_engines_compared(key, (first, second), [index for index, _ in common], wins))
    return found


def _engines_compared(
    key: tuple[str, str, str, str], engines: tuple[str, str], starts: Sequence[int], wins: Sequence[tuple[bool, bool]]
) -> EngineComparison:
    only = tuple(k for k, (a, b) in zip(starts, wins, strict=True) if a and not b)
    other = tuple(k for k, (a, b) in zip(starts, wins, strict=True) if b and not a)
    done = (sum(a for a, _ in wins), sum(b for _, b in wins))
    return EngineComparison(*key, *engines, len(wins), *done, only, other, mcnemar(len(only), len(other)))


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))
