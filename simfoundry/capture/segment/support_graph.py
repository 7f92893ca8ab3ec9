"""The support graph, which specifies the part on which each part stands.

This module also contains tests for hidden and sunken parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import depth_sigma
from simfoundry.capture.segment.masks import Labels, Mask, hull_mm, in_hull, thinned
from simfoundry.capture.segment.regions import Crop
from simfoundry.geometry.frames import Array

CONTACT = 0.015  # [m] maximum gap between an object and its support
OVERLAP = 0.05  # minimum overlap between an object and its support, as a fraction of the smaller visible footprint
# Height of the hidden underside of a ball, as a share of its visible height: it is (1 - cos a) / (1 + cos a) from an
# angle a above, which is a third from 60 degrees, and the tolerance of contacts covers the rest.
UNDERSIDE = 0.25

# Number of directions around a part, and of those in which another part must be visible to surround it. A part hides
# what is behind it, which is at most half of the directions.
SECTORS, AROUND = 12, 7
SECTOR_POINTS = 5  # minimum number of points in a direction; fewer are noise at an edge
SURROUNDED = 0.85  # minimum share of a part inside the outline of the part that surrounds it, which it hides in part
RIM_REACH = 0.06  # [m] maximum distance of what surrounds a part, and its maximum height above the bottom of the part


@dataclass(frozen=True, eq=False)
class RegionPart:
    """A labeled region.

    It stores the heights of the region above the support [m], its area facing the camera [m²], and its points in the
    world [m].
    """

    label: int
    bottom: float
    top: float
    area: float
    points_W: Array

    @property
    def is_grounded(self) -> bool:
        """True if the part reaches down to the support, given the uncertainty due to noise and smoothing."""
        return self.bottom < CONTACT + 0.005


def parts_of(labels: Labels, points_W: Array, pixel_area: Array) -> list[RegionPart]:
    """Return a part for each of the regions 1 to n, in ascending order."""
    out = []
    for label in range(1, int(labels.max()) + 1):
        mask = (labels == label) & np.isfinite(pixel_area)  # user-provided masks may include pixels without depth
        points = points_W[mask]
        bottom, top = np.quantile(points[:, 2], [0.02, 0.98]) if len(points) else (0.0, 0.0)
        out.append(RegionPart(label, float(bottom), float(top), float(pixel_area[mask].sum()), points))
    return out


def carriers(parts: list[RegionPart]) -> dict[int, int]:
    """Map each part to its support.

    The support is the part on whose top it starts or the part that contains it, or 0 for the table. If a part neither
    reaches the table nor has another part below it, its base is hidden, and it is assumed to stand on the table. Being
    close to another part is not evidence of standing on it, but being surrounded by it is: the floor of a tray, and a
    book, may be as low as the noise of the table.
    """
    return {p.label: _carrier(p, parts) for p in parts}


def _carrier(part: RegionPart, parts: list[RegionPart]) -> int:
    around = _surrounded_by(part, parts)
    if around or part.is_grounded:
        return around
    return _stood_on(part, parts) or _contained_by(part, parts)


def _surrounded_by(part: RegionPart, parts: list[RegionPart]) -> int:
    """Return the label of the smallest part that is visible on most sides of ``part``, near its bottom, or 0.

    If ``part`` starts on the top of another part that is not this one, it stands on that one.
    """
    if len(part.points_W) < 20:
        return 0
    own = thinned(part.points_W, 200)[:, :2]
    middle = (own.min(axis=0) + own.max(axis=0)) / 2
    reach = float(np.linalg.norm(np.ptp(own, axis=0))) / 2 + RIM_REACH
    best, smallest = 0, np.inf
    for other in parts:
        if other.label == part.label or len(other.points_W) < 20 or other.bottom > part.bottom + CONTACT:
            continue
        away = other.points_W[:, :2] - middle
        near = (np.hypot(*away.T) < reach) & (other.points_W[:, 2] < part.bottom + RIM_REACH)
        if not near.any() or part.bottom - np.quantile(other.points_W[near, 2], 0.9) > 2 * CONTACT:
            continue  # it ends far below the part
        turn = np.arctan2(away[near, 1], away[near, 0])
        sectors = np.bincount(np.floor((turn + np.pi) / (2 * np.pi) * (SECTORS - 1e-6)).astype(int), minlength=SECTORS)
        area = hull_area(other.points_W)
        is_around = (sectors >= SECTOR_POINTS).sum() >= AROUND and hull_area(part.points_W) < area < smallest
        if is_around and in_hull(hull_mm(other.points_W), own).mean() > SURROUNDED:
            best, smallest = other.label, area
    return best if best and _stood_on(part, parts) in (0, best) else 0


def is_content(part: RegionPart, other: RegionPart) -> bool:
    """Return True if ``part`` is surrounded by ``other`` and begins below its top, as what is in a bowl does."""
    return part.bottom < other.top and _surrounded_by(part, [part, other]) == other.label


def _stood_on(part: RegionPart, parts: list[RegionPart]) -> int:
    """Return the label of the part on which ``part`` stands, or 0 if there is no such part.

    The top of this part meets the bottom of ``part``, whose lowest visible point is higher: a ball hides its underside.
    If there are several such parts, the one with the largest overlap of footprints is returned.
    """
    farthest = 1.5 * CONTACT + UNDERSIDE * (part.top - part.bottom)
    others = [p for p in parts if p.label != part.label and -CONTACT < part.bottom - p.top < farthest]
    share, label = max(((shared_footprint(part, p), -p.label) for p in others), default=(0.0, 0))
    return -label if share > OVERLAP else 0


def _contained_by(part: RegionPart, parts: list[RegionPart]) -> int:
    """Return the label of the highest part right below ``part``, or 0.

    The lower part may also extend up beside ``part``, like the wall of a tray.
    """
    low = part.points_W[part.points_W[:, 2] < part.bottom + 0.02][:, :2]
    best, height = 0, 0.0
    for other in parts:
        if other.label == part.label or len(low) == 0:
            continue
        reach = low.min(axis=0) - 0.02, low.max(axis=0) + 0.02
        xy = other.points_W[:, :2]
        near = other.points_W[((xy > reach[0]) & (xy < reach[1])).all(axis=1)]
        under = near[near[:, 2] < part.bottom + 1.5 * CONTACT]
        if len(under) < 5:
            continue
        level = float(np.quantile(under[:, 2], 0.9))
        gap = part.bottom - level
        if gap < 2 * CONTACT and level > height and in_hull(hull_mm(other.points_W), thinned(low, 60)).mean() > 0.8:
            best, height = other.label, level
    return best


def shared_footprint(one: RegionPart, other: RegionPart) -> float:
    """Return the overlap between the convex footprints of two parts, as a fraction of the smaller footprint."""
    return footprint_overlap(one.points_W, other.points_W)


def hull_area(points_W: Array) -> float:
    """Return the area of the convex footprint of points in the world [mm²]."""
    import cv2

    return float(cv2.contourArea(hull_mm(points_W)))


def footprint_overlap(one: Array, other: Array) -> float:
    """Return the overlap between the convex footprints of two sets of points, as a fraction of the smaller one."""
    import cv2

    a, b = hull_mm(one), hull_mm(other)
    smaller = min(cv2.contourArea(a), cv2.contourArea(b))
    return float(cv2.intersectConvexConvex(a, b)[0]) / smaller if smaller > 0 else 0.0


def below(labels: Labels, crop: Crop) -> dict[int, float]:
    """Return the fraction of each region's lower edge that has an occluder or missing depth below it.

    If the fraction is 1, the base of the object may be hidden. If it is 0, the background is visible below it.
    """
    at, under, other = _pixels_below(labels, crop)
    here, there = crop.depth[at], crop.depth[under]
    in_front = (other > 0) & (there < here + 3 * depth_sigma(here))
    return _shares(labels, at, other != labels[at], in_front | ~np.isfinite(there) | (other < 0))


def sinking(labels: Labels, crop: Crop) -> dict[int, float]:
    """Return the fraction of each region's lower edge at which the surface continues below the level of the support.

    For an object on the support, the surface ends at that level. For an object on the floor behind the support, it does
    not.
    """
    at, under, other = _pixels_below(labels, crop)
    here, there = crop.points_W[at], crop.points_W[under]
    goes_on = (there[:, 2] < -0.008) & (np.linalg.norm(there - here, axis=1) < 0.04)
    return _shares(labels, at, other == 0, goes_on)


Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]


def _pixels_below(labels: Labels, crop: Crop) -> tuple[Pixels, Pixels, Labels]:
    """Return the labeled pixels, the pixels right below them, and the labels of the lower pixels.

    The direction of gravity determines the pixels below. Labels outside the crop are -1.
    """
    h, w = labels.shape
    du, dv = (round(x * (crop.reach + 2)) for x in crop.down)
    rows, columns = np.nonzero(labels > 0)
    v, u = rows + dv, columns + du
    inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
    under = np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)
    return (rows, columns), under, np.where(inside, labels[under], -1)


def _shares(labels: Labels, at: Pixels, edge: Mask, marked: Mask) -> dict[int, float]:
    """Return the fraction of the ``edge`` pixels in each region that are ``marked``."""
    count = int(labels.max()) + 1
    own = labels[at][edge]
    shares = np.bincount(own, marked[edge], count) / np.maximum(np.bincount(own, minlength=count), 1)
    return dict(enumerate(shares.tolist()))
