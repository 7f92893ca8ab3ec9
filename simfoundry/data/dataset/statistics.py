"""Statistics of the features of a dataset: the only implementation, used by all formats, reports and checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

# The quantiles that LeRobot v3 stores, by the key under which it stores them.
QUANTILES: Mapping[str, float] = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


@dataclass(frozen=True, eq=False)
class FeatureStatistics:
    """The statistics of each value of a feature over frames, in the unit of the feature.

    Arrays have the shape of the feature. Those of images have the shape (channels,) and cover the pixels of the images
    that were sampled, such as 0 to 255 for color images.

    Attributes:
        min: The smallest value.
        max: The largest value.
        mean: The mean.
        std: The standard deviation of the population (``ddof=0``).
        count: The number of frames.
        quantiles: The quantiles in :data:`QUANTILES`, by key, interpolated linearly as ``numpy.quantile`` does.
    """

    min: Array
    max: Array
    mean: Array
    std: Array
    count: int
    quantiles: Mapping[str, Array]

    @classmethod
    def of(cls, values: NDArray[Any]) -> FeatureStatistics:
        """Return the statistics of an array whose first axis is time, computed in float64."""
        rows = np.asarray(values, dtype=np.float64)
        return cls(
            min=rows.min(axis=0),
            max=rows.max(axis=0),
            mean=rows.mean(axis=0),
            std=rows.std(axis=0),
            count=len(rows),
            quantiles=dict(zip(QUANTILES, np.quantile(rows, list(QUANTILES.values()), axis=0), strict=True)),
        )
