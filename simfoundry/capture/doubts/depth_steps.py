"""Find a constant error of depth by the steps between its readings.

A stereo camera, or one that projects a pattern, measures disparity in equal steps, so that the inverses of its readings
are equally spaced. They are no longer if a length was added to all readings, and are again if it is subtracted. The
length is found to half a centimeter on any scene, if depth is stored in finer steps and was not filtered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.findings import IMPLAUSIBLE, CaptureFinding
from simfoundry.geometry.frames import Array

LENGTHS = np.arange(-20, 21) * 0.005  # [m] lengths that are tried
# [1/m] range of the spacing of inverse readings: 0.0029 in a Kinect, 0.0007 in a RealSense D435
FINEST, COARSEST = 0.0005, 0.004
BIN = 5e-5  # [1/m] width of the bins in which inverse readings are counted, a tenth of the finest spacing
RANGE = (0.02, 0.98)  # quantiles of the readings that are used, without stray ones
# Minimum periodicity of equally spaced readings, which is 1 if all are exactly so, and minimum ratio to that of lengths
# at least NEXT [m] away. On 70 real tables, stored in millimeters, both are at least 0.43 and 1.42; the length is 0.
PERIODIC, DISTINCT, NEXT = 0.2, 1.2, 0.015
ADDED = 0.015  # [m] minimum length that is reported; a correction of a calibration is smaller
FEWEST, ENOUGH = 5000, 300_000  # minimum number of readings, and number of those that are used of more
NARROW = 0.05  # minimum range of the readings, relative to the nearest one
DIGITS = 5  # decimals [m] to which readings are rounded, so that there are few different ones


@dataclass(frozen=True)
class DepthSteps:
    """The length [m] without which inverse readings are most periodic, and their periodicity with and without it.

    ``periodicity`` is between 0 and 1, and ``rival`` is that of the best other length.
    """

    added: float
    periodicity: float
    rival: float

    @property
    def is_certain(self) -> bool:
        """True if the readings are equally spaced for this length only."""
        return self.periodicity > max(PERIODIC, DISTINCT * self.rival)


def steps_doubt(depth: Array) -> Iterator[CaptureFinding]:
    """Yield a finding if a length seems to have been added to all readings."""
    steps = depth_steps(depth)
    if steps is not None and steps.is_certain and abs(steps.added) >= ADDED:
        kind = "large" if steps.added > 0 else "small"
        length = f"{abs(steps.added) * 100:.1f} cm"
        message = f"all depth seems to be {length} too {kind}: its steps are even only if this is corrected"
        hint = "check what is added to the depth, and the position from which it is measured"
        yield CaptureFinding(IMPLAUSIBLE, message, hint)


def depth_steps(depth: Array) -> DepthSteps | None:
    """Return the length without which the readings of a depth image [m] are equally spaced in their inverse.

    The result is None if there are too few readings.
    """
    z = depth[np.isfinite(depth)]
    z = z[:: max(1, len(z) // ENOUGH)]
    if len(z) < FEWEST:
        return None
    low, high = np.quantile(z, RANGE)
    if low <= 2 * LENGTHS[-1] or high - low < NARROW * low:
        return None
    z, counts = np.unique(np.round(z[(z >= low) & (z <= high)], DIGITS), return_counts=True)
    found = np.array([_periodicity(1 / (z - length), counts) for length in LENGTHS])
    best = int(np.argmax(found))
    other = np.abs(LENGTHS - LENGTHS[best]) >= NEXT
    return DepthSteps(float(LENGTHS[best]), float(found[best]), float(found[other].max()))


def _periodicity(values: Array, weights: NDArray[np.intp]) -> float:
    """Return the largest share of values, shape (n,), that one spacing explains, each as often as its weight."""
    low, high = float(values.min()), float(values.max())
    bins = max(2, int((high - low) / BIN))
    counts, _ = np.histogram(values, bins, (low, high), weights=weights)
    size = 1 << (4 * bins).bit_length()  # padded, so that no spacing is between two frequencies
    spectrum = np.abs(np.fft.rfft(counts, size)) / float(weights.sum())
    spacing = size * (high - low) / bins / np.maximum(np.arange(len(spectrum)), 1)
    return float(spectrum[(spacing >= FINEST) & (spacing <= COARSEST)].max(initial=0.0))
