"""Convert prims that a user added to a compiled stage: primitives with or without physics, cameras, and lights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.backends.usd.surroundings import FULL, X_CU
from simfoundry.frontends.draft import ModelDraft
from simfoundry.frontends.mass_repair import WATER_DENSITY
from simfoundry.frontends.usd.compiled.edits import as_name, pose_data, srgb
from simfoundry.frontends.usd.compiled.scaling import short
from simfoundry.frontends.usd.compiled.stage import StageNote, factored
from simfoundry.frontends.usd.compiled.views import RESOLUTION, camera_pose, lens, light_place
from simfoundry.frontends.usd.geoms import UsdGprims
from simfoundry.frontends.usd.views import LENS, LIGHTS, OFFSETS
from simfoundry.geometry.frames import Pose
from simfoundry.spec.yaml.write import to_data

if TYPE_CHECKING:
    from pxr import Usd

    from simfoundry.frontends.usd.compiled.stage_frame import StageFrame

# Default image size [px], which is the size of viewports in Isaac Sim and usdview.
PICTURE = (1280, 720)

# Scopes in a compiled stage that do not contain members.
OWN_SCOPES = ("Looks", "Contacts", "Physics")


@dataclass
class AddedPrims:
    """New members and their prims, keyed by section and name, with notes on prims that could not be converted."""

    members: dict[str, dict[str, Any]] = field(default_factory=dict)
    prims: dict[tuple[str, str], str] = field(default_factory=dict)
    notes: list[StageNote] = field(default_factory=list)


def added_prims(
    stage: Usd.Stage, carrier: Usd.Prim, known: set[str], data: Mapping[str, Any], frame: StageFrame
) -> AddedPrims:
    """Convert the prims that a user added to a stage to new members of its document.

    Args:
        stage: Edited stage.
        carrier: Prim in which the document is stored.
        known: Paths of prims that represent existing members.
        data: Document data to which the new members will be added.
        frame: World frame of the stage.
    """
    out = AddedPrims()
    taken = {name for section in data.values() if isinstance(section, dict) for name in section}
    for prim in _topmost(stage, carrier, known):
        found = _member(prim, frame)
        if isinstance(found, StageNote):
            out.notes.append(found)
            continue
        section, member = found
        name = as_name(prim.GetName(), taken)
        taken.add(name)
        out.members.setdefault(section, {})[name] = member
        out.prims[section, name] = str(prim.GetPath())
    return out


def _topmost(stage: Usd.Stage, carrier: Usd.Prim, known: set[str]) -> Iterator[Usd.Prim]:
    """Yield the topmost bodies, shapes, cameras and lights that are not below a known prim."""
    from pxr import Usd, UsdGeom, UsdLux, UsdPhysics

    passed = known | {str(carrier.GetPath().AppendChild(name)) for name in OWN_SCOPES}
    apis = (UsdLux.LightAPI, UsdPhysics.RigidBodyAPI, UsdPhysics.ArticulationRootAPI)
    prims = iter(Usd.PrimRange.Stage(stage))
    for prim in prims:
        if str(prim.GetPath()) in passed or prim.GetPath().name.startswith("OmniverseKit"):
            prims.PruneChildren()
        elif prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.Camera) or any(prim.HasAPI(api) for api in apis):
            yield prim
            prims.PruneChildren()


def _member(prim: Usd.Prim, frame: StageFrame) -> tuple[str, dict[str, Any]] | StageNote:
    from pxr import UsdGeom, UsdLux

    pose, _ = factored(frame.matrix(prim))
    if prim.IsA(UsdGeom.Camera):
        return "cameras", _camera(prim, pose)
    return _light(prim, pose) if prim.HasAPI(UsdLux.LightAPI) else _object(prim, frame)


def _object(prim: Usd.Prim, frame: StageFrame) -> tuple[str, dict[str, Any]] | StageNote:
    """Convert a primitive to an object.

    The object can move if the prim is a rigid body, and collides if the prim or its gprim is a collider.
    """
    from pxr import Usd, UsdGeom, UsdLux, UsdPhysics, UsdShade

    shapes = [p for p in Usd.PrimRange(prim) if p.IsA(UsdGeom.Gprim)]
    if len(shapes) != 1:
        message = f"the prim has {len(shapes)} shapes, but only objects with one shape can be imported"
        return StageNote(str(prim.GetPath()), message, "import it separately as an asset")
    (shape,) = shapes
    pxr = SimpleNamespace(UsdGeom=UsdGeom, UsdLux=UsdLux, UsdPhysics=UsdPhysics, UsdShade=UsdShade)
    gprims = UsdGprims(pxr, ModelDraft("", "USD"), 1.0, frame.to_m)
    (X_WS, scale), kind = factored(frame.matrix(shape)), str(shape.GetTypeName())
    found = None if kind == "Plane" else gprims.primitive(shape, kind, np.abs(scale))
    if found is None:
        hint = "save it as a mesh file and use that file as an `asset`"
        return StageNote(str(shape.GetPath()), f"prims of type {kind} cannot be imported", hint)
    geometry, X_SG = found
    is_free = prim.HasAPI(UsdPhysics.RigidBodyAPI) and prim.GetAttribute("physics:rigidBodyEnabled").Get() is not False
    data: dict[str, Any] = {"shape": short(to_data(geometry))}
    color, _ = gprims.look(shape)
    data |= {} if color is None else {"color": tuple(round(v, 3) for v in color[:3])}
    data |= _mass(prim, frame.to_m) if is_free else {"fixed": True}
    data |= _contact(shape)
    pose = pose_data(X_WS @ X_SG, None, Pose.of())
    return "objects", data | ({"pose": pose} if pose else {})


def _mass(prim: Usd.Prim, to_m: float) -> dict[str, float]:
    for name, key, unit in (("physics:mass", "mass", 1.0), ("physics:density", "density", to_m**-3)):
        value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
        if value:
            return {key: short(value * unit)}
    return {"density": WATER_DENSITY}


def _contact(shape: Usd.Prim) -> dict[str, Any]:
    """Return the friction and restitution specified in the stage, or `collision: none` for visual shapes."""
    from pxr import UsdPhysics, UsdShade

    if not shape.HasAPI(UsdPhysics.CollisionAPI):
        return {"collision": "none"}
    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial("physics")
    prim = material.GetPrim() if material else None
    if prim is None or not prim.HasAPI(UsdPhysics.MaterialAPI):
        return {}
    out = {}
    for name, key in (("dynamicFriction", "friction"), ("restitution", "restitution")):
        value = prim.GetAttribute(f"physics:{name}").Get()
        combine = prim.GetAttribute(f"physxMaterial:{key}CombineMode")
        if value is not None and (value or key == "friction"):
            out[key] = short(value**2 if combine and combine.Get() == "multiply" else value)
    return out


def _camera(prim: Usd.Prim, pose: Pose) -> dict[str, Any]:
    values: dict[str, Any] = {name: prim.GetAttribute(name).Get() or 0.0 for name in (*LENS, *OFFSETS)}
    size = prim.GetAttribute(RESOLUTION).Get() if prim.HasAttribute(RESOLUTION) else None
    data = lens({**values, RESOLUTION: tuple(size or PICTURE)}, {})
    middle = {"cx": (data["size"][0] - 1) / 2, "cy": (data["size"][1] - 1) / 2}
    data = {key: value for key, value in data.items() if value != middle.get(key)}
    return {**data, "pose": camera_pose(pose @ X_CU.inverse())}


def _light(prim: Usd.Prim, pose: Pose) -> tuple[str, dict[str, Any]] | StageNote:
    if (kind := LIGHTS.get(str(prim.GetTypeName()))) is None:
        message = f"lights of type {prim.GetTypeName()} are not supported"
        return StageNote(str(prim.GetPath()), message, "use a distant, sphere or dome light")
    intensity, exposure = (float(prim.GetAttribute(f"inputs:{n}").Get() or 0.0) for n in ("intensity", "exposure"))
    color = srgb(prim.GetAttribute("inputs:color").Get())
    data: dict[str, Any] = {"type": kind.value, "intensity": short(intensity * 2.0**exposure / FULL[kind])}
    if color != (1.0, 1.0, 1.0):
        data["color"] = color
    return "lights", {**data, **light_place(kind, pose)}
