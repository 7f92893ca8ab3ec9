"""Shapes and materials on a stage. Primitives become USD primitives, and meshes become references to a separate layer.

Visual materials use UsdPreviewSurface, and contact materials have UsdPhysics, PhysX and Newton attributes. Arrays are
stored in layers in USD's binary format, which is a third of the size of the text format and is memory-mapped when read.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.artifact import number, rounded
from simfoundry.backends.usd.prims import Asset, Prim, vec3
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere
from simfoundry.runtime.usd_layers import author, crate_bytes, new_crate
from simfoundry.scene.model import Collider, Visual

if TYPE_CHECKING:
    from pxr import Sdf

# The path of the mesh layer, which all meshes share because separate files cost more than the meshes themselves.
MESHES = "assets/meshes.usdc"


# Types of prims whose names differ from those of the shapes.
_TYPES: Mapping[type[Geometry], str] = {Box: "Cube", Ellipsoid: "Sphere"}


def define_geometry(parent: Prim, name: str, geometry: Geometry, X_LG: Pose, schemas: Sequence[str]) -> Prim:
    """Define ``geometry`` below ``parent`` at its pose in the link.

    A box becomes a scaled unit cube, an ellipsoid becomes a scaled unit sphere, and a mesh becomes a reference; see
    :func:`mesh_layer`.
    """
    prim = parent.define(name, _TYPES.get(type(geometry), type(geometry).__name__), schemas)
    scales = geometry.size if isinstance(geometry, Box) else geometry.radii if isinstance(geometry, Ellipsoid) else None
    prim.place(X_LG, scale=None if scales is None else scales.tolist())
    match geometry:
        case Mesh():
            prim.references.append(f"@./{MESHES}@</{_LIBRARY}/{_mesh_name(geometry)}>")
            return prim
        case Box():
            prim.attribute("size", "double", 1.0)
            half = (0.5, 0.5, 0.5)
        case Ellipsoid():
            prim.attribute("radius", "double", 1.0)
            half = (1.0, 1.0, 1.0)
        case Sphere(radius=radius):
            prim.attribute("radius", "double", rounded(radius))
            half = (radius, radius, radius)
        case (
            Cylinder(radius=radius, height=height)
            | Capsule(radius=radius, height=height)
            | Cone(radius=radius, height=height)
        ):
            prim.attribute("radius", "double", rounded(radius))
            prim.attribute("axis", "token", "Z", uniform=True)
            prim.attribute("height", "double", rounded(height))
            half = (radius, radius, height / 2 + (radius if isinstance(geometry, Capsule) else 0.0))
    prim.attribute("extent", "float3[]", [tuple([-v for v in half]), half])
    return prim


_LIBRARY = "Meshes"


def _mesh_name(mesh: Mesh) -> str:
    return f"mesh_{mesh.digest}"


def mesh_layer(meshes: Iterable[Mesh]) -> bytes:
    """Return a layer of meshes that are named after their content, free of duplicates, and sorted by name.

    Meshes are in single precision and have texture coordinates if the source has them. They are defined as classes, so
    opening this layer on its own shows nothing; a mesh is visible only through a prim that references its class.
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
    """Return the unit normals of triangles as an array of shape (m, 3). Degenerate triangles have upward normals."""
    a, b, c = (points[faces[:, k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = lengths[:, 0] == 0
    normals[flat], lengths[flat] = [0.0, 0.0, 1.0], 1.0
    return np.asarray((normals / lengths).round(7) + 0.0, dtype=np.float32)


def texture_of(visual: Visual) -> bytes | None:
    """Return the texture of ``visual``, or None if its mesh has no texture coordinates."""
    geometry = visual.geometry
    return geometry.texture if isinstance(geometry, Mesh) and geometry.uv is not None else None


def texture_path(texture: bytes) -> str:
    """Return the path of a texture in the artifact, with a file name derived from its content."""
    return f"assets/{hashlib.sha256(texture).hexdigest()[:16]}.png"


def define_visual(parent: Prim, looks: Prim, visual: Visual) -> None:
    """Define ``visual`` below ``parent``, with its material in the ``looks`` scope."""
    prim = define_geometry(parent, visual.name, visual.geometry, visual.X_LG, ["MaterialBindingAPI"])
    prim.relate("material:binding", [visual_material(looks, visual)])


def visual_material(scope: Prim, visual: Visual) -> Prim:
    """Return the material of ``visual``.

    Materials are named after their content and shared by visuals that look the same.
    """
    texture = texture_of(visual)
    path = "" if texture is None else texture_path(texture)
    rgba = tuple([rounded(v) for v in visual.rgba.tolist()])
    name = _look_name(path, rgba)
    if name not in scope.children:
        _preview_material(scope.define(name, "Material"), np.array(rgba), path)
    return scope.children[name]


@lru_cache(maxsize=256)
def _look_name(path: str, rgba: tuple[float, ...]) -> str:
    return f"look_{hashlib.sha256(f'{path} {list(rgba)}'.encode()).hexdigest()[:10]}"


def linear_from_srgb(rgb: Array) -> Array:
    """Convert an sRGB color, as used by MuJoCo and URDF, to the scene-linear color that UsdPreviewSurface expects."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0.04045) + 0.055) / 1.055) ** 2.4)


def _preview_material(material: Prim, rgba: Array, texture: str) -> None:
    surface = material.define("Surface", "Shader")
    surface.attribute("info:id", "token", "UsdPreviewSurface", uniform=True)
    surface.floats(0.0, "inputs:metallic")
    surface.floats(rgba[3], "inputs:opacity")
    surface.floats(0.5, "inputs:roughness")
    surface.attribute("outputs:surface", "token", None)
    color = linear_from_srgb(rgba[:3])
    if texture:
        image = _texture(material, color, texture)
        surface.connect("inputs:diffuseColor", "color3f", f"{image.path}.outputs:rgb")
    else:
        surface.attribute("inputs:diffuseColor", "color3f", vec3(color))
    material.connect("outputs:surface", "token", f"{surface.path}.outputs:surface")


def _texture(material: Prim, color: Array, texture: str) -> Prim:
    """Define the texture shader, which multiplies by ``color`` and reads its coordinates from the primvar ``st``."""
    reader = material.define("Coordinates", "Shader")
    reader.attribute("info:id", "token", "UsdPrimvarReader_float2", uniform=True)
    reader.attribute("inputs:varname", "string", "st")
    reader.attribute("outputs:result", "float2", None)
    image = material.define("Texture", "Shader")
    image.attribute("info:id", "token", "UsdUVTexture", uniform=True)
    image.attribute("inputs:file", "asset", Asset(f"./{texture}"))
    image.attribute("inputs:scale", "float4", (*vec3(color), 1.0))
    image.attribute("inputs:sourceColorSpace", "token", "sRGB")
    image.connect("inputs:st", "float2", f"{reader.path}.outputs:result")
    for side in "ST":
        image.attribute(f"inputs:wrap{side}", "token", "repeat")
    image.attribute("outputs:rgb", "float3", None)
    return image


def contact_material(scope: Prim, collider: Collider) -> Prim:
    """Return the contact material of ``collider``.

    The material stores √μ and √e with PhysX's ``multiply`` combine mode, which yields geometric means. The surface's
    own coefficients are stored in ``simfoundry:friction`` and ``simfoundry:restitution``.
    """
    name = f"friction_{_word(collider.friction)}_restitution_{_word(collider.restitution)}"
    resists = collider.torsional_friction > 0 or collider.rolling_friction > 0
    if resists:
        name += f"_spinning_{_word(collider.torsional_friction)}_rolling_{_word(collider.rolling_friction)}"
    if name not in scope.children:
        prim = scope.define(name, "Material", ["PhysicsMaterialAPI", "PhysxMaterialAPI"])
        prim.floats(math.sqrt(collider.friction), "physics:dynamicFriction", "physics:staticFriction")
        prim.floats(math.sqrt(collider.restitution), "physics:restitution")
        for quantity in ("friction", "restitution"):
            prim.attribute(f"physxMaterial:{quantity}CombineMode", "token", "multiply", uniform=True)
            prim.attribute(f"simfoundry:{quantity}", "double", rounded(getattr(collider, quantity)))
        if resists:
            prim.schemas += ["NewtonMaterialAPI"]
            prim.floats(collider.rolling_friction, "newton:rollingFriction")
            prim.floats(collider.torsional_friction, "newton:torsionalFriction")
    return scope.children[name]


def _word(value: float) -> str:
    """Format a number as part of a prim name."""
    return number(value).replace(".", "_").replace("-", "m").replace("+", "")
