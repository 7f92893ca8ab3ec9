"""Shapes in local frames: full extents, never half extents; cylinders and capsules along their local z."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array


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
