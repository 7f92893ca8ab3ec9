"""Bodies and backgrounds from mesh files.

Meshes are decomposed for builds, but only looked up in the cache for drafts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simfoundry.assets import convex, mass
from simfoundry.assets.cache import Cache
from simfoundry.assets.convex import Colliders
from simfoundry.assets.errors import LEAST_VOLUME, MeshError, Scale, implausible_size, no_volume, not_closed
from simfoundry.assets.mass import Faces
from simfoundry.assets.mesh import MeshPart, merged, open_edges, read_mesh, read_parts, weld
from simfoundry.assets.mesh_summary import mesh_facts
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Sphere, closed_mesh
from simfoundry.scene.bodies import GRAY, MeshUse
from simfoundry.scene.model import Background, Visual
from simfoundry.scene.state import pose
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.surroundings import BackgroundSpec
from simfoundry.splats.files import read_splat
from simfoundry.splats.gaussians import GaussianSplat


class MeshBody(NamedTuple):
    """A body created from a mesh file.

    Attributes:
        pieces: The visuals.
        solid: A solid with density 1, or None if the mass is already specified.
        colliders: The colliders with their poses in the mesh frame.
        error: The maximum distance between the colliders and the mesh [m].
        is_approximate: True if the convex hull is used because the convex parts are not known.
    """

    pieces: tuple[MeshPart, ...] = ()
    solid: mass.SolidMoments | None = None
    colliders: tuple[tuple[Geometry, Pose], ...] = ()
    error: float = 0.0
    is_approximate: bool = False


def read_body(path: Path, use: MeshUse, cache: Cache | None, report: Callable[[str], object]) -> MeshBody:
    """Read a mesh file and decompose it into convex parts, using ``cache``.

    Raises:
        MeshError: If the file cannot be used.
    """
    pieces = read_mesh(path, use.scale)
    if not use.touches:
        return MeshBody(pieces)
    vertices, faces = weld(*merged(pieces))
    if mass.mesh(vertices, faces).volume < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    solid = None if use.solid == "given" else _solid(path.name, vertices, faces, use.solid)
    found = convex.mesh_colliders(vertices, faces, use.collision, cache, path.name, report)
    if cache is not None and use.collision != "none":
        cache.put(convex.file_key(path, use.scale, use.collision), convex.pack_colliders(found))
    return MeshBody(pieces, solid, _posed(found), found.error)


def draft_body(path: Path, use: MeshUse, cache: Cache | None) -> MeshBody:
    """Return the solid of a mesh file and its cached convex parts, without decomposing the mesh.

    If the convex parts are not cached, the convex hull is returned instead of them.

    Raises:
        MeshError: If the file cannot be used, as in :func:`read_body`.
    """
    summary = mesh_facts(path, cache)
    if use.touches:
        wrong = summary.fault(path.name, use.scale, use.solid, use.collision)
    else:
        wrong = implausible_size(path.name, summary.size(use.scale), use.scale)
    if wrong is not None:
        raise wrong
    if not use.touches:
        return MeshBody()
    solid = None if use.solid == "given" else summary.solid(use.scale, use.solid == "hull")
    if use.collision == "none":
        return MeshBody(solid=solid)
    stored = cache.get(convex.file_key(path, use.scale, use.collision)) if cache is not None else None
    found = convex.unpack_colliders(stored) if stored is not None else None
    if found is not None:
        return MeshBody((), solid, _posed(found), found.error)
    found = Colliders(((np.array(summary.hull) * use.scale, np.array(summary.hull_faces, dtype=np.int32)),))
    return MeshBody((), solid, _posed(found), 0.0, use.collision != "hull" and not summary.is_nearly_convex)


def shown_pieces(path: Path, scale: Scale) -> tuple[MeshPart, ...]:
    """Return the visual pieces of a mesh file, which are kept until the file changes.

    Raises:
        MeshError: If the file cannot be read.
    """
    try:
        state = path.stat()
    except OSError:
        return read_mesh(path, scale)
    return _kept_pieces(path, scale, (state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=32)
def _kept_pieces(path: Path, scale: Scale, version: tuple[int, int]) -> tuple[MeshPart, ...]:
    """Read the pieces of a mesh file, which has been seen in a ``version``."""
    del version  # part of the cache's key alone
    return read_mesh(path, scale)


def shown_splat(path: Path, scale: float) -> GaussianSplat:
    """Return the splat in a file, which is kept until the file changes.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    try:
        state = path.stat()
    except OSError:
        return read_splat(path, scale)
    return _kept_splat(path, scale, (state.st_mtime_ns, state.st_size))


# Two splats, because an editor changes the scale of one; each takes up to a GiB.
@lru_cache(maxsize=2)
def _kept_splat(path: Path, scale: float, version: tuple[int, int]) -> GaussianSplat:
    """Read a splat from a file, which has been seen in a ``version``."""
    del version  # part of the cache's key alone
    return read_splat(path, scale)


def _posed(found: Colliders) -> tuple[tuple[Geometry, Pose], ...]:
    """Return the geometry of each collider along with its pose in the mesh frame."""
    if (primitive := found.primitive) is None:
        return tuple((closed_mesh(*part), Pose.of()) for part in found.parts)
    if primitive.kind == "sphere":
        return ((Sphere(*primitive.size), Pose.of(primitive.center)),)
    X_GP = Pose.of(primitive.center, quat_from_matrix(primitive.rotation))
    return ((Box(frozen(primitive.size)) if primitive.kind == "box" else Cylinder(*primitive.size), X_GP),)


def _solid(name: str, vertices: Array, faces: Faces, how: str) -> mass.SolidMoments:
    """Return the solid that defines the mass of a mesh. The faces of the mesh must be oriented outward."""
    if how == "hull":
        return mass.mesh(*convex.hull(vertices, limit=len(vertices)))
    if gaps := open_edges(faces):
        raise not_closed(name, gaps)
    solid = mass.mesh(vertices, faces)
    if solid.volume < LEAST_VOLUME:
        raise no_volume(name)
    return solid


def lower_background(loaded: Loaded, written: BackgroundSpec) -> Background:
    """Return the background of a scene.

    Raises:
        SpecError: If the background file cannot be used.
    """
    key = "mesh" if written.mesh is not None else "splat"
    path, X_WB = loaded.file(written.mesh or written.splat or ""), pose(written.pose)
    try:
        if key == "splat":
            return Background(X_WB, splat=shown_splat(path, written.scale))
        return Background(X_WB, visuals=tuple(_visuals(path, written.scale)))
    except MeshError as error:
        raise SpecError([loaded.finding(error.code, ("background", key), str(error), error.hint)]) from None


def _visuals(path: Path, scale: float) -> Iterator[Visual]:
    """Yield the visual pieces of a mesh file. Textures are unchanged, and pieces without a color are gray."""
    pieces = read_parts(path, scale)
    for k, piece in enumerate(pieces):
        color = piece.rgba or (GRAY if piece.texture is None else (1.0, 1.0, 1.0, 1.0))
        mesh = closed_mesh(piece.vertices, piece.faces, piece.uv, piece.texture)
        yield Visual("mesh" if len(pieces) == 1 else f"mesh_{k}", mesh, frozen(color))
