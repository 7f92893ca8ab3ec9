"""Paired comparisons between rollouts that start from the same initial states.

They compare two policies in the same engine, or a policy in two engines. Comparing two engines reveals results that
depend on the engine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

from simfoundry.evaluate.statistics.metrics import holm, mcnemar, sign_flip
from simfoundry.evaluate.statistics.records import is_result

Record = Mapping[str, Any]


@dataclass(frozen=True)
class PolicyComparison:
    """A comparison of two policies from the same initial states in one engine.

    Attributes:
        pairs: The number of initial states with a result for both policies.
        both: The number of initial states from which both policies succeeded.
        first_only: The number of initial states from which only the first policy succeeded.
        second_only: The number of initial states from which only the second policy succeeded.
        p: The p-value of the exact McNemar test.
        p_holm: The same p-value after Holm's correction for multiple comparisons.
        progress: The mean difference in the fraction of completed sub-tasks (first policy minus second policy), or None
            if no task has sub-tasks.
        p_progress: The p-value of a paired permutation test on that difference, or None if no task has sub-tasks.
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
        """A one-sentence description of the comparison."""
        parts = {"whole": "", "alone": " of single steps", "onward": " from a step onward"}
        text = (
            f"{self.first} vs. {self.second} from the same {self.pairs} initial states{parts[self.part]} in "
            f"{self.engine}: {self.first} alone succeeds in {self.first_only}, {self.second} alone succeeds in "
            f"{self.second_only}; p = {self.p_holm:.3g} (exact McNemar test, Holm-corrected)"
        )
        if self.progress is None or self.p_progress is None:
            return text
        return f"{text}; completed sub-tasks {self.progress:+.0%}, p = {self.p_progress:.3g} (paired permutation test)"

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as a row of the ``comparisons`` table."""
        return {k: round(v, 6) if isinstance(v, float) else v for k, v in vars(self).items()}


def compare_policies(records: Iterable[Record]) -> list[PolicyComparison]:
    """Compare each pair of policies over the initial states for which both have a result.

    Pairs of policies without a common initial state are skipped. Both policies start from bit-identical states of the
    same task in the same engine. Success is binary, so the exact paired test is McNemar's test. Under the null
    hypothesis, each initial state with different outcomes is a fair coin toss. The fraction of completed sub-tasks has
    more than two values, so it is tested by permuting the signs of the differences.
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
                wins = [(bool(a["success"]), bool(b["success"])) for a, b in pairs]
                counts = len(wins), wins.count((True, True)), wins.count((True, False)), wins.count((False, True))
                shares = [_progress(a) - _progress(b) for a, b in pairs if a["subtasks"] and b["subtasks"]]
                progress = (sum(shares) / len(shares), sign_flip(shares)) if shares else (None, None)
                found.append(
                    PolicyComparison(first, second, engine, part, *counts, mcnemar(*counts[2:]), 1.0, *progress)
                )
    corrected = holm([c.p for c in found])
    return [replace(c, p_holm=p) for c, p in zip(found, corrected, strict=True)]


def _progress(record: Record) -> float:
    """Return the fraction of sub-tasks that were completed."""
    done = record["subtasks"]
    return sum(step is not None for step in done.values()) / len(done)


# Threshold on the difference in successes, as a fraction of the initial states, above which engines disagree. It equals
# 2 of the 25 rollouts in the paper's protocol: rollouts whose contacts differ by rounding errors can end differently
# (docs/evaluation.md).
APART = 2 / 25

# Difference in the number of successes up to which it is attributed to chance, regardless of the number of initial
# states.
CHANCE = 1


@dataclass(frozen=True)
class EngineComparison:
    """A comparison of one policy on one task in two engines.

    Attributes:
        pairs: The number of initial states with a result in both engines.
        first_done: The number of successes in the first engine.
        second_done: The number of successes in the second engine.
        first_only: The indices of the initial states from which the policy succeeded only in the first engine.
        second_only: The indices of the initial states from which the policy succeeded only in the second engine.
        p: The p-value of the exact McNemar test.
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
        """True if the engines differ by more than chance and rounding errors can explain."""
        return abs(self.first_done - self.second_done) > max(CHANCE, APART * self.pairs)

    @property
    def title(self) -> str:
        """The title of the task."""
        return f"{self.task}: {self.step}" if self.step else self.task

    @property
    def sentence(self) -> str:
        """A one-sentence description of the disagreement."""
        return (
            f"{self.title} with {self.policy}: {self.first} and {self.second} disagree: {self.first_done} and "
            f"{self.second_done} of the same {self.pairs} initial states lead to success (p = {self.p:.3g}, exact "
            "McNemar test), so the rate depends more on the engine than on the policy; compare rollouts "
            f"{', '.join(map(str, self.differing))}"
        )

    @property
    def differing(self) -> tuple[int, ...]:
        """The indices of the initial states with different outcomes."""
        return tuple(sorted((*self.first_only, *self.second_only)))

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as a row of the ``engines`` table."""
        return {**vars(self), "p": round(self.p, 6), "disagrees": self.disagrees}


def compare_engines(records: Iterable[Record]) -> list[EngineComparison]:
    """Compare each pair of engines per task and policy.

    The comparison is based on the initial states that have a result in both engines.
    """
    groups: dict[tuple[str, str, str, str], dict[str, dict[tuple[int, str], Record]]] = {}
    for record in records:
        if is_result(record):
            key = (str(record["task"]), str(record["part"]), str(record["step"]), str(record["policy"]))
            starts = groups.setdefault(key, {}).setdefault(str(record["engine"]), {})
            starts[record["index"], record["start"]] = record
    found = []
    for key, engines in groups.items():
        for first, second in combinations(engines, 2):
            mine, theirs = engines[first], engines[second]
            wins = [(s[0], bool(mine[s]["success"]), bool(theirs[s]["success"])) for s in mine if s in theirs]
            if wins:
                only = tuple(index for index, a, b in wins if a and not b)
                other = tuple(index for index, a, b in wins if b and not a)
                done = (sum(a for _, a, _ in wins), sum(b for _, _, b in wins))
                p = mcnemar(len(only), len(other))
                found.append(EngineComparison(*key, first, second, len(wins), *done, only, other, p))
    return found
