"""Visual materials (UsdPreviewSurface) and contact materials (UsdPhysics, PhysX and Newton)."""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache

import numpy as np

from simfoundry.backends.artifact import number, rounded
from simfoundry.backends.usd.prims import Asset, Prim, apply_schemas, attribute, connect, define, vec3
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import Collider, Visual


def texture_of(visual: Visual) -> bytes | None:
    """Return the texture of ``visual`` if its mesh has texture coordinates, otherwise None."""
    geometry = visual.geometry
    return geometry.texture if isinstance(geometry, Mesh) and geometry.uv is not None else None


def texture_path(texture: bytes) -> str:
    """Return the path of a texture in the artifact, named by its content."""
    return f"assets/{hashlib.sha256(texture).hexdigest()[:16]}.png"


def visual_material(scope: Prim, visual: Visual) -> Prim:
    """Return the material of ``visual``; visuals of equal appearance share one, named by its content."""
    texture = texture_of(visual)
    path = "" if texture is None else texture_path(texture)
    rgba = tuple([rounded(v) for v in visual.rgba.tolist()])
    name = _look_name(path, rgba)
    if name not in scope.children:
        _preview_material(define(scope, name, "Material"), np.array(rgba), path)
    return scope.children[name]


@lru_cache(maxsize=256)
def _look_name(path: str, rgba: tuple[float, ...]) -> str:
    return f"look_{hashlib.sha256(f'{path} {list(rgba)}'.encode()).hexdigest()[:10]}"


def linear_from_srgb(rgb: Array) -> Array:
    """Return the scene-linear color, which UsdPreviewSurface expects, of an sRGB color as used by MuJoCo and URDF."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0.04045) + 0.055) / 1.055) ** 2.4)


def _preview_material(material: Prim, rgba: Array, texture: str) -> None:
    surface = define(material, "Surface", "Shader")
    attribute(surface, "info:id", "token", "UsdPreviewSurface", uniform=True)
    attribute(surface, "inputs:metallic", "float", 0.0)
    attribute(surface, "inputs:opacity", "float", rounded(rgba[3]))
    attribute(surface, "inputs:roughness", "float", 0.5)
    attribute(surface, "outputs:surface", "token", None)
    color = linear_from_srgb(rgba[:3])
    if texture:
        image = _texture(material, color, texture)
        connect(surface, "inputs:diffuseColor", "color3f", f"{image.path}.outputs:rgb")
    else:
        attribute(surface, "inputs:diffuseColor", "color3f", vec3(color))
    connect(material, "outputs:surface", "token", f"{surface.path}.outputs:surface")


def _texture(material: Prim, color: Array, texture: str) -> Prim:
    """Define the texture shader, multiplied by ``color``; it reads its coordinates from the primvar ``st``."""
    reader = define(material, "Coordinates", "Shader")
    attribute(reader, "info:id", "token", "UsdPrimvarReader_float2", uniform=True)
    attribute(reader, "inputs:varname", "string", "st")
    attribute(reader, "outputs:result", "float2", None)
    image = define(material, "Texture", "Shader")
    attribute(image, "info:id", "token", "UsdUVTexture", uniform=True)
    attribute(image, "inputs:file", "asset", Asset(f"./{texture}"))
    attribute(image, "inputs:scale", "float4", (*vec3(color), 1.0))
    attribute(image, "inputs:sourceColorSpace", "token", "sRGB")
    connect(image, "inputs:st", "float2", f"{reader.path}.outputs:result")
    attribute(image, "inputs:wrapS", "token", "repeat")
    attribute(image, "inputs:wrapT", "token", "repeat")
    attribute(image, "outputs:rgb", "float3", None)
    return image


def contact_material(scope: Prim, collider: Collider) -> Prim:
    """Return the contact material of ``collider``: √μ and √e with PhysX's ``multiply``, which gives geometric means.

    ``simfoundry:friction`` and ``simfoundry:restitution`` hold the coefficients of the surface itself.
    """
    friction, restitution = number(collider.friction), number(collider.restitution)
    name = f"friction_{_word(friction)}_restitution_{_word(restitution)}"
    spinning, rolling = number(collider.torsional_friction), number(collider.rolling_friction)
    resists = collider.torsional_friction > 0 or collider.rolling_friction > 0
    if resists:
        name += f"_spinning_{_word(spinning)}_rolling_{_word(rolling)}"
    if name not in scope.children:
        prim = define(scope, name, "Material", ["PhysicsMaterialAPI", "PhysxMaterialAPI"])
        root = rounded(math.sqrt(collider.friction))
        attribute(prim, "physics:dynamicFriction", "float", root)
        attribute(prim, "physics:restitution", "float", rounded(math.sqrt(collider.restitution)))
        attribute(prim, "physics:staticFriction", "float", root)
        attribute(prim, "physxMaterial:frictionCombineMode", "token", "multiply", uniform=True)
        attribute(prim, "physxMaterial:restitutionCombineMode", "token", "multiply", uniform=True)
        attribute(prim, "simfoundry:friction", "double", float(friction))
        attribute(prim, "simfoundry:restitution", "double", float(restitution))
        if resists:
            apply_schemas(prim, ["NewtonMaterialAPI"])
            attribute(prim, "newton:rollingFriction", "float", float(rolling))
            attribute(prim, "newton:torsionalFriction", "float", float(spinning))
    return scope.children[name]


def _word(text: str) -> str:
    return text.replace(".", "_").replace("-", "m").replace("+", "")
