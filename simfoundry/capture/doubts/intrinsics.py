"""Judge the intrinsics of a camera: by those of depth cameras, and by what objects look like with another focal length.

A wrong focal length stretches the scene across the viewing direction. The sides of boxes and cans then lean, each by an
angle that depends on where it faces, and round objects become oval. A single factor of the focal length makes all of
them upright and round again, so the factor can be measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.doubts.object_normals import RELATED, TYPICAL, ObjectNormals
from simfoundry.capture.findings import IMPLAUSIBLE, CaptureFinding
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.geometry.frames import Array
from simfoundry.geometry.ray_casts import unit

NARROWEST, WIDEST = 30.0, 100.0  # [deg] horizontal fields of view: a crop of YCB-Video has 33, a D455 90
OFF_CENTER = 0.12  # maximum distance of the principal point from the center, as a fraction of the image's width
STEP = 0.09  # step of the natural logarithm of the focal length in the search; on real tables, the best one is 0 or 1
FACTORS = np.exp(np.arange(-8, 9) * STEP)  # factors of the focal length that are tried, from 0.49 to 2.05
UPRIGHT = 2.5  # [deg] standard deviation of the tilt of upright sides, as normals are measured
ROUND = 0.004  # [m] standard deviation of the distance between a normal and the axis of a round object
FARTHEST = 0.1  # [m] range of the distances between normals and an axis on objects that are not round
SLOPING = 0.25  # minimum horizontal part of a unit normal that points to an axis; flatter surfaces point anywhere
FEWEST = 60  # minimum number of such pixels of an object
WRONG = 0.17  # minimum absolute logarithm of the factor that is reported: two steps
CERTAIN = 12.0  # minimum gain of such a factor that is reported: at most 8 on right tables, at least 37 on wrong ones
HINT = "check `camera` in the capture"


@dataclass(frozen=True)
class FocalFit:
    """The factor of the stated focal length with which objects are most upright and round.

    ``gain`` is the logarithm of the likelihood ratio between this factor and 1.
    """

    factor: float
    gain: float


def intrinsics_doubt(frame: Frame, support: SupportSurface, seen: ObjectNormals) -> Iterator[CaptureFinding]:
    """Yield a finding if no depth camera has the intrinsics, or if another focal length suits the objects."""
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
    fit = focal_fit(support, seen)
    if abs(math.log(fit.factor)) > WRONG and fit.gain > CERTAIN:
        message = (
            f"the sides of objects lean and round objects are oval, as if the focal length were {fit.factor:.2f} times "
            "the stated one"
        )
        yield CaptureFinding(IMPLAUSIBLE, message, HINT)


def focal_fit(support: SupportSurface, seen: ObjectNormals) -> FocalFit:
    """Return the factor of the focal length with which objects are most upright and round."""
    up = support.X_WC.rotation[2]
    likelihood = [_log_likelihood(seen, up, factor) for factor in FACTORS]
    stated = len(FACTORS) // 2
    best = max(range(len(FACTORS)), key=lambda k: (likelihood[k], -abs(k - stated)))  # the stated one without objects
    return FocalFit(float(FACTORS[best]), float(likelihood[best] - likelihood[stated]))


def _log_likelihood(seen: ObjectNormals, up: Array, factor: float) -> float:
    """Return the log-likelihood of a focal length, up to a constant.

    Args:
        seen: Points and normals as measured with the stated focal length.
        up: Normal of the support in the camera frame, shape (3,).
        factor: Factor of the focal length.
    """
    points, labels = seen.points, seen.labels
    stretch = np.array([factor, factor, 1.0])  # of normals; points are stretched by its inverse
    up, normals = unit(up * stretch), unit(seen.normals * stretch)
    tilt = np.degrees(np.arcsin(np.clip(normals @ up, -1, 1)))
    total = _log_mixture(tilt, UPRIGHT, 180.0).sum()
    right = unit(np.cross(up, [0.0, 0.0, 1.0]))
    plan = np.stack([right, np.cross(up, right)], axis=1)
    # Distances in a plan that is stretched are compared in units of the plan of the stated focal length.
    scale = math.sqrt(float(np.prod(np.linalg.norm(plan / stretch[:, None], axis=0))))
    xy, toward = (points / stretch) @ plan / scale, normals @ plan
    length = np.linalg.norm(toward, axis=1)
    for k in np.unique(labels):
        own = (labels == k) & (length > SLOPING)
        if own.sum() >= FEWEST:
            total += _log_mixture(_off_axis(xy[own], toward[own] / length[own, None]), ROUND, FARTHEST).sum()
    return float(total) / RELATED


def _off_axis(xy: Array, toward: Array) -> Array:
    """Return the distance [m] between the axis of an object and the line along each normal in plan, shape (n,).

    The axis is the point that most lines approach. All lines of a surface of revolution meet in its axis.
    """
    across = np.stack([toward[:, 1], -toward[:, 0]], axis=1)
    offset = np.einsum("nk,nk->n", across, xy)
    weight, off = np.ones(len(xy)), offset
    center = xy.mean(axis=0)
    prior = 1e-4 * len(xy) * np.eye(2)  # where all lines are parallel, the axis is beside the middle of the points
    for _ in range(6):
        weighted = across * weight[:, None]
        center = center + np.linalg.solve(across.T @ weighted + prior, weighted.T @ (offset - across @ center))
        off = offset - across @ center
        weight = 1 / (1 + (off / (1.5 * ROUND)) ** 2)
    return np.asarray(off)


def _log_mixture(error: Array, spread: float, span: float) -> Array:
    """Return the log-density of errors that are normal with a standard deviation, or else uniform over a span."""
    normal = np.exp(-0.5 * (error / spread) ** 2) / (spread * math.sqrt(2 * math.pi))
    return np.asarray(np.log(TYPICAL * normal + (1 - TYPICAL) / span))
