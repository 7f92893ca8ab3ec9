"""Metrics of the agreement between simulation and reality, and confidence intervals for success rates.

Pearson's r and the mean maximum rank violation are defined as in the SimFoundry paper, appendix *Real-to-Sim Metrics*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array

# The two-sided 95% quantile of the standard normal distribution, which leaves 2.5% in each tail.
Z_95 = 1.959963984540054


def pearson(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> float | None:
    """Return Pearson's correlation coefficient between two arrays of scores of shape (n,).

    The result is None if either array is constant. In that case, the coefficient is 0/0 and therefore undefined.
    """
    x, y = _pair(real, sim)
    if len(x) < 2 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    dx, dy = x - x.mean(), y - y.mean()
    return float(np.clip(dx @ dy / math.sqrt((dx @ dx) * (dy @ dy)), -1.0, 1.0))


def mmrv(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> float:
    """Return the mean maximum rank violation of two arrays of scores of shape (n,).

    The result has the unit of the real scores. For each policy, the rank violation is the largest real difference from
    any policy that the simulation ranks in the opposite order. The result is the mean over the policies. Comparisons
    are strict, as in the paper, so if two policies are tied in only one of the arrays, the rank of one of them is
    violated.
    """
    x, y = _pair(real, sim)
    if len(x) == 0:
        raise ValueError("at least one policy is needed")
    violated = (y[:, None] < y[None, :]) != (x[:, None] < x[None, :])
    return float(np.max(np.abs(x[:, None] - x[None, :]) * violated, axis=1).mean())


def weighted_pearson(real: Array, sim: Array, weights: Array) -> Array:
    """Return Pearson's correlation coefficient for each row of weighted scores.

    All arguments have shape (rows, n). The result is NaN for constant rows.
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    dx, dy = (v - (share * v).sum(axis=1, keepdims=True) for v in (real, sim))
    square = (share * dx * dx).sum(axis=1) * (share * dy * dy).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.clip((share * dx * dy).sum(axis=1) / np.sqrt(square), -1.0, 1.0))


def weighted_mmrv(real: Array, sim: Array, weights: Array) -> Array:
    """Return the mean maximum rank violation for each row of weighted scores.

    All arguments have shape (rows, n).
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    dx, dy = (v[:, :, None] - v[:, None, :] for v in (real, sim))
    return np.asarray((share * np.max(np.abs(dx) * ((dy < 0) != (dx < 0)), axis=2)).sum(axis=1))


def wilson(successes: int, rollouts: int, z: float = Z_95) -> tuple[float, float]:
    """Return Wilson's score interval for a success rate at ``z`` standard deviations.

    The interval stays within [0, 1] and is meaningful even for 0 or 25 successes in 25 rollouts (Wilson, 1927). If
    there are no rollouts, it is (0, 1).
    """
    if not 0 <= successes <= rollouts:
        raise ValueError(f"{successes} successes in {rollouts} rollouts")
    if rollouts == 0:
        return 0.0, 1.0
    return _wilson(successes / rollouts, rollouts, z)


def _wilson(rate: float, rollouts: float, z: float) -> tuple[float, float]:
    """Return Wilson's score interval for a rate. The number of rollouts need not be an integer."""
    share = z * z / rollouts
    middle = (rate + share / 2) / (1 + share)
    half = z * math.sqrt(rate * (1 - rate) / rollouts + share / (4 * rollouts)) / (1 + share)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Rate:
    """A success rate of ``done`` successes in ``of`` rollouts."""

    done: int
    of: int

    @property
    def share(self) -> float:
        """The rate as a number from 0 to 1.

        The value is 0 if there are no rollouts.
        """
        return self.done / self.of if self.of else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95% interval for the rate."""
        return wilson(self.done, self.of)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.done}/{self.of}  {self.share:.0%} ({low:.0%} to {high:.0%})"


def stratified(counts: Sequence[tuple[int, int]], z: float = Z_95) -> tuple[float, float, float]:
    """Return the mean rate of equally weighted strata, followed by the lower and upper bounds of its interval.

    The variance of the mean is the sum of p(1-p)/n over the strata, divided by the squared number of strata. With a
    single rollout in a stratum, p(1-p) cannot be estimated, so the value for the mean rate is used for all strata.
    Because p(1-p) is concave, this never makes the interval too narrow. The interval is Wilson's interval for S^2 /
    sum(1/n) rollouts, with S strata of n rollouts each. If all n are equal, this is the interval of the pooled
    rollouts.

    Args:
        counts: The numbers of successes and rollouts in each stratum.
        z: The width of the interval in standard deviations.
    """
    if not counts or any(n < 1 for _, n in counts):
        raise ValueError("each stratum needs at least one rollout")
    rate = math.fsum(k / n for k, n in counts) / len(counts)
    effective = len(counts) ** 2 / math.fsum(1 / n for _, n in counts)
    return rate, *_wilson(rate, effective, z)


def mcnemar(first_only: int, second_only: int) -> float:
    """Return the two-sided p-value of the exact McNemar test on paired successes (McNemar, 1947).

    The exact test is a binomial test with probability 1/2. The arguments count the pairs in which only the first or
    only the second member succeeded. All other pairs carry no information. If there is no such pair, the p-value is 1.
    """
    n, least = first_only + second_only, min(first_only, second_only)
    tail: int = sum(math.comb(n, k) for k in range(least + 1))
    return float(min(1.0, 2 * tail / 2**n))


# The maximum number of nonzero differences for which all sign changes are enumerated: 2^16 take about 10 ms. Beyond
# that, sign changes are sampled.
EXACT_FLIPS = 16

# The number of sampled sign changes; with this many, the standard error at p = 0.05 is 0.0015.
DRAWN_FLIPS = 20_000


def sign_flip(differences: Sequence[float], seed: int = 0) -> float:
    """Return the two-sided p-value of a paired permutation test for zero mean of ``differences``.

    Under the null hypothesis, the two members of each pair are exchangeable, and swapping them flips the sign of their
    difference (Fisher, 1935). For up to :data:`EXACT_FLIPS` differences, all sign changes are enumerated. Beyond that,
    they are sampled with ``seed``, and the observed signs are included as one of the samples.

    Args:
        differences: The differences, shape (n,).
        seed: The seed for sampling sign changes.
    """
    rest = np.asarray([d for d in differences if abs(d) > 1e-12], dtype=float)
    if not len(rest):
        return 1.0
    observed = abs(rest.sum()) - 1e-9
    if len(rest) <= EXACT_FLIPS:
        bits = np.arange(2 ** len(rest))[:, None] >> np.arange(len(rest)) & 1
        return float((np.abs((2 * bits - 1) @ rest) >= observed).mean())
    rng, extreme = np.random.default_rng(seed), 1
    for _ in range(DRAWN_FLIPS // 100):  # in blocks, because 20,000 draws of 10,000 signs would take 1.6 GB
        signs = rng.integers(0, 2, (100, len(rest)))
        extreme += int((np.abs((2 * signs - 1) @ rest) >= observed).sum())
    return extreme / (1 + DRAWN_FLIPS)


def holm(p: Sequence[float]) -> list[float]:
    """Correct p-values for multiple comparisons (Holm, 1979), preserving their order."""
    corrected, most = [0.0] * len(p), 0.0
    for rank, k in enumerate(sorted(range(len(p)), key=lambda k: p[k])):
        most = max(most, min(1.0, (len(p) - rank) * p[k]))
        corrected[k] = most
    return corrected


def _pair(real: Sequence[float] | Array, sim: Sequence[float] | Array) -> tuple[Array, Array]:
    x, y = np.asarray(real, dtype=float), np.asarray(sim, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"both arrays must have the same number of scores, but have shapes {x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("scores must be finite")
    return x, y
