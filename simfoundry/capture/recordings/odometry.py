"""Track a depth camera through a recording, by registering each depth image to an earlier one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.frame import NEAREST, depth_sigma, in_range
from simfoundry.capture.recordings.recording import scaled_intrinsics
from simfoundry.geometry.frames import Array, Pose

# Width of the images that are registered [px]; noise averages out over 50,000 pixels, and each takes 0.1 s.
WIDTH = 320

# Spacing of the pixels that are registered [px].
SPACING = 3

# Largest distance between two points that correspond [m], at the first and at the last iteration. A hand moves a camera
# by 3 cm in a tenth of a second.
FAR, NEAR = 0.08, 0.015
ITERATIONS = 20

# Least share of the pixels that must see the reference image's surface, and of these that must agree with it.
OVERLAP, AGREEING = 0.3, 0.6

# Share of the pixels that see the reference below which the image becomes the next reference.
FRESH = 0.6

# Least ratio of the smallest and the largest eigenvalue of the normal equations, in which a rotation by 1 rad counts as
# much as 1 m. A bare table, on which a camera may slide unnoticed, has less than a thousandth of it.
CONDITION = 1e-4


@dataclass(frozen=True, eq=False)
class DepthSurface:
    """A depth image with the intrinsics K [px], the points [m] and normals at its pixels, shape (h, w, 3)."""

    K: Array
    points: Array
    normals: Array


class DepthOdometry:
    """Tracks a depth camera. Its first image defines the frame in which the poses are."""

    def __init__(self) -> None:
        self._reference: DepthSurface | None = None
        self._X_WR = Pose.of()
        self._last = Pose.of()

    def track(self, depth: Array, K: Array) -> Pose | None:
        """Return the pose of the camera that took a depth image, or None if it was lost.

        Args:
            depth: Depth [m], shape (h, w); NaN where there is none.
            K: Intrinsic matrix [px], shape (3, 3).
        """
        surface = depth_surface(depth, K)
        if self._reference is None:
            self._reference = surface
            return self._last
        found = register_surface(self._reference, surface, self._X_WR.inverse() @ self._last)
        if found is None:
            return None
        self._last = self._X_WR @ found.X_RC
        if found.overlap < FRESH:
            self._reference, self._X_WR = surface, self._last
        return self._last


@dataclass(frozen=True)
class Registration:
    """The pose of a camera in the frame of a reference camera, and the share of pixels that see what that one saw."""

    X_RC: Pose
    overlap: float


@dataclass(frozen=True)
class PosePrior:
    """The trust in a stated pose: the reach [m] of its errors, and weights against those of registered points.

    The weight of a motion is the share of the points that outweigh it, times the square of their lever [m] for a turn.
    """

    reach: float
    shift: float
    turn: float

    def weights(self, count: int) -> Array:
        """Return the weights of three turns [rad] and three shifts [m] against ``count`` points, shape (6,)."""
        return count * np.array([self.turn] * 3 + [self.shift] * 3)


# A tracker's or a robot's pose is off by millimeters. Neighboring readings of a sensor err alike and normals are noisy,
# so that each of 6,000 residuals counts like noise of 14 mm against a pose that is off by 5 mm and half a degree.
STATED = PosePrior(reach=0.03, shift=0.0013, turn=0.0004)


def refined_pose(reference: DepthSurface, surface: DepthSurface, stated: Pose) -> Pose:
    """Return the pose of a camera in that of a reference, near a stated one, at which their depth agrees best.

    What the images do not show, such as a shift along a bare table, stays as stated.
    """
    found = register_surface(reference, surface, stated, STATED)
    return stated if found is None else found.X_RC


def register_surface(
    reference: DepthSurface, surface: DepthSurface, start: Pose, prior: PosePrior | None = None
) -> Registration | None:
    """Return the pose at which a depth image agrees with a reference image, or None if there is none near ``start``.

    Points are paired by projection into the reference image; their distances along its normals are minimized.
    """
    points = surface.points[::SPACING, ::SPACING].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])]
    X_RC, overlap, agreeing = start, 0.0, 0.0
    far, gone = FAR if prior is None else prior.reach, np.zeros(6)
    for k in range(ITERATIONS):
        limit = far * (NEAR / far) ** (k / (ITERATIONS - 1))
        moved = X_RC.apply(points)
        targets, normals = _paired(reference, moved)
        gap = moved - targets
        residual = np.einsum("ij,ij->i", gap, normals)
        known = np.isfinite(residual)
        near = known & (np.abs(residual) < limit) & (np.einsum("ij,ij->i", gap, gap) < (3 * limit) ** 2)
        if near.sum() < 100:
            return None
        overlap = float(known.mean())
        agreeing = float((np.abs(residual[known]) < 3 * depth_sigma(moved[known, 2])).mean())
        step = _step(moved[near], normals[near], residual[near], limit, prior, gone)
        if step is None:
            return None
        motion, change = step
        X_RC, gone = motion @ X_RC, gone + change
    return Registration(X_RC, overlap) if overlap >= OVERLAP and agreeing >= AGREEING else None


def _step(
    points: Array, normals: Array, residual: Array, limit: float, prior: PosePrior | None, gone: Array
) -> tuple[Pose, Array] | None:
    """Return the small motion that brings points (n, 3) onto planes, with distances (n,), or None if it is free.

    The motion is returned as a pose and as three turns [rad] and three shifts [m], shape (6,). ``gone`` is the motion
    since the start, which the prior holds back.
    """
    weight = np.square(1 - np.square(residual / limit))  # Tukey's
    center = points.mean(axis=0)
    rows = np.column_stack([np.cross(points - center, normals), normals])
    hessian, slope = rows.T @ (rows * weight[:, None]), rows.T @ (weight * residual)
    if prior is not None:
        trust = prior.weights(len(points))
        hessian, slope = hessian + np.diag(trust), slope + trust * gone
    else:
        values = np.linalg.eigvalsh(hessian)
        if values[0] < CONDITION * values[-1]:
            return None
    change = np.linalg.solve(hessian, -slope)
    turn, shift = np.split(change, 2)
    angle = float(np.linalg.norm(turn))
    rotation = Pose.about(turn / angle, angle) if angle > 1e-12 else Pose.of()
    return Pose.of(center + shift) @ rotation @ Pose.of(-center), change


def _paired(reference: DepthSurface, points: Array) -> tuple[Array, Array]:
    """Return the points and normals of a reference at which it sees points (n, 3); NaN where it sees nothing."""
    h, w = reference.points.shape[:2]
    z = np.where(points[:, 2] > NEAREST, points[:, 2], np.nan)
    with np.errstate(invalid="ignore"):
        u = np.rint(points[:, 0] / z * reference.K[0, 0] + reference.K[0, 2])
        v = np.rint(points[:, 1] / z * reference.K[1, 1] + reference.K[1, 2])
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
    row, column = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
    targets = np.where(inside[:, None], reference.points[row, column], np.nan)
    return targets, reference.normals[row, column]


def depth_surface(depth: Array, K: Array) -> DepthSurface:
    """Return the points and normals of a depth image, reduced in size and smoothed within surfaces."""
    import cv2

    step = max(1, round(depth.shape[1] / WIDTH))
    small = depth[::step, ::step]
    small = np.where(in_range(small), small, 0.0).astype(np.float32)
    K = scaled_intrinsics(K, (1 / step, 1 / step))
    smooth = cv2.bilateralFilter(small, 5, 0.03, 2.0)
    h, w = small.shape
    z = np.where(small > 0, smooth, np.nan).astype(np.float64)
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    points = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    right, down = np.full_like(points, np.nan), np.full_like(points, np.nan)
    right[:, 1:-1], down[1:-1] = points[:, 2:] - points[:, :-2], points[2:] - points[:-2]
    normal = np.cross(right, down)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = normal / length
        step_away = np.maximum(np.abs(right[..., 2]), np.abs(down[..., 2])) > 0.05  # across an edge
    normal[step_away] = np.nan
    return DepthSurface(K, points, normal)
