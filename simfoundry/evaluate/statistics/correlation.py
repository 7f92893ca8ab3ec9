"""Correlation of real and simulated success rates: Pearson's r and MMRV per task, with intervals from posterior
draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from simfoundry.evaluate.statistics.metrics import mmrv, pearson, weighted_mmrv, weighted_pearson
from simfoundry.evaluate.statistics.scores import Score, ScoresError
from simfoundry.geometry.frames import Array

Interval = tuple[float, float]

BLOCK = 1000
"""Number of draws per batch: MMRV compares all pairs of policies in each, 80 MB for a hundred policies."""


@dataclass(frozen=True)
class RateAgreement:
    """Agreement between simulation and reality on one task, over the policies evaluated in both.

    ``real`` and ``sim`` are rates in [0, 1] in the order of ``policies``. ``pearson`` is None if one of the two is
    constant. The intervals are central intervals over redrawn rates and policies, None with a single policy.
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
    """Options of the intervals: ``rollouts`` is the number assumed for rates that do not state it."""

    count: int = 2000
    rollouts: int = 25
    confidence: float = 0.95
    seed: int = 0


def agreements(real: Sequence[Score], sim: Sequence[Score], draws: Draws) -> list[RateAgreement]:
    """Compute the agreement on each task in both tables, in the order of the real scores; raises ScoresError if there
    is none.

    Each draw samples every rate from its Jeffreys posterior, Beta(k + 1/2, n - k + 1/2), so that 0 and 25 of 25 are not
    treated as certain, and the policies by a Bayesian bootstrap (Rubin, 1981) with weights from a flat Dirichlet.
    Resampling three to five policies with replacement would mostly leave two, and r at 1 or -1. Of 95 % intervals for 3
    to 8 policies with 25 rollouts each, 84 to 99 % contain the r of the population of policies
    (``tests/corpora/intervals.py``); of a bootstrap over the rollouts alone, 57 to 94 % did.
    """
    there = {(s.task, s.policy): s for s in sim}
    tasks: dict[str, list[tuple[Score, Score]]] = {}
    for score in real:
        twin = there.get((score.task, score.policy))
        if twin is not None:
            tasks.setdefault(score.task, []).append((score, twin))
    if not tasks:
        raise ScoresError(
            "no pair of task and policy is in both tables: "
            f"the real one has {_some(real)}; the simulated one has {_some(sim)}"
        )
    rng = np.random.default_rng(draws.seed)
    return [_agreement(task, pairs, draws, rng) for task, pairs in tasks.items()]


def left_out(real: Sequence[Score], sim: Sequence[Score]) -> list[str]:
    """List the pairs ``task × policy`` that only one of the two tables has, sorted."""
    a, b = ({(s.task, s.policy) for s in scores} for scores in (real, sim))
    return [f"{task} × {policy}" for task, policy in sorted(a ^ b)]


def reservations(scores: Sequence[Score]) -> list[str]:
    """Return a warning sentence for each rate that lacks some of its planned rollouts."""
    said = []
    for s in scores:
        of = "" if s.rollouts is None else f" of {s.rollouts + s.missing}"
        if s.missing:
            said.append(f"{s.policy} on {s.task}: {s.missing}{of} rollouts are missing; the rate is that of the others")
        if s.invalid:
            said.append(f"{s.policy} on {s.task}: {s.invalid} rollouts failed by an invalid answer")
    return said


def mean_agreement(found: Sequence[RateAgreement]) -> tuple[float | None, float]:
    """Mean of r over the tasks that define it (None if there is none), and mean MMRV over all tasks."""
    defined = [a.pearson for a in found if a.pearson is not None]
    return (fmean(defined) if defined else None), fmean(a.mmrv for a in found)


def _agreement(task: str, pairs: list[tuple[Score, Score]], draws: Draws, rng: np.random.Generator) -> RateAgreement:
    real, sim = (np.array([pair[k].rate for pair in pairs]) for k in (0, 1))
    r, violation = _drawn(pairs, draws, rng)
    return RateAgreement(
        task=task,
        policies=tuple(pair[0].policy for pair in pairs),
        real=tuple(map(float, real)),
        sim=tuple(map(float, sim)),
        pearson=pearson(real, sim),
        mmrv=mmrv(real, sim),
        pearson_interval=_interval(r, draws.confidence),
        mmrv_interval=_interval(violation, draws.confidence) if len(pairs) > 1 else None,
    )


def _drawn(pairs: list[tuple[Score, Score]], draws: Draws, rng: np.random.Generator) -> tuple[Array, Array]:
    """Pearson's r (NaN if it is undefined) and MMRV of each draw, shape (draws,)."""
    found: list[tuple[Array, Array]] = []
    for start in range(0, draws.count, BLOCK):
        count = min(BLOCK, draws.count - start)
        real, sim = (_rates([pair[k] for pair in pairs], draws, count, rng) for k in (0, 1))
        weights = rng.dirichlet(np.ones(len(pairs)), count)
        found.append((weighted_pearson(real, sim, weights), weighted_mmrv(real, sim, weights)))
    r, violation = (np.concatenate(rows) for rows in zip(*found, strict=True))
    return r, violation


def _rates(scores: list[Score], draws: Draws, count: int, rng: np.random.Generator) -> Array:
    """Sample rates from their posteriors, shape (count, policies)."""
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
