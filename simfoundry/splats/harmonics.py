"""Real spherical harmonics with the signs and the order of 3D Gaussian Splatting, up to degree 3."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

# Normalization of the functions below, by degree and order (glTF KHR_gaussian_splatting, appendix A). The constant one
# also converts the first coefficient to a color.
SH0 = 0.28209479177387814  # 1 / (2 sqrt(pi))
_SH1 = 0.4886025119029199  # sqrt(3 / (4 pi))
_SH2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_SH3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)

# Number of directions from which a rotation of coefficients is solved. Seven would do for degree 3; more keep the
# system well-conditioned.
_SAMPLES = 64


def harmonic_basis(directions: Array, degree: int) -> Array:
    """Return the basis functions at unit directions of shape (n, 3), as an array of shape (n, (degree + 1)^2)."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    columns = [np.full_like(x, SH0)]
    if degree >= 1:
        columns += [-_SH1 * y, _SH1 * z, -_SH1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        a, b, c = _SH2
        columns += [a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, c * (xx - yy)]
    if degree >= 3:
        a, b, c, d, e = _SH3
        columns += [
            -a * y * (3 * xx - yy), b * x * y * z, -c * y * (4 * zz - xx - yy), d * z * (2 * zz - 3 * xx - 3 * yy),
            -c * x * (4 * zz - xx - yy), e * z * (xx - yy), -a * x * (xx - 3 * yy),
        ]  # fmt: skip
    return np.stack(columns, axis=1)


def rotated_harmonics(coefficients: NDArray[np.float32], R_AB: Array) -> NDArray[np.float32]:
    """Return coefficients of shape (n, k, 3) that give in frame A the colors that the given ones have in frame B."""
    degree = math.isqrt(coefficients.shape[1]) - 1
    directions = _sphere(_SAMPLES)
    in_a, in_b = harmonic_basis(directions, degree), harmonic_basis(directions @ R_AB, degree)
    out = coefficients.astype(np.float32, copy=True)
    for order in range(1, degree + 1):  # a rotation mixes only functions of one degree
        band = slice(order**2, (order + 1) ** 2)
        turn, *_ = np.linalg.lstsq(in_a[:, band], in_b[:, band], rcond=None)
        out[:, band] = np.einsum("ij,njc->nic", turn, coefficients[:, band].astype(np.float64))
    return out


def _sphere(count: int) -> Array:
    """Return ``count`` unit vectors spread evenly over the sphere (a Fibonacci lattice), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, k * math.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
