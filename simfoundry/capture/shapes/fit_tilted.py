"""Fit bodies of revolution whose axis is not vertical, such as cans that lean, mugs that lie and bowls that tilt.

The evidence is turned until the axis is vertical, where the fits of upright bodies apply.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from simfoundry.capture.shapes.closest_points import rotations_about
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate
from simfoundry.capture.shapes.fit_lathe import (
    body_of_revolution,
    hollow_profile,
    is_open,
    profile_cost,
    rim_axis,
    solid_profile,
)
from simfoundry.capture.shapes.fit_primitives import search, start_axis
from simfoundry.capture.shapes.register_mesh import misplacement
from simfoundry.geometry.frames import Array, Pose

# Points and rays that the search for an axis uses: 30 points for each level of a profile, and a grid of 25 x 25.
POINTS, RAYS = 420, 640

# Number of directions of the axis that are tried first: 18 degrees apart.
DIRECTIONS = 130

# Least angle of the axis to the vertical [deg]; below, the fits of upright bodies are more accurate.
UPRIGHT_DEG = 6.0

# Least cosine of the axis to the direction of the camera: an end that is seen edge-on may be either one.
EDGE_ON = -0.1

# The best directions that are refined, their least angle to each other [deg], and the evaluations for each.
STARTS, APART_DEG, EVALUATIONS = 2, 25.0, 120

# Edges of the initial simplex: tilt [rad], and the share of the radius by which the axis moves.
STEP_RAD, STEP_SHARE = 0.12, 0.15

# Greatest height of the bottom inside an open container, as a share of its own: what is higher is a lid with a rim.
HIGHEST_FLOOR = 0.6

# Percentile of the heights along the axis below which points are noise.
LOWEST_PERCENTILE = 1.0


class _Family(NamedTuple):
    name: str
    profile: Callable[[Evidence, Array], Array]
    start: Callable[[Evidence], tuple[Array, float]]


class _Axis(NamedTuple):
    """An axis that ``R_TW`` turns to the vertical, and its position in xy and the radius [m] there."""

    cost: float
    R_TW: Array
    position: Array
    radius: float


_SOLID = _Family("tilted", solid_profile, start_axis)
_HOLLOW = _Family("tilted_hollow", hollow_profile, rim_axis)


def fit_tilted(evidence: Evidence) -> FitCandidate | None:
    """Return the solid of revolution about a tilted axis that explains the evidence best, or None if it is upright."""
    return _fit(_SOLID, evidence)


def fit_tilted_hollow(evidence: Evidence) -> FitCandidate | None:
    """Return the open container about a tilted axis that explains the evidence best, or None if none is open."""
    return _fit(_HOLLOW, evidence)


def _fit(family: _Family, evidence: Evidence) -> FitCandidate | None:
    few = _thinned(evidence)
    starts = sorted(filter(None, (_start(family, few, R_TW) for R_TW in _turns(few))), key=lambda axis: axis.cost)
    best = min((_refined(family, few, axis) for axis in _distinct(starts)), key=lambda axis: axis.cost, default=None)
    if best is None or best.R_TW[2, 2] > math.cos(math.radians(UPRIGHT_DEG)):
        return None
    turned = _turned(evidence, best.R_TW)
    profile = family.profile(turned, best.position)
    if family is _HOLLOW and not _is_container(turned, best.position, profile):
        return None
    upright = body_of_revolution(family.name, turned, best.position, profile)
    if upright is None:
        return None
    lowest = _lowest(best.R_TW, turned.base_z, best.position, profile)
    X_WO = Pose.from_matrix(best.R_TW.T) @ upright.X_WO
    return replace(upright, X_WO=X_WO, penalty=misplacement(evidence, lowest))


def _is_container(turned: Evidence, axis: Array, profile: Array) -> bool:
    """Return True if the camera sees into the body with a profile of :func:`hollow_profile`, and deeply."""
    return is_open(turned, axis, float(profile[:, 0].max())) and profile[0, 1] < HIGHEST_FLOOR * profile[:, 1].max()


def _turns(evidence: Evidence) -> list[Array]:
    """Return rotations, shape (3, 3) each, that turn directions to the vertical: those of tops that the camera sees."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1 - 2 * k / DIRECTIONS, k * math.pi * (3 - math.sqrt(5))
    side = np.sqrt(1 - z**2)
    directions = np.column_stack([side * np.cos(turn), side * np.sin(turn), z])
    toward = evidence.eye - np.median(evidence.points, axis=0)
    return [_to_vertical(axis) for axis in directions[directions @ toward > EDGE_ON * np.linalg.norm(toward)]]


def _to_vertical(axis: Array) -> Array:
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side), axis])


def _start(family: _Family, evidence: Evidence, R_TW: Array) -> _Axis | None:
    turned = _turned(evidence, R_TW)
    position, radius = family.start(turned)
    if family is _HOLLOW and not is_open(turned, position, radius):
        return None
    return _Axis(_cost(family, evidence, turned, R_TW, position), R_TW, position, radius)


def _cost(family: _Family, evidence: Evidence, turned: Evidence, R_TW: Array, position: Array) -> float:
    profile = family.profile(turned, position)
    lowest = _lowest(R_TW, turned.base_z, position, profile)
    return profile_cost(turned, position, profile) + misplacement(evidence, lowest)


def _refined(family: _Family, evidence: Evidence, axis: _Axis) -> _Axis:
    """Tilt and move an axis until the cost is least."""
    pivot = np.median(evidence.points, axis=0)
    start = axis.position - (axis.R_TW @ pivot)[:2]

    def placed(x: Array) -> tuple[Array, Array]:
        R_TW = rotations_about(np.array([[x[0], x[1], 0.0]]))[0] @ axis.R_TW
        return R_TW, (R_TW @ pivot)[:2] + start + x[2:]

    def cost(x: Array) -> float:
        R_TW, position = placed(x)
        return _cost(family, evidence, _turned(evidence, R_TW), R_TW, position)

    steps = np.array([STEP_RAD, STEP_RAD, STEP_SHARE * axis.radius, STEP_SHARE * axis.radius])
    value, best = search(cost, np.zeros(4), steps, EVALUATIONS)
    return _Axis(value, *placed(best), axis.radius)


def _distinct(axes: list[_Axis]) -> list[_Axis]:
    chosen: list[_Axis] = []
    for axis in axes:
        is_new = all(axis.R_TW[2] @ other.R_TW[2] < math.cos(math.radians(APART_DEG)) for other in chosen)
        if is_new and len(chosen) < STARTS:
            chosen.append(axis)
    return chosen


def _thinned(evidence: Evidence) -> Evidence:
    """Return the evidence with fewer points and rays, evenly spread."""
    points = np.linspace(0, len(evidence.points) - 1, min(len(evidence.points), POINTS)).astype(np.int64)
    rays = slice(None, None, max(1, len(evidence.rays) // RAYS))
    return replace(
        evidence,
        points=evidence.points[points],
        rays=evidence.rays[rays],
        depth=evidence.depth[rays],
        inside=evidence.inside[rays],
        hidden=evidence.hidden[rays],
    )


def _turned(evidence: Evidence, R_TW: Array) -> Evidence:
    """Return the evidence in a frame in which an axis is vertical, with the base at the lowest points."""
    points = evidence.points @ R_TW.T
    base_z = float(np.percentile(points[:, 2], LOWEST_PERCENTILE))
    support = replace(evidence.support, X_WC=Pose.from_matrix(R_TW) @ evidence.support.X_WC)
    return replace(evidence, support=support, points=points, rays=evidence.rays @ R_TW.T, base_z=base_z)


def _lowest(R_TW: Array, base_z: float, axis: Array, profile: Array) -> float:
    """Return the height [m] of the lowest point in the world of a body whose axis ``R_TW`` turns to the vertical."""
    up = R_TW[:, 2]  # of the world, in the turned frame
    reach = profile[:, 1] * up[2] - profile[:, 0] * math.hypot(up[0], up[1])
    return float(up @ [*axis, base_z] + reach.min())
