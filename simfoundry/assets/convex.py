"""Convex decomposition of meshes into collision geometry for all simulators.

CoACD runs in a subprocess, because it may crash, hang, or exhaust memory on bad meshes.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.deviation import deviation, simplified
from simfoundry.assets.errors import MeshError, flat
from simfoundry.assets.mass import mesh as solid_of
from simfoundry.assets.mesh_summary import NEARLY_CONVEX, file_digest
from simfoundry.assets.primitives import KINDS, Primitive, fitted_primitives
from simfoundry.runtime.workers import Limits, Worker, WorkerError

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

LIMITS = Limits(seconds=300.0, memory=8 * 2**30)
"""Limits of one mesh; those of YCB take up to a minute of one core."""

FUNCTION = "simfoundry.assets.convex:run"
"""Function that the subprocess calls."""

MAX_PARTS = 32
"""Largest number of colliders of a mesh; the simulation time is proportional to it."""

SETTINGS: dict[str, float | int] = {
    # Of 0.05, 0.1 and 0.2 measured on YCB: with 0.1 the banana is 3 parts within 6.7 mm (2 within 10 with 0.2) and the
    # mug 32 within 8.6 mm (23 within 12); 0.05 takes up to three times as long, for 6.7 mm where 0.1 has 8.2 (drill).
    "threshold": 0.1,
    "max_convex_hull": MAX_PARTS,
    "seed": 0,
    "max_ch_vertex": 60,
    "resolution": 1000,
    "mcts_iterations": 20,
    "mcts_nodes": 10,
    "mcts_max_depth": 2,
}


def decompose(
    name: str, vertices: Array, faces: Faces, report: Callable[[str], object] = lambda message: None
) -> list[Array]:
    """Return the corners [m] of the convex pieces of a welded, closed mesh, each of shape (n, 3).

    ``report`` receives a progress message every other second. Raises :class:`MeshError`, which names the mesh, if CoACD
    fails.
    """
    message = f"cutting {name} into convex parts"
    report(message)
    try:
        return list(_worker().call(FUNCTION, vertices, faces, wait=lambda s: report(f"{message}, {s:.0f} s")))
    except WorkerError as error:
        hint = "repair or simplify the mesh, or write `collision: hull`"
        raise MeshError("SF301", f"{name} cannot be decomposed: CoACD {error}", hint) from None


@cache
def settings() -> str:
    """Return the settings that determine the pieces of a mesh."""
    from importlib.metadata import version

    return f"coacd {version('coacd')} {sorted(SETTINGS.items())!r}"


@cache
def _worker() -> Worker:
    """Return the subprocess, which is started for the first mesh and reused for all others."""
    return Worker(LIMITS)


def run(vertices: Array, faces: Faces) -> list[Any]:
    """Decompose a mesh with CoACD in this process."""
    import coacd

    coacd.set_log_level("error")
    pieces = coacd.run_coacd(coacd.Mesh(vertices, faces), decimate=True, **SETTINGS)
    return [np.asarray(corners, dtype=np.float64) for corners, _ in pieces]


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
    """Return the colliders of a welded mesh: its ``hull``, convex parts (``decompose``), the best (``auto``), or none.

    ``auto`` chooses a box, cylinder or sphere if it is as close to the mesh as the hull, otherwise the hull if the mesh
    is nearly convex, and convex parts if it is not. ``report`` receives progress messages. Raises :class:`MeshError`,
    which names the mesh, if it is flat or cannot be decomposed.
    """
    if how == "none":
        return Colliders()
    key = key_of("colliders 1", how, settings(), vertices.tobytes(), faces.tobytes())
    stored = cache.get(key) if cache is not None else None
    found = unpack_colliders(stored) if stored is not None else None
    if found is not None:
        return found
    found = _chosen(vertices, faces, how, name, report)
    if cache is not None and (len(found.parts) > 1 or len(faces) >= SLOW_FACES):
        cache.put(key, pack_colliders(found))
    return found


def _chosen(vertices: Array, faces: Faces, how: str, name: str, report: Callable[[str], object]) -> Colliders:
    whole, outline = hull(vertices), hull(vertices, limit=len(vertices))
    filled = solid_of(vertices, faces).volume / solid_of(*outline).volume
    vertices, faces, lost = simplified(vertices, faces)
    size = float(np.ptp(vertices, axis=0).max())
    error = deviation(vertices, faces, [whole])
    nearly = filled >= NEARLY_CONVEX or (filled >= SHALLOW_FILL and error <= SHALLOW * size)
    best = Colliders((whole,), None, error + lost)
    if how == "auto" and nearly:  # the closest primitive, unless all are much farther from the mesh than the hull
        closest = error + PRIMITIVE_MARGIN * size
        for primitive in fitted_primitives(outline[0], PRIMITIVE_APART * size):
            apart = deviation(vertices, faces, [hull(primitive.corners(), limit=len(vertices) + 1000)])
            if apart <= closest:
                best, closest = Colliders((), primitive, apart + lost), apart
    elif how != "hull":
        pieces = decompose(name, vertices, faces, report)
        parts = tuple(hull(corners) for corners in pieces if _is_solid(corners))
        if parts:
            best = Colliders(parts, None, deviation(vertices, faces, list(parts)) + lost)
    return best


def _is_solid(vertices: Array) -> bool:
    """Return True if points span a volume; slivers make contacts unstable."""
    centered = np.asarray(vertices) - np.mean(vertices, axis=0)
    return len(vertices) >= 4 and float(np.linalg.svd(centered, compute_uv=False)[2]) > 1e-5


def file_key(path: Path, scale: float, how: str) -> str:
    """Return the cache key of the colliders of a mesh file read with a scale, without reading the mesh."""
    return key_of("file colliders 1", how, repr(scale), settings(), file_digest(path))


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
