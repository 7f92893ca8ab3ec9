"""Closed triangle meshes of simple solids, and the mass properties that say whether one stands."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simfoundry.scene.frames import Array, frozen_array
from simfoundry.scene.model import Box, Capsule, Cylinder, Geometry, Mesh, Sphere

SIDES = 48


def as_mesh(geometry: Geometry) -> Mesh:
    """The geometry itself if it is a mesh, else a closed mesh of the primitive, in the same frame."""
    if isinstance(geometry, Mesh):
        return geometry
    if isinstance(geometry, Box):
        return box_mesh(geometry.size)
    if isinstance(geometry, Cylinder):
        half = geometry.height / 2
        return lathe_mesh(np.array([[0.0, half], [geometry.radius, half], [geometry.radius, -half], [0.0, -half]]))
    if isinstance(geometry, Capsule):
        cap, half = np.linspace(0, math.pi / 2, 9), geometry.height / 2
        upper = np.column_stack([np.sin(cap), np.cos(cap)]) * geometry.radius + [0, half]
        return lathe_mesh(np.vstack([upper, upper[::-1] * [1, -1]]))
    assert isinstance(geometry, Sphere)
    angle = np.linspace(0, math.pi, 17)
    return lathe_mesh(geometry.radius * np.column_stack([np.sin(angle), np.cos(angle)]))


def box_mesh(size: Array) -> Mesh:
    """A box of full extents ``size`` [m] centred on its frame: eight corners, twelve faces."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh(frozen_array(corners), _faces(faces))


def lathe_mesh(profile: Array, sides: int = SIDES) -> Mesh:
    """A profile of (radius, height) [m], shape (k, 2), revolved about z.

    The profile starts and ends on the axis (radius 0) and runs so that the solid lies on its right-hand side in the
    (radius, height) plane: from the top down the outside to the foot.
    """
    angle = np.arange(sides) * (2 * math.pi / sides)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    inner = profile[1:-1]
    vertices = np.concatenate(
        [
            np.array([[0.0, 0.0, profile[0, 1]]]),
            *[np.column_stack([radius * ring, np.full(sides, height)]) for radius, height in inner],
            np.array([[0.0, 0.0, profile[-1, 1]]]),
        ]
    )
    return Mesh(frozen_array(vertices), _ring_faces(len(inner), sides))


def loft_mesh(rings: Array) -> Mesh:
    """Rings of points [m], shape (k, sides, 3), from the bottom up, each counter-clockwise from above, closed by caps.

    The caps are fans about each end ring's mean, so the end rings must be star-shaped about it.
    """
    levels, sides, _ = rings.shape
    top_down = rings[::-1].reshape(-1, 3)
    vertices = np.concatenate([rings[-1].mean(axis=0)[None], top_down, rings[0].mean(axis=0)[None]])
    return Mesh(frozen_array(vertices), _ring_faces(levels, sides))


def _ring_faces(levels: int, sides: int) -> NDArray[np.int32]:
    """Faces over an apex, ``levels`` rings from the top down and a second apex, counter-clockwise from outside."""
    here = np.arange(sides)
    after = (here + 1) % sides
    first, last = 1, 1 + (levels - 1) * sides
    end = 1 + levels * sides
    parts = [np.column_stack([np.zeros(sides, dtype=int), first + here, first + after])]
    for level in range(levels - 1):
        upper, lower = 1 + level * sides, 1 + (level + 1) * sides
        parts.append(np.column_stack([upper + here, lower + here, lower + after]))
        parts.append(np.column_stack([upper + here, lower + after, upper + after]))
    parts.append(np.column_stack([np.full(sides, end), last + after, last + here]))
    return _faces(np.concatenate(parts))


def _faces(faces: object) -> NDArray[np.int32]:
    array = np.array(faces, dtype=np.int32)
    array.setflags(write=False)
    return array


def volume_and_com(vertices: Array, faces: NDArray[np.int32]) -> tuple[float, Array]:
    """Volume [m^3] of a closed mesh (positive if it faces outward) and its centre of mass [m], shape (3,)."""
    origin = vertices.mean(axis=0)  # near the solid, so that nothing cancels
    a, b, c = (vertices[faces[:, k]] - origin for k in range(3))
    six_volumes = np.einsum("ij,ij->i", a, np.cross(b, c))
    total = float(six_volumes.sum())
    if abs(total) < 1e-15:
        return 0.0, origin
    return total / 6.0, origin + (six_volumes[:, None] * (a + b + c) / 4.0).sum(axis=0) / total


def hull_margin(footprint: Array, point: Array) -> float:
    """How far inside the convex hull of ``footprint`` (xy [m], shape (n, 2)) a point lies [m]; negative outside."""
    from scipy.spatial import ConvexHull

    equations = ConvexHull(footprint).equations
    return float(-(equations[:, :2] @ point + equations[:, 2]).max())
