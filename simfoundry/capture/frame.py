"""The registered RGB-D image that is reconstructed, and data types that the stages of the reconstruction share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.findings import CaptureFinding
from simfoundry.errors import PicklableError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.spec.models.capture import Decomposition, SupportChoice

NEAREST, FARTHEST = 0.1, 5.0  # Measuring range of tabletop sensors [m]
MIN_PIXELS = 200  # Minimum number of pixels with depth; a plane cannot be found with fewer

# Depth units keyed by their scale to meters, most common first; used in hints when the depth is implausible.
UNITS = {
    0.001: "millimeters",
    0.0001: "tenths of a millimeter",
    1.0: "meters",
    0.01: "centimeters",
    1e-6: "micrometers",
    1000.0: "kilometers",
}


def in_range(depth: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return a mask of the depths [m] within the measuring range of tabletop sensors; NaN is outside."""
    return np.asarray((depth >= NEAREST) & (depth <= FARTHEST))


class CaptureError(PicklableError):
    """An error raised for a capture that cannot be reconstructed.

    The error contains a diagnostic code, a message and a hint.
    """

    def __init__(self, code: str, message: str, hint: str) -> None:
        super().__init__(f"{message} [{code}]\n  hint: {hint}")
        self.code = code
        self.message = message
        self.hint = hint


@dataclass(frozen=True, eq=False)
class Frame:
    """A color image with depth registered to it.

    Attributes:
        color: RGB image, shape (h, w, 3).
        depth: Depth along the optical axis [m], shape (h, w). Pixels without a reading are NaN.
        K: Intrinsic matrix [px], shape (3, 3).
        instances: Number of the object at each pixel, shape (h, w), where 0 is the background. The value is None if the
            capture has no masks.
        decomposition: Constraints on the division into objects, or None.
        support: The surface that a person chose as the support, or None.
        findings: What is doubtful about the images.
        models: Models that found the depth, each as the plain data of a :class:`ModelUse`.
    """

    color: NDArray[np.uint8]
    depth: Array
    K: Array
    instances: NDArray[np.int32] | None = None
    decomposition: Decomposition | None = None
    support: SupportChoice | None = None
    findings: tuple[CaptureFinding, ...] = ()
    models: tuple[Mapping[str, Any], ...] = ()

    @property
    def points(self) -> Array:
        """The points in the camera frame [m], as an array of shape (h, w, 3).

        Pixels without depth are NaN.
        """
        h, w = self.depth.shape
        u, v = np.meshgrid(np.arange(w), np.arange(h))
        x = (u - self.K[0, 2]) / self.K[0, 0] * self.depth
        y = (v - self.K[1, 2]) / self.K[1, 1] * self.depth
        return np.stack([x, y, self.depth], axis=-1)

    def points_of(self, mask: NDArray[np.bool_]) -> Array:
        """Return the points of the pixels under a mask of shape (h, w), in the order of rows, as in :attr:`points`.

        Returns:
            Points in the camera frame [m], shape (n, 3).
        """
        v, u = np.nonzero(mask)
        depth = self.depth[v, u]
        x, y = (u - self.K[0, 2]) / self.K[0, 0] * depth, (v - self.K[1, 2]) / self.K[1, 1] * depth
        return np.stack([x, y, depth], axis=-1)

    def cleaned(self) -> Frame:
        """Return the frame without depth values outside the sensor range.

        Raises:
            CaptureError: Too few values remain.
        """
        finite = np.isfinite(self.depth) & (self.depth > 0)
        if not finite.any():
            hint = "check that the depth file belongs to the color image, and check which values are declared invalid"
            raise CaptureError("SF502", "the depth image has no valid pixels", hint)
        valid = finite & in_range(self.depth)
        if not valid.any():
            median = float(np.median(self.depth[finite]))
            scale = next((s for s in UNITS if NEAREST <= median * s <= FARTHEST), None)
            unit = f"the unit seems to be {UNITS[scale]}" if scale else "the unit is not a common depth unit"
            hint = f"multiply the capture's depth scale by {scale:g}" if scale else "check the capture's depth scale"
            message = f"no depth value is between {NEAREST} and {FARTHEST} m (median {median:g}): {unit}"
            raise CaptureError("SF502", message, hint)
        if valid.sum() < MIN_PIXELS:
            message = f"only {valid.sum()} of {valid.size} depth pixels are between {NEAREST} and {FARTHEST} m"
            hint = f"at least {MIN_PIXELS} are required; check the sensor's range and the declared invalid values"
            raise CaptureError("SF502", message, hint)
        return replace(self, depth=np.where(valid, self.depth, np.nan))


@dataclass(frozen=True)
class SupportRival:
    """Another surface that could be the support.

    ``share`` is its evidence relative to that for the chosen surface, ``height`` [m] its position above the chosen
    surface, negative below, ``area`` its visible area [m²], and ``pixel`` (column, row) is on it. ``carried`` is the
    visible area [m²] of what stands on it and not on the chosen surface, if the two are parallel.
    """

    share: float
    height: float
    area: float
    pixel: tuple[int, int]
    carried: float = 0.0


@dataclass(frozen=True, eq=False)
class SupportLevel:
    """Another level surface that carries objects, beside the support: a lower table, a shelf, a chest.

    Attributes:
        height: Height above the support [m], negative below it.
        outline: Boundary of the visible surface in world xy [m], counterclockwise, shape (n, 2).
        inliers: Mask of the surface pixels, shape (h, w).
    """

    height: float
    outline: Array
    inliers: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SupportSurface:
    """The surface that supports the objects.

    Attributes:
        X_WC: Camera pose in the world frame. The origin of this frame is on the surface, and its z axis points up.
        outline: Boundary of the visible surface in world xy [m], shape (n, 2). The boundary is a simple
            counterclockwise polygon whose first point is not repeated at the end.
        residual: Median distance of the surface points from the plane [m].
        inliers: Mask of the surface pixels, shape (h, w).
        rivals: Other surfaces that could be the support, with the best evidence first.
        levels: Those of them that carry objects of their own.
    """

    X_WC: Pose
    outline: Array
    residual: float
    inliers: NDArray[np.bool_]
    rivals: tuple[SupportRival, ...] = ()
    levels: tuple[SupportLevel, ...] = ()

    def at(self, level: SupportLevel) -> SupportSurface:
        """Return another level as a support, with the world frame raised to its height."""
        X_WC = Pose.of(self.X_WC.p - np.array([0.0, 0.0, level.height]), self.X_WC.q)
        return SupportSurface(X_WC, level.outline, self.residual, level.inliers)


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The segmented objects above the support.

    ``labels`` contains the number of the object at each pixel, from 1 to n, or 0 if there is none. Its shape is (h, w).
    ``supports[k]`` is the number of the object that supports object ``k``, or 0 for the table.
    ``surfaces`` contains the numbers that are levels of the support and not objects, with the index of the level.
    ``pieces`` contains the numbers of the objects that the capture names in its decomposition, by name. ``unmet`` lists
    the constraints that could not be respected, as sentences. ``doubted`` are the objects that may be several, and
    ``joined`` are those whose visible parts were joined although what is between them is hidden.
    """

    labels: NDArray[np.int32]
    supports: dict[int, int]
    pieces: Mapping[str, int] = field(default_factory=dict)
    unmet: tuple[str, ...] = ()
    surfaces: Mapping[int, int] = field(default_factory=dict)
    doubted: tuple[int, ...] = ()
    joined: tuple[int, ...] = ()

    @property
    def objects(self) -> NDArray[np.int32]:
        """The labels without those of surfaces, shape (h, w)."""
        return np.where(np.isin(self.labels, list(self.surfaces)), 0, self.labels).astype(np.int32)


def depth_sigma(depth: Array) -> Array:
    """Return the standard deviation [m] of a depth reading of ``depth`` [m].

    The quadratic noise model of triangulation sensors is used, with generous, uncalibrated constants. Thresholds
    throughout the capture code are multiples of this value.
    """
    return np.asarray(0.0012 + 0.0022 * depth**2)
