"""Real against simulated success rates: Pearson's r and MMRV of each task, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from simfoundry.evaluate.metrics import mmrv, pearson
from simfoundry.evaluate.scores import Score, ScoresError
from simfoundry.scene.frames import Array

Interval = tuple[float, float]


@dataclass(frozen=True)
class Agreement:
    """How simulation agrees with reality on one task, over the policies that both have been tried with.

    ``real`` and ``sim`` are rates in [0, 1] in the order of ``policies``. ``pearson`` is None where one of the two does
    not vary. The intervals hold the middle share of what rollouts drawn anew give, None where no draw defines them.
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
    """How the bootstrap draws: every rollout of every policy anew, from its rate; ``rollouts`` where nobody said."""

    count: int = 2000
    rollouts: int = 25
    confidence: float = 0.95
    seed: int = 0


def agreements(real: Sequence[Score], sim: Sequence[Score], draws: Draws) -> list[Agreement]:
    """Agreement on each task that both have, in the order of the real scores; a ScoresError where there is none.

    Policies stay as they are in the bootstrap: of the three to five of a usual comparison, drawing policies anew would
    mostly leave out the very ones that differ.
    """
    there = {(s.task, s.policy): s for s in sim}
    tasks: dict[str, list[tuple[Score, Score]]] = {}
    for score in real:
        twin = there.get((score.task, score.policy))
        if twin is not None:
            tasks.setdefault(score.task, []).append((score, twin))
    if not tasks:
        raise ScoresError(
            "no task and policy stand in both tables: "
            f"the real one has {_some(real)}; the simulated one has {_some(sim)}"
        )
    rng = np.random.default_rng(draws.seed)
    return [_agreement(task, pairs, draws, rng) for task, pairs in tasks.items()]


def left_out(real: Sequence[Score], sim: Sequence[Score]) -> list[str]:
    """Pairs of ``task × policy`` that only one of the two has, sorted."""
    a, b = ({(s.task, s.policy) for s in scores} for scores in (real, sim))
    return [f"{task} × {policy}" for task, policy in sorted(a ^ b)]


def mean_agreement(found: Sequence[Agreement]) -> tuple[float | None, float]:
    """Mean of r over the tasks that define it, None where none does, and mean MMRV over all."""
    defined = [a.pearson for a in found if a.pearson is not None]
    return (fmean(defined) if defined else None), fmean(a.mmrv for a in found)


def _agreement(task: str, pairs: list[tuple[Score, Score]], draws: Draws, rng: np.random.Generator) -> Agreement:
    real, sim = (np.array([pair[k].rate for pair in pairs]) for k in (0, 1))
    again = [_drawn([pair[k] for pair in pairs], draws, rng) for k in (0, 1)]
    return Agreement(
        task=task,
        policies=tuple(pair[0].policy for pair in pairs),
        real=tuple(map(float, real)),
        sim=tuple(map(float, sim)),
        pearson=pearson(real, sim),
        mmrv=mmrv(real, sim),
        pearson_interval=_interval(pearson, again, draws.confidence),
        mmrv_interval=_interval(mmrv, again, draws.confidence),
    )


def _drawn(scores: list[Score], draws: Draws, rng: np.random.Generator) -> Array:
    """Rates of rollouts drawn anew, shape (draws, policies)."""
    counts = [s.rollouts or draws.rollouts for s in scores]
    return np.column_stack(
        [rng.binomial(n, s.rate, draws.count) / n for n, s in zip(counts, scores, strict=True)]
    ).astype(float)


def _interval(metric: Callable[[Array, Array], float | None], again: list[Array], confidence: float) -> Interval | None:
    found = [value for x, y in zip(*again, strict=True) if (value := metric(x, y)) is not None]
    if not found:
        return None
    tail = (1 - confidence) / 2
    low, high = np.quantile(found, [tail, 1 - tail])
    return float(low), float(high)


def _some(scores: Sequence[Score]) -> str:
    names = [f"{s.task} × {s.policy}" for s in scores[:3]]
    return ", ".join(names) + (f" and {len(scores) - 3} more" if len(scores) > 3 else "")
