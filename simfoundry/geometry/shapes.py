"""Shapes in local frames, and their surfaces.

Sizes are full extents, never half extents; cylinders and capsules are along their local z.
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
    """A box centered on its frame; ``size`` is its full extents [m], shape (3,)."""

    size: Array


@dataclass(frozen=True)
class Sphere:
    """A sphere centered on its frame; ``radius`` [m]."""

    radius: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z, centered on its frame; ``radius`` and full ``height`` [m]."""

    radius: float
    height: float


@dataclass(frozen=True)
class Capsule:
    """A capsule along z, centered on its frame; ``height`` [m] is that of the cylindrical part, without the caps."""

    radius: float
    height: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    ``vertices`` [m], shape (n, 3); ``faces`` int32, shape (m, 3), counter-clockwise from outside; ``uv`` shape (n, 2)
    with v up (as in OBJ and USD), or None; ``texture`` the bytes of a PNG, or None.
    """

    vertices: Array
    faces: NDArray[np.int32]
    uv: Array | None = None
    texture: bytes | None = None

    @cached_property
    def digest(self) -> str:
        """Sixteen hex digits of a content hash that identifies this mesh."""
        h = hashlib.sha256()
        for part in (self.vertices, self.faces, self.uv):
            h.update(b"-" if part is None else str(part.shape).encode() + np.ascontiguousarray(part).tobytes())
        h.update(self.texture or b"")
        return h.hexdigest()[:16]


Primitive = Box | Sphere | Cylinder | Capsule
Geometry = Primitive | Mesh


Faces = NDArray[np.int32]


def tessellate(geometry: Geometry, segments: int = 48) -> Mesh:
    """Return the surface of a primitive as a mesh in the primitive's own frame; meshes are returned unchanged.

    ``segments`` is the number of edges around z, at least 3. Vertices lie on the true surface, so a round shape loses
    at most ``radius * (1 - cos(pi / segments))`` [m] of its radius. Equal inputs give equal bytes.
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
    """Points ``(r, z)`` on a circle about ``(0, z)`` from angle ``start`` to ``stop`` [rad], measured from +z."""
    angles = [start + (stop - start) * k / steps for k in range(steps + 1)]
    return [(radius * math.sin(a), z + radius * math.cos(a)) for a in angles]


def revolved(profile: Array | list[tuple[float, float]], segments: int = 48) -> Mesh:
    """Return the solid of revolution of a profile of (radius, height) [m], shape (k, 2), as a closed mesh.

    The profile starts and ends on the axis, from the top down the outside to the bottom.
    """
    from simfoundry.assets.solids import lathe_mesh

    return closed_mesh(*lathe_mesh(np.asarray(profile, dtype=np.float64), segments))


def closed_mesh(vertices: Array, faces: NDArray[np.integer]) -> Mesh:
    """Return a mesh with read-only arrays."""
    index = np.ascontiguousarray(faces, dtype=np.int32)
    index.setflags(write=False)
    return Mesh(vertices=frozen_array(vertices), faces=index)


def hull_mesh(points: Array) -> Mesh | None:
    """Convex hull of points [m], shape (n, 3), with at most 64 vertices; None if the points are coplanar."""
    from simfoundry.assets.convex import hull
    from simfoundry.assets.errors import MeshError

    try:
        vertices, faces = hull(points)
    except MeshError:
        return None
    return closed_mesh(vertices, faces)
