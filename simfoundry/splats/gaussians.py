"""Gaussian splats (Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023) as physical values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.geometry.similarity import Similarity
from simfoundry.splats.harmonics import rotated_harmonics

# Maximum number of Gaussians in a splat; each takes 250 bytes in memory, and a room has about one million.
MAX_GAUSSIANS = 5_000_000

# Maximum size of a splat file [bytes]: that many Gaussians with all 62 single-precision values of a trainer's file.
MAX_SPLAT_BYTES = MAX_GAUSSIANS * 62 * 4 + 100_000

# Highest degree of spherical harmonics; no trainer writes more, and glTF defines no more.
MAX_DEGREE = 3

EXPORT = "export it again from the trainer"

Floats = NDArray[np.float32]
Numbers = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class GaussianSplat:
    """A splat of n Gaussians in single precision, in the frame F of its file with z up.

    The color seen along a unit direction d, from the camera to the center, is ``harmonics . Y(d) + 0.5`` with the basis
    Y of :func:`simfoundry.splats.harmonics.harmonic_basis`. It is an sRGB value, below 0 clipped to 0.

    Attributes:
        positions: Centers [m], shape (n, 3).
        scales: Standard deviations along the axes of each Gaussian [m], at least zero, shape (n, 3).
        rotations: Unit quaternions (wxyz) from the axes of each Gaussian to F, shape (n, 4).
        opacities: Opacities at the centers in [0, 1], shape (n,).
        harmonics: Spherical harmonics coefficients for red, green and blue in ascending order, shape
            (n, (degree + 1)^2, 3).
    """

    positions: Floats
    scales: Floats
    rotations: Floats
    opacities: Floats
    harmonics: Floats

    def __len__(self) -> int:
        """Return the number of Gaussians."""
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Return the maximum degree of the spherical harmonics."""
        return math.isqrt(self.harmonics.shape[1]) - 1

    def moved(self, S_AF: Similarity) -> GaussianSplat:
        """Return the splat in frame A. Colors turn along with the Gaussians. The identity returns the splat itself."""
        if S_AF.X_AB.is_identity and S_AF.scale == 1.0:
            return self
        turned, harmonics = self.rotations, self.harmonics
        if abs(S_AF.X_AB.q[0]) < 1.0:
            turned = _single(_products(S_AF.X_AB.q, self.rotations.astype(np.float64)))
            harmonics = rotated_harmonics(self.harmonics, S_AF.X_AB.rotation)
            harmonics.setflags(write=False)
        positions = _single(S_AF.apply(self.positions.astype(np.float64)))
        return GaussianSplat(positions, _single(self.scales * S_AF.scale), turned, self.opacities, harmonics)

    def selected(self, index: NDArray[np.bool_] | NDArray[np.int64]) -> GaussianSplat:
        """Return some of the Gaussians, by a mask or by index."""
        return GaussianSplat(*(_single(values[index]) for values in vars(self).values()))


def gaussian_splat(
    name: str, positions: Numbers, scales: Numbers, rotations: Numbers, opacities: Numbers, harmonics: Numbers
) -> GaussianSplat:
    """Return a splat of checked values; for their shapes, see :class:`GaussianSplat`.

    Quaternions are normalized, and those of length zero, which some trainers write, become the identity.

    Args:
        name: Name of the file, for messages.
        positions: Centers [m].
        scales: Standard deviations [m].
        rotations: Quaternions (wxyz) of any length.
        opacities: Opacities.
        harmonics: Spherical harmonics coefficients.

    Raises:
        MeshError: If the values do not make a splat.
    """
    n = len(positions)
    check_count(name, n)
    shapes = ((n, 3), (n, 3), (n, 4), (n,))
    if tuple(a.shape for a in (positions, scales, rotations, opacities)) != shapes or len(harmonics) != n:
        raise MeshError("SF301", f"{name} has arrays of different lengths", EXPORT)
    if harmonics.shape[1:] not in [((degree + 1) ** 2, 3) for degree in range(MAX_DEGREE + 1)]:
        message = f"{name} has spherical harmonics of a degree that is not between 0 and {MAX_DEGREE}"
        raise MeshError("SF301", message, EXPORT)
    with np.errstate(over="ignore", invalid="ignore"):  # reported below
        turns = rotations.astype(np.float64)
        lengths = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = np.where(lengths != 0, turns / np.where(lengths != 0, lengths, 1.0), [1.0, 0.0, 0.0, 0.0])
        made = GaussianSplat(*(_single(a) for a in (positions, scales, turns, opacities, harmonics)))
    if not all(np.isfinite(values).all() for values in vars(made).values()):
        raise MeshError("SF301", f"{name} has Gaussians with non-finite values", EXPORT)
    if made.scales.min() < 0:
        raise MeshError("SF301", f"{name} has Gaussians with negative scales", EXPORT)
    if made.opacities.min() < 0 or made.opacities.max() > 1:
        raise MeshError("SF301", f"{name} has opacities that are not between 0 and 1", EXPORT)
    return made


def joined_splats(name: str, parts: Sequence[GaussianSplat]) -> GaussianSplat:
    """Return the splats of a file as one, with the highest of their degrees.

    Raises:
        MeshError: If there are no splats, or too many Gaussians.
    """
    check_count(name, sum(map(len, parts)))
    if len(parts) == 1:
        return parts[0]
    most = max(part.harmonics.shape[1] for part in parts)
    padded = [np.pad(part.harmonics, ((0, 0), (0, most - part.harmonics.shape[1]), (0, 0))) for part in parts]
    columns = ("positions", "scales", "rotations", "opacities")
    values = [np.concatenate([getattr(part, column) for part in parts]) for column in columns]
    return GaussianSplat(*map(_single, (*values, np.concatenate(padded))))


def check_count(name: str, count: int) -> None:
    """Check the number of Gaussians in a file, before memory is taken for them.

    Raises:
        MeshError: If there are none or too many.
    """
    if not 0 < count <= MAX_GAUSSIANS:
        message = f"{name} has {count} Gaussians; it must have 1 to {MAX_GAUSSIANS}"
        raise MeshError("SF301", message, EXPORT)


def _products(q: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Hamilton products of one quaternion with n others (wxyz), shape (n, 4)."""
    w, x, y, z = q
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(turns @ left.T)


def _single(values: Numbers) -> Floats:
    out = np.ascontiguousarray(values, dtype=np.float32)
    if out is values:
        out = out.view()
    out.setflags(write=False)
    return out
