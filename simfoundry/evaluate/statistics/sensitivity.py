"""Sensitivity of success rates to the values that a recipe varies.

For each number, Spearman's rank correlation between the value and the success rate of a cousin is computed, with an
interval and a p-value. For each choice, the success rate is computed separately for every value.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.metrics import Rate, holm, weighted_pearson
from simfoundry.geometry.frames import Array

# Format of the manifests of cousins, as in simfoundry/cousins/run/report.py.
MANIFEST_VERSION = "cousins-run/1"

# Maximum size of a manifest [bytes]: 100,000 cousins with 50 values each.
MAX_MANIFEST = 512 * 2**20

# Number of resampled rows that are processed at once, which limits memory: 16 MB an array for 10,000 cousins.
ROWS = 200


@dataclass(frozen=True)
class NumberSensitivity:
    """The dependence of a policy's success rate on a number that varies.

    Attributes:
        name: Path of the value, with its component if it has several.
        cousins: Number of cousins with results.
        low: Least value drawn.
        high: Greatest value drawn.
        correlation: Spearman's rank correlation, or None if all values or all rates are equal.
        interval: 95% interval of the correlation, by a Bayesian bootstrap over the cousins, or None.
        p: p-value of a permutation test, corrected for the number of values by Holm's method, or None.
    """

    name: str
    cousins: int
    low: float
    high: float
    correlation: float | None
    interval: tuple[float, float] | None = None
    p: float | None = None


@dataclass(frozen=True)
class ChoiceSensitivity:
    """The success rate of a policy for one of several values."""

    name: str
    value: str
    cousins: int
    rate: Rate


@dataclass(frozen=True)
class SensitivityTable:
    """The sensitivities of one policy in one engine, the strongest correlation first."""

    policy: str
    engine: str
    cousins: int
    rollouts: int
    numbers: tuple[NumberSensitivity, ...]
    choices: tuple[ChoiceSensitivity, ...]

    @property
    def title(self) -> str:
        """The policy and the engine, with the numbers of cousins and rollouts."""
        return f"{self.policy} in {self.engine}: {self.rollouts} rollouts of {self.cousins} cousins"

    def to_json(self) -> dict[str, Any]:
        """Return the table as plain data."""
        choices = [
            {**{k: v for k, v in vars(c).items() if k != "rate"}, "successes": c.rate.done, "rollouts": c.rate.of}
            | {"rate": round(c.rate.share, 6), "interval": [round(v, 6) for v in c.rate.interval]}
            for c in self.choices
        ]
        numbers = [dict(vars(number)) for number in self.numbers]
        return {**vars(self), "numbers": numbers, "choices": choices}


@dataclass(frozen=True)
class VariedCousins:
    """The values of the cousins of a recipe, by index."""

    recipe: str
    seed: int
    values: Mapping[int, Mapping[str, float | str]]


def read_varied(path: Path) -> VariedCousins:
    """Read the values of cousins from a manifest, or from a folder that contains ``manifest.json``.

    Raises:
        SimfoundryError: If the file is not a manifest, or if no values vary.
    """
    file, data = read_cousins(path)
    try:
        values = {int(c["index"]): dict(_flat(c.get("vary", {}))) for c in data["cousins"]}
        recipe, seed = str(data["recipe"]), int(data["seed"])
    except (ValueError, KeyError, TypeError, AttributeError):
        raise _no_manifest(file) from None
    if not any(values.values()):
        raise SimfoundryError(f"the cousins in {file} have no values that vary; add `vary` to the recipe")
    return VariedCousins(recipe, seed, values)


def read_cousins(path: Path) -> tuple[Path, dict[str, Any]]:
    """Read a manifest of cousins, or the one in a folder, and return its path and content.

    Raises:
        SimfoundryError: If the file is not a manifest.
    """
    file = path / "manifest.json" if path.is_dir() else path
    try:
        if file.stat().st_size > MAX_MANIFEST:
            raise SimfoundryError(f"{file} is larger than {MAX_MANIFEST >> 20} MiB, the limit for a manifest")
        data = json.loads(file.read_text(encoding="utf-8"))
        if data["simfoundry"] != MANIFEST_VERSION:
            raise ValueError
        return file, data
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise _no_manifest(file) from None


def _no_manifest(file: Path) -> SimfoundryError:
    return SimfoundryError(f"{file} is not a manifest of cousins; pass the output folder of `simfoundry cousins`")


def _flat(values: Mapping[str, Any]) -> Iterator[tuple[str, float | str]]:
    """Yield each number and choice. The components of a value are values of their own."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}.{part}", float(number)) for part, number in value.items())
        else:
            yield name, value if isinstance(value, str) else float(value)


def read_rollouts(path: Path) -> list[Mapping[str, Any]]:
    """Read the rollouts in ``results.json``, or in a folder that contains it.

    Raises:
        SimfoundryError: If the file was not written by `simfoundry eval`.
    """
    file = path / "results.json" if path.is_dir() else path
    try:
        rollouts = json.loads(file.read_text(encoding="utf-8"))["rollouts"]
        return [r for r in rollouts if isinstance(r["success"], bool) and r["policy"] and r["engine"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise SimfoundryError(f"{file} contains no rollouts; pass the output folder of `simfoundry eval`") from None


def sensitivities(
    cousins: VariedCousins, rollouts: Sequence[Mapping[str, Any]], draws: int = 2000, seed: int = 0
) -> list[SensitivityTable]:
    """Compute the sensitivities of each policy in each engine.

    All cousins have the same weight, however many rollouts they have.

    Args:
        cousins: The values of the cousins.
        rollouts: The rollouts of an evaluation. Those of other recipes and seeds are ignored.
        draws: Number of samples for intervals and p-values.
        seed: Seed for sampling.

    Raises:
        SimfoundryError: If no rollout is of one of the cousins.
    """
    groups: dict[tuple[str, str], dict[int, list[bool]]] = {}
    for rollout in rollouts:
        origin = rollout.get("cousin") or {}
        if (origin.get("recipe"), origin.get("seed")) != (cousins.recipe, cousins.seed):
            continue
        if origin.get("index") in cousins.values and rollout.get("part", "whole") == "whole":
            of = groups.setdefault((str(rollout["policy"]), str(rollout["engine"])), {})
            of.setdefault(origin["index"], []).append(rollout["success"])
    if not groups:
        text = f"no rollout is of a cousin of recipe `{cousins.recipe}` with seed {cousins.seed}"
        raise SimfoundryError(f"{text}; evaluate the folder of cousins with `simfoundry eval` first")
    rng = np.random.default_rng(seed)
    return [_table(policy, engine, of, cousins, draws, rng) for (policy, engine), of in groups.items()]


def _table(
    policy: str,
    engine: str,
    done: Mapping[int, Sequence[bool]],
    cousins: VariedCousins,
    draws: int,
    rng: np.random.Generator,
) -> SensitivityTable:
    names = dict.fromkeys(name for index in sorted(done) for name in cousins.values[index])
    numbers: list[NumberSensitivity] = []
    choices: list[ChoiceSensitivity] = []
    for name in names:
        there = [index for index in sorted(done) if name in cousins.values[index]]
        values = [cousins.values[index][name] for index in there]
        rates = np.array([np.mean(done[index]) for index in there])
        if all(isinstance(value, float) for value in values):
            numbers.append(_correlated(name, np.array(values, dtype=np.float64), rates, draws, rng))
            continue
        for value in dict.fromkeys(sorted(map(str, values))):
            of = [index for index, other in zip(there, values, strict=True) if other == value]
            count = sum(len(done[index]) for index in of)
            choices.append(ChoiceSensitivity(name, value, len(of), Rate(sum(sum(done[i]) for i in of), count)))
    corrected = iter(holm([number.p for number in numbers if number.p is not None]))
    numbers = [n if n.p is None else replace(n, p=next(corrected)) for n in numbers]
    numbers.sort(key=lambda n: -abs(n.correlation or 0.0))
    return SensitivityTable(policy, engine, len(done), sum(map(len, done.values())), tuple(numbers), tuple(choices))


def _correlated(name: str, values: Array, rates: Array, draws: int, rng: np.random.Generator) -> NumberSensitivity:
    """Return the rank correlation between the values and the success rates of cousins, both of shape (n,)."""
    low, high = float(values.min()), float(values.max())
    if low == high or rates.min() == rates.max() or len(values) < 3:
        return NumberSensitivity(name, len(values), low, high, None)
    x, y = ranks(values), ranks(rates)
    found = weighted_pearson(x[None], y[None], np.ones((1, len(x))))[0]
    resampled, permuted = [], []
    for start in range(0, draws, ROWS):
        count = min(ROWS, draws - start)
        resampled.append(weighted_pearson(x[None], y[None], rng.dirichlet(np.ones(len(x)), count)))
        shuffled = rng.permuted(np.tile(y, (count, 1)), axis=1)
        permuted.append(weighted_pearson(x[None], shuffled, np.ones((count, len(x)))))
    known = np.concatenate(resampled)
    interval = np.quantile(known[np.isfinite(known)], [0.025, 0.975])
    # Adding one to both counts keeps the p-value valid for any number of permutations (Phipson and Smyth, 2010).
    exceeding = int(np.sum(np.abs(np.concatenate(permuted)) >= abs(found) - 1e-12))
    p = (exceeding + 1) / (draws + 1)
    return NumberSensitivity(name, len(x), low, high, float(found), (float(interval[0]), float(interval[1])), p)


def ranks(values: Array) -> Array:
    """Return the rank of each value, shape (n,). Equal values share the mean of their ranks."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    mean = last - (counts - 1) / 2
    return np.asarray(mean[inverse], dtype=np.float64)
