"""Spec entries for a reconstruction: objects, the support, the camera and materials, along with their mesh files."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.mesh import open_edges, weld
from simfoundry.capture.description.kinds import SUPPORT, MaterialPrior, kind_of, material_of
from simfoundry.capture.description.level_object import level_outline, level_thickness
from simfoundry.capture.description.mass_estimates import mass_estimate
from simfoundry.capture.description.support_object import DEFAULT_THICKNESS
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.scene_reading import MatchedReading
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.fit_handle import FittedHandle
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Box, Cylinder, Mesh, Sphere, tessellate
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.scene.state import pose_spec
from simfoundry.spec.models import base as spec
from simfoundry.spec.models import shapes
from simfoundry.spec.models.origin import ModelUse, Origin
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import ObjectSpec
from simfoundry.spec.models.surroundings import CameraSpec

# Upper hue limits [deg] of English color words on the HSV color wheel.
_HUES = ((15, "red"), (40, "orange"), (68, "yellow"), (165, "green"), (195, "cyan"), (260, "blue"), (320, "purple"))


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


SUPPORT_NAME = "table"  # The name of the support in the scene
LEVEL_NAME = "surface"  # Name of another level that carries objects, after its color
LEVEL_NOTE = "a second surface that carries objects, as far as it is visible"


def unique_names(wanted: Iterable[str]) -> list[str]:
    """Make object names unique.

    The suffixes ``_2``, ``_3``, … are appended to duplicates and to names that equal the name of the support.
    """
    used = {SUPPORT_NAME}
    out = []
    for base in wanted:
        name, k = base, 2
        while name in used:
            name, k = f"{base}_{k}", k + 1
        used.add(name)
        out.append(name)
    return out


def support_spec(capture: str, support: SupportSurface, measured: float | None) -> ObjectSpec:
    """Return the spec of the support, which is a fixed prism whose top is at z = 0.

    ``measured`` is its measured thickness [m], or None to assume the default thickness.
    """
    outline = tuple((meters(x), meters(y)) for x, y in support.outline)
    note = "thickness measured at its edge" if measured else "thickness assumed: no edge was seen"
    thickness = measured or DEFAULT_THICKNESS
    return ObjectSpec(
        category="table",
        fixed=True,
        shape=shapes.PrismShape(prism=shapes.Prism(outline=outline, height=thickness)),
        visual=f"meshes/{SUPPORT_NAME}.obj",
        material=SUPPORT.name,
        pose=FramedPose(xyz=(0.0, 0.0, -thickness / 2)),
        origin=Origin(capture=capture, fit_error=meters(support.residual), note=note),
    )


def level_spec(capture: str, name: str, shape: FittedShape, residual: float, segment: int) -> ObjectSpec:
    """Return the spec of a level beside the support: a fixed prism whose top carries objects."""
    outline = tuple((meters(x), meters(y)) for x, y in level_outline(shape))
    return ObjectSpec(
        category="table",
        fixed=True,
        shape=shapes.PrismShape(prism=shapes.Prism(outline=outline, height=meters(level_thickness(shape)))),
        visual=f"meshes/{name}.obj",
        material=SUPPORT.name,
        pose=pose_spec(shape.X_WO),
        origin=Origin(capture=capture, fit_error=meters(residual), segment=segment, note=LEVEL_NOTE),
    )


def material_prior(shape: FittedShape, segment: int, read: MatchedReading | None) -> MaterialPrior:
    """Return the prior of an object's material: as a model states it, or as its form and size suggest."""
    seen = None if read is None else read.objects.get(segment)
    return (None if seen is None else material_of(seen.material)) or kind_of(shape).material


def object_spec(
    capture: str,
    name: str,
    shape: FittedShape,
    segment: int | None = None,
    read: MatchedReading | None = None,
    models: tuple[ModelUse, ...] = (),
) -> ObjectSpec:
    """Return the spec of a fitted object, with an estimated mass and its origin.

    The object is represented by a primitive if possible, and otherwise by a mesh. ``segment`` is its number in the
    segmentation, ``read`` is what a model states about the objects, and ``models`` are others that contributed.
    """
    seen = None if read is None or segment is None else read.objects.get(segment)
    primitive = shape_spec(shape)
    surface = tessellate(shape.geometry)
    is_open = primitive is None and open_edges(weld(surface.vertices, surface.faces)[1]) > 0
    volume = hull_volume(surface) if is_open else mass.mesh(surface.vertices, surface.faces).volume
    kind = kind_of(shape)
    substance = kind.material if segment is None else material_prior(shape, segment, read)
    densities = substance.density, substance.lowest, substance.highest
    kilograms, low, high = (float(f"{volume * density:.2g}") for density in densities)
    estimate = spec.Estimate(value=kilograms, range=(low, high), source="material_table")
    if seen is not None and read is not None and seen.mass is not None:
        estimate = mass_estimate(seen.mass, read.use.name)
    return ObjectSpec(
        category=(shape.model or kind.name) if seen is None else plain_name(seen.category),
        shape=primitive,
        asset=None if primitive is not None else f"meshes/{name}.obj",
        visual=f"meshes/{name}.obj" if primitive is not None else None,
        material=substance.name,
        solid="hull" if is_open else "exact",
        mass=estimate,
        pose=pose_spec(shape.X_WO),
        origin=Origin(
            capture=capture,
            fit_error=meters(shape.fit_m),
            confidence=round(shape.confidence, 2),
            segment=segment,
            note=f"CAD model `{shape.model}`" if shape.model else None,
            models=models if seen is None or read is None else (*models, read.use),
        ),
    )


def hull_volume(surface: Mesh) -> float:
    """Return the volume of the convex hull [m^3] of a mesh that is not closed."""
    from scipy.spatial import ConvexHull

    return float(ConvexHull(surface.vertices).volume)


def shape_spec(shape: FittedShape) -> shapes.Shape | None:
    """Return a shape in the form used in specs, or None if only a mesh can represent the shape."""
    geometry = shape.geometry
    if shape.profile is not None:
        body = shapes.LatheShape(lathe=shapes.Lathe(profile=tuple((meters(r), meters(z)) for r, z in shape.profile)))
        return body if shape.handle is None else _with_handle(body, shape.handle)
    if shape.wall > 0:
        x, y, z = (meters(v) for v in np.ptp(tessellate(geometry).vertices, axis=0))
        return shapes.OpenBoxShape(open_box=shapes.OpenBox(size=(x, y, z), wall=meters(shape.wall)))
    match geometry:
        case Box():
            x, y, z = (meters(v) for v in geometry.size)
            return shapes.BoxShape(box=(x, y, z))
        case Cylinder():
            size = shapes.Round(radius=meters(geometry.radius), height=meters(geometry.height))
            return shapes.CylinderShape(cylinder=size)
        case Sphere():
            return shapes.SphereShape(sphere=meters(geometry.radius))
    return None


def _with_handle(body: shapes.LatheShape, handle: FittedHandle) -> shapes.CompoundShape:
    """Return a body of revolution and its handle as one rigid body."""
    outline = tuple((meters(x), meters(y)) for x, y in handle.outline)
    plate = shapes.PrismShape(prism=shapes.Prism(outline=outline, height=meters(handle.width)))
    parts = {
        "body": shapes.CompoundPart(shape=body),
        "handle": shapes.CompoundPart(shape=plate, pose=pose_spec(handle.X_OH)),
    }
    return shapes.CompoundShape(compound=parts)


def camera_spec(frame: Frame, support: SupportSurface) -> CameraSpec:
    """Return the spec of the camera that took the image."""
    height, width = frame.depth.shape
    x, y, z = (meters(v) for v in support.X_WC.p)
    qw, qx, qy, qz = (round(float(v), 6) for v in support.X_WC.q)
    fx, fy, cx, cy = (round(float(frame.K[at]), 3) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    pose = spec.CameraPose(xyz=(x, y, z), quat_wxyz=(qw, qx, qy, qz))
    return CameraSpec(size=(width, height), fx=fx, fy=fy, cx=cx, cy=cy, pose=pose)


def mesh_files(name: str, mesh: Mesh) -> dict[str, bytes]:
    """Return the files of a mesh, keyed by their path relative to the scene.

    Vertices are rounded to 0.01 mm.
    """
    uv = None if mesh.uv is None else frozen_array(np.round(mesh.uv, 5))
    mesh = Mesh(frozen_array(np.round(mesh.vertices, 5)), mesh.faces, uv, mesh.texture)
    return {f"meshes/{path}": data for path, data in obj_with_material(mesh, name).items()}


def meters(value: float) -> float:
    """Round a length [m] to 0.1 mm. This is finer than the resolution of any supported sensor."""
    return round(float(value), 4)
