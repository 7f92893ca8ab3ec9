"""Random quantiles that depend only on the seed, the index of the cousin and the name of the value.

An entry that is added to a recipe, another order of the entries or another number of workers therefore changes no other
value. Splits restrict the quantiles, so that no two splits share a value.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from simfoundry.spec.models.vary import SplitSpec

# Number of bits of a quantile, as in the mantissa of a double.
BITS = 53


@dataclass(frozen=True)
class QuantileSource:
    """The quantiles of one cousin.

    Attributes:
        seed: Seed of the run.
        index: Index of the cousin.
        splits: Lower and upper quantile of each split, by name.
        split: Name of the cousin's split, or empty if there are no splits.
    """

    seed: int
    index: int
    splits: Mapping[str, tuple[float, float]]
    split: str = ""

    @classmethod
    def of(cls, seed: int, index: int, splits: Mapping[str, SplitSpec], split: str = "") -> QuantileSource:
        """Return the quantiles of a cousin.

        Args:
            seed: Seed of the run.
            index: Index of the cousin.
            splits: The splits of the recipe.
            split: The split to draw from. By default, the split is drawn as well, in proportion to the shares.
        """
        ends = {name: spec.ends for name, spec in splits.items()}
        source = cls(seed, index, ends, split)
        if not ends or split:
            return source
        left = source.free("split", "") * sum(high - low for low, high in ends.values())
        for name, (low, high) in ends.items():
            left -= high - low
            if left < 0:
                return cls(seed, index, ends, name)
        return cls(seed, index, ends, next(reversed(ends)))

    def free(self, stream: str, component: str) -> float:
        """Return a number in [0, 1) to which the splits do not apply, such as a direction."""
        text = f"{self.seed}/{self.index}/{stream}/{component}"
        bits = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> (64 - BITS)
        return float(bits / 2**BITS)

    def quantile(self, stream: str, component: str = "") -> float:
        """Return the quantile of a value, in [0, 1) and in the cousin's split."""
        low, high = self.splits.get(self.split, (0.0, 1.0))
        return low + self.free(stream, component) * (high - low)

    def choice(self, stream: str, count: int) -> int:
        """Return the index of one of ``count`` values. Each split has values of its own."""
        start, end = shares(count, self.splits).get(self.split, (0, count))
        return start + int(self.free(stream, "") * (end - start))


def shares(count: int, splits: Mapping[str, tuple[float, float]]) -> dict[str, tuple[int, int]]:
    """Divide ``count`` values among splits by their quantiles. Each split has at least one value.

    Returns:
        The index of the first value of each split, and that after its last value.
    """
    names = sorted(splits, key=lambda name: splits[name])
    found: dict[str, tuple[int, int]] = {}
    taken = 0
    for name in names:
        start = max(taken, round(splits[name][0] * count))
        found[name] = (start, max(start + 1, round(splits[name][1] * count)))
        taken = found[name][1]
    for name in reversed(names):  # splits that need a value of their own push those before them down
        end = min(found[name][1], count)
        found[name] = (min(found[name][0], end - 1), end)
        count = found[name][0]
    return found
