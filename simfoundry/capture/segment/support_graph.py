"""Support graph: which part stands on which, which occludes which, and which cannot be an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import depth_sigma
from simfoundry.geometry.frames import Array

CONTACT = 0.015  # [m] largest gap between an object and its support
OVERLAP = 0.05  # least share of the smaller visible footprint that an object shares with its support
Labels = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class RegionPart:
    """One labeled region: heights above the support [m], area facing the camera [m²], and points in the world [m]."""

    label: int
    bottom: float
    top: float
    area: float
    points_W: Array

    @property
    def is_grounded(self) -> bool:
        """Whether the part reaches down to the support, within what noise and smoothing leave open."""
        return self.bottom < CONTACT + 0.005


def parts_of(labels: Labels, points_W: Array, depth: Array, K: Array) -> list[RegionPart]:
    """The regions 1..n, in that order."""
    pixel_area = depth**2 / (K[0, 0] * K[1, 1])
    out = []
    for label in range(1, int(labels.max()) + 1):
        mask = (labels == label) & np.isfinite(depth)  # given masks cover pixels without depth too
        points = points_W[mask]
        bottom, top = np.quantile(points[:, 2], [0.02, 0.98]) if len(points) else (0.0, 0.0)
        out.append(RegionPart(label, float(bottom), float(top), float(pixel_area[mask].sum()), points))
    return out


def carriers(parts: list[RegionPart]) -> dict[int, int]:
    """Map each part to its support: the part that it begins on top of, else 0 for the table.

    A part that neither reaches the table nor has another part below it has a hidden foot, and stands on the table:
    being near another part is no evidence of standing on it.
    """
    return {p.label: 0 if p.is_grounded else _stood_on(p, parts) or _contained_by(p, parts) for p in parts}


def _stood_on(part: RegionPart, parts: list[RegionPart]) -> int:
    """Return the part whose top meets the bottom of ``part`` and whose footprint overlaps it most."""
    best, most = 0, OVERLAP
    for other in parts:
        if other.label != part.label and -CONTACT < part.bottom - other.top < 1.5 * CONTACT:
            share = shared_footprint(part, other)
            if share > most:
                best, most = other.label, share
    return best


def _contained_by(part: RegionPart, parts: list[RegionPart]) -> int:
    """Return the highest part right under ``part``; it may also rise beside it, as the wall of a tray does."""
    low = part.points_W[part.points_W[:, 2] < part.bottom + 0.02][:, :2]
    best, height = 0, 0.0
    for other in parts:
        if other.label == part.label or len(low) == 0:
            continue
        near = _near(low, other.points_W)
        under = near[near[:, 2] < part.bottom + 1.5 * CONTACT]
        if len(under) < 5:
            continue
        level = float(np.quantile(under[:, 2], 0.9))
        gap = part.bottom - level
        if gap < 2 * CONTACT and level > height and _is_over(low, other.points_W) > 0.8:
            best, height = other.label, level
    return best


def shared_footprint(one: RegionPart, other: RegionPart) -> float:
    """Overlap of two convex footprints, as a share of the smaller one."""
    import cv2

    a, b = footprint_hull(one.points_W), footprint_hull(other.points_W)
    smaller = min(cv2.contourArea(a), cv2.contourArea(b))
    return float(cv2.intersectConvexConvex(a, b)[0]) / smaller if smaller > 0 else 0.0


def footprint_hull(points_W: Array) -> NDArray[np.float32]:
    """Convex hull [mm] of the xy of points [m], shape (n, 2) or (n, 3)."""
    import cv2

    thinned = points_W[:: max(1, len(points_W) // 2000), :2] * 1000
    return np.asarray(cv2.convexHull(thinned.astype(np.float32)), dtype=np.float32)


def _near(low: Array, points: Array) -> Array:
    """Those of ``points`` within 2 cm around the bounding box of the xy positions ``low``."""
    lo, hi = low.min(axis=0) - 0.02, low.max(axis=0) + 0.02
    return np.asarray(points[((points[:, :2] > lo) & (points[:, :2] < hi)).all(axis=1)])


def _is_over(low: Array, ground: Array) -> float:
    """Share of the points ``low`` above the convex footprint of ``ground`` (xy [m])."""
    import cv2

    hull = footprint_hull(ground)
    feet = low[:: max(1, len(low) // 60)] * 1000
    return float(np.mean([cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0 for x, y in feet]))


def below(labels: Labels, depth: Array, down: tuple[float, float], reach: int) -> dict[int, float]:
    """Share of each region's lower edge below which an occluder, or no depth, is seen.

    ``down`` is the picture direction (u, v) of gravity. 1: the foot may be
    hidden; 0: the background is visible below it.
    """
    h, w = labels.shape
    du, dv = (round(x * (reach + 2)) for x in down)
    v, u = np.nonzero(labels > 0)
    inside = (u + du >= 0) & (u + du < w) & (v + dv >= 0) & (v + dv < h)
    hidden = np.ones(len(u), bool)
    own = labels[v, u]
    v2, u2 = (v + dv)[inside], (u + du)[inside]
    other = labels[v2, u2]
    here, there = depth[v[inside], u[inside]], depth[v2, u2]
    in_front = (other > 0) & (there < here + 3 * depth_sigma(here))
    hidden[inside] = in_front | ~np.isfinite(there)
    lower_edge = np.ones(len(u), bool)
    lower_edge[inside] = other != own[inside]
    counts = np.bincount(own[lower_edge], minlength=int(labels.max()) + 1)
    shares = np.bincount(own[lower_edge], hidden[lower_edge], minlength=int(labels.max()) + 1)
    return {k: float(shares[k] / max(1, counts[k])) for k in range(1, int(labels.max()) + 1)}


def sinking(labels: Labels, points_W: Array, down: tuple[float, float], reach: int) -> dict[int, float]:
    """Share of each region's lower edge below which its surface continues under the level of the support.

    ``down`` is the picture direction (u, v) of gravity. An object on the support ends there; one behind it
    on the floor does not.
    """
    h, w = labels.shape
    du, dv = (round(x * (reach + 2)) for x in down)
    v, u = np.nonzero(labels > 0)
    inside = (u + du >= 0) & (u + du < w) & (v + dv >= 0) & (v + dv < h)
    v, u = v[inside], u[inside]
    edge = labels[v + dv, u + du] == 0
    v, u = v[edge], u[edge]
    here, there = points_W[v, u], points_W[v + dv, u + du]
    goes_on = (there[:, 2] < -0.008) & (np.linalg.norm(there - here, axis=1) < 0.04)
    own = labels[v, u]
    counts = np.bincount(own, minlength=int(labels.max()) + 1)
    shares = np.bincount(own, goes_on, minlength=int(labels.max()) + 1)
    return {k: float(shares[k] / max(1, counts[k])) for k in range(1, int(labels.max()) + 1)}
