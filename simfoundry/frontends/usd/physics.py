"""Read the UsdPhysics joints and masses in a USD stage, and convert them to SI units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import JointDraft, LinkDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.mass_repair import assume_density, inertia_of_moments
from simfoundry.frontends.usd.geoms import UsdGprims
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.spec.models.asset import DriveSpec

AXES = {"X": np.array([1.0, 0, 0]), "Y": np.array([0, 1.0, 0]), "Z": np.array([0, 0, 1.0])}

# Minimum magnitude of limits and forces that are treated as infinite.
#
# USD files often contain a large single-precision number instead of infinity.
INFINITE = 1e30

# Quaternions shorter than this are treated as missing; newer USD versions write zero for a missing rotation.
NO_LENGTH = 1e-9

# One end of a joint: the body's path, the pose of the joint's target in the body frame, and the target's scale.
JointEnd = tuple[str, Pose, Array]

_FRICTION = ("physxJoint:jointFriction", "mjc:frictionloss", "newton:friction")
_ARMATURE = ("physxJoint:armature", "mjc:armature", "newton:armature")

# Speed [deg/s, or stage units/s] that PhysX's schema states for joints without a limit.
UNLIMITED = 1e6

_VELOCITY = ("physxJoint:maxJointVelocity", "newton:velocityLimit")
_EFFORT = ("mjc:actuatorfrcrange:max",)
_DAMPING = ("mjc:damping", "newton:damping")


@dataclass
class UsdJoint:
    """A joint with the parent ``body0`` and the child ``body1``, which may be swapped when the tree is constructed.

    ``X_0`` and ``X_1`` are the poses of the joint frame in the two bodies. The axis is expressed in the joint frame.
    ``others`` are the axes after the first one, in order from the parent on.
    """

    path: str
    parent: str
    child: str
    X_0: Pose
    X_1: Pose
    draft: JointDraft
    others: list[JointDraft]

    def frame(self, body: str) -> Pose:
        """Return the pose of the joint frame in one of its two bodies."""
        return self.X_0 if body == self.parent else self.X_1


def read_joint(prim: Any, end: Callable[[list[Any]], JointEnd], geoms: UsdGprims) -> UsdJoint:
    """Read a joint and record its unsupported features.

    Args:
        prim: Prim of the joint.
        end: Function that resolves the targets at one end of the joint.
        geoms: Converter that contains the draft and the stage units.
    """
    joint = geoms.pxr.UsdPhysics.Joint(prim)
    ends = (end(list(relation.GetTargets())) for relation in (joint.GetBody0Rel(), joint.GetBody1Rel()))
    (parent, X_P, scale_0), (child, X_C, scale_1) = ends
    X_0 = X_P @ attribute_pose(prim, joint.GetLocalPos0Attr().Get(), joint.GetLocalRot0Attr().Get(), scale_0)
    X_1 = X_C @ attribute_pose(prim, joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get(), scale_1)
    path = str(prim.GetPath())
    draft = JointDraft(path, "fixed", parent, child, axis=AXES["X"])
    reader = _JointReader(prim, draft, geoms)
    reader.read()
    return UsdJoint(path, parent, child, X_0, X_1, draft, reader.others)


def attribute_pose(prim: Any, position: Any, rotation: Any, scale: Array | float = 1.0) -> Pose:
    """Return the pose specified by a prim's position and rotation attributes.

    Missing values and zero quaternions represent the identity.

    Raises:
        ImportRefusedError: If a number is not finite.
    """
    p = np.array(position if position is not None else (0, 0, 0), dtype=np.float64) * scale
    q = (1.0, 0.0, 0.0, 0.0) if rotation is None else (rotation.GetReal(), *rotation.GetImaginary())
    if not np.isfinite([*p, *q]).all():
        file = Path(prim.GetStage().GetRootLayer().realPath)
        raise ImportRefusedError(file, f"a frame of `{prim.GetPath()}` has non-finite numbers")
    return Pose.of(p, q if math.hypot(*q) > NO_LENGTH else (1.0, 0.0, 0.0, 0.0))


class _JointReader:
    """A reader for the type, limits and dynamics of a joint."""

    def __init__(self, prim: Any, joint: JointDraft, geoms: UsdGprims) -> None:
        self.prim, self.joint, self.label = prim, joint, f"joint `{joint.name}`"
        self.others: list[JointDraft] = []
        self.pxr, self.draft, self.to_m, self.to_kg = geoms.pxr, geoms.draft, geoms.to_m, geoms.to_kg

    def read(self) -> None:
        physics, prim, kind = self.pxr.UsdPhysics, self.prim, self.prim.GetTypeName()
        match kind:
            case "PhysicsFixedJoint":
                return
            case "PhysicsRevoluteJoint" | "PhysicsPrismaticJoint":
                turns = kind == "PhysicsRevoluteJoint"
                schema = physics.RevoluteJoint(prim) if turns else physics.PrismaticJoint(prim)
                self.joint.axis = AXES[schema.GetAxisAttr().Get()]
                self.limit(turns, schema.GetLowerLimitAttr().Get(), schema.GetUpperLimitAttr().Get())
                closed = prim.GetAttribute("simfoundry:closed")
                self.joint.closed = closed.Get() if closed and closed.Get() in ("lower", "upper") else None
                self.dynamics("angular" if turns else "linear", turns)
            case "PhysicsSphericalJoint":
                self.joint.type = "ball"
                schema = physics.SphericalJoint(prim)
                cones = (schema.GetConeAngle0LimitAttr().Get(), schema.GetConeAngle1LimitAttr().Get())
                if any(c is not None and 0 <= c < 180 for c in cones):
                    self.draft.inexpressible(f"cone limit of {self.label}")
            case "PhysicsJoint":
                self.six_axes()
            case _:
                self.draft.dropped(f"motion of {self.label}", f"{kind} is not supported, so the joint is fixed")

    def limit(self, turns: bool, low: float | None, high: float | None) -> None:
        """Set the type and limits of a joint with a single axis."""
        joint, factor = self.joint, math.radians(1.0) if turns else self.to_m
        low, high = (None if b is None or not abs(b) <= INFINITE else float(b) * factor for b in (low, high))
        if low is not None and high is not None and low < high:
            joint.type, joint.limits = ("revolute" if turns else "prismatic"), (low, high)
        elif low is not None and high is not None and low == high:
            self.draft.changed(self.label, "the limits leave no range of motion, so the joint is fixed at zero")
        elif turns:
            joint.type = "continuous"
            if (low is None) != (high is None):
                self.draft.dropped(f"single limit of {self.label}", "a joint must have two limits or none")
        else:
            least, most = self.draft.unlimited_slide(self.label)
            joint.type, joint.limits = "prismatic", (least if low is None else low, most if high is None else high)

    def dynamics(self, token: str, turns: bool) -> None:
        """Set the damping, friction, armature and drive of a joint. Angular quantities in the stage are per degree."""
        prim, joint, to_m, to_kg = self.prim, self.joint, self.to_m, self.to_kg
        force = to_kg * to_m * (to_m if turns else 1.0)
        per_unit = math.degrees(1.0) if turns else 1.0 / to_m
        own = f"physxJointAxis:{token}"
        joint.friction = _first(prim, (*_FRICTION, f"{own}:dynamicFrictionEffort")) * force
        joint.armature = _first(prim, (*_ARMATURE, f"{own}:armature")) * to_kg * (to_m**2 if turns else 1.0)
        passive = _first(prim, (*_DAMPING, f"{own}:viscousFrictionCoefficient"))
        joint.damping = passive * (1.0 if prim.HasAttribute("mjc:damping") else force * per_unit)
        speed = _first(prim, (*_VELOCITY, f"{own}:maxJointVelocity"))
        joint.velocity = speed * (math.radians(1.0) if turns else to_m) if 0 < speed < UNLIMITED else None
        joint.effort = _first(prim, _EFFORT) or None
        if not prim.HasAPI(self.pxr.UsdPhysics.DriveAPI, token):
            return
        drive = self.pxr.UsdPhysics.DriveAPI(prim, token)
        stiffness, damping = (float(a.Get() or 0.0) for a in (drive.GetStiffnessAttr(), drive.GetDampingAttr()))
        if stiffness <= 0 and damping <= 0:
            return
        if drive.GetTypeAttr().Get() == "acceleration":
            why = "only force drives are supported, not acceleration drives"
            self.draft.dropped(f"drive of {self.label}", why)
            return
        factor = to_kg * (to_m**2 * math.degrees(1.0) if turns else 1.0)
        limit, target = drive.GetMaxForceAttr().Get(), drive.GetTargetPositionAttr()
        has_target = target.HasAuthoredValue() and stiffness > 0
        joint.drive = DriveSpec(
            stiffness=max(0.0, stiffness) * factor,
            damping=max(0.0, damping) * factor,
            target=float(target.Get()) * (math.radians(1.0) if turns else to_m) if has_target else None,
            force_limit=float(limit) * force if limit is not None and 0 < limit < INFINITE else None,
        )

    def six_axes(self) -> None:
        """Convert a joint with individually locked axes to a fixed, ball or free joint, or to a joint with these axes.

        The child slides before it turns about X, Y and Z, in this order, as in Newton.
        """
        free: dict[str, tuple[float | None, float | None]] = {}
        for token in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ"):
            limit = self.pxr.UsdPhysics.LimitAPI(self.prim, token)
            is_limited = self.prim.HasAPI(self.pxr.UsdPhysics.LimitAPI, token)
            low, high = (limit.GetLowAttr().Get(), limit.GetHighAttr().Get()) if is_limited else (None, None)
            if low is None or high is None or low < high:
                free[token] = (low, high)
        if len(free) == 6:
            self.joint.type = "free"
        elif list(free) == ["rotX", "rotY", "rotZ"]:
            self.joint.type = "ball"
        elif len(free) == 1:
            ((token, bounds),) = free.items()
            self.joint.axis = AXES[token[-1]]
            self.limit(token.startswith("rot"), *bounds)
            self.dynamics(token, token.startswith("rot"))
        elif free:
            first, path = self.joint, self.joint.name
            for token, bounds in free.items():
                if first.name != path:
                    self.joint = JointDraft(path, "fixed", first.parent, first.child)
                    self.others.append(self.joint)
                self.joint.name, self.joint.axis = f"{path}_{token}", AXES[token[-1]]
                self.limit(token.startswith("rot"), *bounds)
                self.dynamics(token, token.startswith("rot"))
            self.joint = first


def _first(prim: Any, names: tuple[str, ...]) -> float:
    """Return the first positive value among the attributes in ``names``, or 0 if there is none."""
    values = (prim.GetAttribute(name).Get() for name in names if prim.HasAttribute(name))
    return next((float(v) for v in values if isinstance(v, int | float) and math.isfinite(v) and v > 0), 0.0)


# Products of inertia below this fraction of the trace are single-precision noise from rotating the axes.
NOISE = 1e-9


@dataclass
class UsdBody:
    """A rigid body in the stage.

    ``X_WB`` is the pose of the body frame in the world, and ``scale`` [m per unit] converts lengths in that frame to
    meters. ``X_BL`` is the pose of the link frame in the body frame, which joints may change.
    """

    prim: Any
    X_WB: Pose
    scale: Array
    link: LinkDraft
    X_BL: Pose = IDENTITY


def add_mass(body: UsdBody, colliders: list[Any], geoms: UsdGprims) -> None:
    """Set the mass properties of a body.

    As in UsdPhysics, the body's mass takes precedence, followed by its density, the masses of its colliders, and the
    densities of its materials. ``geoms`` provides the draft and the stage units.
    """
    physics, link, draft, to_m, to_kg = geoms.pxr.UsdPhysics, body.link, geoms.draft, geoms.to_m, geoms.to_kg
    disabled = body.prim.GetAttribute("physxRigidBody:disableGravity").Get() is True
    link.gravity_compensation = 1.0 if disabled else min(1.0, _first(body.prim, ("mjc:gravcomp",)))
    api = physics.MassAPI(body.prim)
    mass, density = api.GetMassAttr().Get(), api.GetDensityAttr().Get()
    masses = [float(m) for p in colliders if (m := physics.MassAPI(p).GetMassAttr().Get()) and m > 0]
    densities = {geoms.surface(p)[1] for p in colliders}
    if mass and mass > 0:
        link.mass = float(mass) * to_kg
        _add_inertia(body, api, to_kg * to_m**2)
    elif density and density > 0:
        link.density = float(density) * to_kg / to_m**3
    elif masses and len(masses) == len(colliders):
        link.mass = math.fsum(masses) * to_kg
        if len(masses) > 1:
            draft.changed(f"masses of the colliders of `{link.name}`", "the sum of the masses is distributed by volume")
    elif len(densities) == 1 and None not in densities:
        link.density = densities.pop()
    elif link.colliders:
        assume_density(draft, link, "UsdPhysics")
    else:
        link.mass, link.com, link.assumed = 1.0, np.zeros(3), "import"
        why = "the stage specifies neither a mass nor colliders; 1 kg is assumed, as in PhysX"
        draft.assumed(f"mass of `{link.name}`", why)


def _add_inertia(body: UsdBody, api: Any, unit: float) -> None:
    """Set the center of mass and inertia of a body, expressed in the link frame, if the stage specifies them."""
    link, X_LB = body.link, body.X_BL.inverse()
    com = api.GetCenterOfMassAttr().Get()
    is_given = api.GetCenterOfMassAttr().HasAuthoredValue() and all(math.isfinite(v) for v in com)
    if is_given:
        link.com = X_LB.apply(np.array(com, dtype=np.float64) * body.scale)
    diagonal = np.array(api.GetDiagonalInertiaAttr().Get() or (0, 0, 0), dtype=np.float64)
    if not diagonal.any():
        return
    R_LI = (X_LB @ attribute_pose(body.prim, None, api.GetPrincipalAxesAttr().Get())).rotation
    link.inertia = inertia_of_moments(diagonal * unit, R_LI, NOISE)
    if not is_given:
        link.com = X_LB.p.copy()
