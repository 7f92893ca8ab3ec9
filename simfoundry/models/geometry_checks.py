"""Checks that recognize cameras, poses and depth in another convention than the stated one, and name it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.models.contract import ConventionError

Floats = NDArray[Any]

# Largest plausible median depth [m] of a capture: an indoor scene is smaller, and a scene in millimeters is larger.
FARTHEST_MEDIAN_M = 60.0

# Smallest plausible median depth [m]. A depth camera does not see closer; kilometers or normalized values are below it.
NEAREST_MEDIAN_M = 0.02

ROTATION_ERROR = 1e-3  # Maximum deviation of R Rᵀ from the identity, enough for matrices in single precision

# Turns a camera frame with y up and z backward (OpenGL, USD, Blender) into one with y down and z forward (OpenCV).
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def check_depth_unit(depth: Floats, name: str = "depth") -> None:
    """Check that depths [m] are neither in millimeters nor along a z axis that points backward.

    Raises:
        ConventionError: If the depth is implausible.
    """
    if (depth < 0).any():
        where = "more than half" if (depth < 0).mean() > 0.5 else "some"
        raise ConventionError(
            f"has negative values in {where} of `{name}`; depth is positive along the viewing direction "
            "(an OpenGL camera looks along -z), and 0 where it is unknown"
        )
    known = depth[depth > 0]
    if not known.size:
        raise ConventionError(f"has no pixel with a known `{name}`")
    median = float(np.median(known))
    if median > FARTHEST_MEDIAN_M:
        guess = "millimeters" if median < FARTHEST_MEDIAN_M * 1000 else "no length"
        raise ConventionError(f"has a median `{name}` of {median:.4g} m; is it in {guess}? It must be in meters")
    if median < NEAREST_MEDIAN_M:
        raise ConventionError(
            f"has a median `{name}` of {median:.3g} m; is it relative or inverse? It must be in meters"
        )


def check_intrinsics(K: Floats, width: int, height: int, name: str = "K") -> None:
    """Check an intrinsic matrix [px], shape (3, 3), for an image of the given size.

    Raises:
        ConventionError: If the matrix belongs to another image size or is normalized.
    """
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not np.allclose(K[2], [0, 0, 1]):
        transposed = np.allclose(K[:, 2], [0, 0, 1])
        raise ConventionError(f"has a `{name}` whose last row is not (0, 0, 1){'; is it transposed?' * transposed}")
    if min(fx, fy) <= 0:
        raise ConventionError(f"has a `{name}` with focal lengths {fx:.4g} and {fy:.4g} px; they must be positive")
    if max(fx, fy) < 10 and max(cx, cy) <= 2:
        raise ConventionError(f"has a `{name}` that is normalized by the image size; it must be in pixels")
    # The principal point of a camera lies within the middle half of the image, unless the image was cropped or resized.
    if not (0.15 * width < cx < 0.85 * width and 0.15 * height < cy < 0.85 * height):
        raise ConventionError(
            f"has a `{name}` with the principal point ({cx:.1f}, {cy:.1f}) in an image of {width} x {height} pixels; "
            "does it belong to an image of another size?"
        )


def check_transform(X_AB: Floats, name: str) -> None:
    """Check rigid transforms, shape (..., 4, 4).

    Raises:
        ConventionError: If a rotation is not orthonormal or mirrors, or if the last row is not (0, 0, 0, 1).
    """
    for matrix in X_AB.reshape(-1, 4, 4):
        rotation = matrix[:3, :3]
        if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
            transposed = np.allclose(matrix[:3, 3], 0) and not np.allclose(matrix[3, :3], 0)
            raise ConventionError(
                f"has a `{name}` whose last row is not (0, 0, 0, 1){'; is it transposed?' * transposed}"
            )
        gram = rotation @ rotation.T
        if not np.allclose(gram, np.eye(3), atol=ROTATION_ERROR):
            factor = float(np.sqrt(np.trace(gram) / 3))
            scaled = np.allclose(gram, np.eye(3) * factor**2, atol=ROTATION_ERROR * max(1.0, factor**2))
            what = f"scaled by {factor:.4g}" if scaled else "not a rotation"
            raise ConventionError(f"has a `{name}` that is {what}; its first three columns must be a rotation")
        if np.linalg.det(rotation) < 0:
            raise ConventionError(f"has a `{name}` that mirrors (determinant -1); frames are right-handed")


def points_of(depth: Floats, K: Floats, step: int = 1) -> Floats:
    """Return the points [m] of every ``step``-th pixel with known depth in the camera frame, shape (n, 3)."""
    v, u = np.nonzero(depth[::step, ::step] > 0)
    v, u = v * step, u * step
    z = depth[v, u].astype(np.float64)
    return np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1)


def overlap(depth: Floats, K: Floats, points: Floats) -> float:
    """Return the fraction of points in view whose distance agrees with a depth image within 5 %.

    Args:
        depth: Depth [m], shape (H, W), 0 where unknown.
        K: Intrinsic matrix [px], shape (3, 3).
        points: Points [m] in the camera frame, shape (n, 3).

    Returns:
        The fraction, or 0 if fewer than 1 % of the points are in view.
    """
    z = points[:, 2]
    front = points[z > 1e-6]
    if not len(front):
        return 0.0
    pixels = np.rint(front[:, :2] / front[:, 2:] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]])
    height, width = depth.shape
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    if inside.sum() < max(8, len(points) // 100):
        return 0.0
    u, v = pixels[inside].astype(np.int64).T
    seen, expected = depth[v, u], front[inside, 2]
    return float((np.abs(seen - expected) < 0.05 * expected)[seen > 0].mean()) if (seen > 0).any() else 0.0
