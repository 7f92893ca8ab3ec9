"""Geometries: primitives as USD primitives, meshes by reference to one layer beside the stage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.artifact import rounded
from simfoundry.backends.usd.crates import author, crate_bytes, new_crate
from simfoundry.backends.usd.prims import Prim, attribute, define, place
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere

if TYPE_CHECKING:
    from pxr import Sdf

MESHES = "assets/meshes.usdc"
"""The path of the mesh layer; a single layer, because separate files cost more than the meshes themselves."""


def define_geometry(parent: Prim, name: str, geometry: Geometry, X_LG: Pose, schemas: Sequence[str]) -> Prim:
    """Define ``geometry`` below ``parent``, posed in its link.

    A box is a scaled unit cube; a mesh is a reference, see :func:`mesh_layer`.
    """
    match geometry:
        case Box(size=size):
            prim = define(parent, name, "Cube", schemas)
            attribute(prim, "size", "double", 1.0)
            _extent(prim, [0.5, 0.5, 0.5])
            place(prim, X_LG, scale=size.tolist())
            return prim
        case Sphere(radius=radius):
            prim = define(parent, name, "Sphere", schemas)
            _extent(prim, [radius] * 3)
        case Cylinder(radius=radius, height=height):
            prim = define(parent, name, "Cylinder", schemas)
            _along_z(prim, height)
            _extent(prim, [radius, radius, height / 2])
        case Capsule(radius=radius, height=height):
            prim = define(parent, name, "Capsule", schemas)
            _along_z(prim, height)
            _extent(prim, [radius, radius, height / 2 + radius])
        case Mesh():
            prim = define(parent, name, "Mesh", schemas)
            prim.references.append(f"@./{MESHES}@</{_LIBRARY}/{_mesh_name(geometry)}>")
            place(prim, X_LG)
            return prim
    attribute(prim, "radius", "double", rounded(radius))
    place(prim, X_LG)
    return prim


_LIBRARY = "Meshes"


def _mesh_name(mesh: Mesh) -> str:
    return f"mesh_{mesh.digest}"


def mesh_layer(meshes: Iterable[Mesh]) -> bytes:
    """Return a layer of meshes named by content, without duplicates and sorted by name.

    Meshes are in single precision and have texture coordinates if the source has them. They are defined as classes, so
    a stage that opens only this layer shows nothing; the prim that refers to a class makes it visible.
    """
    from pxr import Sdf

    layer = new_crate(_LIBRARY)
    with Sdf.ChangeBlock():
        library = Sdf.PrimSpec(layer, _LIBRARY, Sdf.SpecifierClass, "Scope")
        for name, mesh in sorted({_mesh_name(mesh): mesh for mesh in meshes}.items()):
            _define_mesh(Sdf.PrimSpec(library, name, Sdf.SpecifierDef, "Mesh"), mesh)
    return crate_bytes(layer)


def _define_mesh(prim: Sdf.PrimSpec, mesh: Mesh) -> None:
    from pxr import Vt

    points = np.asarray(mesh.vertices, dtype=np.float32)
    author(prim, "points", "point3f[]", Vt.Vec3fArray.FromNumpy(points))
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    author(prim, "extent", "float3[]", Vt.Vec3fArray.FromNumpy(bounds))
    indices = np.ascontiguousarray(mesh.faces, dtype=np.int32).ravel()
    author(prim, "faceVertexIndices", "int[]", Vt.IntArray.FromNumpy(indices))
    counts = np.full(len(mesh.faces), 3, dtype=np.int32)
    author(prim, "faceVertexCounts", "int[]", Vt.IntArray.FromNumpy(counts))
    normals = Vt.Vec3fArray.FromNumpy(_face_normals(points, mesh.faces))
    author(prim, "normals", "normal3f[]", normals).SetInfo("interpolation", "uniform")
    author(prim, "subdivisionScheme", "token", "none", uniform=True)
    if mesh.uv is not None:
        uv = np.ascontiguousarray(mesh.uv, dtype=np.float32)
        author(prim, "primvars:st", "texCoord2f[]", Vt.Vec2fArray.FromNumpy(uv)).SetInfo("interpolation", "vertex")


def _face_normals(points: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the unit normals of triangles, shape (m, 3); degenerate triangles get an upward normal."""
    a, b, c = (points[faces[:, k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = lengths[:, 0] == 0
    normals[flat], lengths[flat] = [0.0, 0.0, 1.0], 1.0
    return np.asarray((normals / lengths).round(7) + 0.0, dtype=np.float32)


def _along_z(prim: Prim, height: float) -> None:
    attribute(prim, "axis", "token", "Z", uniform=True)
    attribute(prim, "height", "double", rounded(height))


def _extent(prim: Prim, half: Sequence[float]) -> None:
    attribute(prim, "extent", "float3[]", [tuple([-v for v in half]), tuple(half)])
