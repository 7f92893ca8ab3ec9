"""How well simulation tells what happens in reality, and how sure a success rate is.

Pearson's r and the mean maximum rank violation are those of the SimFoundry paper, appendix *Real-to-Sim Metrics*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simfoundry.scene.frames import Array

Z_95 = 1.959963984540054
"""Quantile of the normal distribution that leaves 5 % in both tails together."""


def pearson(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> float | None:
    """Pearson's correlation coefficient of two rows of scores, shape (n,); None where one of them does not vary.

    A row that is constant has no correlation with anything: the coefficient is 0/0, and neither 0 nor 1 would be true.
    """
    x, y = _pair(real, sim)
    if len(x) < 2 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    dx, dy = x - x.mean(), y - y.mean()
    return float(np.clip(dx @ dy / math.sqrt((dx @ dx) * (dy @ dy)), -1.0, 1.0))


def mmrv(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> float:
    """Mean maximum rank violation of two rows of scores, shape (n,), in the unit of the real ones.

    For each policy the greatest real difference to one that simulation ranks otherwise; their mean. The comparisons are
    strict, so a tie in one row and an order in the other is a violation of one of the two policies, as in the paper.
    """
    x, y = _pair(real, sim)
    if len(x) == 0:
        raise ValueError("there is no mean over no policies")
    violated = (y[:, None] < y[None, :]) != (x[:, None] < x[None, :])
    return float(np.max(np.abs(x[:, None] - x[None, :]) * violated, axis=1).mean())


def wilson(successes: int, rollouts: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval of a success rate, for ``z`` standard deviations; (0, 1) where nothing was tried.

    It stays within [0, 1] and says something sensible of 0 and of 25 successes in 25 rollouts (Wilson, 1927).
    """
    if not 0 <= successes <= rollouts:
        raise ValueError(f"{successes} successes in {rollouts} rollouts")
    if rollouts == 0:
        return 0.0, 1.0
    rate, share = successes / rollouts, z * z / rollouts
    middle = (rate + share / 2) / (1 + share)
    half = z * math.sqrt(rate * (1 - rate) / rollouts + share / (4 * rollouts)) / (1 + share)
    return max(0.0, middle - half), min(1.0, middle + half)


def _pair(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> tuple[Array, Array]:
    x, y = np.asarray(real, dtype=float), np.asarray(sim, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"as many scores of one as of the other are needed, not shapes {x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("scores must be finite")
    return x, y
