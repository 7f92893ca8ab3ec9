"""Statistics of the features of a dataset: the only implementation, used by all formats, reports and checks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

# The quantiles that LeRobot v3 stores, by the key under which it stores them.
QUANTILES: Mapping[str, float] = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

# Maximum number of images of an episode that are counted; LeRobot samples at least as many of longer episodes.
SAMPLED_IMAGES = 100

# Resolution at which depths are counted [m], that of images in millimeters, and the largest depth that is counted.
DEPTH_STEP, DEPTH_BINS = 1e-3, 2**16


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

    def to_json(self) -> dict[str, Any]:
        """Return the statistics as JSON data, from which :meth:`from_json` restores them."""
        arrays = {"min": self.min, "max": self.max, "mean": self.mean, "std": self.std, **self.quantiles}
        return {key: np.asarray(value).tolist() for key, value in arrays.items()} | {"count": self.count}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> FeatureStatistics:
        """Restore statistics.

        Raises:
            ValueError, TypeError, KeyError: If the data are not such statistics.
        """
        arrays = {key: np.array(data[key], dtype=np.float64) for key in ("min", "max", "mean", "std")}
        quantiles = {key: np.array(data[key], dtype=np.float64) for key in QUANTILES if key in data}
        return cls(**arrays, count=int(data["count"]), quantiles=quantiles)


def sampled_frames(length: int) -> set[int]:
    """Return the frames of an episode whose images are counted, evenly distributed."""
    return {int(k) for k in np.linspace(0, length - 1, min(length, SAMPLED_IMAGES)).round()}


@dataclass(frozen=True, eq=False)
class PixelCounts:
    """Histograms of the pixel values in the sampled images of a feature, which determine its statistics exactly.

    Attributes:
        counts: The number of pixels with each value, int64, shape (channels, values).
        step: The difference between successive values: 1, or the resolution of depths [m].
        frames: The number of images.
    """

    counts: NDArray[np.int64]
    step: float
    frames: int

    @classmethod
    def of(cls, images: Iterable[NDArray[Any]]) -> PixelCounts:
        """Count the pixels of images of shape (height, width, channels). There must be at least one."""
        total, step, frames = None, 1.0, 0
        for image in images:
            step = 1.0 if image.dtype.kind in "iu" else DEPTH_STEP
            rows = [_counted(image[..., k].ravel(), step) for k in range(image.shape[2])]
            new = _stacked(rows)
            total = new if total is None else _stacked([*_added(total, new)])
            frames += 1
        if total is None:
            raise ValueError("there are no images to count")
        return cls(total, step, frames)

    @classmethod
    def stored(cls, counts: NDArray[np.int64], dtype: str, frames: int) -> PixelCounts:
        """Return counts that were read from a file, of images of a type such as ``uint8``."""
        return cls(counts, 1.0 if np.dtype(dtype).kind in "iu" else DEPTH_STEP, frames)

    def __add__(self, other: PixelCounts) -> PixelCounts:
        return PixelCounts(_stacked([*_added(self.counts, other.counts)]), self.step, self.frames + other.frames)

    def statistics(self) -> FeatureStatistics:
        """Return the statistics of all counted pixels, shape (channels,)."""
        values = np.arange(self.counts.shape[1]) * self.step
        totals = self.counts.sum(axis=1)
        mean = (self.counts @ values) / totals
        variance = np.einsum("ck,ck->c", self.counts, (values - mean[:, None]) ** 2) / totals
        present = self.counts > 0
        cumulative = self.counts.cumsum(axis=1)
        return FeatureStatistics(
            min=present.argmax(axis=1) * self.step,
            max=(present.shape[1] - 1 - present[:, ::-1].argmax(axis=1)) * self.step,
            mean=mean,
            std=np.sqrt(variance),
            count=self.frames,
            quantiles={key: _quantile(cumulative, q) * self.step for key, q in QUANTILES.items()},
        )


def _counted(values: NDArray[Any], step: float) -> NDArray[np.int64]:
    if step != 1.0:
        values = np.clip(np.rint(values / step), 0, DEPTH_BINS - 1).astype(np.int64)
    return np.bincount(np.maximum(values, 0))


def _stacked(rows: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return rows of different lengths as one array, padded with zeros."""
    width = max(map(len, rows))
    return np.array([np.pad(row, (0, width - len(row))) for row in rows], dtype=np.int64)


def _added(a: NDArray[np.int64], b: NDArray[np.int64]) -> Iterable[NDArray[np.int64]]:
    for x, y in zip(a, b, strict=True):
        padded = _stacked([x, y])
        yield padded[0] + padded[1]


def _quantile(cumulative: NDArray[np.int64], q: float) -> Array:
    """Return the quantile in each row of cumulative counts, interpolated linearly between neighbors."""
    found = []
    for row in cumulative:
        position = (int(row[-1]) - 1) * q
        low = int(np.floor(position))
        below, above = np.searchsorted(row, [low, min(low + 1, int(row[-1]) - 1)], side="right")
        found.append(below + (above - below) * (position - low))
    return np.array(found, dtype=np.float64)
