"""Shapes: primitives as USD's own, meshes as layers of their own that the scene refers to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.usd.prims import attribute, define, place, rounded
from simfoundry.scene.frames import Pose
from simfoundry.scene.model import Box, Capsule, Cylinder, Geometry, Mesh, Sphere

if TYPE_CHECKING:
    from pxr import Sdf


def define_geometry(
    parent: Sdf.PrimSpec, name: str, geometry: Geometry, X_LG: Pose, schemas: Sequence[str]
) -> Sdf.PrimSpec:
    """Define ``geometry`` below ``parent``, posed in its link.

    A box is a unit cube, scaled; the mesh of a layer in ``assets/`` is referred to, see :func:`mesh_layer`.
    """
    from pxr import Sdf

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
            prim.referenceList.prependedItems = [Sdf.Reference(f"./{mesh_path(geometry)}")]
            place(prim, X_LG)
            return prim
    attribute(prim, "radius", "double", rounded(radius))
    place(prim, X_LG)
    return prim


def mesh_path(mesh: Mesh) -> str:
    """The path of a mesh's layer in the artifact."""
    return f"assets/{mesh.digest}.usda"


def mesh_layer(mesh: Mesh) -> bytes:
    """A layer whose default prim is the mesh, in single precision, with texture coordinates where it has them.

    Text, although a crate would be a third of the size: every release of USD reads it, and writes the same bytes.
    """
    from pxr import Sdf, Vt

    layer = Sdf.Layer.CreateAnonymous(".usda")
    root = layer.pseudoRoot
    root.SetInfo("metersPerUnit", 1.0)
    root.SetInfo("upAxis", "Z")
    layer.defaultPrim = "mesh"
    with Sdf.ChangeBlock():
        prim = Sdf.PrimSpec(layer, "mesh", Sdf.SpecifierDef, "Mesh")
        points = np.asarray(mesh.vertices, dtype=np.float32)
        attribute(prim, "points", "point3f[]", Vt.Vec3fArray.FromNumpy(points))
        bounds = np.stack([points.min(axis=0), points.max(axis=0)])
        attribute(prim, "extent", "float3[]", Vt.Vec3fArray.FromNumpy(bounds))
        indices = np.ascontiguousarray(mesh.faces, dtype=np.int32).ravel()
        attribute(prim, "faceVertexIndices", "int[]", Vt.IntArray.FromNumpy(indices))
        counts = np.full(len(mesh.faces), 3, dtype=np.int32)
        attribute(prim, "faceVertexCounts", "int[]", Vt.IntArray.FromNumpy(counts))
        attribute(prim, "normals", "normal3f[]", Vt.Vec3fArray.FromNumpy(_face_normals(points, mesh.faces)))
        prim.attributes["normals"].SetInfo("interpolation", "uniform")
        attribute(prim, "subdivisionScheme", "token", "none", uniform=True)
        if mesh.uv is not None:
            uv = np.ascontiguousarray(mesh.uv, dtype=np.float32)
            attribute(prim, "primvars:st", "texCoord2f[]", Vt.Vec2fArray.FromNumpy(uv))
            prim.attributes["primvars:st"].SetInfo("interpolation", "vertex")
    return str(layer.ExportToString()).encode()


def _face_normals(points: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Unit normals of triangles, shape (m, 3); those of triangles without area point up."""
    a, b, c = (points[faces[:, k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = lengths[:, 0] == 0
    normals[flat], lengths[flat] = [0.0, 0.0, 1.0], 1.0
    return np.asarray((normals / lengths).round(7) + 0.0, dtype=np.float32)


def _along_z(prim: Sdf.PrimSpec, height: float) -> None:
    attribute(prim, "axis", "token", "Z", uniform=True)
    attribute(prim, "height", "double", rounded(height))


def _extent(prim: Sdf.PrimSpec, half: Sequence[float]) -> None:
    from pxr import Gf, Vt

    corner = Gf.Vec3f(*half)
    attribute(prim, "extent", "float3[]", Vt.Vec3fArray([-corner, corner]))
