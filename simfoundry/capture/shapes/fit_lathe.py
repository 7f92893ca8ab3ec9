"""Fit bodies of revolution to bottles, jars, bowls, cups and pots.

Bottles and jars are solid, whereas bowls, cups and pots are hollow.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate, RayAgreement, binned_medians, smooth_gaps
from simfoundry.capture.shapes.fit_primitives import promising_cost, search, start_axis
from simfoundry.capture.shapes.solid_casts import cast_lathe
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import revolved

LEVELS = 14  # number of levels in a profile; they are about 1 cm apart on bottles and 5 mm on bowls
WALL = 0.004  # [m] wall thickness of a container; crockery walls are 3 to 6 mm thick
OPEN = 0.08  # minimum fraction of the points that are visible only if the object is open at the top
PROFILE_STEP = 0.0007  # [m] half the depth noise of a good sensor at half a meter
SIDES = 32  # number of sides of a solid of revolution; the radius is off by at most 0.5%
FLOOR = 0.005  # [m] floor thickness of a container whose floor is not visible
_MIN_RADIUS = 0.003  # [m] the depth noise at half a meter
_MIN_IN_LEVEL = 4  # minimum number of points in a level for computing a median


def fit_lathe(evidence: Evidence, rival: float = math.inf) -> FitCandidate | None:
    """Fit the solid of revolution with a vertical axis on ``base_z`` that best explains the evidence.

    The result is None if its profile would cross itself.
    """
    most = promising_cost("lathe", rival)
    return body_of_revolution("lathe", evidence, *_fit(evidence, *start_axis(evidence), solid_profile, most))


def fit_hollow(evidence: Evidence, rival: float = math.inf) -> FitCandidate | None:
    """Fit the open container of revolution that best explains the evidence.

    The result is None if there are no points inside a rim.
    """
    axis, radius = rim_axis(evidence)
    if not is_open(evidence, axis, radius):
        return None
    axis, profile = _fit(evidence, axis, radius, hollow_profile, promising_cost("hollow", rival))
    if not is_open(evidence, axis, float(profile[:, 0].max())):
        return None
    return body_of_revolution("hollow", evidence, axis, profile)


def _fit(
    evidence: Evidence, axis: Array, radius: float, profile_of: Callable[[Evidence, Array], Array], most: float
) -> tuple[Array, Array]:
    """Search for the best axis near ``axis`` [m], and return it along with the profile about it.

    The search ends early if the cost remains above ``most``.
    """

    def cost(x: Array) -> float:
        return profile_cost(evidence, x, profile_of(evidence, x))

    start = min((axis + shift * radius * evidence.view for shift in (-0.3, 0.0, 0.3)), key=cost)
    _, best = search(cost, start, np.array([0.15 * radius, 0.15 * radius]), 60, most)
    return best, profile_of(evidence, best)


def body_of_revolution(family: str, evidence: Evidence, axis: Array, profile: Array) -> FitCandidate | None:
    """Return the solid with a profile about the vertical axis at ``axis`` [m], or None if the profile crosses itself.

    The profile is simplified by up to ``PROFILE_STEP``, but its ends are preserved.
    """
    import shapely

    rounded = shapely.LineString(np.round(profile, 4))
    lines = [rounded.simplify(step, preserve_topology=False) for step in (PROFILE_STEP, PROFILE_STEP / 3)]
    line = next((line for line in (*lines, rounded) if len(line.coords) > 3 and shapely.Polygon(line).is_valid), None)
    if line is None:
        return None
    simple = np.asarray(line.coords)
    judged = _agreement(evidence, axis, profile)
    return FitCandidate(family, revolved(simple, SIDES), _pose(evidence, axis), judged, profile=simple)


def profile_cost(evidence: Evidence, axis: Array, profile: Array) -> float:
    """Return the cost of the solid with a profile about the vertical axis at ``axis`` [m]."""
    return evidence.cost(cast_lathe, profile, _pose(evidence, axis))


def _agreement(evidence: Evidence, axis: Array, profile: Array) -> RayAgreement:
    return evidence.judge(cast_lathe, profile, _pose(evidence, axis))


def _pose(evidence: Evidence, axis: Array) -> Pose:
    return Pose.of((axis[0], axis[1], evidence.base_z))


def _cylindrical(evidence: Evidence, axis: Array) -> tuple[Array, Array]:
    """Return the distance from the axis and the height above the base for every point [m]."""
    offset = evidence.points[:, :2] - axis
    return np.hypot(offset[:, 0], offset[:, 1]), evidence.points[:, 2] - evidence.base_z


def _level_radii(r: Array, z: Array, edges: Array) -> Array:
    """Return the median radius in each level between ``edges``.

    The result is NaN for levels with too few points.
    """
    level = np.clip(np.searchsorted(edges, z) - 1, 0, LEVELS - 1)
    return binned_medians(level, r, LEVELS, _MIN_IN_LEVEL)


def _fill(z: Array, radii: Array, fallback: Callable[[], float]) -> Array:
    """Interpolate levels that were not visible. Values beyond the ends are extrapolated as constants."""
    filled = smooth_gaps(z, radii) if np.isfinite(radii).any() else np.full(len(z), fallback())
    return np.maximum(filled, _MIN_RADIUS)


def solid_profile(evidence: Evidence, axis: Array) -> Array:
    """Return the profile of a closed solid about ``axis``.

    It consists of the median side radius in each level and a flat top.
    """
    r, z = _cylindrical(evidence, axis)
    height = max(evidence.top - evidence.base_z, 2 * _MIN_RADIUS)
    side = z < height - 0.4 * evidence.scale  # points above this height are on the lid
    edges = np.linspace(0.0, height, LEVELS + 1)
    centers = (edges[:-1] + edges[1:]) / 2
    radii = _fill(centers, _level_radii(r[side], z[side], edges), lambda: float(np.percentile(r, 95)))
    heights = np.concatenate([[height], centers[::-1], [0.0]])
    outline = np.concatenate([[radii[-1]], radii[::-1], [radii[0]]])
    return np.vstack([[0.0, height], np.column_stack([outline, heights]), [0.0, 0.0]])


def is_open(evidence: Evidence, axis: Array, radius: float) -> bool:
    """Return True if enough points are visible only through an opening with the given ``radius`` [m] at the top."""
    return bool(_seen_through_rim(evidence, axis, radius).mean() >= OPEN)


def _seen_through_rim(evidence: Evidence, axis: Array, radius: float) -> Mask:
    """Return a mask of the points that are clearly below the rim and seen through the opening.

    The opening has the given ``radius`` [m].
    """
    below = evidence.top - evidence.points[:, 2]
    if evidence.eye[2] <= evidence.top:  # the camera is not above the rim, as if the container lies and faces away
        return np.zeros(len(below), dtype=bool)
    fall = evidence.eye[2] - evidence.points[:, 2]
    share = np.clip(below / np.where(np.abs(fall) < 1e-9, 1e-9, fall), 0.0, 1.0)
    crossing = evidence.points[:, :2] + share[:, None] * (evidence.eye[:2] - evidence.points[:, :2])
    distance = np.hypot(*(crossing - axis).T)
    deep = below > max(evidence.scale, 0.1 * (evidence.top - evidence.base_z))
    return np.asarray(deep & (distance < radius - WALL))


def hollow_profile(evidence: Evidence, axis: Array) -> Array:
    """Return the profile of an open container about ``axis``.

    It consists of the cavity floor, the inner wall, the rim, the outer wall, and the base.
    """
    r, z = _cylindrical(evidence, axis)
    height = max(evidence.top - evidence.base_z, 4 * FLOOR)
    near_rim = r[z > height - max(0.8 * evidence.scale, 0.08 * height)]
    rim = float(np.percentile(near_rim, 90) if len(near_rim) >= _MIN_IN_LEVEL else np.percentile(r, 95))
    inner = _seen_through_rim(evidence, axis, rim)
    edges = np.linspace(0.0, height, LEVELS + 1)
    centers = (edges[:-1] + edges[1:]) / 2
    outside = _level_radii(r[~inner], z[~inner], edges)
    inside = _level_radii(r[inner], z[inner], edges)
    outer = _fill(centers, np.where(np.isfinite(outside), outside, inside + WALL), lambda: rim)
    floor = min(FLOOR, 0.3 * height)
    central = z[inner & (r < 0.4 * rim)]
    if len(central) >= 2 * _MIN_IN_LEVEL:
        floor = float(np.clip(np.median(central), FLOOR, height - 2 * FLOOR))
    levels = np.concatenate([[0.0], centers, [height]])
    outer_at = np.maximum(np.concatenate([outer[:1], outer, [max(outer[-1], rim)]]), _MIN_RADIUS + WALL)
    limit = np.concatenate([[np.inf], np.where(np.isfinite(inside), inside, np.inf), [np.inf]])
    inner_at = np.maximum(np.minimum(outer_at - WALL, np.maximum(limit, outer_at - 4 * WALL)), _MIN_RADIUS)
    wall = np.column_stack([inner_at, levels])[levels > floor + 1e-6]
    outward = np.column_stack([outer_at[::-1], levels[::-1]])
    return np.vstack([[0.0, floor], [np.interp(floor, levels, inner_at), floor], wall, outward, [0.0, 0.0]])


def rim_axis(evidence: Evidence) -> tuple[Array, float]:
    """Return an initial axis and radius for an open container, in xy [m].

    They are the result of a robust circle fit to the points near the top.
    """
    axis, radius = start_axis(evidence)
    band = max(0.8 * evidence.scale, 0.1 * (evidence.top - evidence.base_z))
    rim = evidence.points[evidence.points[:, 2] > evidence.top - band, :2]
    if len(rim) < 12:
        return axis, radius
    low, high = np.percentile(rim @ evidence.view, [2.0, 98.0])
    if high - low < radius:  # the far side of the rim is not visible
        return axis, radius
    weight = np.ones(len(rim))
    for _ in range(8):
        system = np.column_stack([2 * rim, np.ones(len(rim))]) * weight[:, None]
        solved, *_ = np.linalg.lstsq(system, (rim**2).sum(axis=1) * weight, rcond=None)
        fitted = float(np.sqrt(max(solved[2] + solved[:2] @ solved[:2], _MIN_RADIUS**2)))
        error = np.abs(np.hypot(*(rim - solved[:2]).T) - fitted)
        weight = 1.0 / np.sqrt(np.maximum(error, 0.1 * evidence.scale))
    return solved[:2], fitted
