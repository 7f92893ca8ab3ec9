"""Find the surface that the objects stand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.errors import CaptureError
from simfoundry.capture.frame import Frame, Support
from simfoundry.capture.noise import depth_sigma, valid_depth
from simfoundry.capture.outline import Plan, plan_of, polygon_of
from simfoundry.capture.planes import TOLERANCE, Plane, candidate_planes, is_level, refine
from simfoundry.capture.relief import normals_of, tangents
from simfoundry.scene.frames import Array, Pose

TALLEST = 0.5  # [m] above a plane, what still counts as standing on it
CROSSING = 0.6  # cosine of the angle between surface and plane from which on it crosses rather than joins
SURVEY_WIDTH = 240  # [px] of the picture on which candidates are compared


@dataclass(frozen=True, eq=False)
class _Surface:
    plane: Plane
    X_WC: Pose
    inliers: NDArray[np.bool_]
    plan: Plan
    score: float


def find_support(frame: Frame) -> Support:
    """The support of the objects in ``frame``, and the world frame on it.

    The origin is the centroid of the visible surface, z is the plane's normal towards the camera, x is the camera's
    viewing direction along the plane (its up direction if it looks straight down), y is to the left.

    Of all planes that could be a table top, the support is the one that has most on it and of it in view, the near
    counting more than the far (by area rather than by pixels). A box that carries another loses against the table
    below, because the table carries both; the floor loses because it is far and its things stand higher than objects do.
    Raises :class:`CaptureError` (``no-depth``, ``depth-unit``, ``no-plane``).
    """
    valid = valid_depth(frame.depth)
    depth = np.where(valid, frame.depth, np.nan)
    step = max(1, frame.depth.shape[1] // SURVEY_WIDTH)
    small = Frame(frame.color[::step, ::step], depth[::step, ::step], _reduced(frame.K, step))
    points = small.points[np.isfinite(small.depth)]
    planes = candidate_planes(points, np.random.default_rng(0)) if len(points) >= 50 else []
    surfaces = [s for plane in planes if (s := _survey(small, plane, finest=0.01)) is not None]
    if not surfaces:
        raise CaptureError(
            "no-plane",
            "no flat surface is seen from above that objects could stand on",
            "show at least a hand's breadth of the table top around the objects, with the camera upright above it",
        )
    best = max(surfaces, key=lambda s: s.score)
    return _measured(Frame(frame.color, depth, frame.K), best)


def _reduced(K: Array, step: int) -> Array:
    """Intrinsics of the picture that keeps every ``step``-th pixel."""
    out = np.array(K, dtype=np.float64)
    out[:2] /= step
    return out


def _measured(frame: Frame, rough: _Surface) -> Support:
    """Refine the plane on the pixels of its own connected surface at full resolution, and take its outline there."""
    plane = rough.plane
    for _ in range(2):
        near = _on_plane(frame, plane) & rough.plan.contains(rough.X_WC.apply(frame.points)[..., :2])
        points = frame.points[near]
        if len(points) < 10:
            break
        plane = refine(plane, points[:: max(1, len(points) // 60000)])
    surface = _survey(frame, plane, finest=0.005)
    if surface is None:
        surface = rough
    center = np.append(surface.X_WC.apply(frame.points[surface.inliers])[:, :2].mean(axis=0), 0.0)
    X_WC = Pose.of(surface.X_WC.p - center, surface.X_WC.q)
    residual = float(np.median(np.abs(plane.height(frame.points[surface.inliers]))))
    return Support(X_WC, polygon_of(surface.plan) - center[:2], residual, surface.inliers)


def _on_plane(frame: Frame, plane: Plane) -> NDArray[np.bool_]:
    """Pixels within the noise of the plane, except where a surface clearly crosses it, as the back of a chair does."""
    import cv2

    radius = max(2, round(frame.depth.shape[1] / 160))
    with np.errstate(invalid="ignore"):
        normals = normals_of(tangents(frame.depth, radius, 1 + (radius - 1) // 3), frame.K)
    dense = cv2.blur(np.isfinite(frame.depth).astype(np.float32), (2 * radius + 1, 2 * radius + 1)) > 0.9
    crossing = dense & (np.abs(normals @ plane.normal) < CROSSING)
    return np.asarray((np.abs(plane.height(frame.points)) < TOLERANCE * depth_sigma(frame.depth)) & ~crossing)


def world_on(plane: Plane) -> Pose:
    """``X_WC`` of a camera above ``plane``: the origin right below the camera, x along its viewing direction."""
    z = plane.normal
    x = np.array([0.0, 0.0, 1.0]) - z[2] * z
    if np.linalg.norm(x) < 0.2:
        x = np.array([0.0, -1.0, 0.0]) + z[1] * z
    x = x / np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z])
    matrix[2, 3] = -plane.offset
    return Pose.from_matrix(matrix)


def _survey(frame: Frame, plane: Plane, finest: float) -> _Surface | None:
    """The surface that ``plane`` has in this picture, and how much speaks for it being the support."""
    X_WC = world_on(plane)
    points_W = X_WC.apply(frame.points)
    inliers = _on_plane(frame, plane)
    tolerance = TOLERANCE * depth_sigma(frame.depth)
    hidden = ~np.isfinite(frame.depth) | (points_W[..., 2] > tolerance)
    plan = plan_of(inliers, hidden, X_WC, frame.K, points_W, finest)
    if plan is None:
        return None
    above = plan.contains(points_W[..., :2])
    inliers = inliers & above
    if inliers.sum() < 10:
        return None
    carried = above & (points_W[..., 2] > 2 * tolerance) & (points_W[..., 2] < TALLEST)
    # A pixel covers an area that grows with the squared depth; dividing by it once more favours the near.
    nearness = 1.0 / float(np.median(frame.depth[inliers])) ** 2
    score = (float(carried.sum()) + 0.5 * float(inliers.sum())) * nearness * (1.0 if is_level(plane) else 0.3)
    return _Surface(plane, X_WC, inliers, plan, score)
