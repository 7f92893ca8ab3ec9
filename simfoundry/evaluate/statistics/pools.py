"""Success over many tasks, such as a folder of cousins: pooled and stratified rates, and paired policy comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from simfoundry.evaluate.statistics.metrics import Rate, holm, mcnemar, sign_flip, stratified
from simfoundry.evaluate.statistics.records import is_result
from simfoundry.evaluate.tasks.task import Task
from simfoundry.spec.load import load
from simfoundry.spec.yaml.text import read

Record = Mapping[str, Any]


def cousin_of(task: Task) -> dict[str, Any] | None:
    """Return the identity of a cousin: its recipe, seed and index, and the ``axes`` along which it differs from its
    twin.

    None for a task not made by a recipe. The axes are derived from the fields of its documents that the twin's lack.
    """
    origin = task.setup.task_spec.origin
    if origin is None or origin.cousin is None:
        return None
    scene = task.setup.scene
    # The document's own entries, without those of its bases.
    own = (read(scene.path).data.get("objects") or {}) if scene.bases else {}
    known = getattr(load(scene.bases[0]).spec, "objects", {}) if own else {}
    axes = set()
    for name, fields in own.items():
        if name not in known:
            axes.add("distractors")
        elif set(fields) - {"pose", "place", "joints"}:
            axes.add("object")
        else:
            axes.add("scene")
    if not task.setup.task.bases:  # it is a new task and does not extend the twin's
        axes.add("task")
    cousin = origin.cousin
    return {"recipe": cousin.recipe, "seed": cousin.seed, "index": cousin.index, "axes": sorted(axes)}


@dataclass(frozen=True)
class RatePool:
    """The results of a policy over several tasks in one engine.

    ``counts`` are successes and rollouts of each task; ``subtasks`` those of each step by name. ``rate`` weights all
    rollouts equally; the stratified rate weights all tasks equally.
    """

    policy: str
    engine: str
    part: str
    stratum: str
    counts: tuple[tuple[int, int], ...]
    subtasks: Mapping[str, Rate]
    invalid: int

    @property
    def rate(self) -> Rate:
        """Successful rollouts out of all with a result."""
        return Rate(sum(done for done, _ in self.counts), sum(of for _, of in self.counts))

    @property
    def title(self) -> str:
        """Title of the stratum."""
        parts = {"whole": "", "alone": ", single steps", "onward": ", from a step on"}
        return f"{self.stratum}{parts[self.part]}"

    @property
    def is_balanced(self) -> bool:
        """Return whether all tasks have equally many rollouts, so that the stratified rate equals the pooled one."""
        return len({of for _, of in self.counts}) == 1

    @property
    def stratified_text(self) -> str:
        """Stratified rate with its interval, as text."""
        rate, low, high = stratified(self.counts)
        return f"{rate:.0%} ({low:.0%} to {high:.0%})"

    def to_json(self) -> dict[str, Any]:
        """Return a row of ``pooled``."""
        rate, low, high = stratified(self.counts)
        return {
            "part": self.part,
            "stratum": self.stratum,
            "engine": self.engine,
            "policy": self.policy,
            "tasks": len(self.counts),
            "successes": self.rate.done,
            "rollouts": self.rate.of,
            "invalid": self.invalid,
            "subtasks": {name: {"done": rate.done, "of": rate.of} for name, rate in self.subtasks.items()},
            "rate": round(self.rate.share, 6),
            "interval": [round(v, 6) for v in self.rate.interval],
            "stratified_rate": round(rate, 6),
            "stratified_interval": [round(low, 6), round(high, 6)],
        }


def pools(records: Iterable[Record]) -> list[RatePool]:
    """Pool every policy over all tasks of each kind, and over those of each recipe and set of axes if these differ.

    Pools need several tasks; a single one has its own row. Single steps and remainders of tasks are separate from whole
    tasks (``part``), because they measure different abilities.
    """
    groups: dict[tuple[str, str, str, str], dict[str, list[Record]]] = {}
    results = [r for r in records if is_result(r)]
    strata: dict[str, set[str]] = {}
    for record in results:
        strata.setdefault(record["part"], set()).add(stratum_of(record))
    for record in results:
        names = ["all", stratum_of(record)] if len(strata[record["part"]]) > 1 else ["all"]
        for name in names:
            tasks = groups.setdefault((record["part"], name, record["engine"], record["policy"]), {})
            tasks.setdefault(f"{record['task']}/{record['step']}", []).append(record)
    order = {name: k for k, name in enumerate(dict.fromkeys(("all", *(key[1] for key in groups))))}
    found = []
    for part, name, engine, policy in sorted(groups, key=lambda key: (key[0] != "whole", key[0], order[key[1]])):
        tasks = groups[part, name, engine, policy]
        counts = tuple((sum(r["success"] for r in each), len(each)) for each in tasks.values())
        invalid = sum(r["end"] == "invalid answer" for each in tasks.values() for r in each)
        every = [r for each in tasks.values() for r in each]
        named = dict.fromkeys(step for r in every for step in r["subtasks"])
        steps = {step: _rate_of_step([r["subtasks"][step] for r in every if step in r["subtasks"]]) for step in named}
        found.append(RatePool(policy, engine, part, name, counts, steps, invalid))
    several = {(p.part, p.stratum) for p in found if len(p.counts) > 1 or p.stratum != "all"}
    return [pool for pool in found if (pool.part, pool.stratum) in several]


def _rate_of_step(done: Sequence[int | None]) -> Rate:
    return Rate(sum(step is not None for step in done), len(done))


def pool_rows(found: Sequence[RatePool]) -> dict[str, dict[str, RatePool]]:
    """Arrange the pools by title and policy; the title names the engine if there are several."""
    several, rows = len({pool.engine for pool in found}) > 1, dict[str, dict[str, RatePool]]()
    for pool in found:
        rows.setdefault(f"{pool.title} in {pool.engine}" if several else pool.title, {})[pool.policy] = pool
    return rows


def stratum_of(record: Record) -> str:
    """Return the stratum of a rollout: the recipe and the axes of its cousin."""
    cousin = record.get("cousin")
    return f"{cousin['recipe']}: {' + '.join(cousin['axes']) or 'as the twin'}" if cousin else "no cousins"


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


def comparisons(records: Iterable[Record]) -> list[PolicyComparison]:
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
                found.append(_compared(first, second, engine, part, pairs))
    corrected = holm([c.p for c in found])
    return [PolicyComparison(**{**vars(c), "p_holm": p}) for c, p in zip(found, corrected, strict=True)]


def _compared(
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
