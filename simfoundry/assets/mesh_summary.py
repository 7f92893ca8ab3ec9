"""What a check wants to know of a mesh file: bounds, volume, gaps and hull, measured once and kept in the cache.

A file that was measured before is only hashed, so that a second check loads neither numpy nor a reader of meshes.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import (
    LEAST_VOLUME,
    MAX_BYTES,
    MeshError,
    flat,
    implausible_size,
    no_volume,
    not_closed,
    too_large,
)

VERSION = "mesh facts 1"
"""Changes with what is measured."""

Vec = tuple[float, float, float]


@dataclass(frozen=True)
class MeshFacts:
    """A mesh in the units of its file, z up.

    ``size`` is the longest side of its bounds; ``triangles`` counts them, ``gaps`` the edges with a face on one side
    only; ``volume`` and ``hull_volume`` are those of the surface and of its convex hull, of which ``hull`` has at most
    64 corners, and none where the mesh is flat.
    """

    size: float
    triangles: int
    gaps: int
    volume: float
    hull_volume: float
    hull: tuple[Vec, ...]

    def fault(self, name: str, scale: float, solid: str, collision: str) -> MeshError | None:
        """What lowering will find wrong with the file ``name``, read with ``scale``, as a body of these fields.

        Where the inertia of the body is given, ``solid`` is `given`: the mesh need not be closed.
        """
        wrong = implausible_size(name, self.size * scale, scale)
        if wrong is None and solid == "exact":
            if self.gaps:
                wrong = not_closed(name, self.gaps)
            elif self.volume * scale**3 < LEAST_VOLUME:
                wrong = no_volume(name)
        if wrong is None and not self.hull and (solid == "hull" or collision != "none"):
            wrong = flat()
        return wrong


def mesh_facts(path: Path, cache: Cache | None = None) -> MeshFacts:
    """The facts of a mesh file, from the cache where they are; raises :class:`MeshError` where it cannot be read."""
    try:
        stat = path.stat()
    except OSError as error:
        raise _unreadable(path, error) from None
    return _facts(path, (stat.st_size, stat.st_mtime_ns), cache or Cache.default())


def _unreadable(path: Path, error: OSError) -> MeshError:
    return MeshError("SF301", f"{path.name} cannot be read as a mesh: {error.strerror or error}", "make it readable")


@lru_cache(maxsize=4096)
def _facts(path: Path, version: tuple[int, int], cache: Cache) -> MeshFacts:
    """The facts of a file of this size [B], changed at this time [ns]; many things are made of one mesh."""
    size, _ = version
    if size > MAX_BYTES:
        raise too_large(path.name, size)
    try:
        key = _key(path)
    except OSError as error:
        raise _unreadable(path, error) from None
    stored = cache.get(key)
    facts = _read(stored) if stored is not None else None
    if facts is None:
        facts = measure(path)
        cache.put(key, json.dumps(asdict(facts)).encode())
    return facts


def _key(path: Path) -> str:
    """Of the bytes, and of the suffix that says how they are read."""
    import hashlib

    digest = hashlib.sha256(f"{VERSION} {path.suffix.lower()} ".encode())
    with path.open("rb") as stream:
        while block := stream.read(2**20):
            digest.update(block)
    return digest.hexdigest()


def _read(stored: bytes) -> MeshFacts | None:
    """The stored facts; None where the entry is damaged, so that they are measured again."""
    try:
        data = json.loads(stored)
        hull = tuple((float(x), float(y), float(z)) for x, y, z in data["hull"])
        numbers = (float(data["size"]), int(data["triangles"]), int(data["gaps"]))
        return MeshFacts(*numbers, float(data["volume"]), float(data["hull_volume"]), hull)
    except (ValueError, TypeError, KeyError):
        return None


def measure(path: Path) -> MeshFacts:
    """Read a mesh file and measure it; raises :class:`MeshError` where it cannot be read."""
    import numpy as np

    from simfoundry.assets import mass
    from simfoundry.assets.convex import hull
    from simfoundry.assets.mesh import extent, open_edges, read_parts, weld

    parts = read_parts(path)
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts)])
    vertices = np.concatenate([p.vertices for p in parts])
    joined = np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)]).astype(np.int32)
    vertices, faces = weld(vertices, joined)
    triangles, gaps = len(joined), open_edges(faces)
    volume = abs(mass.mesh(vertices, faces).volume) if len(faces) else 0.0
    corners: tuple[Vec, ...] = ()
    full = 0.0
    try:
        full = mass.mesh(*hull(vertices, limit=len(vertices))).volume
        corners = tuple((float(x), float(y), float(z)) for x, y, z in hull(vertices)[0])
    except MeshError:
        pass  # flat or a point: it has no hull, and the finding is that of its volume
    return MeshFacts(extent(parts), triangles, gaps, volume, full, corners)
