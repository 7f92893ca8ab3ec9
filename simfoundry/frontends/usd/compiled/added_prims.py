"""Prims that a person added to a compiled stage: primitives with or without physics, cameras, lights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.backends.usd.cameras import X_CU
from simfoundry.backends.usd.lights import FULL
from simfoundry.frontends.usd.compiled.edits import pose_data
from simfoundry.frontends.usd.compiled.stage import factored
from simfoundry.frontends.usd.compiled.values import StageNote, as_name, short, srgb
from simfoundry.frontends.usd.compiled.views import camera_pose, lens, light_place, light_type
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix

if TYPE_CHECKING:
    from pxr import Usd

    from simfoundry.frontends.usd.compiled.stage_frame import StageFrame

WATER = 1000.0
"""The density [kg/m^3] that UsdPhysics gives to what has neither mass nor density."""

PICTURE = (1280, 720)
"""The size [px] of a picture of which a stage does not say it."""

OWN_SCOPES = ("Looks", "Contacts", "Physics")
"""Scopes of a compiled stage that hold no members."""


@dataclass
class Added:
    """New members by section and name, their prims, and what could not become one."""

    members: dict[str, dict[str, Any]] = field(default_factory=dict)
    prims: dict[tuple[str, str], str] = field(default_factory=dict)
    notes: list[StageNote] = field(default_factory=list)


def added(stage: Usd.Stage, carrier: Usd.Prim, known: set[str], data: Mapping[str, Any], world: StageFrame) -> Added:
    """What stands on the stage beside the parts at the paths ``known``, as members for the document ``data``."""
    out = Added()
    taken = {name for section in data.values() if isinstance(section, dict) for name in section}
    for prim in _others(stage, carrier, known):
        found = _member(prim, world)
        if isinstance(found, StageNote):
            out.notes.append(found)
        elif found is not None:
            section, member = found
            name = as_name(prim.GetName(), taken)
            taken.add(name)
            out.members.setdefault(section, {})[name] = member
            out.prims[section, name] = str(prim.GetPath())
    return out


def _others(stage: Usd.Stage, carrier: Usd.Prim, known: set[str]) -> Iterator[Usd.Prim]:
    """The topmost prims that are bodies, shapes, cameras or lights, outside of what is known."""
    from pxr import Usd

    passed = known | {str(carrier.GetPath().AppendChild(name)) for name in OWN_SCOPES}
    prims = iter(Usd.PrimRange.Stage(stage))
    for prim in prims:
        if str(prim.GetPath()) in passed or prim.GetPath().name.startswith("OmniverseKit"):
            prims.PruneChildren()
        elif _is_member(prim):
            yield prim
            prims.PruneChildren()


def _is_member(prim: Usd.Prim) -> bool:
    from pxr import UsdGeom, UsdLux, UsdPhysics

    typed = prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.Camera) or prim.HasAPI(UsdLux.LightAPI)
    return bool(typed or prim.HasAPI(UsdPhysics.RigidBodyAPI) or prim.HasAPI(UsdPhysics.ArticulationRootAPI))


def _member(prim: Usd.Prim, world: StageFrame) -> tuple[str, dict[str, Any]] | StageNote:
    from pxr import UsdGeom, UsdLux

    pose, scale = factored(world.matrix(prim))
    if prim.IsA(UsdGeom.Camera):
        return "cameras", _camera(prim, pose)
    if prim.HasAPI(UsdLux.LightAPI):
        return _light(prim, pose)
    return _object(prim, world, pose, scale)


def _object(prim: Usd.Prim, world: StageFrame, pose: Pose, scale: Array) -> tuple[str, dict[str, Any]] | StageNote:
    """A primitive; it is free where it is a rigid body, and touched where it, or what it holds, collides."""
    from pxr import Usd, UsdGeom, UsdPhysics

    path = str(prim.GetPath())
    shapes = [p for p in Usd.PrimRange(prim) if p.IsA(UsdGeom.Gprim)]
    if len(shapes) != 1:
        return StageNote(path, f"it has {len(shapes)} shapes, and one is taken over", "import it alone, as an asset")
    shape = shapes[0]
    X_WS, scale = factored(world.matrix(shape)) if shape != prim else (pose, scale)
    found = _shape(shape, scale)
    if found is None:
        message = f"a {shape.GetTypeName()} is not taken over"
        return StageNote(str(shape.GetPath()), message, "save it as a mesh file and name that as an `asset`")
    kind, turned = found
    data: dict[str, Any] = {"shape": kind}
    free = prim.HasAPI(UsdPhysics.RigidBodyAPI) and prim.GetAttribute("physics:rigidBodyEnabled").Get() is not False
    if not free:
        data["fixed"] = True
    data |= _color(shape)
    if free:
        data |= _mass(prim, world.to_m)
    data |= _touch(shape)
    written = pose_data(X_WS @ turned, None, Pose.of())
    if written:
        data["pose"] = written
    return "objects", data


def _shape(prim: Usd.Prim, scale: Array) -> tuple[dict[str, Any], Pose] | None:
    """A primitive in the words of the document, and the turn that brings its axis to z; None where there is no word."""
    x, y, z = (abs(float(v)) for v in scale)
    kind = str(prim.GetTypeName())
    if kind == "Cube":
        size = float(prim.GetAttribute("size").Get())
        return {"box": tuple(short(size * v) for v in (x, y, z))}, Pose.of()
    if kind == "Sphere":
        even = max(x, y, z) - min(x, y, z) <= 1e-6 * x
        return ({"sphere": short(float(prim.GetAttribute("radius").Get()) * x)}, Pose.of()) if even else None
    if kind not in ("Cylinder", "Capsule"):
        return None
    axis = str(prim.GetAttribute("axis").Get() or "Z")
    k = "XYZ".index(axis)
    along, (a, b) = (x, y, z)[k], [v for i, v in enumerate((x, y, z)) if i != k]
    if abs(a - b) > 1e-6 * a or (kind == "Capsule" and abs(a - along) > 1e-6 * a):
        return None
    radius, height = (float(prim.GetAttribute(n).Get()) for n in ("radius", "height"))
    frame = np.eye(3)[:, [(k + 1) % 3, (k + 2) % 3, k]]  # its z is the axis, and it stays right-handed
    value = {"radius": short(radius * a), "height": short(height * along)}
    return {kind.lower(): value}, Pose.of(q=quat_from_matrix(frame))


def _mass(prim: Usd.Prim, to_m: float) -> dict[str, float]:
    for name, key, unit in (("physics:mass", "mass", 1.0), ("physics:density", "density", to_m**-3)):
        value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
        if value:
            return {key: short(value * unit)}
    return {"density": WATER}


def _touch(shape: Usd.Prim) -> dict[str, Any]:
    """Friction and restitution where the stage says them; `collision: none` for what is only seen."""
    from pxr import UsdPhysics, UsdShade

    if not shape.HasAPI(UsdPhysics.CollisionAPI):
        return {"collision": "none"}
    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial("physics")
    prim = material.GetPrim() if material else None
    if prim is None or not prim.HasAPI(UsdPhysics.MaterialAPI):
        return {}
    out = {}
    for name, key, mode in (
        ("dynamicFriction", "friction", "friction"),
        ("restitution", "restitution", "restitution"),
    ):
        value = prim.GetAttribute(f"physics:{name}").Get()
        combine = prim.GetAttribute(f"physxMaterial:{mode}CombineMode")
        if value is not None:
            out[key] = short(value**2 if combine and combine.Get() == "multiply" else value)
    return {k: v for k, v in out.items() if k != "restitution" or v}


def _color(shape: Usd.Prim) -> dict[str, Any]:
    """The plain colour of a shape: of its preview material, or else as it is displayed."""
    from pxr import UsdGeom, UsdShade

    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial()
    if material:
        surface = material.ComputeSurfaceSource()[0]
        color = surface.GetInput("diffuseColor").Get() if surface and surface.GetInput("diffuseColor") else None
        if color is not None:
            return {"color": srgb(color)}
    shown = UsdGeom.Gprim(shape).GetDisplayColorAttr().Get()
    return {"color": srgb(shown[0])} if shown else {}


def _camera(prim: Usd.Prim, pose: Pose) -> dict[str, Any]:
    names = ("focalLength", "horizontalAperture", "verticalAperture")
    values = {name: float(prim.GetAttribute(name).Get()) for name in names}
    values |= {name: float(prim.GetAttribute(name).Get() or 0.0) for name in (f"{n}Offset" for n in names[1:])}
    resolution = (
        prim.GetAttribute("simfoundry:resolution").Get() if prim.HasAttribute("simfoundry:resolution") else None
    )
    data = lens({**values, "simfoundry:resolution": tuple(resolution or PICTURE)}, {})
    width, height = data["size"]
    for key, middle in (("cx", (width - 1) / 2), ("cy", (height - 1) / 2)):
        if data[key] == middle:
            del data[key]
    return {**data, "pose": camera_pose(pose @ X_CU.inverse())}


def _light(prim: Usd.Prim, pose: Pose) -> tuple[str, dict[str, Any]] | StageNote:
    kind = light_type(str(prim.GetTypeName()))
    if kind is None:
        return StageNote(
            str(prim.GetPath()), f"a {prim.GetTypeName()} is no light of a scene", "use a distant, sphere or dome"
        )
    bright = float(prim.GetAttribute("inputs:intensity").Get()) * 2.0 ** float(
        prim.GetAttribute("inputs:exposure").Get() or 0
    )
    color = srgb(prim.GetAttribute("inputs:color").Get())
    data: dict[str, Any] = {"type": kind.value, "intensity": short(bright / FULL[kind])}
    if color != (1.0, 1.0, 1.0):
        data["color"] = color
    return "lights", {**data, **light_place(kind, pose)}
