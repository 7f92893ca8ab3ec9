"""Fit a box in any orientation, as cartons have that lean on others."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.capture.shapes.closest_points import rotations_about
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate
from simfoundry.capture.shapes.fit_primitives import DEPTH_PRIOR, SMALLEST, promising_cost, search
from simfoundry.capture.shapes.register_mesh import misplacement
from simfoundry.capture.shapes.solid_casts import cast_box
from simfoundry.capture.shapes.visible_cloud import VisibleCloud
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box

# Number of points whose normals are compared.
POINTS = 400

# Normals within this angle [deg] belong to one face: those of noisy points at 1 m are off by 6 degrees.
FACE_DEG = 14.0

# Least share of the points on a second face.
SECOND_FACE = 0.08

# A box with an axis within this angle [deg] of the vertical is upright, for which another fit is more accurate.
UPRIGHT_DEG = 7.0

# Edges of the initial simplex: translation [m], rotation [rad] and extents [m]; evaluations of each of two simplices.
STEPS, EVALUATIONS = (0.006,) * 3 + (0.07,) * 3 + (0.01,) * 3, 220


def fit_leaning_box(evidence: Evidence, rival: float = math.inf) -> FitCandidate | None:
    """Return the box in any orientation that explains the evidence best, or None if it is upright."""
    cloud = VisibleCloud.of(evidence, POINTS)
    axes, is_deep = _axes(cloud)
    if np.abs(axes[2]).max() > math.cos(math.radians(UPRIGHT_DEG)):
        return None
    local = evidence.points @ axes
    low, high = np.percentile(local, [1.0, 99.0], axis=0)
    if not is_deep:  # only one face is visible, so that the extent behind it is a guess
        low[0] = min(low[0], high[0] - DEPTH_PRIOR * float(np.min((high - low)[1:])))
    start_size, middle = np.maximum(high - low, SMALLEST), axes @ ((low + high) / 2)
    pivot = evidence.points.mean(axis=0)

    def box(x: Array) -> tuple[Array, Pose]:
        turn = rotations_about(x[None, 3:6])[0]
        X_WO = Pose.from_matrix(turn @ axes)
        return np.maximum(start_size + x[6:9], SMALLEST), Pose.of(pivot + turn @ (middle - pivot) + x[:3], X_WO.q)

    def cost(x: Array) -> float:
        size, X_WO = box(x)
        low_z = float(X_WO.p[2] - np.abs(X_WO.rotation[2]) @ size / 2)
        return evidence.cost(cast_box, size, X_WO) + misplacement(evidence, low_z)

    x = np.zeros(len(STEPS))
    for scale in (1.0, 0.4):
        value, x = search(cost, x, scale * np.array(STEPS), EVALUATIONS, promising_cost("leaning", rival))
    size, X_WO = box(x)
    if np.abs(X_WO.rotation[2]).max() > math.cos(math.radians(UPRIGHT_DEG)):
        return None
    result = evidence.judge(cast_box, size, X_WO)
    return FitCandidate("leaning", Box(frozen_array(size)), X_WO, result, not is_deep, penalty=value - result.cost)


def _axes(cloud: VisibleCloud) -> tuple[Array, bool]:
    """Return the axes of a box as columns, the normal of its largest visible face first, shape (3, 3).

    The second value is False if no other face is visible; the others then align with the outline of this one.
    """
    first, _ = _largest_face(cloud.normals)
    beside = np.abs(cloud.normals @ first) < math.sin(math.radians(2 * FACE_DEG))
    second, share = _largest_face(cloud.normals[beside]) if beside.any() else (first, 0.0)
    is_deep = share * beside.mean() >= SECOND_FACE
    if not is_deep:
        second = _outline_direction(cloud.points, first)
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)]), is_deep


def _largest_face(normals: Array) -> tuple[Array, float]:
    """Return the mean normal of the largest group of similar normals, and its share."""
    near = normals @ normals.T > math.cos(math.radians(FACE_DEG))
    best = near[int(np.argmax(near.sum(axis=1)))]
    mean = normals[best].mean(axis=0)
    return mean / np.linalg.norm(mean), float(best.mean())


def _outline_direction(points: Array, normal: Array) -> Array:
    """Return the direction in a plane along which the rectangle around the points is smallest."""
    side = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    side /= np.linalg.norm(side)
    up = np.cross(normal, side)
    turns = np.radians(np.arange(0.0, 90.0, 3.0))
    directions = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * up
    across = np.cos(turns)[:, None] * up - np.sin(turns)[:, None] * side
    spans = [np.ptp(np.percentile(points @ d.T, [2.0, 98.0], axis=0), axis=0) for d in (directions, across)]
    return np.asarray(directions[int(np.argmin(spans[0] * spans[1]))])
