"""Metrics of the agreement between simulation and reality, and confidence intervals of success rates.

Pearson's r and the mean maximum rank violation are defined as in the SimFoundry paper, appendix *Real-to-Sim Metrics*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array

Z_95 = 1.959963984540054
"""Quantile of the normal distribution that leaves a total of 5 % in both tails."""


def pearson(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> float | None:
    """Pearson's correlation coefficient of two rows of scores, shape (n,); None if one of them is constant.

    A constant row has no defined correlation: the coefficient is 0/0, and neither 0 nor 1 would be correct.
    """
    x, y = _pair(real, sim)
    if len(x) < 2 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    dx, dy = x - x.mean(), y - y.mean()
    return float(np.clip(dx @ dy / math.sqrt((dx @ dx) * (dy @ dy)), -1.0, 1.0))


def mmrv(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> float:
    """Mean maximum rank violation of two rows of scores, shape (n,), in the unit of the real ones.

    For each policy, take the largest real difference to a policy that simulation ranks in the opposite order; return
    the mean. Comparisons are strict, so a tie in one row and an order in the other violates the rank of one of the two
    policies, as in the paper.
    """
    x, y = _pair(real, sim)
    if len(x) == 0:
        raise ValueError("at least one policy is needed")
    violated = (y[:, None] < y[None, :]) != (x[:, None] < x[None, :])
    return float(np.max(np.abs(x[:, None] - x[None, :]) * violated, axis=1).mean())


def weighted_pearson(real: Array, sim: Array, weights: Array) -> Array:
    """Pearson's coefficient of each row of weighted scores, all of shape (rows, n); NaN for constant rows."""
    share = weights / weights.sum(axis=1, keepdims=True)
    dx, dy = (v - (share * v).sum(axis=1, keepdims=True) for v in (real, sim))
    square = (share * dx * dx).sum(axis=1) * (share * dy * dy).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.clip((share * dx * dy).sum(axis=1) / np.sqrt(square), -1.0, 1.0))


def weighted_mmrv(real: Array, sim: Array, weights: Array) -> Array:
    """Mean maximum rank violation of each row of weighted scores, all of shape (rows, n)."""
    share = weights / weights.sum(axis=1, keepdims=True)
    dx, dy = (v[:, :, None] - v[:, None, :] for v in (real, sim))
    return np.asarray((share * np.max(np.abs(dx) * ((dy < 0) != (dx < 0)), axis=2)).sum(axis=1))


def wilson(successes: int, rollouts: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's score interval of a success rate, for ``z`` standard deviations; (0, 1) without rollouts.

    It stays within [0, 1] and is meaningful even for 0 and for 25 successes in 25 rollouts (Wilson, 1927).
    """
    if not 0 <= successes <= rollouts:
        raise ValueError(f"{successes} successes in {rollouts} rollouts")
    if rollouts == 0:
        return 0.0, 1.0
    return _wilson(successes / rollouts, rollouts, z)


def _wilson(rate: float, rollouts: float, z: float) -> tuple[float, float]:
    share = z * z / rollouts
    middle = (rate + share / 2) / (1 + share)
    half = z * math.sqrt(rate * (1 - rate) / rollouts + share / (4 * rollouts)) / (1 + share)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Rate:
    """A success rate: ``done`` of ``of`` rollouts."""

    done: int
    of: int

    @property
    def share(self) -> float:
        """Rate in [0, 1]; 0 without rollouts."""
        return self.done / self.of if self.of else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the rate."""
        return wilson(self.done, self.of)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.done}/{self.of}  {self.share:.0%} ({low:.0%} to {high:.0%})"


def stratified(counts: Sequence[tuple[int, int]], z: float = Z_95) -> tuple[float, float, float]:
    """Mean rate of equally weighted strata, each (successes, rollouts), and the ends of its interval.

    The variance of the mean is that of the strata's rates, sum p(1-p)/n over the square of their number. With one
    rollout in a stratum its p(1-p) cannot be estimated, so that of the mean rate is used for all; because p(1-p) is
    concave, this never makes the interval too narrow. The interval is Wilson's for S^2 / sum(1/n) rollouts, with S
    strata of n each; with equal n, this is the interval of all rollouts together.
    """
    if not counts or any(n < 1 for _, n in counts):
        raise ValueError("each stratum needs at least one rollout")
    rate = math.fsum(k / n for k, n in counts) / len(counts)
    effective = len(counts) ** 2 / math.fsum(1 / n for _, n in counts)
    return rate, *_wilson(rate, effective, z)


def mcnemar(first_only: int, second_only: int) -> float:
    """Two-sided p-value of the exact McNemar test of paired successes (McNemar, 1947; exact: a binomial test of 1/2).

    The arguments count the pairs in which only one of the two succeeded; other pairs carry no information. 1 without
    any.
    """
    n, least = first_only + second_only, min(first_only, second_only)
    tail: int = sum(math.comb(n, k) for k in range(least + 1))
    return float(min(1.0, 2 * tail / 2**n))


EXACT_FLIPS = 16
"""Maximum number of nonzero differences for which all 2^16 sign changes are enumerated, in about 10 ms; beyond it,
signs are sampled.
"""

DRAWN_FLIPS = 20_000
"""Number of sampled sign changes, for which the standard error of p = 0.05 is 0.0015."""


def sign_flip(differences: Sequence[float], seed: int = 0) -> float:
    """Two-sided p-value of the paired permutation test that the mean of ``differences``, shape (n,), is zero.

    Under the null hypothesis the two members of a pair are exchangeable, which changes the sign of their difference
    (Fisher, 1935). All sign changes are enumerated for up to :data:`EXACT_FLIPS` differences; beyond that they are
    sampled with ``seed``, and the observed one counts as one of them.
    """
    rest = np.asarray([d for d in differences if abs(d) > 1e-12], dtype=float)
    if not len(rest):
        return 1.0
    observed = abs(rest.sum()) - 1e-9
    if len(rest) <= EXACT_FLIPS:
        bits = np.arange(2 ** len(rest))[:, None] >> np.arange(len(rest)) & 1
        return float((np.abs((2 * bits - 1) @ rest) >= observed).mean())
    rng, extreme = np.random.default_rng(seed), 1
    for _ in range(DRAWN_FLIPS // 100):  # in blocks, because 20,000 draws of 10,000 signs take 1.6 GB
        signs = rng.integers(0, 2, (100, len(rest)))
        extreme += int((np.abs((2 * signs - 1) @ rest) >= observed).sum())
    return extreme / (1 + DRAWN_FLIPS)


def holm(p: Sequence[float]) -> list[float]:
    """Correct p-values for multiple comparisons (Holm, 1979), in the same order."""
    corrected, most = [0.0] * len(p), 0.0
    for rank, k in enumerate(sorted(range(len(p)), key=lambda k: p[k])):
        most = max(most, min(1.0, (len(p) - rank) * p[k]))
        corrected[k] = most
    return corrected


def _pair(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> tuple[Array, Array]:
    x, y = np.asarray(real, dtype=float), np.asarray(sim, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"both rows must have the same number of scores, but have shapes {x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("scores must be finite")
    return x, y
