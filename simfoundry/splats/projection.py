"""Gaussians as ellipses in an image: the affine approximation of perspective (EWA splatting; Zwicker et al., 2001)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose, rotations
from simfoundry.splats.gaussians import GaussianSplat
from simfoundry.splats.harmonics import SH0, harmonic_basis

# Depth [m] below which Gaussians are left out. So near the camera, the affine approximation smears them over the image.
NEAREST = 0.1

# Variance [px^2] by which each ellipse is blurred: that of the area of a pixel. The opacity is lowered such that the
# image stays as bright (Yu et al., Mip-Splatting, CVPR 2024, section 4.2). Trainers blur by 0.3 and keep the opacity,
# which makes distant splats in small images too thick.
BLUR = 1 / 12

# Opacity below which a Gaussian is left out at a pixel: half of what 8 bits can show, and the limit of trainers.
LEAST_ALPHA = 1 / 255

# Width of the region around the image, relative to it, beyond which the slope of the projection is not followed any
# further, as when trainers render. Gaussians beside the image would otherwise be stretched across it.
_MARGIN = 1.3

# Value of the quadratic form within which the order of Gaussians is exact: 1.4 standard deviations, where the opacity
# is e^-1 of that at the center. An exact order of what is farther out would take twice as long.
_CORE = 2.0

Singles = NDArray[np.float32]


class Pinhole(Protocol):
    """Size [px] and intrinsics [px] of a camera; the center of the first pixel is (0, 0)."""

    @property
    def width(self) -> int: ...  # noqa: D102
    @property
    def height(self) -> int: ...  # noqa: D102
    @property
    def fx(self) -> float: ...  # noqa: D102
    @property
    def fy(self) -> float: ...  # noqa: D102
    @property
    def cx(self) -> float: ...  # noqa: D102
    @property
    def cy(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Ellipses:
    """The m visible Gaussians of a splat in an image, sorted by their nearest points.

    A Gaussian has the opacity ``opacity * exp(-(a x^2 + 2 b x y + c y^2) / 2)`` at the offset (x, y) [px] from its
    center, and its depth there is ``depth + slope . (x, y)``.

    Attributes:
        center: Centers [px], shape (m, 2).
        conic: Coefficients a, b and c [1/px^2], shape (m, 3).
        reach: Value of the quadratic form at which the opacity becomes :data:`LEAST_ALPHA`, shape (m,).
        nearest: Least depth [m] of the Gaussian within 1.4 standard deviations, in ascending order, shape (m,).
        depth: Depth [m] of the center along the optical axis, shape (m,).
        slope: Change of the depth [m/px], shape (m, 2).
        opacity: Opacity at the center, shape (m,).
        color: sRGB color, at least 0, shape (m, 3).
    """

    center: Array
    conic: Array
    reach: Array
    nearest: Array
    depth: Array
    slope: Array
    opacity: Array
    color: Singles


def project(splat: GaussianSplat, X_CF: Pose, camera: Pinhole, blur: float = BLUR) -> Ellipses:
    """Return the Gaussians of a splat that a camera sees.

    Args:
        splat: The splat in a frame F.
        X_CF: The pose of F in the camera frame (x right, y down, z forward).
        camera: The intrinsics.
        blur: Variance by which each ellipse is blurred [px^2].
    """
    seen = np.flatnonzero(splat.opacities > LEAST_ALPHA)
    p_C = X_CF.apply(splat.positions[seen].astype(np.float64))
    ahead = p_C[:, 2] > NEAREST
    seen, p_C = seen[ahead], p_C[ahead]
    x, y, z = p_C.T
    covariance = _image_covariance(splat, seen, X_CF, camera, p_C)
    sharp = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] ** 2
    uu, uv, vv = covariance[:, 0, 0] + blur, covariance[:, 0, 1], covariance[:, 1, 1] + blur
    determinant = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        opacity = splat.opacities[seen] * np.sqrt(np.maximum(sharp, 0.0) / determinant)
    kept = np.isfinite(opacity) & (opacity > LEAST_ALPHA)
    reach = 2.0 * np.log(np.where(kept, opacity, 1.0) / LEAST_ALPHA)
    center = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
    wide, high = np.sqrt(reach * uu), np.sqrt(reach * vv)
    kept &= (center[:, 0] + wide >= 0) & (center[:, 0] - wide <= camera.width - 1)
    kept &= (center[:, 1] + high >= 0) & (center[:, 1] - high <= camera.height - 1)
    index = np.flatnonzero(kept)
    conic = np.stack([vv, -uv, uu], axis=1)[index] / determinant[index, None]
    uz, vz = covariance[index, 0, 2], covariance[index, 1, 2]
    slope = np.stack([conic[:, 0] * uz + conic[:, 1] * vz, conic[:, 1] * uz + conic[:, 2] * vz], axis=1)
    # The largest change of the depth within an ellipse is the square root of reach * slope . covariance . slope.
    within = np.minimum(reach[index], _CORE)
    nearest = z[index] - np.sqrt(np.maximum(within * (slope[:, 0] * uz + slope[:, 1] * vz), 0.0))
    order = np.argsort(nearest, kind="stable")
    index, conic, slope, nearest = index[order], conic[order], slope[order], nearest[order]
    color = _colors(splat, seen[index], X_CF.inverse().p)
    return Ellipses(
        center[index], conic, reach[index], nearest, z[index], slope, opacity[index].astype(np.float64), color
    )


def _image_covariance(splat: GaussianSplat, seen: NDArray[np.int64], X_CF: Pose, camera: Pinhole, p_C: Array) -> Array:
    """Return the covariance of image coordinates and depth [px, px, m] of each Gaussian, shape (n, 3, 3)."""
    x, y, z = p_C.T
    half = camera.width / camera.fx / 2, camera.height / camera.fy / 2
    middle = (camera.width - 1) / 2, (camera.height - 1) / 2
    beside_x, beside_y = (middle[0] - camera.cx) / camera.fx, (middle[1] - camera.cy) / camera.fy
    tx = np.clip(x / z, beside_x - _MARGIN * half[0], beside_x + _MARGIN * half[0])
    ty = np.clip(y / z, beside_y - _MARGIN * half[1], beside_y + _MARGIN * half[1])
    axes = X_CF.rotation @ rotations(splat.rotations[seen].astype(np.float64))
    axes *= splat.scales[seen].astype(np.float64)[:, None, :]
    u = (camera.fx / z)[:, None] * (axes[:, 0] - tx[:, None] * axes[:, 2])
    v = (camera.fy / z)[:, None] * (axes[:, 1] - ty[:, None] * axes[:, 2])
    rows = np.stack([u, v, axes[:, 2]], axis=1)
    return np.asarray(rows @ rows.transpose(0, 2, 1))


def _colors(splat: GaussianSplat, seen: NDArray[np.int64], eye: Array) -> Singles:
    """Return the colors that Gaussians have from a position [m] in the frame of their splat, shape (m, 3)."""
    harmonics = splat.harmonics[seen]
    if splat.degree == 0:
        return _clipped(harmonics[:, 0] * np.float32(SH0))
    away = splat.positions[seen].astype(np.float64) - eye
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    basis = harmonic_basis(away, splat.degree).astype(np.float32)
    return _clipped(np.einsum("nk,nkc->nc", basis, harmonics))


def _clipped(colors: Singles) -> Singles:
    return np.asarray(np.maximum(colors + np.float32(0.5), np.float32(0.0)), dtype=np.float32)
