"""Convex decomposition of meshes into collision geometry for all simulators."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.deviation import deviation
from simfoundry.assets.errors import flat
from simfoundry.assets.mass import mesh as solid_of
from simfoundry.assets.mesh_summary import NEARLY_CONVEX, file_digest
from simfoundry.assets.primitives import KINDS, Primitive, fitted_primitives

Array = NDArray[np.float64]
Faces = NDArray[np.int32]
Part = tuple[Array, Faces]

MAX_HULL_VERTICES = 64
"""PhysX cooks at most 64 vertices into a hull and simplifies anything larger by itself."""

SHALLOW_FILL, SHALLOW = 0.80, 0.07
"""A mesh that fills this share also does, if its hollows are no deeper than this share of its longest side.

Measured on the 21 YCB-Video objects (`python -m tests.benchmarks.colliders FOLDER`): the cans, bottles and the marker,
which are convex to a hand, fill 0.82 to 0.96 of their hulls with hollows of 3 to 6.8 %; the next are the pitcher (0.82,
8.3 %) and the banana (0.65, 18 %), then containers and tools (below 0.45, above 10 %).
"""

PRIMITIVE_MARGIN = 0.01
"""A primitive may be farther from the mesh than the hull by this share of the longest side, less than hulls are.

A prism of 24 sides or more is a cylinder by this, one of 12 sides is not.
"""

PRIMITIVE_APART = 0.10
"""Primitives farther from the hull than this share of the longest side are not compared with the mesh at all."""

SLOW_FACES = 2000
"""Smallest triangle count for caching hulls and primitives, which take a tenth of a second to compute."""


def hull(points: Array, limit: int = MAX_HULL_VERTICES) -> Part:
    """Return the convex hull of points [m], shape (n, 3), with at most ``limit`` vertices and outward faces.

    Raises :class:`MeshError` for coplanar points.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[np.sort(ConvexHull(points).vertices)]
    except (QhullError, ValueError):  # ValueError if there are no points
        raise flat() from None
    if len(corners) > limit:
        corners = corners[_spread(corners, limit)]
    result = ConvexHull(corners)
    faces = result.simplices.astype(np.int32)
    outward = result.equations[:, :3]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    flipped = np.einsum("ij,ij->i", np.cross(b - a, c - a), outward) < 0
    faces[flipped] = faces[flipped][:, ::-1]
    order = np.lexsort(faces.T[::-1])
    return corners, np.ascontiguousarray(faces[order])


def _spread(points: Array, count: int) -> NDArray[np.int64]:
    """Return the indices of ``count`` points that are far from each other, starting at the lowest corner."""
    chosen = [int(np.lexsort(points.T)[0])]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(np.array(chosen))


@dataclass(frozen=True, eq=False)
class Colliders:
    """Collision geometry of a mesh: convex ``parts``, or a single ``primitive``.

    ``error`` [m] is the largest distance between its surface and that of the mesh.
    """

    parts: tuple[Part, ...] = ()
    primitive: Primitive | None = None
    error: float = 0.0


def mesh_colliders(
    vertices: Array,
    faces: Faces,
    how: str,
    cache: Cache | None = None,
    name: str = "the mesh",
    report: Callable[[str], object] = lambda message: None,
) -> Colliders:
    """Colliders of a welded mesh: its ``hull``, convex parts of it (``decompose``), or ``auto``, whichever suits it.

    ``auto`` gives a box, cylinder or sphere where that is as near as the hull, the hull where the mesh is nearly
    convex, and parts where it is not. ``report`` hears what takes long. Raises :class:`MeshError`, with ``name``, where
    the mesh is flat or cannot be decomposed; ``none`` gives none.
    """
    if how == "none":
        return Colliders()
    from simfoundry.assets import decompose

    key = key_of("colliders 1", how, decompose.settings(), vertices.tobytes(), faces.tobytes())
    stored = cache.get(key) if cache is not None else None
    kept = unpack_colliders(stored) if stored is not None else None
    if kept is not None:
        return kept
    found = _chosen(vertices, faces, how, name, report)
    if cache is not None and (len(found.parts) > 1 or len(faces) >= SLOW_FACES):
        cache.put(key, pack_colliders(found))
    return found


def _chosen(vertices: Array, faces: Faces, how: str, name: str, report: Callable[[str], object]) -> Colliders:
    from simfoundry.assets import decompose  # most meshes need no process
    from simfoundry.assets.deviation import simplified

    whole, outline = hull(vertices), hull(vertices, limit=len(vertices))
    volume, full = solid_of(vertices, faces).volume, solid_of(*outline).volume
    vertices, faces, lost = simplified(vertices, faces)
    size = float(np.ptp(vertices, axis=0).max())
    error = deviation(vertices, faces, [whole])
    filled = volume / full
    nearly = filled >= NEARLY_CONVEX or (filled >= SHALLOW_FILL and error <= SHALLOW * size)
    if how == "hull":
        return Colliders((whole,), None, error + lost)
    if how == "auto" and nearly:
        return _simplest(vertices, faces, outline[0], whole, error, lost, size)
    pieces = decompose.decompose(name, vertices, faces, report)
    parts = tuple(hull(corners) for corners in pieces if _is_solid(corners))
    if not parts:
        return Colliders((whole,), None, error + lost)
    return Colliders(parts, None, deviation(vertices, faces, list(parts)) + lost)


def _simplest(
    vertices: Array, faces: Faces, corners: Array, whole: Part, error: float, lost: float, size: float
) -> Colliders:
    """The nearest primitive of a nearly convex mesh, where it is not much farther from it than the hull; else that."""
    best, nearest = Colliders((whole,), None, error + lost), error + PRIMITIVE_MARGIN * size
    for primitive in fitted_primitives(corners, PRIMITIVE_APART * size):
        apart = deviation(vertices, faces, [hull(primitive.corners(), limit=len(vertices) + 1000)])
        if apart <= nearest:
            best, nearest = Colliders((), primitive, apart + lost), apart
    return best


def _is_solid(vertices: Array) -> bool:
    """Return True if points span a volume; slivers make contacts unstable."""
    centered = np.asarray(vertices) - np.mean(vertices, axis=0)
    return len(vertices) >= 4 and float(np.linalg.svd(centered, compute_uv=False)[2]) > 1e-5


def file_key(path: Path, scale: float, how: str) -> str:
    """Return the cache key of the colliders of a mesh file read with a scale, without reading the mesh."""
    from simfoundry.assets import decompose

    return key_of("file colliders 1", how, repr(scale), decompose.settings(), file_digest(path))


def pack_colliders(found: Colliders) -> bytes:
    """Serialize colliders for a cache."""
    stream = io.BytesIO()
    arrays: dict[str, Array | Faces] = {"error": np.array([found.error])}
    for k, (corners, sides) in enumerate(found.parts):
        arrays |= {f"v{k:03d}": corners, f"f{k:03d}": sides}
    if found.primitive is not None:
        body = found.primitive
        kind = np.array([KINDS.index(body.kind)], dtype=np.int32)
        arrays |= {"kind": kind, "size": np.array(body.size), "rotation": body.rotation, "center": body.center}
    np.savez(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def unpack_colliders(data: bytes) -> Colliders | None:
    """Deserialize a cache entry; None if it is damaged and must be recomputed."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            count = sum(name.startswith("v") for name in arrays.files)
            parts = tuple((arrays[f"v{k:03d}"], arrays[f"f{k:03d}"]) for k in range(count))
            primitive = None
            if "kind" in arrays.files:
                size = tuple(float(v) for v in arrays["size"])
                primitive = Primitive(KINDS[int(arrays["kind"][0])], size, arrays["rotation"], arrays["center"])
            return Colliders(parts, primitive, float(arrays["error"][0]))
    except (ValueError, OSError, KeyError, EOFError, IndexError, zipfile.BadZipFile):
        return None
