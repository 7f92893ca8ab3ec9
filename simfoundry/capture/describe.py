"""Spec entries for a reconstruction: objects, support, camera and materials, along with their mesh files."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simfoundry.assets import mass
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.support_object import Thickness
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere, tessellate
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.scene.state import pose_spec
from simfoundry.spec.models.base import (
    BoxShape,
    CameraPose,
    CylinderShape,
    Estimate,
    Lathe,
    LatheShape,
    Material,
    Origin,
    PoseSpec,
    Prism,
    PrismShape,
    Round,
    Shape,
    SphereShape,
)
from simfoundry.spec.models.scene import CameraSpec, ObjectSpec


class ShapeKind(StrEnum):
    """The kind of an object, as inferred from its shape."""

    BOX = "box"
    CAN = "can"
    BALL = "ball"
    BOWL = "bowl"
    OBJECT = "object"


@dataclass(frozen=True)
class MaterialPrior:
    """A row in the material table: density [kg/m^3] of the solid volume, its range, and the Coulomb coefficient."""

    name: str
    density: float
    lowest: float
    highest: float
    friction: float


# Densities are the range over YCB objects of the same kind. Friction coefficients are estimates for contact with wood.
TABLE = {
    ShapeKind.BOX: MaterialPrior("carton", 400, 150, 750, 0.4),
    ShapeKind.CAN: MaterialPrior("can", 700, 300, 1050, 0.35),
    ShapeKind.BALL: MaterialPrior("fruit", 800, 100, 1050, 0.5),
    ShapeKind.BOWL: MaterialPrior("crockery", 1800, 900, 2500, 0.35),
    ShapeKind.OBJECT: MaterialPrior("package", 600, 150, 1100, 0.4),
}
SUPPORT = MaterialPrior("table_top", 700, 500, 900, 0.5)

# Upper hue limits [deg] of the English color words, read off the HSV color wheel.
_HUES = ((15, "red"), (40, "orange"), (68, "yellow"), (165, "green"), (195, "cyan"), (260, "blue"), (320, "purple"))


def kind_of(geometry: Geometry, hollow: bool) -> ShapeKind:
    """Return the kind of object that a fitted shape suggests."""
    match geometry:
        case Box():
            return ShapeKind.BOX
        case Cylinder() | Capsule():
            return ShapeKind.CAN
        case Sphere():
            return ShapeKind.BALL
    return ShapeKind.BOWL if hollow else ShapeKind.OBJECT


def color_word(rgb: tuple[float, float, float]) -> str:
    """Return a common English word for an sRGB color with components in [0, 1]."""
    hue, saturation, value = colorsys.rgb_to_hsv(*rgb)
    if value < 0.2:
        return "black"
    if saturation < 0.18:
        return "white" if value > 0.65 else "gray"
    degrees = hue * 360
    if 10 <= degrees < 45 and value < 0.6:
        return "brown"
    if (degrees >= 320 or degrees < 15) and saturation < 0.45 and value > 0.6:
        return "pink"
    return next((word for limit, word in _HUES if degrees < limit), "red")


def unique_names(wanted: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return the names, with ``_2``, ``_3``, … appended to duplicates."""
    used = set(taken)
    out = []
    for base in wanted:
        name, k = base, 2
        while name in used:
            name, k = f"{base}_{k}", k + 1
        used.add(name)
        out.append(name)
    return out


SUPPORT_NAME = "table"  # the name of the support in the scene


def support_spec(capture: str, support: SupportSurface, slab: Thickness) -> ObjectSpec:
    """Return the spec of the support: a fixed prism whose top is at z = 0."""
    outline = tuple((meters(x), meters(y)) for x, y in support.outline)
    note = "thickness measured at its edge" if slab.measured else "thickness assumed: no edge was seen"
    return ObjectSpec(
        category="table",
        fixed=True,
        shape=PrismShape(prism=Prism(outline=outline, height=slab.value)),
        visual=f"meshes/{SUPPORT_NAME}.obj",
        material=SUPPORT.name,
        pose=PoseSpec(xyz=(0.0, 0.0, -slab.value / 2)),
        origin=Origin(capture=capture, fit_error=meters(support.residual), note=note),
    )


def object_spec(
    capture: str, name: str, shape: FittedShape, mesh: Mesh, substance: MaterialPrior, color: tuple[float, float, float]
) -> ObjectSpec:
    """Return the spec of a fitted object: a primitive if possible, otherwise a mesh, with estimated mass and origin."""
    primitive = _shape_spec(shape)
    surface = tessellate(shape.geometry)
    volume = mass.mesh(surface.vertices, surface.faces).volume
    kilograms = [_significant(volume * d) for d in (substance.density, substance.lowest, substance.highest)]
    low, high = min(kilograms[0], kilograms[1]), max(kilograms[0], kilograms[2])
    return ObjectSpec(
        category=kind_of(shape.geometry, shape.hollow).value,
        shape=primitive,
        asset=None if primitive is not None else f"meshes/{name}.obj",
        visual=f"meshes/{name}.obj" if primitive is not None else None,
        material=substance.name,
        color=_rgb(color) if mesh.texture is None else None,
        mass=Estimate(value=kilograms[0], range=(low, high), source="material_table"),
        pose=pose_spec(shape.X_WO),
        origin=Origin(capture=capture, fit_error=meters(shape.fit_m), confidence=round(shape.confidence, 2)),
    )


def _shape_spec(shape: FittedShape) -> Shape | None:
    """Return the shape in spec form, or None if only a mesh can represent it."""
    geometry = shape.geometry
    if shape.profile is not None:
        return LatheShape(lathe=Lathe(profile=tuple((meters(r), meters(z)) for r, z in shape.profile)))
    match geometry:
        case Box():
            x, y, z = (meters(v) for v in geometry.size)
            return BoxShape(box=(x, y, z))
        case Cylinder():
            return CylinderShape(cylinder=Round(radius=meters(geometry.radius), height=meters(geometry.height)))
        case Sphere():
            return SphereShape(sphere=meters(geometry.radius))
    return None


def camera_spec(frame: Frame, support: SupportSurface) -> CameraSpec:
    """Return the spec of the camera that took the image."""
    height, width = frame.depth.shape
    X_WC: Pose = support.X_WC
    x, y, z = (meters(v) for v in X_WC.p)
    qw, qx, qy, qz = (round(float(v), 6) for v in X_WC.q)
    return CameraSpec(
        size=(width, height),
        fx=round(float(frame.K[0, 0]), 3),
        fy=round(float(frame.K[1, 1]), 3),
        cx=round(float(frame.K[0, 2]), 3),
        cy=round(float(frame.K[1, 2]), 3),
        pose=CameraPose(xyz=(x, y, z), quat_wxyz=(qw, qx, qy, qz)),
    )


def material_spec(substance: MaterialPrior) -> Material:
    """Convert a row in the material table to a material."""
    return Material(density=substance.density, friction=substance.friction)


def mesh_files(name: str, mesh: Mesh) -> dict[str, bytes]:
    """Return the files of a mesh, keyed by path relative to the scene; vertices are rounded to 0.01 mm."""
    uv = None if mesh.uv is None else frozen_array(np.round(mesh.uv, 5))
    mesh = Mesh(frozen_array(np.round(mesh.vertices, 5)), mesh.faces, uv, mesh.texture)
    return {f"meshes/{path}": data for path, data in obj_with_material(mesh, name).items()}


def meters(value: float) -> float:
    """Round a length [m] to 0.1 mm, which is finer than the resolution of any supported sensor."""
    return round(float(value), 4)


def _significant(value: float) -> float:
    return float(f"{value:.2g}")


def _rgb(color: tuple[float, float, float]) -> tuple[float, float, float]:
    r, g, b = (round(float(c), 2) for c in color)
    return r, g, b
