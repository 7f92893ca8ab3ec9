"""Summaries of mesh files for checks (bounds, volume, gaps and hull), which are computed once and cached.

A file that is already in the cache only needs to be hashed, so repeated checks import neither numpy nor a mesh reader.
"""

from __future__ import annotations

import hashlib
import json
import math
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import TypeAdapter

from simfoundry.assets import errors
from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MeshError, Scale

if TYPE_CHECKING:
    from simfoundry.assets.mass import SolidMoments

# Minimum fraction of its convex hull's volume that a mesh must fill to count as nearly convex.
NEARLY_CONVEX = 0.90

# Version of the measurements, which is part of the cache key.
VERSION = "mesh facts 3"

Vec = tuple[float, float, float]
# Moments of a solid: its center of mass (x, y, z) followed by its inertia (xx, yy, zz, xy, xz, yz).
Moments = tuple[float, ...]

ZERO_MOMENTS: Moments = (0.0,) * 9


@dataclass(frozen=True)
class MeshFacts:
    """Measurements of a mesh in file units with z up.

    Attributes:
        sides: Extents of the bounding box along x, y and z.
        triangles: Number of triangles.
        gaps: Number of edges with a face on only one side.
        volume: Volume enclosed by the surface.
        hull_volume: Volume of the convex hull.
        hull: Corners of the convex hull, of which there are at most 64; empty if the mesh is flat.
        hull_faces: Triangles of the convex hull.
        moments: Center of mass, and inertia about the center of mass, at density 1.
        hull_moments: Center of mass and inertia of the convex hull, at density 1.
    """

    sides: Vec
    triangles: int
    gaps: int
    volume: float
    hull_volume: float
    hull: tuple[Vec, ...]
    hull_faces: tuple[tuple[int, int, int], ...] = ()
    moments: Moments = ZERO_MOMENTS
    hull_moments: Moments = ZERO_MOMENTS

    @property
    def is_nearly_convex(self) -> bool:
        """Return True if the mesh is closed and so nearly convex that ``collision: auto`` never decomposes it."""
        return not self.gaps and self.hull_volume > 0 and self.volume >= NEARLY_CONVEX * self.hull_volume

    def size(self, scale: Scale = 1.0) -> float:
        """Return the longest side [m] of the bounding box of the scaled mesh."""
        return max(side * factor for side, factor in zip(self.sides, axes_of(scale), strict=True))

    def solid(self, scale: Scale, of_hull: bool) -> SolidMoments:
        """Return the moments of the scaled mesh, or of its scaled convex hull, at density 1."""
        import numpy as np

        from simfoundry.assets.mass import SolidMoments

        x, y, z, xx, yy, zz, xy, xz, yz = self.hull_moments if of_hull else self.moments
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        volume = self.hull_volume if of_hull else self.volume
        if not isinstance(scale, tuple):
            return SolidMoments(volume * scale**3, np.array([x, y, z]) * scale, inertia * scale**5)
        factors = np.array(scale)
        second = np.trace(inertia) / 2 * np.eye(3) - inertia  # integral of the products of coordinates
        second = second * np.outer(factors, factors) * factors.prod()
        scaled = np.trace(second) * np.eye(3) - second
        return SolidMoments(volume * float(factors.prod()), np.array([x, y, z]) * factors, scaled)

    def fault(self, name: str, scale: Scale, solid: str, collision: str) -> MeshError | None:
        """Return the error that lowering would report for a body that uses this mesh, or None.

        Args:
            name: Name of the mesh file for the message.
            scale: Scale of the mesh [m per unit].
            solid: The body's ``solid`` key, or `given` if the body's inertia is specified. In that case, the mesh does
                not need to be closed.
            collision: The body's ``collision`` key.
        """
        wrong = errors.implausible_size(name, self.size(scale), scale)
        if wrong is not None:
            return wrong
        if solid == "exact" and self.gaps:
            return errors.not_closed(name, self.gaps)
        if solid == "exact" and self.volume * math.prod(axes_of(scale)) < errors.LEAST_VOLUME:
            return errors.no_volume(name)
        return errors.flat() if not self.hull and (solid == "hull" or collision != "none") else None


def axes_of(scale: Scale) -> Vec:
    """Return the scale along each axis."""
    return scale if isinstance(scale, tuple) else (scale, scale, scale)


def mesh_facts(path: Path, store: Cache | None = None) -> MeshFacts:
    """Return the measurements of a mesh file, read from the cache ``store`` if possible.

    Raises:
        MeshError: If the file cannot be read.
    """
    try:
        stat = path.stat()
        return _facts(path, (stat.st_size, stat.st_mtime_ns), store or Cache.default())
    except OSError as error:
        message = f"{path.name} could not be read as a mesh: {error.strerror or error}"
        raise MeshError("SF301", message, "make it readable") from None


@lru_cache(maxsize=4096)
def _facts(path: Path, version: tuple[int, int], store: Cache) -> MeshFacts:
    """Return the measurements of a file, which are memoized because objects often share a mesh.

    ``version`` is the file's size [bytes] and modification time [ns].
    """
    size, _ = version
    if size > errors.MAX_BYTES:
        raise errors.too_large(path.name, size)
    key = file_digest(path)
    with suppress(ValueError):  # the entry is missing, or corrupt and must be recomputed
        return _reader().validate_json(store.get(key) or b"")
    facts = measure(path)
    store.put(key, json.dumps(asdict(facts)).encode())
    return facts


@cache
def _reader() -> TypeAdapter[MeshFacts]:
    return TypeAdapter(MeshFacts)


def file_digest(path: Path) -> str:
    """Return a digest of a file's content and of its suffix, which determines the reader."""
    digest = hashlib.sha256(f"{VERSION} {path.suffix.lower()} ".encode())
    with path.open("rb") as stream:
        while block := stream.read(2**20):
            digest.update(block)
    return digest.hexdigest()


def measure(path: Path) -> MeshFacts:
    """Read a mesh file and measure it.

    Raises:
        MeshError: If the file cannot be read.
    """
    from simfoundry.assets import mass
    from simfoundry.assets.convex import hull
    from simfoundry.assets.mesh import merged, open_edges, read_parts, sides, weld

    parts = read_parts(path)
    vertices, joined = merged(parts)
    vertices, faces = weld(vertices, joined)
    triangles, gaps = len(joined), open_edges(faces)
    own = mass.mesh(vertices, faces) if len(faces) else None
    corners: tuple[Vec, ...] = ()
    hull_faces: tuple[tuple[int, int, int], ...] = ()
    full = None
    with suppress(MeshError):  # coplanar points have no hull, which is reported as a missing volume
        full = mass.mesh(*hull(vertices, limit=len(vertices)))
        points, triples = hull(vertices)
        corners = tuple((float(x), float(y), float(z)) for x, y, z in points)
        hull_faces = tuple((int(a), int(b), int(c)) for a, b, c in triples)
    volumes = (abs(own.volume) if own is not None else 0.0, full.volume if full is not None else 0.0)
    x, y, z = (float(v) for v in sides(parts))
    return MeshFacts((x, y, z), triangles, gaps, *volumes, corners, hull_faces, _moments(own), _moments(full))


def _moments(solid: SolidMoments | None) -> Moments:
    if solid is None or not solid.volume:
        return ZERO_MOMENTS
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (solid.inertia * (1 if solid.volume > 0 else -1)).tolist()
    return (*solid.com.tolist(), xx, yy, zz, xy, xz, yz)
