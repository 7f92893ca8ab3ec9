"""Judge the intrinsics of a camera: by those of depth cameras, and by the angle between objects and their support.

With a wrong focal length, planes that are perpendicular seem tilted against each other. A factor of 1.4 tilts the sides
of boxes and cans on a table, seen at 45 degrees, by 15 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from simfoundry.capture.findings import IMPLAUSIBLE, CaptureFinding
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.segment.regions import normals_of, tangents
from simfoundry.geometry.frames import Array

NARROWEST, WIDEST = (
    30.0,
    100.0,
)  # [deg] horizontal fields of view: a crop of YCB-Video has 33, a D455 90
OFF_CENTER = 0.12  # maximum distance of the principal point from the center, as a fraction of the image's width
WIDTH = 320  # [px] width of the image in which normals are estimated, over a radius of RADIUS pixels
RADIUS = 4
BIN = 2.0  # [deg] width of a bin of the histogram of tilts, which is smoothed over three bins
TILTED = 8.0  # [deg] minimum tilt that is reported; with right intrinsics, the sides of objects are within 1 degree
STEEPEST = 26.0  # [deg] maximum tilt that is searched; walls of bowls are flatter than that
FEWEST = 600  # minimum number of pixels on upright sides
CLEAR = 2.0  # minimum ratio between the numbers of pixels at this tilt and of upright pixels
HINT = "check `camera` in the capture"


def intrinsics_doubt(frame: Frame, support: SupportSurface, labels: Labels) -> Iterator[CaptureFinding]:
    """Yield a finding if no depth camera has the intrinsics of a frame, or if the sides of all objects are tilted."""
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
        yield CaptureFinding(IMPLAUSIBLE, message, HINT)
    tilt = common_tilt(frame, support, labels)
    if tilt:
        message = f"the sides of most objects are tilted by {tilt:+.0f} deg, as with wrong intrinsics"
        yield CaptureFinding(IMPLAUSIBLE, message, HINT)


def common_tilt(frame: Frame, support: SupportSurface, labels: Labels) -> float:
    """Return the tilt [deg] that the sides of most objects share, positive if they face up, or 0 for upright ones."""
    tilts = side_tilts(frame, support, labels)
    if len(tilts) < FEWEST:
        return 0.0
    edge = STEEPEST + BIN
    counts, edges = np.histogram(tilts, bins=np.arange(-edge - BIN / 2, edge + BIN, BIN))
    counts = np.convolve(counts, np.ones(3), "same")
    middles = (edges[:-1] + edges[1:]) / 2
    inner = np.abs(middles) <= STEEPEST
    best = int(np.argmax(np.where(inner, counts, 0)))
    upright = float(counts[np.abs(middles) < 2 * BIN].max())
    tilt = float(middles[best])
    return tilt if abs(tilt) >= TILTED and counts[best] > CLEAR * upright else 0.0


def side_tilts(frame: Frame, support: SupportSurface, labels: Labels) -> Array:
    """Return the angle [deg] between the surface and the support's normal, minus 90, at a sample of object pixels."""
    step = max(1, round(frame.depth.shape[1] / WIDTH))
    K = np.array(frame.K, dtype=np.float64)
    K[:2] /= step
    small = labels[::step, ::step]
    depth = np.where(small > 0, frame.depth[::step, ::step], np.nan)
    normals = normals_of(tangents(depth, RADIUS, 1, small), K)
    sine = normals @ support.X_WC.rotation[2]
    return np.asarray(np.degrees(np.arcsin(np.clip(sine[np.isfinite(sine)], -1, 1))))
