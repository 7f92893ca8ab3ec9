"""Find the ground below furniture that fills the view and whose faces look like tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.capture.frame import CaptureError, Frame, SupportSurface, depth_sigma
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.planes import Plane, candidate_planes
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.capture import SupportChoice

# Points that lie farther below a plane than so many standard deviations of depth are not noise. The ground has at most
# this share of them, such as a floor beside a table.
DEVIATIONS, MOST_BELOW = 5.0, 0.05

# Number of points to look at; planes are found with as many.
POINTS = 20_000


def find_ground(frame: Frame) -> SupportSurface:
    """Return the surface on which an object stands.

    It is the support that a capture would have, unless much of the view lies below it and a larger surface is below
    everything: the front of a cabinet looks like a table, and its handles like objects on it. A person's choice in
    ``frame.support`` always wins.

    Raises:
        CaptureError: If there is no surface.
    """
    try:
        found = find_support(frame)
    except CaptureError:
        found = None
    if found is not None and frame.support is not None:
        return found
    clean = frame.cleaned()
    points = clean.points[np.isfinite(clean.depth)]
    points = points[:: max(1, len(points) // POINTS)]
    if found is not None and _share_below(_plane_of(found), points) < MOST_BELOW:
        return found
    planes = candidate_planes(points, np.random.default_rng(0)) if len(points) else []
    low = [plane for plane in planes if _share_below(plane, points) < MOST_BELOW]
    largest = max(low, key=lambda plane: _count_on(plane, points), default=None)
    if largest is None or (found is not None and _count_on(largest, points) < _count_on(_plane_of(found), points)):
        return found or find_support(frame)
    a, b, c = map(float, largest.normal)
    return find_support(replace(frame, support=SupportChoice(plane=(a, b, c, largest.offset))))


def _plane_of(surface: SupportSurface) -> Plane:
    """Return the plane of a surface in the camera frame."""
    X_CW = surface.X_WC.inverse()
    normal = X_CW.rotation[:, 2]
    return Plane(normal, float(normal @ X_CW.p))


def _share_below(plane: Plane, points: Array) -> float:
    """Return the share of points of the camera frame [m], shape (n, 3), that are below a plane."""
    return float((plane.height(points) < -DEVIATIONS * depth_sigma(points[:, 2])).mean())


def _count_on(plane: Plane, points: Array) -> int:
    """Return how many points of the camera frame [m], shape (n, 3), are on a plane."""
    return int((np.abs(plane.height(points)) < DEVIATIONS * depth_sigma(points[:, 2])).sum())
