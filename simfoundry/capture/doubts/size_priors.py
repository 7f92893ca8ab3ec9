"""Judge the unit of a depth image by the sizes that tabletops have."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from simfoundry.capture.findings import IMPLAUSIBLE, CaptureFinding
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.segment.masks import Labels
from simfoundry.geometry.frames import Array

# Median and spread (standard deviation of the natural logarithm) of the distance between camera and support, and of the
# largest visible extent of the middle object, on 70 real and 100 synthetic tables of seven sensors.
DISTANCE, DISTANCE_SPREAD = 0.9, 0.30
SIZE, SIZE_SPREAD = 0.15, 0.40
# Standard deviations from the expected scale that are reported. A camera is more often near small objects than far
# from large ones: of 97 real and 55 synthetic tables, the scales are between -2.3 and 1.2.
LARGE, SMALL = 1.5, 2.1
# Minimum width [m] of the visible support, in its narrow direction, that is too large for a tabletop if the camera and
# the objects are not small either. It is from 0.68 to 1.11 on 70 real and 100 synthetic tables.
WIDE = 1.35
# Units [m] in which cameras, and collections of their images, store depth.
CAMERA_UNITS = (
    *(1.0, 0.01, 1e-3, 1e-4, 1e-6),  # round units; a Kinect and most RealSense have 1 mm, a D405 and YCB-Video 0.1 mm
    *(5e-4, 2.5e-4, 2e-4, 1.25e-4),  # half a millimeter, RealSense L515, TUM RGB-D, and RealSense SR300
    *(1 / 256, 10 / 65535),  # KITTI, and simulators that spread 10 m over 16 bits
)
CALIBRATED = 0.01  # maximum relative difference from such a unit, which a calibration may have changed


def unit_doubt(scale: float) -> Iterator[CaptureFinding]:
    """Yield a finding if no camera is known to store depth in units of ``scale`` [m]."""
    if any(abs(scale / unit - 1) <= CALIBRATED for unit in CAMERA_UNITS):
        return
    message = f"no common depth camera stores depth in units of {scale * 1000:.4g} mm"
    yield CaptureFinding(IMPLAUSIBLE, message, "check `scale` under `depth` in the capture")


def scale_doubt(frame: Frame, support: SupportSurface, labels: Labels, points_W: Array) -> Iterator[CaptureFinding]:
    """Yield a finding if the camera is too near or far and the objects are too small or large for a tabletop."""
    sizes = [extent_of(points_W[labels == k]) for k in np.unique(labels[labels > 0])]
    if not sizes:
        return
    distance = float(np.nanmedian(frame.depth[support.inliers]))
    size = float(np.median(sizes))
    off = scale_of(distance, size)
    spread = (DISTANCE_SPREAD**-2 + SIZE_SPREAD**-2) ** -0.5
    wide = support_width(support)
    if off > 0 and wide > WIDE:
        message = f"the support is at least {wide:.1f} m wide, which is large for a table that is {distance:.2f} m away"
        yield CaptureFinding(IMPLAUSIBLE, message, "check `scale` under `depth` in the capture")
    elif not -SMALL * spread <= off <= LARGE * spread:
        kind = "large" if off > 0 else "small"
        message = (
            f"the camera is {distance:.2f} m from the support and its objects are {size * 100:.0f} cm large, which is "
            f"{math.exp(abs(off)):.1f} times as {kind} as expected of a tabletop"
        )
        yield CaptureFinding(IMPLAUSIBLE, message, "check `scale` under `depth` in the capture")


def support_width(support: SupportSurface) -> float:
    """Return the width [m] of the visible support in its narrow direction."""
    import shapely

    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shapely.Polygon(support.outline)))
    return float(np.linalg.norm(np.diff(corners[:3], axis=0), axis=1).min())


def scale_of(distance: float, size: float) -> float:
    """Return the logarithm of the scale by which a distance and a size [m] exceed those of tabletops."""
    weights = DISTANCE_SPREAD**-2, SIZE_SPREAD**-2
    logs = math.log(max(distance, 1e-3) / DISTANCE), math.log(max(size, 1e-4) / SIZE)
    return sum(w * x for w, x in zip(weights, logs, strict=True)) / sum(weights)


def extent_of(points: Array) -> float:
    """Return the largest extent [m] of points, shape (n, 3), along the axes of the world, without stray ones."""
    points = points[np.isfinite(points[:, 2])]
    return float(np.ptp(np.quantile(points, [0.02, 0.98], axis=0), axis=0).max()) if len(points) else 0.0
