"""OpenUSD, from the usd build through its own ``load.py``: what the stage says, without a simulator."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

from simfoundry.scene.frames import Pose
from simfoundry.verify.facts import (
    ColliderFacts,
    Facts,
    JointFacts,
    LinkFacts,
    Moment,
    mesh_bounds,
    numbers,
    pose_numbers,
    shape_bounds,
)
from simfoundry.verify.readers import Session, load_module

_OBJECTS = "/World/Objects"
_TYPES = {"PhysicsPrismaticJoint": "prismatic", "PhysicsRevoluteJoint": "revolute", "PhysicsSphericalJoint": "ball"}
_KINDS = {"Cube": "box", "Sphere": "sphere", "Cylinder": "cylinder", "Capsule": "capsule", "Mesh": "mesh"}


def open_build(folder: Path) -> Session:
    """The stage of the build in ``folder``."""
    return UsdSession(load_module(folder / "load.py").load())


class UsdSession:
    """A stage, which does not move."""

    timestep = 0.0

    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self._cache = UsdGeom.XformCache()

    def step(self) -> None:
        """A stage has no dynamics."""
        raise NotImplementedError("a USD stage does not step")

    def moment(self, time: float) -> Moment:
        """Poses and joint positions as authored."""
        poses = {prim.GetName(): pose_numbers(self._pose(prim)) for prim in self._objects()}
        return Moment(time, poses, {name: _position(prim) for name, prim in self._joints().items()})

    def facts(self) -> Facts:
        """Links and joints, and the gravity of the physics scene."""
        physics = UsdPhysics.Scene(self.stage.GetPrimAtPath("/World/Physics"))
        direction = np.array(physics.GetGravityDirectionAttr().Get(), dtype=np.float64)
        return Facts(
            links={name: self._link(prim) for name, prim in links(self.stage).items()},
            joints={name: _joint(prim) for name, prim in self._joints().items()},
            gravity=numbers(direction * physics.GetGravityMagnitudeAttr().Get()),
        )

    def close(self) -> None:
        """USD frees the stage with the object."""

    def _objects(self) -> list[Usd.Prim]:
        return list(self.stage.GetPrimAtPath(_OBJECTS).GetChildren())

    def _joints(self) -> dict[str, Usd.Prim]:
        return {
            f"{item.GetName()}.{prim.GetName()}": prim
            for item in self._objects()
            for prim in (item.GetChild("Joints").GetChildren() if item.GetChild("Joints") else [])
            if prim.GetTypeName() != "PhysicsFixedJoint"
        }

    def _pose(self, prim: Usd.Prim) -> Pose:
        matrix: Gf.Matrix4d = self._cache.GetLocalToWorldTransform(prim)
        return Pose.from_matrix(np.array(matrix).T)  # USD multiplies row vectors

    def _link(self, prim: Usd.Prim) -> LinkFacts:
        mass = UsdPhysics.MassAPI(prim)
        axes = Pose.of(q=_wxyz(mass.GetPrincipalAxesAttr().Get())).rotation
        moments = np.array(mass.GetDiagonalInertiaAttr().Get(), dtype=np.float64)
        scope = prim.GetChild("Colliders")
        X_LW = self._pose(prim).inverse()
        return LinkFacts(
            pose=pose_numbers(self._pose(prim)),
            mass=float(mass.GetMassAttr().Get()),
            com=numbers(mass.GetCenterOfMassAttr().Get()),
            inertia=numbers(axes @ np.diag(moments) @ axes.T),
            colliders=tuple(self._collider(child, X_LW) for child in (scope.GetChildren() if scope else [])),
        )

    def _collider(self, prim: Usd.Prim, X_LW: Pose) -> ColliderFacts:
        kind = _KINDS.get(str(prim.GetTypeName()), "other")
        # Gf keeps the scale of a box apart from its rotation.
        transform = Gf.Transform(self._cache.GetLocalToWorldTransform(prim))
        q = transform.GetRotation().GetQuat()
        X_LG = X_LW @ Pose.of(transform.GetTranslation(), [q.GetReal(), *q.GetImaginary()])
        match kind:
            case "box":
                side = float(prim.GetAttribute("size").Get())
                bounds = shape_bounds(kind, [side * s for s in transform.GetScale()], X_LG)
            case "mesh":
                bounds = mesh_bounds(np.array(prim.GetAttribute("points").Get()), X_LG)
            case "sphere":
                bounds = shape_bounds(kind, [prim.GetAttribute("radius").Get()], X_LG)
            case _:
                bounds = shape_bounds(kind, [prim.GetAttribute(n).Get() for n in ("radius", "height")], X_LG)
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        surface = UsdPhysics.MaterialAPI(material)
        return ColliderFacts(
            name=prim.GetName(),
            kind=kind,
            bounds=bounds,
            friction=_own(material, "friction", float(surface.GetDynamicFrictionAttr().Get())),
            restitution=_own(material, "restitution", float(surface.GetRestitutionAttr().Get())),
        )


def links(stage: Usd.Stage) -> dict[str, Usd.Prim]:
    """The prims of all links by qualified name; the first of an object is its root."""
    found = {}
    for item in stage.GetPrimAtPath(_OBJECTS).GetChildren():
        for k, prim in enumerate(p for p in item.GetChildren() if p.GetTypeName() == "Xform"):
            found[item.GetName() if k == 0 else f"{item.GetName()}.{prim.GetName()}"] = prim
    return found


def _own(material: UsdShade.Material, name: str, value: float) -> float:
    """A surface's own coefficient, which under the combine mode ``multiply`` is written as its root."""
    mode = material.GetPrim().GetAttribute(f"physxMaterial:{name}CombineMode").Get()
    return value * value if mode == "multiply" else value


def _joint(prim: Usd.Prim) -> JointFacts:
    kind = _TYPES.get(str(prim.GetTypeName()), "other")
    if kind not in ("prismatic", "revolute"):
        return JointFacts(type=kind)
    instance, unit = ("linear", 1.0) if kind == "prismatic" else ("angular", math.radians(1.0))
    typed = UsdPhysics.PrismaticJoint(prim) if kind == "prismatic" else UsdPhysics.RevoluteJoint(prim)
    lower, upper = (float(attr.Get()) * unit for attr in (typed.GetLowerLimitAttr(), typed.GetUpperLimitAttr()))
    drive = UsdPhysics.DriveAPI.Get(prim, instance)
    unit_axis = np.eye(3)["XYZ".index(str(typed.GetAxisAttr().Get()))]
    return JointFacts(
        type=kind,
        axis=numbers(Pose.of(q=_wxyz(typed.GetLocalRot1Attr().Get())).apply(unit_axis)),
        limits=(lower, upper) if math.isfinite(lower) and math.isfinite(upper) else (),
        damping=float(drive.GetDampingAttr().Get()) / unit if drive else 0.0,
        friction=_number(prim, f"physxJointAxis:{instance}:dynamicFrictionEffort"),
        armature=_number(prim, f"physxJointAxis:{instance}:armature"),
        position=_position(prim),
    )


def _position(prim: Usd.Prim) -> float:
    slides = prim.GetTypeName() == "PhysicsPrismaticJoint"
    value = _number(prim, f"state:{'linear' if slides else 'angular'}:physics:position")
    return value if slides else math.radians(value)


def _number(prim: Usd.Prim, name: str) -> float:
    value = prim.GetAttribute(name).Get()
    return 0.0 if value is None else float(value)


def _wxyz(q: Gf.Quatf) -> list[float]:
    return [q.GetReal(), *q.GetImaginary()]
