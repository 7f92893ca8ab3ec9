"""The OpenUSD session for USD builds. The build's ``load.py`` opens the stage, which is read without a simulator."""

from __future__ import annotations

import math
from pathlib import Path
from types import ModuleType

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

from simfoundry.geometry.frames import Pose
from simfoundry.verify import readback as rb

_SCOPES = ("/World/Objects", "/World/Robots")
_TYPES = {"PhysicsPrismaticJoint": "prismatic", "PhysicsRevoluteJoint": "revolute", "PhysicsSphericalJoint": "ball"}
_KINDS = {"Cube": "box"} | {kind: kind.lower() for kind in ("Sphere", "Cylinder", "Capsule", "Cone", "Mesh")}


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the stage of the build in ``folder``."""
    return UsdSession(loader.load())


class UsdSession(rb.Session):
    """A USD stage, which cannot be stepped."""

    timestep = 0.0

    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self._cache = UsdGeom.XformCache()

    def step(self) -> None:
        """Raise NotImplementedError, because a stage has no dynamics."""
        raise NotImplementedError("a USD stage has no dynamics and cannot be stepped")

    def moment(self, time: float) -> rb.Moment:
        """Return the authored poses and joint positions."""
        poses = {prim.GetName(): rb.pose_numbers(self._pose(prim)) for prim in self._objects()}
        return rb.Moment(time, poses, {name: _position(prim) for name, prim in self._joints().items()})

    def read(self) -> rb.WorldReadback:
        """Return the links, the joints, and the gravity of the physics scene."""
        physics = UsdPhysics.Scene(self.stage.GetPrimAtPath("/World/Physics"))
        direction = np.array(physics.GetGravityDirectionAttr().Get(), dtype=np.float64)
        held = self._held()
        joints = {name: self._joint(name, prim) for name, prim in self._joints().items()}
        own = {
            name: rb.LinkReadback(pose=rb.pose_numbers(self._pose(prim)))
            for name, prim in _references(self.stage).items()
        }
        return rb.WorldReadback(
            links={name: self._link(prim, held[name]) for name, prim in links(self.stage).items()} | own,
            joints=joints,
            gravity=rb.numbers(direction * physics.GetGravityMagnitudeAttr().Get()),
            silent=self._silent(),
            actuators=rb.driven(joints),
        )

    def _objects(self) -> list[Usd.Prim]:
        return _items(self.stage)

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

    def _held(self) -> dict[str, str | None]:
        """Return the parent of each link, or None for static links whose parent is not in the stage.

        A link with a joint has the joint's other body as its parent. Otherwise, a rigid body is free, and the root of a
        static object is held by the world.
        """
        names = {prim.GetPath(): name for name, prim in links(self.stage).items()}
        found: dict[str, str | None] = {}
        for item in self._objects():
            scope = item.GetChild("Joints")
            for prim in scope.GetChildren() if scope else []:
                ends = [
                    r.GetTargets() for r in (UsdPhysics.Joint(prim).GetBody0Rel(), UsdPhysics.Joint(prim).GetBody1Rel())
                ]
                if ends[1] and ends[1][0] in names:
                    found[names[ends[1][0]]] = names.get(ends[0][0], rb.WORLD) if ends[0] else rb.WORLD
        for name, prim in links(self.stage).items():
            free = rb.FREE if prim.HasAPI(UsdPhysics.RigidBodyAPI) else None if "." in name else rb.WORLD
            found.setdefault(name, free)
        return found

    def _silent(self) -> tuple[str, ...]:
        """Return the filtered pairs of links. A static link is represented by its colliders."""
        names = {str(prim.GetPath()): name for name, prim in links(self.stage).items()}
        found = set()
        for path, name in names.items():
            pairs = UsdPhysics.FilteredPairsAPI(self.stage.GetPrimAtPath(path)).GetFilteredPairsRel()
            for target in pairs.GetTargets() if pairs else []:
                found.add(rb.pair_name(name, names[str(target).partition("/Colliders/")[0]]))
        return tuple(sorted(found))

    def _link(self, prim: Usd.Prim, held: str | None) -> rb.LinkReadback:
        mass = UsdPhysics.MassAPI(prim)
        axes = Pose.of(q=_wxyz(mass.GetPrincipalAxesAttr().Get())).rotation
        moments = np.array(mass.GetDiagonalInertiaAttr().Get(), dtype=np.float64)
        scope = prim.GetChild("Colliders")
        X_LW = self._pose(prim).inverse()
        return rb.LinkReadback(
            pose=rb.pose_numbers(self._pose(prim)),
            mass=float(mass.GetMassAttr().Get()),
            com=rb.numbers(mass.GetCenterOfMassAttr().Get()),
            inertia=rb.numbers(axes @ np.diag(moments) @ axes.T),
            held=held,
            gravity_compensation=_number(prim, "mjc:gravcomp"),
            colliders=tuple(self._collider(child, X_LW) for child in (scope.GetChildren() if scope else [])),
        )

    def _collider(self, prim: Usd.Prim, X_LW: Pose) -> rb.ColliderReadback:
        kind = _KINDS.get(str(prim.GetTypeName()), "other")
        # Gf separates the scale of a box from its rotation.
        transform = Gf.Transform(self._cache.GetLocalToWorldTransform(prim))
        q = transform.GetRotation().GetQuat()
        X_LG = X_LW @ Pose.of(transform.GetTranslation(), [q.GetReal(), *q.GetImaginary()])
        match kind:
            case "box":
                side = float(prim.GetAttribute("size").Get())
                bounds = rb.shape_bounds(kind, [side * s for s in transform.GetScale()], X_LG)
            case "mesh":
                bounds = rb.mesh_bounds(np.array(prim.GetAttribute("points").Get()), X_LG)
            case "sphere":
                bounds = rb.shape_bounds(kind, [prim.GetAttribute("radius").Get()], X_LG)
            case _:
                bounds = rb.shape_bounds(kind, [prim.GetAttribute(n).Get() for n in ("radius", "height")], X_LG)
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        surface = UsdPhysics.MaterialAPI(material)
        return rb.ColliderReadback(
            name=prim.GetName(),
            kind=kind,
            bounds=bounds,
            friction=_own(material, "friction", float(surface.GetDynamicFrictionAttr().Get())),
            restitution=_own(material, "restitution", float(surface.GetRestitutionAttr().Get())),
            spinning=_number(material.GetPrim(), "newton:torsionalFriction"),
            rolling=_number(material.GetPrim(), "newton:rollingFriction"),
        )

    def _joint(self, name: str, prim: Usd.Prim) -> rb.JointReadback:
        """Return the values of a joint as authored. The position of a ball joint is computed from the body poses."""
        if prim.GetTypeName() != "PhysicsSphericalJoint":
            return _joint(name, prim)
        ball = UsdPhysics.SphericalJoint(prim)
        parent, child = (r.GetTargets()[0] for r in (ball.GetBody0Rel(), ball.GetBody1Rel()))
        X_WP, X_WC = (self._pose(self.stage.GetPrimAtPath(path)) for path in (parent, child))
        X_PJ, X_CJ = (Pose.of(q=_wxyz(a.Get())) for a in (ball.GetLocalRot0Attr(), ball.GetLocalRot1Attr()))
        turned = (X_WP @ X_PJ).inverse() @ X_WC @ X_CJ
        return rb.JointReadback(
            type="ball",
            limits=(),
            damping=_number(prim, "newton:damping") / math.radians(1.0),
            friction=_number(prim, "newton:friction"),
            armature=_number(prim, "newton:armature"),
            position=rb.numbers(turned.q),
            follows="",
            law=(),
            drive=(),
            effort=(),
        )


def links(stage: Usd.Stage) -> dict[str, Usd.Prim]:
    """Return the prims of all links, keyed by qualified name. The first link of each object is its root."""
    found = {}
    for item in _items(stage):
        if not item.GetChild("Model"):
            for k, prim in enumerate(p for p in item.GetChildren() if p.GetTypeName() == "Xform"):
                found[item.GetName() if k == 0 else f"{item.GetName()}.{prim.GetName()}"] = prim
    return found


def _items(stage: Usd.Stage) -> list[Usd.Prim]:
    """Return the prims of objects and robots."""
    scopes = (stage.GetPrimAtPath(path) for path in _SCOPES)
    return [prim for scope in scopes if scope for prim in scope.GetChildren()]


def _references(stage: Usd.Stage) -> dict[str, Usd.Prim]:
    """Return the robots that are references to their own files. Their prims keep their own names."""
    return {prim.GetName(): prim for prim in _items(stage) if prim.GetChild("Model")}


def _own(material: UsdShade.Material, name: str, value: float) -> float:
    """Return the coefficient of a surface itself, whose square root is stored for the combine mode ``multiply``."""
    mode = material.GetPrim().GetAttribute(f"physxMaterial:{name}CombineMode").Get()
    return value * value if mode == "multiply" else value


def _joint(name: str, prim: Usd.Prim) -> rb.JointReadback:
    kind = _TYPES.get(str(prim.GetTypeName()), "other")
    if kind not in ("prismatic", "revolute"):
        return rb.JointReadback(type=kind)
    instance, unit = ("linear", 1.0) if kind == "prismatic" else ("angular", math.radians(1.0))
    typed = UsdPhysics.PrismaticJoint(prim) if kind == "prismatic" else UsdPhysics.RevoluteJoint(prim)
    lower, upper = (float(attr.Get()) * unit for attr in (typed.GetLowerLimitAttr(), typed.GetUpperLimitAttr()))
    drive = UsdPhysics.DriveAPI.Get(prim, instance)
    gains = (drive.GetStiffnessAttr(), drive.GetDampingAttr()) if drive else ()
    spring = tuple(float(gain.Get()) / unit for gain in gains)
    target = (float(drive.GetTargetPositionAttr().Get()) * unit,) if drive else ()
    limit = float(drive.GetMaxForceAttr().Get()) if drive else math.inf
    effort, velocity = (_numbers(prim, name) for name in ("mjc:actuatorfrcrange:max", "newton:velocityLimit"))
    unit_axis = np.eye(3)["XYZ".index(str(typed.GetAxisAttr().Get()))]
    follows, law = _law(name, prim)
    return rb.JointReadback(
        type=kind,
        axis=rb.numbers(Pose.of(q=_wxyz(typed.GetLocalRot1Attr().Get())).apply(unit_axis)),
        limits=(lower, upper) if math.isfinite(lower) and math.isfinite(upper) else (),
        damping=_number(prim, "newton:damping") / unit,
        friction=_number(prim, f"physxJointAxis:{instance}:dynamicFrictionEffort"),
        armature=_number(prim, f"physxJointAxis:{instance}:armature"),
        position=_position(prim),
        follows=follows,
        law=law,
        drive=spring + target,
        effort=(limit,) if math.isfinite(limit) else (),
        max_effort=effort,
        max_velocity=tuple(speed * unit for speed in velocity),
    )


def _law(name: str, prim: Usd.Prim) -> tuple[str, tuple[float, ...]]:
    """Return a mimic joint's leader, its multiplier and its offset [rad or m]."""
    leaders = prim.GetRelationship("newton:mimicJoint").GetTargets()
    if not leaders:
        return "", ()
    leader = prim.GetStage().GetPrimAtPath(leaders[0])
    unit, unit_of_leader = (
        1.0 if p.GetTypeName() == "PhysicsPrismaticJoint" else math.radians(1.0) for p in (prim, leader)
    )
    multiplier, offset = _number(prim, "newton:mimicCoef1"), _number(prim, "newton:mimicCoef0")
    return f"{name.partition('.')[0]}.{leader.GetName()}", (multiplier * unit / unit_of_leader, offset * unit)


def _position(prim: Usd.Prim) -> float:
    slides = prim.GetTypeName() == "PhysicsPrismaticJoint"
    value = _number(prim, f"state:{'linear' if slides else 'angular'}:physics:position")
    return value if slides else math.radians(value)


def _number(prim: Usd.Prim, name: str) -> float:
    value = prim.GetAttribute(name).Get()
    return 0.0 if value is None else float(value)


def _numbers(prim: Usd.Prim, name: str) -> rb.Numbers:
    """Return the value of an attribute, or nothing if it is not authored."""
    value = prim.GetAttribute(name).Get()
    return () if value is None else (float(value),)


def _wxyz(q: Gf.Quatf) -> list[float]:
    return [q.GetReal(), *q.GetImaginary()]
