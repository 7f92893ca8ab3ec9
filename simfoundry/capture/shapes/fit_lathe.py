"""Bodies of revolution: bottles and jars as solids, bowls, cups and pots as solids with a cavity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.shapes.evidence import Evidence, RayAgreement, agreement, cast_lathe
from simfoundry.capture.shapes.fit_primitives import search, start_axis
from simfoundry.geometry.frames import Array, Pose

LEVELS = 14  # levels of a profile: about 1 cm on bottles, 5 mm on bowls
WALL = 0.004  # [m] wall of a container: crockery has 3 to 6 mm
FLOOR = 0.005  # [m] floor of a container, where it is not seen
_MIN_RADIUS = 0.003  # [m] the depth noise at half a meter
_MIN_IN_LEVEL = 4  # points that a level needs for a median


@dataclass(frozen=True, eq=False)
class LatheFit:
    """A body of revolution: ``profile`` of (radius, height above the base) [m], shape (k, 2), from the axis on top (or
    the cavity's floor) round the outside to the axis at the base; ``X_WO`` has its origin on the base.
    """

    profile: Array
    X_WO: Pose
    agreement: RayAgreement
    hollow: bool


def fit_lathe(evidence: Evidence) -> LatheFit:
    """Fit the solid of revolution with a vertical axis on ``base_z`` that best explains the evidence."""
    axis, radius = start_axis(evidence)
    return _fit(evidence, axis, radius, solid_profile, hollow=False)


def fit_hollow(evidence: Evidence) -> LatheFit | None:
    """Fit the open container of revolution that best explains the evidence; None if no points lie inside a rim."""
    axis, radius = _rim_axis(evidence)
    if cavity_share(evidence, axis, radius) < 0.08:
        return None
    fit = _fit(evidence, axis, radius, hollow_profile, hollow=True)
    rim = float(fit.profile[:, 0].max())
    return fit if cavity_share(evidence, fit.X_WO.p[:2], rim) >= 0.08 else None


def _fit(
    evidence: Evidence, axis: Array, radius: float, profile_of: Callable[[Evidence, Array], Array], *, hollow: bool
) -> LatheFit:
    def judge(x: Array) -> RayAgreement:
        return agreement(evidence, cast_lathe(evidence.eye, evidence.rays, profile_of(evidence, x), _pose(evidence, x)))

    view = evidence.view
    starts = [axis + shift * radius * view for shift in (-0.3, 0.0, 0.3)]
    start = min(starts, key=lambda x: judge(x).cost)
    _, best = search(lambda x: judge(x).cost, start, np.array([0.15 * radius, 0.15 * radius]), 60)
    return LatheFit(profile_of(evidence, best), _pose(evidence, best), judge(best), hollow)


def _pose(evidence: Evidence, axis: Array) -> Pose:
    return Pose.of((axis[0], axis[1], evidence.base_z))


def _cylindrical(evidence: Evidence, axis: Array) -> tuple[Array, Array]:
    """Distance from the axis and height above the base of every point [m]."""
    offset = evidence.points[:, :2] - axis
    return np.hypot(offset[:, 0], offset[:, 1]), evidence.points[:, 2] - evidence.base_z


def _level_radii(r: Array, z: Array, edges: Array) -> Array:
    """Median radius in each level between ``edges``, NaN where there are too few points."""
    level = np.clip(np.searchsorted(edges, z) - 1, 0, len(edges) - 2)
    out = np.full(len(edges) - 1, np.nan)
    for k in range(len(out)):
        here = r[level == k]
        if len(here) >= _MIN_IN_LEVEL:
            out[k] = np.median(here)
    return out


def _fill(z: Array, radii: Array, fallback: float) -> Array:
    """Interpolate unseen levels; hold the ends."""
    seen = np.isfinite(radii)
    if not seen.any():
        return np.full(len(z), max(fallback, _MIN_RADIUS))
    filled = np.interp(z, z[seen], radii[seen])
    padded = np.concatenate([filled[:1], filled, filled[-1:]])
    smooth = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    return np.asarray(np.maximum(smooth, _MIN_RADIUS))


def solid_profile(evidence: Evidence, axis: Array) -> Array:
    """Profile of a closed solid about ``axis``: median radius of the side in each level, and a flat top."""
    r, z = _cylindrical(evidence, axis)
    height = max(evidence.top - evidence.base_z, 2 * _MIN_RADIUS)
    side = z < height - 0.4 * evidence.scale  # above are the points of the lid
    edges = np.linspace(0.0, height, LEVELS + 1)
    centers = (edges[:-1] + edges[1:]) / 2
    radii = _fill(centers, _level_radii(r[side], z[side], edges), float(np.percentile(r, 95)))
    heights = np.concatenate([[height], centers[::-1], [0.0]])
    outline = np.concatenate([[radii[-1]], radii[::-1], [radii[0]]])
    return np.vstack([[0.0, height], np.column_stack([outline, heights]), [0.0, 0.0]])


def through_rim(evidence: Evidence, axis: Array, radius: float) -> NDArray[np.bool_]:
    """Select the points seen through the disk of ``radius`` [m] at the height of the rim, and lie clearly below it."""
    rim = evidence.top
    below = rim - evidence.points[:, 2]
    fall = evidence.eye[2] - evidence.points[:, 2]
    share = np.clip(below / np.where(np.abs(fall) < 1e-9, 1e-9, fall), 0.0, 1.0)
    crossing = evidence.points[:, :2] + share[:, None] * (evidence.eye[:2] - evidence.points[:, :2])
    distance = np.hypot(*(crossing - axis).T)
    return np.asarray((below > max(evidence.scale, 0.1 * (rim - evidence.base_z))) & (distance < radius - WALL))


def cavity_share(evidence: Evidence, axis: Array, radius: float) -> float:
    """Share of the points that can only be seen if the object is open at the top."""
    return float(through_rim(evidence, axis, radius).mean()) if len(evidence.points) else 0.0


def hollow_profile(evidence: Evidence, axis: Array) -> Array:
    """Profile of an open container about ``axis``: cavity floor, inner wall, rim, outer wall, foot."""
    r, z = _cylindrical(evidence, axis)
    height = max(evidence.top - evidence.base_z, 4 * FLOOR)
    rim = _rim_radius(r, z, height, evidence.scale)
    inner = through_rim(evidence, axis, rim)
    edges = np.linspace(0.0, height, LEVELS + 1)
    centers = (edges[:-1] + edges[1:]) / 2
    outside = _level_radii(r[~inner], z[~inner], edges)
    inside = _level_radii(r[inner], z[inner], edges)
    pooled = np.where(np.isfinite(outside), outside, inside + WALL)
    outer = _fill(centers, pooled, rim)
    floor = _floor(r, z, inner, rim, height)
    levels = np.concatenate([[0.0], centers, [height]])
    outer_at = np.concatenate([outer[:1], outer, [max(outer[-1], rim)]])
    outer_at = np.maximum(outer_at, _MIN_RADIUS + WALL)
    cavity = levels > floor + 1e-6
    seen = np.where(np.isfinite(inside), inside, np.inf)
    limit = np.concatenate([[np.inf], seen, [np.inf]])
    inner_at = np.maximum(np.minimum(outer_at - WALL, np.maximum(limit, outer_at - 4 * WALL)), _MIN_RADIUS)
    floor_radius = float(np.interp(floor, levels, inner_at))
    inward = np.vstack([[floor_radius, floor], np.column_stack([inner_at, levels])[cavity]])
    outward = np.column_stack([outer_at[::-1], levels[::-1]])
    return np.vstack([[0.0, floor], inward, outward, [0.0, 0.0]])


def _rim_radius(r: Array, z: Array, height: float, scale: float) -> float:
    near = r[z > height - max(0.8 * scale, 0.08 * height)]
    return float(np.percentile(near, 90)) if len(near) >= _MIN_IN_LEVEL else float(np.percentile(r, 95))


def _floor(r: Array, z: Array, inner: NDArray[np.bool_], rim: float, height: float) -> float:
    """Height [m] of the cavity's floor: as seen near the axis, else as deep as the points seen, else ``FLOOR``."""
    central = z[inner & (r < 0.4 * rim)]
    if len(central) >= 2 * _MIN_IN_LEVEL:
        return float(np.clip(np.median(central), FLOOR, height - 2 * FLOOR))
    return min(FLOOR, 0.3 * height)


def _rim_axis(evidence: Evidence) -> tuple[Array, float]:
    """A first axis for a container: the robust circle through the points near the top."""
    axis, radius = start_axis(evidence)
    band = max(0.8 * evidence.scale, 0.1 * (evidence.top - evidence.base_z))
    rim = evidence.points[evidence.points[:, 2] > evidence.top - band, :2]
    if len(rim) < 12:
        return axis, radius
    low, high = np.percentile(rim @ evidence.view, [2.0, 98.0])
    if high - low < radius:  # the far side of the rim was not seen
        return axis, radius
    weight = np.ones(len(rim))
    for _ in range(8):
        system = np.column_stack([2 * rim, np.ones(len(rim))]) * weight[:, None]
        solved, *_ = np.linalg.lstsq(system, (rim**2).sum(axis=1) * weight, rcond=None)
        fitted = float(np.sqrt(max(solved[2] + solved[:2] @ solved[:2], _MIN_RADIUS**2)))
        error = np.abs(np.hypot(*(rim - solved[:2]).T) - fitted)
        weight = 1.0 / np.sqrt(np.maximum(error, 0.1 * evidence.scale))
    return solved[:2], fitted
