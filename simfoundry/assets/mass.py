"""Compute the volume, center of mass and inertia of solids with uniform density."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]  # Vertex indices of triangles, shape (m, 3)


@dataclass(frozen=True, eq=False)
class SolidMoments:
    """The volume moments of a solid with a density of 1.

    ``volume`` is in m^3. ``com`` is the center of mass [m], shape (3,), and ``inertia`` is the inertia tensor [m^5]
    about the center of mass, shape (3, 3).
    """

    volume: float
    com: Array
    inertia: Array

    def moved(self, rotation: Array, translation: Array) -> SolidMoments:
        """Return the moments after the solid is rotated and then translated.

        Args:
            rotation: Rotation matrix, shape (3, 3).
            translation: Translation [m], shape (3,).
        """
        return SolidMoments(self.volume, rotation @ self.com + translation, rotation @ self.inertia @ rotation.T)


def _diagonal(xx: float, yy: float, zz: float) -> Array:
    """Return a diagonal 3x3 matrix. This is several times faster than ``numpy.diag``."""
    return np.array([[xx, 0.0, 0.0], [0.0, yy, 0.0], [0.0, 0.0, zz]])


def box(size: Array) -> SolidMoments:
    """Return the moments of a box with full extents ``size`` [m], centered at the origin."""
    x, y, z = (float(v) for v in size)
    volume = x * y * z
    return SolidMoments(volume, np.zeros(3), volume / 12 * _diagonal(y * y + z * z, x * x + z * z, x * x + y * y))


def sphere(radius: float) -> SolidMoments:
    """Return the moments of a sphere centered at the origin."""
    volume = 4 / 3 * math.pi * radius**3
    moment = 0.4 * volume * radius**2
    return SolidMoments(volume, np.zeros(3), _diagonal(moment, moment, moment))


def ellipsoid(radii: Array) -> SolidMoments:
    """Return the moments of an ellipsoid with the given radii along x, y, z [m], centered at the origin."""
    x, y, z = (float(v) for v in radii)
    volume = 4 / 3 * math.pi * x * y * z
    return SolidMoments(volume, np.zeros(3), volume / 5 * _diagonal(y * y + z * z, x * x + z * z, x * x + y * y))


def cone(radius: float, height: float) -> SolidMoments:
    """Return the moments of a cone along z, with its base at -height/2 and its tip at height/2.

    The center of mass is a quarter of the height above the base.
    """
    volume = math.pi * radius**2 * height / 3
    across = 3 / 80 * volume * (4 * radius**2 + height**2)
    return SolidMoments(volume, np.array([0.0, 0.0, -height / 4]), _diagonal(across, across, 0.3 * volume * radius**2))


def cylinder(radius: float, height: float) -> SolidMoments:
    """Return the moments of a cylinder along z, centered at the origin."""
    volume = math.pi * radius**2 * height
    across = volume * (3 * radius**2 + height**2) / 12
    return SolidMoments(volume, np.zeros(3), _diagonal(across, across, volume * radius**2 / 2))


def capsule(radius: float, height: float) -> SolidMoments:
    """Return the moments of a capsule along z, centered at the origin.

    ``height`` [m] is the height of the cylindrical part.
    """
    tube = cylinder(radius, height)
    caps = 4 / 3 * math.pi * radius**3
    # Two hemispheres; the center of mass of each is 3/8 of the radius above its flat face.
    across = caps * (0.4 * radius**2 + height**2 / 4 + 3 / 8 * height * radius)
    inertia = tube.inertia + _diagonal(across, across, 0.4 * caps * radius**2)
    return SolidMoments(tube.volume + caps, np.zeros(3), inertia)


# Gauss-Legendre nodes and weights on [-1, 1]; three nodes integrate polynomials up to degree 5 exactly.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def revolution(profile: Array) -> SolidMoments:
    """Return the moments of the solid obtained by rotating a closed polygon about z.

    The polygon consists of (radius, height) pairs [m], shape (n, 2). By the theorem of Pappus and Guldin, the volume is
    2 pi times the integral of the radius over the polygon, and the other moments are similar integrals. Along an edge,
    the integrands are polynomials of degree 4 or less, so the sum over the edges is exact.
    """
    following = np.roll(profile, -1, axis=0)
    share = (_NODES[:, None] + 1) / 2  # position along each edge, shape (3, 1)
    origin = float(profile[:, 1].mean())  # relative heights reduce rounding errors
    r = profile[:, 0] + share * (following[:, 0] - profile[:, 0])
    z = profile[:, 1] - origin + share * (following[:, 1] - profile[:, 1])
    along = math.pi * _WEIGHTS[:, None] * (following[:, 1] - profile[:, 1])  # 2 pi dz, over half the length of [-1, 1]

    def integral(values: Array) -> float:
        return math.fsum((along * values).ravel().tolist())

    sign = math.copysign(1.0, integral(r**2 / 2))
    volume, lever, square, spin = (sign * integral(v) for v in (r**2 / 2, z * r**2 / 2, z**2 * r**2 / 2, r**4 / 4))
    middle = lever / volume
    across = spin / 2 + square - volume * middle**2
    return SolidMoments(volume, np.array([0.0, 0.0, middle + origin]), _diagonal(across, across, spin))


def mesh(vertices: Array, faces: Faces) -> SolidMoments:
    """Return the moments of the solid inside a closed surface, summed over signed tetrahedra.

    The volume is negative if the faces point inward.
    """
    origin = vertices.mean(axis=0)  # placing the common apex of the tetrahedra nearby reduces rounding errors
    a, b, c = (vertices[faces[:, k]] - origin for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    volume = float(volumes.sum())
    if volume == 0.0:
        return SolidMoments(0.0, origin.copy(), np.zeros((3, 3)))
    com = ((a + b + c) * volumes[:, None]).sum(axis=0) / 4 / volume
    total = a + b + c
    second = sum(np.einsum("i,ij,ik->jk", volumes, p, p) for p in (a, b, c, total)) / 20
    second = second - volume * np.outer(com, com)
    return SolidMoments(volume, origin + com, np.trace(second) * np.eye(3) - second)


def combine(parts: list[tuple[float, SolidMoments]]) -> tuple[float, Array, Array]:
    """Return the mass [kg], center of mass [m], and inertia [kg m^2] of a body.

    ``parts`` lists the density [kg/m^3] and the moments of each part. The inertia is taken about the center of mass.
    """
    if len(parts) == 1:  # preserves all digits of the center of mass
        density, solid = parts[0]
        return density * solid.volume, solid.com, density * solid.inertia
    mass = math.fsum(d * s.volume for d, s in parts)  # the result of `sum` depends on the Python version
    com = sum((d * s.volume * s.com for d, s in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for d, s in parts:
        r = s.com - com
        inertia += d * (s.inertia + s.volume * (float(r @ r) * np.eye(3) - np.outer(r, r)))
    return mass, com, inertia
