"""How often the intervals of `simfoundry correlate` hold the truth, on made-up comparisons whose truth is known.

``python -m tests.corpora.intervals`` takes seconds. Policies are drawn from all that there could be: their real rate is
uniform, their simulated one the same with noise. An interval is to hold Pearson's r of all of them.
"""

from __future__ import annotations

import numpy as np

from simfoundry.evaluate.statistics.correlation import Draws, Score, agreements
from simfoundry.evaluate.statistics.metrics import pearson
from simfoundry.geometry.frames import Array

ROLLOUTS, COMPARISONS = 25, 300


def policies(count: int, noise: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Real and simulated success rates of so many policies."""
    real = rng.random(count)
    return real, np.clip(real + noise * rng.standard_normal(count), 0.01, 0.99)


def main() -> None:
    """Print the share of 95% intervals that hold the r of all policies."""
    rng = np.random.default_rng(0)
    for noise in (0.1, 0.3):
        truth = pearson(*policies(200_000, noise, rng))
        assert truth is not None
        for count in (3, 5, 8):
            held = 0
            for k in range(COMPARISONS):
                real, sim = (
                    [Score("t", str(p), n / ROLLOUTS, ROLLOUTS) for p, n in enumerate(rng.binomial(ROLLOUTS, rates))]
                    for rates in policies(count, noise, rng)
                )
                (found,) = agreements(real, sim, Draws(800, seed=k))
                low, high = found.pearson_interval or (-1.0, 1.0)
                held += low <= truth <= high
            print(f"{count} policies, true r {truth:.2f}: {held / COMPARISONS:.0%} of the intervals hold it")


if __name__ == "__main__":
    main()
