"""Judge the unit of a depth image and the intrinsics of a camera by the sizes that tabletops have."""

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
DOUBT = 2.3  # standard deviations from the expected scale that are reported; 2 % of right captures are beyond it
NARROWEST, WIDEST = 30.0, 100.0  # [deg] horizontal fields of view of depth cameras: 43 (Ensenso) to 90 (D455)
OFF_CENTER = 0.12  # maximum distance of the principal point from the center, as a fraction of the image's width


def scale_doubt(frame: Frame, support: SupportSurface, labels: Labels, points_W: Array) -> Iterator[CaptureFinding]:
    """Yield a finding if the camera is too near or far and the objects are too small or large for a tabletop."""
    sizes = [extent_of(points_W[labels == k]) for k in range(1, int(labels.max()) + 1)]
    if not sizes:
        return
    distance = float(np.median(frame.depth[support.inliers]))
    size = float(np.median(sizes))
    off = scale_of(distance, size)
    spread = (DISTANCE_SPREAD**-2 + SIZE_SPREAD**-2) ** -0.5
    if abs(off) > DOUBT * spread:
        kind = "large" if off > 0 else "small"
        message = (
            f"the camera is {distance:.2f} m from the support and its objects are {size * 100:.0f} cm large, which is "
            f"{math.exp(abs(off)):.1f} times as {kind} as expected of a tabletop"
        )
        yield CaptureFinding(IMPLAUSIBLE, message, "check `scale` under `depth` in the capture")


def scale_of(distance: float, size: float) -> float:
    """Return the logarithm of the scale by which a distance and a size [m] exceed those of tabletops."""
    weights = DISTANCE_SPREAD**-2, SIZE_SPREAD**-2
    logs = math.log(max(distance, 1e-3) / DISTANCE), math.log(max(size, 1e-4) / SIZE)
    return sum(w * x for w, x in zip(weights, logs, strict=True)) / sum(weights)


def extent_of(points: Array) -> float:
    """Return the largest extent [m] of points, shape (n, 3), along the axes of the world, without stray ones."""
    points = points[np.isfinite(points[:, 2])]
    return float(np.ptp(np.quantile(points, [0.02, 0.98], axis=0), axis=0).max()) if len(points) else 0.0


def intrinsics_doubt(frame: Frame) -> Iterator[CaptureFinding]:
    """Yield a finding if no depth camera has the intrinsics of a frame."""
    h, w = frame.depth.shape
    fx, fy, cx, cy = (float(frame.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    field = math.degrees(2 * math.atan(w / 2 / fx))
    faults = []
    if not NARROWEST <= field <= WIDEST:
        faults.append(f"a horizontal field of view of {field:.0f} deg")
    if not 0.9 < fx / fy < 1.1:
        faults.append(f"pixels that are {fx / fy:.2f} times as wide as high")
    if max(abs(cx - w / 2), abs(cy - h / 2)) > OFF_CENTER * w:
        faults.append(f"the principal point [{cx:.0f}, {cy:.0f}] far from the center of the image")
    if faults:
        message = f"the camera has {' and '.join(faults)}, as after cropping or scaling the image"
        yield CaptureFinding(IMPLAUSIBLE, message, "check `camera` in the capture")
