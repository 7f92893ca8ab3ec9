"""Fit boxes without a lid: trays, bins and cartons into which the camera can see."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate, RayAgreement
from simfoundry.capture.shapes.fit_primitives import SMALLEST, box_around, promising_cost, search, upright_box, walk
from simfoundry.capture.shapes.solid_casts import cast_open_box
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh, closed_mesh

WALL = 0.006  # [m] wall at which the fit starts; those of trays and bins are 2 to 8 mm thick, of wooden ones 12 mm
WALL_LIMITS = (0.002, 0.015)  # [m] thinner walls cannot be told from noise, and thicker ones are rare
SEEN_INSIDE = 0.15  # minimum fraction of the points that are inside the walls and below the rim
DEEP = 0.25  # minimum depth of such points below the rim, as a fraction of the height: noise at a lid is lower
YAW_STEP_DEG = 6.0  # [deg] between starts; the search turns a box by more than half of it
EVALUATIONS = 320


def fit_open_box(evidence: Evidence, rival: float = math.inf) -> FitCandidate | None:
    """Return the open box on ``base_z`` that best explains the evidence, or None if no point is inside its walls."""

    def cost(x: Array) -> float:
        outside = np.maximum(WALL_LIMITS[0] - x[6], 0) + np.maximum(x[6] - WALL_LIMITS[1], 0)
        small = np.maximum(SMALLEST - x[3:6], 0).sum()
        return evidence.cost(cast_open_box, *_solid(evidence, x)) + float(outside + small) / evidence.scale

    starts = [np.append(box_around(evidence, yaw), WALL) for yaw in np.deg2rad(np.arange(0.0, 90.0, YAW_STEP_DEG))]
    start = min(starts, key=cost)
    if _inside(evidence, start).mean() < SEEN_INSIDE:
        return None
    steps = np.array([0.006, 0.006, np.radians(4), 0.008, 0.008, 0.006, 0.003])
    most = promising_cost("open_box", rival)
    value, best = search(cost, start, steps, EVALUATIONS, most)
    best = walk(cost, value, best) if value <= most else best
    if _inside(evidence, best).mean() < SEEN_INSIDE:
        return None
    size, wall, X_WO = _solid(evidence, best)
    return FitCandidate("open_box", open_box_mesh(size, wall), X_WO, _agreement(evidence, best), wall=wall)


def open_box_mesh(size: Array, wall: float) -> Mesh:
    """Return the surface of an open box with full extents ``size`` [m], centered at the middle of its outside."""
    half = size / 2
    outer = _corners(half, -half[2], half[2])
    inner = _corners(half - wall, -half[2] + wall, half[2])
    faces = [(0, 2, 1), (0, 3, 2), (8, 9, 10), (8, 10, 11)]  # the bottom, and the floor
    for a in range(4):
        b = (a + 1) % 4
        faces += [(a, b, b + 4), (a, b + 4, a + 4)]  # outside
        faces += [(a + 8, b + 12, b + 8), (a + 8, a + 12, b + 12)]  # inside
        faces += [(a + 4, b + 4, b + 12), (a + 4, b + 12, a + 12)]  # rim
    return closed_mesh(np.concatenate([outer, inner]), np.array(faces, np.int32))


def _corners(half: Array, low: float, high: float) -> Array:
    """Return the corners of a box at two heights [m], counterclockwise as seen from above, shape (8, 3)."""
    x, y = float(half[0]), float(half[1])
    return np.array([(a, b, z) for z in (low, high) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y))])


def _solid(evidence: Evidence, x: Array) -> tuple[Array, float, Pose]:
    """Return the extents [m], the wall [m] and the pose of the open box with parameters (x, y, yaw, extents, wall)."""
    size, X_WO = upright_box(x, evidence.base_z)
    return size, float(np.clip(x[6], WALL_LIMITS[0], min(WALL_LIMITS[1], 0.3 * size.min()))), X_WO


def _agreement(evidence: Evidence, x: Array) -> RayAgreement:
    return evidence.judge(cast_open_box, *_solid(evidence, x))


def _inside(evidence: Evidence, x: Array) -> Mask:
    """Return a mask of the points that are inside the walls of an open box and clearly below its rim."""
    size, wall, X_WO = _solid(evidence, x)
    local = X_WO.inverse().apply(evidence.points)
    between = (np.abs(local[:, :2]) < size[:2] / 2 - wall - 0.5 * evidence.scale).all(axis=1)
    return np.asarray(between & (size[2] / 2 - local[:, 2] > max(DEEP * size[2], 0.7 * evidence.scale)))
