"""Noise of depth readings, and a check that a depth picture is in meters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.errors import CaptureError
from simfoundry.geometry.frames import Array

NEAREST, FARTHEST = 0.1, 5.0  # [m] the range in which tabletop sensors measure
MIN_PIXELS = 200  # pixels with depth: fewer show no plane


def depth_sigma(depth: Array) -> Array:
    """Standard deviation [m] of a depth reading at ``depth`` [m].

    The quadratic law of triangulating sensors with generous, uncalibrated constants; thresholds across the capture code
    are multiples of it.
    """
    return np.asarray(0.0012 + 0.0022 * depth**2)


def valid_depth(depth: Array) -> NDArray[np.bool_]:
    """Pixels with a usable reading, shape (h, w); a :class:`CaptureError` where there are too few of them."""
    finite = np.isfinite(depth) & (depth > 0)
    if not finite.any():
        raise CaptureError(
            "SF502",
            "the depth picture has no valid pixel",
            "check that the depth file belongs to the color picture, and which values the capture declares invalid",
        )
    valid = finite & (depth >= NEAREST) & (depth <= FARTHEST)
    if not valid.any():
        raise _wrong_unit(float(np.median(depth[finite])))
    if int(valid.sum()) < MIN_PIXELS:
        raise CaptureError(
            "SF502",
            f"only {int(valid.sum())} of {depth.size} depth pixels lie between {NEAREST} and {FARTHEST} m",
            f"at least {MIN_PIXELS} are needed; check the sensor's range and the declared invalid values",
        )
    return np.asarray(valid)


def _wrong_unit(median: float) -> CaptureError:
    units = [("millimeters", 0.001), ("tenths of a millimeter", 0.0001), ("micrometers", 1e-6)]
    for name, scale in units:
        if NEAREST <= median * scale <= FARTHEST:
            guess = f"it seems to be in {name}", f"set the depth scale of the capture to {scale:g} (meters per unit)"
            break
    else:
        if NEAREST <= median * 1000 <= FARTHEST:
            guess = (
                "it seems to be in kilometers, as when a scale of 0.001 is applied twice",
                "multiply the depth scale of the capture by 1000",
            )
        else:
            guess = "its unit is not one a sensor writes", "set the depth scale of the capture (meters per unit)"
    return CaptureError(
        "SF502",
        f"no depth lies between {NEAREST} and {FARTHEST} m (median {median:g}): {guess[0]}",
        guess[1],
    )
