"""Compute the success rates in ``results.json`` from rollout records.

Rates and their intervals are computed for tasks and for the steps of tasks. Rates are also pooled over multiple tasks,
such as a folder of cousins. A rollout with an invalid response counts as a failure. A rollout without a response has no
result, so it is counted as missing and excluded from all rates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from simfoundry import __version__
from simfoundry.evaluate.rollouts.rollout import RolloutEnd
from simfoundry.evaluate.statistics.comparisons import compare_engines, compare_policies
from simfoundry.evaluate.statistics.metrics import Rate, stratified
from simfoundry.evaluate.statistics.records import is_result
from simfoundry.evaluate.task import Task
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import ObjectSpec
from simfoundry.spec.yaml.text import read

Record = Mapping[str, Any]


def cousin_of(task: Task) -> dict[str, Any] | None:
    """Return the recipe, seed, index and axes of a cousin.

    ``axes`` are the axes along which the cousin differs from its twin. They are derived from the fields in its
    documents that the twin's documents do not contain. The result is None if the task was not generated from a recipe.
    """
    origin = task.setup.task_spec.origin
    if origin is None or origin.cousin is None:
        return None
    cousin, scene = origin.cousin, task.setup.scene
    # The document's own entries, without those of its bases.
    own = read(scene.path).data if scene.bases else {}
    objects = own.get("objects") or {}
    base = load(scene.bases[0]) if objects else None
    known = getattr(base.spec, "objects", {}) if base is not None else {}
    axes = {"distractors" for name in objects if name not in known}
    for name in objects.keys() & known.keys():
        axes |= _axes_of_object(objects[name], scene, cousin.index, known[name])
    axes |= {"vary" for key in own if key in _VARIED}
    axes |= set() if task.setup.task.bases else {"task"}  # a new task does not extend the twin's task
    axes |= {"vary" for key in read(task.setup.task.path).data if key == "instruction" and "task" not in axes}
    return {"recipe": cousin.recipe, "seed": cousin.seed, "index": cousin.index, "axes": sorted(axes)}


# Keys of scenes that only the axis `vary` writes.
_VARIED = ("gravity", "options", "materials", "frames", "robots", "cameras", "lights", "background")


def _axes_of_object(own: Mapping[str, Any], scene: Loaded, index: int, twin: ObjectSpec) -> set[str]:
    """Return the axes along which an object differs from the twin's, according to its own entries."""
    moved = bool(own.keys() & {"pose", "place"})
    # Settling writes the joints of objects that a layout moved; welded objects are moved only by drawn values.
    axes = {"vary" if twin.fixed else "scene"} if moved else {"vary"} if own.get("joints") else set()
    if any(value is not None for key, value in own.items() if key not in ("pose", "place", "joints", "asset")):
        axes.add("vary")
    asset = own.get("asset")
    if asset is not None and Path(asset).name.startswith(f"{index:06d}."):  # the drawn values of an asset
        axes.add("vary")
        used = scene.used(asset)
        replaced = used is not None and used.bases and twin.asset is not None
        if used is not None and replaced and used.bases[0].name == Path(str(twin.asset)).name:
            return axes
    return axes | ({"object"} if asset is not None else set())


@dataclass(frozen=True)
class RatePool:
    """The results of a policy over multiple tasks in one engine.

    ``counts`` contains the numbers of successes and rollouts for each task, and ``subtasks`` contains the rate of each
    step by name. ``rate`` weights all rollouts equally, whereas the stratified rate weights all tasks equally.
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
        """The success rate over all rollouts that have a result."""
        return Rate(sum(done for done, _ in self.counts), sum(of for _, of in self.counts))

    @property
    def title(self) -> str:
        """The title of the stratum."""
        parts = {"whole": "", "alone": ", single steps", "onward": ", from a step onward"}
        return f"{self.stratum}{parts[self.part]}"

    @property
    def is_balanced(self) -> bool:
        """True if all tasks have the same number of rollouts.

        In that case, the stratified and pooled rates are equal.
        """
        return len({of for _, of in self.counts}) == 1

    @property
    def stratified_text(self) -> str:
        """The stratified rate with its interval, as text."""
        rate, low, high = stratified(self.counts)
        return f"{rate:.0%} ({low:.0%} to {high:.0%})"

    def to_json(self) -> dict[str, Any]:
        """Return the pool as a row of the ``pooled`` table."""
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
            "subtasks": {name: dict(vars(rate)) for name, rate in self.subtasks.items()},
            "rate": round(self.rate.share, 6),
            "interval": _rounded(self.rate.interval),
            "stratified_rate": round(rate, 6),
            "stratified_interval": _rounded((low, high)),
        }


def _rounded(interval: tuple[float, float]) -> list[float]:
    return [round(v, 6) for v in interval]


def pools(records: Iterable[Record]) -> list[RatePool]:
    """Pool the results of every policy over all tasks, and over each stratum if there are several strata.

    A stratum consists of a recipe and a set of axes. A pool contains at least two tasks because there is already a
    separate row for each single task. Single steps and remainders of tasks (``part``) are pooled separately from whole
    tasks because they measure different abilities.
    """
    groups: dict[tuple[str, str, str, str], dict[str, list[Record]]] = {}
    results = [r for r in records if is_result(r)]
    strata = Counter(part for part, _ in {(r["part"], stratum_of(r)) for r in results})
    for record in results:
        for name in ["all", stratum_of(record)] if strata[record["part"]] > 1 else ["all"]:
            tasks = groups.setdefault((record["part"], name, record["engine"], record["policy"]), {})
            tasks.setdefault(f"{record['task']}/{record['step']}", []).append(record)
    order = list(dict.fromkeys(("all", *(key[1] for key in groups))))
    found = []
    for part, name, engine, policy in sorted(groups, key=lambda key: (key[0] != "whole", key[0], order.index(key[1]))):
        tasks = groups[part, name, engine, policy]
        every = [r for each in tasks.values() for r in each]
        counts = tuple((sum(r["success"] for r in each), len(each)) for each in tasks.values())
        invalid = sum(r["end"] == RolloutEnd.INVALID for r in every)
        named = dict.fromkeys(step for r in every for step in r["subtasks"])
        steps = {step: _rate_of([r["subtasks"][step] for r in every if step in r["subtasks"]]) for step in named}
        found.append(RatePool(policy, engine, part, name, counts, steps, invalid))
    several = {(p.part, p.stratum) for p in found if len(p.counts) > 1 or p.stratum != "all"}
    return [pool for pool in found if (pool.part, pool.stratum) in several]


def _rate_of(done: Sequence[int | None]) -> Rate:
    """Return the success rate of a step.

    ``done`` contains the control step at which each rollout completed the step, or None if the rollout did not complete
    it.
    """
    return Rate(sum(step is not None for step in done), len(done))


def stratum_of(record: Record) -> str:
    """Return the stratum of a rollout.

    The stratum consists of the recipe and the axes of the rollout's cousin.
    """
    cousin = record.get("cousin")
    return f"{cousin['recipe']}: {' + '.join(cousin['axes']) or 'as the twin'}" if cousin else "no cousins"


VERSION = "results/2"

# The maximum number of tasks for which tables also list the steps; with a hundred cousins of four steps each, the
# tables would be too long.
MANY = 12


@dataclass(frozen=True)
class ScoreRow:
    """The results of a policy on a task in an engine.

    Attributes:
        success: The success rate of the whole task.
        subtasks: The success rate of each step.
        ends: The number of rollouts for each reason to end.
        invalid: The number of rollouts that failed because of an invalid response.
        missing: The number of requested rollouts without a result.
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
    """The mean number of control steps in the successful rollouts, or None if there are none."""
    invalid: int
    missing: int

    @property
    def title(self) -> str:
        """The title of the task."""
        steps = {"whole": "", "alone": f": {self.step}", "onward": f" from {self.step}"}
        return f"{self.task}{steps[self.part]}"

    @property
    def key(self) -> tuple[str, ...]:
        """The key that all records in this row share. It is the value returned by :func:`cell_key`."""
        return self.task, self.part, self.step, self.engine, self.policy

    @property
    def exceptions(self) -> str:
        """The numbers of invalid responses and missing rollouts, as text.

        The text is empty if both numbers are zero.
        """
        counts = {"with an invalid response": self.invalid, "missing": self.missing}
        return ", ".join(f"{count} {words}" for words, count in counts.items() if count)

    @property
    def summary(self) -> str:
        """The success rate as text, followed by the numbers of invalid responses and missing rollouts, if any."""
        rate = str(self.success) if self.success.of else "no result"
        return f"{rate}, {self.exceptions}" if self.exceptions else rate

    def to_json(self) -> dict[str, Any]:
        """Return the row as an entry of the ``scores`` table, which `simfoundry correlate` reads.

        The results of a single step are listed as a separate task.
        """
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
            "interval": _rounded(self.success.interval),
            "mean_steps": None if self.mean_steps is None else round(self.mean_steps, 2),
            "subtasks": {n: {**vars(rate), "interval": _rounded(rate.interval)} for n, rate in self.subtasks.items()},
            "ends": dict(self.ends),
        }


def cells(records: Iterable[Mapping[str, Any]]) -> list[ScoreRow]:
    """Group the records by task, engine and policy, preserving their order."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for record in records:
        groups.setdefault(cell_key(record), []).append(record)
    return [_cell(key, found) for key, found in groups.items()]


Row = TypeVar("Row", ScoreRow, RatePool)


def by_title(found: Sequence[Row]) -> dict[str, dict[str, Row]]:
    """Arrange rows by title and policy. The title includes the engine if there are several engines."""
    several = len({row.engine for row in found}) > 1
    named: dict[str, dict[str, Row]] = {}
    for row in found:
        named.setdefault(f"{row.title} in {row.engine}" if several else row.title, {})[row.policy] = row
    return named


def cell_key(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the key of the row to which a record belongs.

    The key consists of the task, the part, the step, the engine and the policy.
    """
    return tuple(record[key] for key in ("task", "part", "step", "engine", "policy"))


def _cell(key: tuple[str, ...], every: list[Mapping[str, Any]]) -> ScoreRow:
    task, part, step, engine, policy = key
    found = [r for r in every if is_result(r)]
    missing = max(0, max(r["asked_rollouts"] for r in every) - len(found))
    steps = [r["steps"] for r in found if r["success"]]
    names = dict.fromkeys(name for record in found for name in record["subtasks"])
    subtasks = {n: _rate_of([r["subtasks"].get(n) for r in found]) for n in names}
    ends = Counter(sorted(r["end"] for r in found))
    mean, invalid = sum(steps) / len(steps) if steps else None, ends[RolloutEnd.INVALID]
    success = Rate(len(steps), len(found))
    return ScoreRow(task, part, step, engine, policy, success, subtasks, ends, mean, invalid, missing)


def results(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the results of an evaluation as plain data.

    Identical rollouts produce identical bytes. ``rollouts`` contains the rollouts that have a result, and
    ``unanswered`` contains those that were tried but have no result.
    """
    kept = [{key: value for key, value in r.items() if key not in ("timings", "simfoundry")} for r in records]
    return {
        "simfoundry": VERSION,
        "version": __version__,
        "scores": [cell.to_json() for cell in cells(records)],
        "pooled": [pool.to_json() for pool in pools(records)],
        "engines": [one.to_json() for one in compare_engines(records)],
        "comparisons": [one.to_json() for one in compare_policies(records)],
        "rollouts": [r for r in kept if is_result(r)],
        "unanswered": [r for r in kept if not is_result(r)],
    }
