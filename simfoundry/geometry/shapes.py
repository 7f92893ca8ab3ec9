"""Shapes in their local frames, and their surface meshes.

Sizes are full extents, never half extents. Cylinders, capsules and cones are aligned with their local z axis.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, frozen_array


@dataclass(frozen=True, eq=False)
class Box:
    """A box centered on its frame, with the full extents ``size`` [m] along its three axes."""

    size: Array


@dataclass(frozen=True)
class Sphere:
    """A sphere centered on its frame, with a ``radius`` [m]."""

    radius: float


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid centered on its frame, with ``radii`` [m] along its three axes, shape (3,)."""

    radii: Array


@dataclass(frozen=True)
class Cone:
    """A cone along z with its base at -height/2 and its tip at height/2; ``radius`` [m] is that of its base."""

    radius: float
    height: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z, centered on its frame, with a ``radius`` [m] and a full ``height`` [m]."""

    radius: float
    height: float


@dataclass(frozen=True)
class Capsule:
    """A capsule along z, centered on its frame. ``height`` [m] is the length of the cylinder, excluding the caps."""

    radius: float
    height: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Vertex positions [m], shape (n, 3).
        faces: Vertex indices of each face, int32, shape (m, 3), counterclockwise as seen from outside.
        uv: Texture coordinates, shape (n, 2), with v up as in OBJ and USD, or None.
        texture: Content of a PNG file, or None.
    """

    vertices: Array
    faces: NDArray[np.int32]
    uv: Array | None = None
    texture: bytes | None = None

    @cached_property
    def digest(self) -> str:
        """The first 16 hex digits of a content hash that identifies this mesh."""
        h = hashlib.sha256()
        for part in (self.vertices, self.faces, self.uv):
            h.update(b"-" if part is None else str(part.shape).encode() + np.ascontiguousarray(part).tobytes())
        h.update(self.texture or b"")
        return h.hexdigest()[:16]


Primitive = Box | Sphere | Ellipsoid | Cylinder | Capsule | Cone
Geometry = Primitive | Mesh


Faces = NDArray[np.int32]


def tessellate(geometry: Geometry, segments: int = 48) -> Mesh:
    """Return the surface of a primitive as a mesh in the primitive's own frame. Meshes are returned unchanged.

    ``segments`` is the number of edges around z, which must be at least 3. All vertices are on the true surface, so the
    radius of a round shape shrinks by at most ``radius * (1 - cos(pi / segments))`` [m]. The result is always
    byte-identical.
    """
    if segments < 3:
        raise ValueError(f"a round shape needs at least 3 segments, got {segments}")
    match geometry:
        case Mesh():
            return geometry
        case Box():
            return _box(geometry.size)
        case Sphere():
            return revolved(_arc(geometry.radius, 0.0, 0.0, math.pi, max(2, segments // 2)), segments)
        case Ellipsoid():
            ball = tessellate(Sphere(1.0), segments)
            return closed_mesh(ball.vertices * geometry.radii, ball.faces)
        case Cone():
            r, z = geometry.radius, geometry.height / 2
            return revolved([(0.0, z), (r, -z), (0.0, -z)], segments)
        case Cylinder():
            r, z = geometry.radius, geometry.height / 2
            return revolved([(0.0, z), (r, z), (r, -z), (0.0, -z)], segments)
        case Capsule():
            r, z, rings = geometry.radius, geometry.height / 2, max(1, segments // 4)
            top = _arc(r, z, 0.0, math.pi / 2, rings)
            bottom = _arc(r, -z, math.pi / 2, math.pi, rings)
            return revolved(top + (bottom if z > 0 else bottom[1:]), segments)


def _box(size: Array) -> Mesh:
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * np.asarray(size) / 2
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return closed_mesh(corners, np.array(faces, dtype=np.int32))


def _arc(radius: float, z: float, start: float, stop: float, steps: int) -> list[tuple[float, float]]:
    """Return points ``(r, z)`` on a circular arc around ``(0, z)``.

    The arc extends from angle ``start`` to ``stop`` [rad], measured from the +z direction.
    """
    angles = [start + (stop - start) * k / steps for k in range(steps + 1)]
    return [(radius * math.sin(a), z + radius * math.cos(a)) for a in angles]


def revolved(profile: Array | list[tuple[float, float]], segments: int = 48) -> Mesh:
    """Revolve a profile about z and return the solid as a closed mesh.

    The profile consists of (radius, height) points [m], shape (k, 2). It must start on the axis at the top, run down
    the outside, and end on the axis at the bottom.
    """
    from simfoundry.assets.solids import lathe_mesh

    return closed_mesh(*lathe_mesh(np.asarray(profile, dtype=np.float64), segments))


def closed_mesh(
    vertices: Array, faces: NDArray[np.integer], uv: Array | None = None, texture: bytes | None = None
) -> Mesh:
    """Return a mesh with read-only arrays."""
    index = np.ascontiguousarray(faces, dtype=np.int32)
    index.setflags(write=False)
    return Mesh(frozen_array(vertices), index, None if uv is None else frozen_array(uv), texture)


def hull_mesh(points: Array) -> Mesh | None:
    """Return the convex hull of points with at most 64 vertices, or None if the points are coplanar.

    Args:
        points: Points [m], shape (n, 3).
    """
    from simfoundry.assets.convex import hull
    from simfoundry.assets.errors import MeshError

    try:
        vertices, faces = hull(points)
    except MeshError:
        return None
    return closed_mesh(vertices, faces)
