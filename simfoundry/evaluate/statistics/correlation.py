"""Correlation between real and simulated success rates.

For each task, the correlation is measured by Pearson's r and by MMRV, with uncertainty intervals. The rates are read
from a table or from the results of `simfoundry eval`. A table is a CSV file with a header. It has the columns ``task``,
``policy`` and either ``rate`` (0 to 1, or a percentage with ``%``) or ``successes`` and ``rollouts``. The column
``rollouts`` may also accompany ``rate``. Lines starting with ``#`` are comments.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.metrics import mmrv, pearson, weighted_mmrv, weighted_pearson
from simfoundry.geometry.frames import Array

# The maximum size of a table [bytes].
MOST_BYTES = 32 * 2**20


class ScoresError(SimfoundryError):
    """An error in a table of scores.

    The message includes the file, the line and the expected content.
    """


@dataclass(frozen=True)
class Score:
    """The success rate of a policy on a task.

    Attributes:
        rate: The success rate, from 0 to 1.
        rollouts: The number of rollouts with a result, or None if it is unknown.
        invalid: The number of those rollouts that failed because of an invalid response.
        missing: The number of additional rollouts that have no result.
    """

    task: str
    policy: str
    rate: float
    rollouts: int | None
    engine: str = ""
    invalid: int = 0
    missing: int = 0


def read_scores(path: Path) -> list[Score]:
    """Read scores, in file order, from a CSV table, a ``results.json`` file, or a folder that contains such a file.

    Rows of ``results.json`` without any result are skipped.
    """
    file = path / "results.json" if path.is_dir() else path
    if file.stat().st_size > MOST_BYTES:
        raise ScoresError(f"{file} is larger than {MOST_BYTES >> 20} MiB, the limit for a table of success rates")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScoresError(f"{file} is not UTF-8 text: {error.reason} at byte {error.start}") from None
    rows = _json_rows(file, text) if file.suffix == ".json" else _csv_rows(file, text)
    scores: dict[tuple[str, str, str], Score] = {}
    for place, row in rows:
        if row.get("rollouts") == 0 and row.get("missing"):
            continue
        score = _score(place, row)
        if (score.task, score.policy, score.engine) in scores:
            raise ScoresError(f"{place}: {score.policy} on {score.task} is a duplicate; list each pair only once")
        scores[score.task, score.policy, score.engine] = score
    if not scores:
        raise ScoresError(f"{file} contains no scores; add a line with task, policy and rate for each score")
    return list(scores.values())


def _csv_rows(file: Path, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line.lstrip()[0] != "#"]
    reader = csv.DictReader((line for _, line in lines), skipinitialspace=True)
    header = {name.strip() for name in reader.fieldnames or ()}
    if not {"task", "policy"} <= header or not ("rate" in header or {"successes", "rollouts"} <= header):
        wanted = "task, policy and rate, or task, policy, successes and rollouts"
        raise ScoresError(
            f"{file}:1: the header must contain {wanted}; it contains {', '.join(sorted(header)) or 'nothing'}"
        )
    for (number, _), row in zip(lines[1:], reader, strict=False):
        yield f"{file}:{number}", {key.strip(): value for key, value in row.items() if isinstance(key, str)}


def _json_rows(file: Path, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ScoresError(f"{file} is not valid JSON: {error}") from None
    rows = data.get("scores") if isinstance(data, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ScoresError(f"{file} has no list `scores`; `simfoundry eval` writes one into results.json")
    for k, row in enumerate(rows):
        onward = {"task": f"{row.get('task')}+{row['from']}"} if row.get("from") else {}
        yield f"{file}: scores[{k}]", {**row, **onward}


def _score(place: str, row: Mapping[str, Any]) -> Score:
    task, policy = (str(row.get(key) or "").strip() for key in ("task", "policy"))
    if not task or not policy:
        raise ScoresError(f"{place}: task and policy are required")
    rollouts = _number(place, row, "rollouts")
    successes = _number(place, row, "successes")
    rate = _number(place, row, "rate")
    if rollouts is not None and (rollouts < 1 or rollouts != int(rollouts)):
        raise ScoresError(f"{place}: rollouts must be a whole number above 0, not {rollouts:g}")
    if rate is None:
        if successes is None or rollouts is None:
            raise ScoresError(f"{place}: either a rate, or successes and rollouts are required")
        rate = successes / rollouts
    if not 0 <= rate <= 1:
        hint = "use a number between 0 and 1, or a percentage such as 34%"
        raise ScoresError(f"{place}: {rate:g} is not a success rate; {hint}")
    counts = {key: int(_number(place, row, key) or 0) for key in ("invalid", "missing")}
    of, engine = None if rollouts is None else int(rollouts), str(row.get("engine") or "")
    return Score(task, policy, rate, of, engine, **counts)


def by_engine(scores: list[Score]) -> dict[str, list[Score]]:
    """Group the scores by engine, preserving their order.

    Scores from a table without engines form a single group, whose name is the empty string.
    """
    found: dict[str, list[Score]] = {}
    for score in scores:
        found.setdefault(score.engine, []).append(score)
    return found


def _number(place: str, row: Mapping[str, Any], key: str) -> float | None:
    value = row.get(key)
    if value is None or str(value).strip() in ("", "-", "--"):
        return None
    word = str(value).strip()
    try:
        number = float(word.removesuffix("%")) / (100 if word.endswith("%") else 1)
    except ValueError:
        raise ScoresError(f"{place}: {key} is `{word[:40]}`, which is not a number") from None
    if not math.isfinite(number):
        raise ScoresError(f"{place}: {key} is `{word[:40]}`, which is not finite")
    return number


Interval = tuple[float, float]

# Number of draws per batch. MMRV compares all pairs of policies in each draw, which takes 80 MB for 100 policies.
BLOCK = 1000


@dataclass(frozen=True)
class RateAgreement:
    """The agreement between simulation and reality on a task, for the policies that were evaluated in both.

    Attributes:
        policies: The names of the policies.
        real: The real success rate of each policy, from 0 to 1.
        sim: The simulated success rate of each policy, from 0 to 1.
        pearson: Pearson's r, or None if either set of rates is constant.
        mmrv: The mean maximum rank violation.
        pearson_interval: The central interval for r over resampled rates and policies, or None for a single policy.
        mmrv_interval: The central interval for MMRV over resampled rates and policies, or None for a single policy.
    """

    task: str
    policies: tuple[str, ...]
    real: tuple[float, ...]
    sim: tuple[float, ...]
    pearson: float | None
    mmrv: float
    pearson_interval: Interval | None = None
    mmrv_interval: Interval | None = None


@dataclass(frozen=True)
class Draws:
    """Options for computing the intervals.

    ``count`` is the number of draws. ``rollouts`` is the number of rollouts to assume for rates whose number of
    rollouts is unknown.
    """

    count: int = 2000
    rollouts: int = 25
    confidence: float = 0.95
    seed: int = 0


def agreements(real: Sequence[Score], sim: Sequence[Score], draws: Draws) -> list[RateAgreement]:
    """Compute the agreement on each task that is in both tables, in the order of the real scores.

    Each draw samples every rate from its Jeffreys posterior, Beta(k + 1/2, n - k + 1/2), so that rates of 0 and 25 out
    of 25 are not treated as certain. It also samples the policies with a Bayesian bootstrap (Rubin, 1981), with weights
    from a flat Dirichlet distribution. Resampling three or four policies with replacement would often leave only two
    distinct policies, for which r is always 1 or -1. For 3 to 8 policies with 25 rollouts each, 84 to 99% of the 95%
    intervals contain the r of the underlying policy population (``tests/corpora/intervals.py``). For a bootstrap over
    the rollouts alone, 57 to 94% do.

    Raises:
        ScoresError: If the two tables have no combination of task and policy in common.
    """
    there = {(s.task, s.policy): s for s in sim}
    tasks: dict[str, list[tuple[Score, Score]]] = {}
    for score in real:
        if (score.task, score.policy) in there:
            tasks.setdefault(score.task, []).append((score, there[score.task, score.policy]))
    if not tasks:
        raise ScoresError(
            "the two tables have no task and policy in common: "
            f"the real one contains {_some(real)}; the simulated one contains {_some(sim)}"
        )
    rng = np.random.default_rng(draws.seed)
    return [_agreement(task, pairs, draws, rng) for task, pairs in tasks.items()]


def left_out(real: Sequence[Score], sim: Sequence[Score]) -> list[str]:
    """Return all ``task × policy`` pairs that appear in only one of the two tables, in sorted order."""
    a, b = ({(s.task, s.policy) for s in scores} for scores in (real, sim))
    return [f"{task} × {policy}" for task, policy in sorted(a ^ b)]


def reservations(scores: Sequence[Score]) -> list[str]:
    """Return a warning for each rate that has missing rollouts or invalid responses."""
    said = []
    for s in scores:
        name, of = f"{s.policy} on {s.task}", "" if s.rollouts is None else f" of {s.rollouts + s.missing}"
        said += [f"{name}: {s.missing}{of} rollouts are missing and not included in the rate"] * bool(s.missing)
        said += [f"{name}: {s.invalid} rollouts failed because of an invalid response"] * bool(s.invalid)
    return said


def mean_agreement(found: Sequence[RateAgreement]) -> tuple[float | None, float]:
    """Return the mean r and the mean MMRV over all tasks.

    Tasks for which r is undefined are excluded from the mean r, which is None if r is undefined for every task.
    """
    defined = [a.pearson for a in found if a.pearson is not None]
    return (fmean(defined) if defined else None), fmean(a.mmrv for a in found)


def _agreement(task: str, pairs: list[tuple[Score, Score]], draws: Draws, rng: np.random.Generator) -> RateAgreement:
    policies = tuple(score.policy for score, _ in pairs)
    real, sim = (tuple(pair[k].rate for pair in pairs) for k in (0, 1))
    r, violation = (_interval(drawn, draws.confidence) for drawn in _drawn(pairs, draws, rng))
    violation = violation if len(pairs) > 1 else None
    return RateAgreement(task, policies, real, sim, pearson(real, sim), mmrv(real, sim), r, violation)


def _drawn(pairs: list[tuple[Score, Score]], draws: Draws, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return Pearson's r and MMRV for each draw, as two arrays of shape (draws,).

    Undefined values of r are NaN.
    """
    found: list[tuple[Array, Array]] = []
    for start in range(0, draws.count, BLOCK):
        count = min(BLOCK, draws.count - start)
        real, sim = (_rates([pair[k] for pair in pairs], draws, count, rng) for k in (0, 1))
        weights = rng.dirichlet(np.ones(len(pairs)), count)
        found.append((weighted_pearson(real, sim, weights), weighted_mmrv(real, sim, weights)))
    r, violation = (np.concatenate(rows) for rows in zip(*found, strict=True))
    return r, violation


def _rates(scores: list[Score], draws: Draws, count: int, rng: np.random.Generator) -> Array:
    """Draw samples of the rates from their posteriors, as an array of shape (count, policies)."""
    of = np.array([s.rollouts or draws.rollouts for s in scores], dtype=float)
    done = np.array([s.rate for s in scores]) * of
    return rng.beta(done + 0.5, of - done + 0.5, (count, len(scores)))


def _interval(drawn: Array, confidence: float) -> Interval | None:
    defined = drawn[np.isfinite(drawn)]
    if not len(defined):
        return None
    tail = (1 - confidence) / 2
    low, high = np.quantile(defined, [tail, 1 - tail])
    return float(low), float(high)


def _some(scores: Sequence[Score]) -> str:
    names = [f"{s.task} × {s.policy}" for s in scores[:3]]
    return ", ".join(names) + (f" and {len(scores) - 3} more" if len(scores) > 3 else "")
