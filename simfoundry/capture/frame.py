"""One registered RGB-D picture, the input of every later stage of a capture, and what the stages find in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose

NEAREST, FARTHEST = 0.1, 5.0  # [m] the range in which tabletop sensors measure
MIN_PIXELS = 200  # pixels with depth: fewer show no plane

# Units of depth by their scale to meters, the most common first, for a hint where depth is implausible.
UNITS = {
    0.001: "millimeters",
    0.0001: "tenths of a millimeter",
    1.0: "meters",
    0.01: "centimeters",
    1e-6: "micrometers",
    1000.0: "kilometers",
}


class CaptureError(Exception):
    """A capture that cannot be turned into a scene: a stable ``code``, the fault, and a hint that says what to do."""

    def __init__(self, code: str, message: str, hint: str) -> None:
        super().__init__(f"{message} [{code}]\n  hint: {hint}")
        self.code = code
        self.message = message
        self.hint = hint


@dataclass(frozen=True, eq=False)
class Frame:
    """A color picture with depth registered to it.

    ``color`` uint8 RGB, shape (h, w, 3); ``depth`` [m] along the optical axis, float64, shape (h, w), NaN where there
    is none; ``K`` the intrinsics [px], shape (3, 3); ``instances`` int32, shape (h, w), 0 where there is no object and
    one number an object, or None where the capture has no masks.
    """

    color: NDArray[np.uint8]
    depth: Array
    K: Array
    instances: NDArray[np.int32] | None = None

    @property
    def points(self) -> Array:
        """Points in the camera frame [m], shape (h, w, 3), NaN where there is no depth."""
        h, w = self.depth.shape
        u, v = np.meshgrid(np.arange(w), np.arange(h))
        x = (u - self.K[0, 2]) / self.K[0, 0] * self.depth
        y = (v - self.K[1, 2]) / self.K[1, 1] * self.depth
        return np.stack([x, y, self.depth], axis=-1)

    def cleaned(self) -> Frame:
        """Return the frame without depth outside the range of sensors; :class:`CaptureError` if too little remains."""
        finite = np.isfinite(self.depth) & (self.depth > 0)
        if not finite.any():
            hint = "check that the depth file belongs to the color picture, and which values are declared invalid"
            raise CaptureError("SF502", "the depth picture has no valid pixel", hint)
        valid = finite & (self.depth >= NEAREST) & (self.depth <= FARTHEST)
        if not valid.any():
            median = float(np.median(self.depth[finite]))
            scale = next((s for s in UNITS if NEAREST <= median * s <= FARTHEST), None)
            unit = f"it seems to be in {UNITS[scale]}" if scale else "its unit is not one a sensor writes"
            hint = (
                f"multiply the depth scale of the capture by {scale:g}" if scale else "check the capture's depth scale"
            )
            message = f"no depth lies between {NEAREST} and {FARTHEST} m (median {median:g}): {unit}"
            raise CaptureError("SF502", message, hint)
        if valid.sum() < MIN_PIXELS:
            message = f"only {valid.sum()} of {valid.size} depth pixels lie between {NEAREST} and {FARTHEST} m"
            hint = f"at least {MIN_PIXELS} are needed; check the sensor's range and the declared invalid values"
            raise CaptureError("SF502", message, hint)
        return replace(self, depth=np.where(valid, self.depth, np.nan))


@dataclass(frozen=True, eq=False)
class SupportSurface:
    """Supporting surface of the objects.

    ``X_WC`` puts the camera into the world whose origin lies on the surface, z up; ``outline`` [m] is the boundary of
    the seen surface in world xy, shape (n, 2), counter-clockwise, simple, not repeated at its end; ``residual`` [m] is
    the median distance of its points from the plane; ``inliers`` bool, shape (h, w), marks its pixels.
    """

    X_WC: Pose
    outline: Array
    residual: float
    inliers: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Objects above the support.

    ``labels`` int32, shape (h, w): 0 where there is no object, else 1..n. ``supports[k]`` is the support of object
    ``k``: another object's number, or 0 for the table.
    """

    labels: NDArray[np.int32]
    supports: dict[int, int]


def depth_sigma(depth: Array) -> Array:
    """Standard deviation [m] of a depth reading at ``depth`` [m].

    The quadratic law of triangulating sensors with generous, uncalibrated constants; thresholds across the capture code
    are multiples of it.
    """
    return np.asarray(0.0012 + 0.0022 * depth**2)
