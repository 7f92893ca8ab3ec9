"""Convex decomposition of meshes into collision geometry for all simulators.

CoACD runs in a subprocess because it can crash, hang, or run out of memory on bad meshes.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.deviation import deviation, simplified
from simfoundry.assets.errors import MeshError, Scale, flat
from simfoundry.assets.mass import Array, Faces
from simfoundry.assets.mass import mesh as solid_of
from simfoundry.assets.mesh_summary import NEARLY_CONVEX, file_digest
from simfoundry.assets.primitives import KINDS, Primitive, fitted_primitives
from simfoundry.runtime.workers import CrashError, Limits, Worker, WorkerError

# Resource limits per mesh; YCB meshes take up to a minute on one core.
LIMITS = Limits(seconds=300.0, memory=8 * 2**30)

# The function to call in the subprocess.
FUNCTION = "simfoundry.assets.convex:run"

# Maximum number of colliders per mesh; simulation time is proportional to this number.
MAX_PARTS = 32

SETTINGS: dict[str, float | int] = {
    # Chosen from 0.05, 0.1 and 0.2 by measurements on YCB. A threshold of 0.1 splits the banana into 3 parts with an
    # error of 6.7 mm (0.2: 2 parts, 10 mm) and the mug into 32 parts with 8.6 mm (0.2: 23 parts, 12 mm). A threshold of
    # 0.05 takes up to three times as long and reduces the drill's error only from 8.2 to 6.7 mm.
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
    """Decompose a welded, closed mesh into convex pieces.

    Args:
        name: Name of the mesh for messages.
        vertices: Vertices of the mesh [m], shape (n, 3).
        faces: Triangles of the mesh, shape (m, 3).
        report: Function that receives a progress message every two seconds.

    Returns:
        The corners [m] of each piece, shape (k, 3).

    Raises:
        MeshError: If CoACD fails. The message names the mesh.
    """
    message = f"decomposing {name} into convex parts"
    report(message)
    call = partial(_worker().call, FUNCTION, vertices, faces, wait=lambda s: report(f"{message}, {s:.0f} s"))
    try:
        with suppress(CrashError):
            return list(call("auto"))
        return list(call("off"))  # the check crashed on triangles without area, and a closed mesh needs no repair
    except WorkerError as error:
        hint = "repair or simplify the mesh, or write `collision: hull`"
        raise MeshError("SF301", f"{name} could not be decomposed: CoACD {error}", hint) from None


@cache
def settings() -> str:
    """Return all settings that affect mesh decomposition as a string for use in cache keys."""
    from importlib.metadata import version

    return f"coacd {version('coacd')} {sorted(SETTINGS.items())!r}"


@cache
def _worker() -> Worker:
    """Return the CoACD subprocess, which is started for the first mesh and then reused."""
    return Worker(LIMITS)


def run(vertices: Array, faces: Faces, preprocess_mode: str) -> list[Any]:
    """Decompose a mesh with CoACD in this process.

    With the mode ``auto``, CoACD checks the mesh, and repairs it if it intersects itself. With ``off``, it does not.
    """
    import coacd

    coacd.set_log_level("error")
    mesh = coacd.Mesh(vertices, faces)
    pieces = coacd.run_coacd(mesh, decimate=True, preprocess_mode=preprocess_mode, **SETTINGS)
    return [np.asarray(corners, dtype=np.float64) for corners, _ in pieces]


Part = tuple[Array, Faces]

# Maximum number of vertices in a convex hull; PhysX simplifies larger hulls on its own.
MAX_HULL_VERTICES = 64

# Limits for meshes that fill less than ``NEARLY_CONVEX`` of their hull but still collide as the hull.
#
# The first is the minimum fraction of the hull's volume that the mesh fills, the second the maximum depth of its
# concave regions relative to its longest side. Both were chosen from measurements on the 21 YCB-Video objects (`python
# -m tests.benchmarks.colliders FOLDER`). Cans, bottles and the marker, which a gripper can treat as convex, fill 0.82
# to 0.96 of their hulls with concave regions of 3 to 6.8% in depth. Next are the pitcher (0.82, 8.3%) and the banana
# (0.65, 18%), followed by containers and tools (below 0.45, above 10%).
SHALLOW_FILL, SHALLOW = 0.80, 0.07

# How much farther from the mesh a primitive may be than the hull, as a fraction of the mesh's longest side.
#
# With this margin, a prism with at least 24 sides is replaced with a cylinder, but a prism with 12 sides is not.
PRIMITIVE_MARGIN = 0.01

# Maximum distance of a primitive from the hull, as a fraction of the mesh's longest side.
#
# Primitives farther away are rejected without being compared with the mesh.
PRIMITIVE_APART = 0.10

# Minimum number of triangles for which hulls and primitives are cached; computing them then takes about 0.1 s.
SLOW_FACES = 2000


def hull(points: Array, limit: int = MAX_HULL_VERTICES) -> Part:
    """Return the convex hull of n points.

    The hull has at most ``limit`` vertices, and its triangles face outward.

    Args:
        points: Points [m], shape (n, 3).
        limit: Maximum number of vertices.

    Raises:
        MeshError: If the points are coplanar.
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
    """Return the indices of ``count`` points that are far apart, selected greedily starting at the lowest corner."""
    chosen = [int(np.lexsort(points.T)[0])]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(np.array(chosen))


@dataclass(frozen=True, eq=False)
class Colliders:
    """The collision geometry for a mesh, which consists of convex ``parts`` or of a single ``primitive``.

    ``error`` [m] is the maximum distance between the surfaces of the collision geometry and the mesh.
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
    """Return the collision geometry for a welded mesh.

    Args:
        vertices: Vertices of the mesh [m], shape (n, 3).
        faces: Triangles of the mesh, shape (m, 3).
        how: Method, with the same values as the ``collision`` key in a document: ``hull``, ``decompose``, ``auto`` or
            ``none``. With ``auto``, a nearly convex mesh becomes a box, cylinder or sphere if that shape is about as
            close to the mesh as its hull, and otherwise becomes its hull. All other meshes are decomposed into convex
            parts.
        cache: Cache for the results.
        name: Name of the mesh for messages.
        report: Function that receives progress messages.

    Raises:
        MeshError: If the mesh is flat or cannot be decomposed. The message names the mesh.
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
    """Return True if the points span a volume that is not a sliver, because slivers would make contacts unstable."""
    centered = np.asarray(vertices) - np.mean(vertices, axis=0)
    return len(vertices) >= 4 and float(np.linalg.svd(centered, compute_uv=False)[2]) > 1e-5


def file_key(path: Path, scale: Scale, how: str) -> str:
    """Return the cache key for the colliders of a mesh file that is read with ``scale``, without parsing the mesh."""
    return key_of("file colliders 1", how, repr(scale), settings(), file_digest(path))


def pack_colliders(found: Colliders) -> bytes:
    """Serialize colliders for the cache."""
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
    """Deserialize colliders from a cache entry, or return None if the entry is corrupt and must be recomputed."""
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
