"""Convex parts of meshes and prisms: what touches in every simulator."""

from __future__ import annotations

import io
import zipfile

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.faults import flat
from simfoundry.assets.mass import mesh as solid_of

Array = NDArray[np.float64]
Faces = NDArray[np.int32]
Part = tuple[Array, Faces]

MAX_HULL_VERTICES = 64
"""PhysX cooks at most 64 vertices into a hull and simplifies anything larger by itself."""

NEARLY_CONVEX = 0.90
"""A mesh that fills this share of its hull collides as its hull."""


def hull(points: Array, limit: int = MAX_HULL_VERTICES) -> Part:
    """Convex hull of points [m], shape (n, 3), with at most ``limit`` vertices, faces counter-clockwise from outside.

    Raises :class:`MeshError` for points that lie in one plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[np.sort(ConvexHull(points).vertices)]
    except (QhullError, ValueError):  # the second where there are no points at all
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
    """Indices of ``count`` points that lie far from one another, starting at the lowest corner."""
    chosen = [int(np.lexsort(points.T)[0])]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(np.array(chosen))


def convex_parts(
    vertices: Array, faces: Faces, how: str, cache: Cache | None = None, name: str = "the mesh"
) -> tuple[Part, ...]:
    """Convex parts of a welded mesh: ``hull``, ``decompose``, or ``auto`` for whichever suits it; none for ``none``.

    Raises :class:`MeshError`, with ``name``, where it is flat or cannot be decomposed.
    """
    if how == "none":
        return ()
    whole = hull(vertices)
    if how == "hull" or (how == "auto" and _nearly_convex(vertices, faces)):
        return (whole,)
    from simfoundry.assets import decompose  # most meshes need no process

    key = key_of("convex 2", decompose.settings(), vertices.tobytes(), faces.tobytes())
    stored = cache.get(key) if cache is not None else None
    kept = _unpack(stored) if stored is not None else ()
    if kept:
        return kept
    parts = tuple(hull(corners) for corners in decompose.decompose(name, vertices, faces) if _is_solid(corners))
    if not parts:
        return (whole,)
    if cache is not None:
        cache.put(key, _pack(parts))
    return parts


def _nearly_convex(vertices: Array, faces: Faces) -> bool:
    full = solid_of(*hull(vertices, limit=len(vertices))).volume
    return solid_of(vertices, faces).volume / full >= NEARLY_CONVEX


def _is_solid(vertices: Array) -> bool:
    """Whether points span a volume; slivers would only make trouble in contact."""
    centred = np.asarray(vertices) - np.mean(vertices, axis=0)
    return len(vertices) >= 4 and float(np.linalg.svd(centred, compute_uv=False)[2]) > 1e-5


def _pack(parts: tuple[Part, ...]) -> bytes:
    stream = io.BytesIO()
    arrays: dict[str, Array | Faces] = {}
    for k, (corners, sides) in enumerate(parts):
        arrays |= {f"v{k:03d}": corners, f"f{k:03d}": sides}
    np.savez(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def _unpack(data: bytes) -> tuple[Part, ...]:
    """The stored parts; none where the entry is damaged, so that they are computed again."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            count = len(arrays.files) // 2
            return tuple((arrays[f"v{k:03d}"], arrays[f"f{k:03d}"]) for k in range(count))
    except (ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile):
        return ()
