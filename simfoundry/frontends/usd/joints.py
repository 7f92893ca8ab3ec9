"""UsdPhysics joints: their frames in both bodies, kind, limits, drives, damping and friction, in SI units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.frontends.draft import Draft, DriveDraft
from simfoundry.geometry.frames import Array, Pose

FAR = 1000.0
"""Limit [m] of a slide that has none."""

AXES = {"X": np.array([1.0, 0, 0]), "Y": np.array([0, 1.0, 0]), "Z": np.array([0, 0, 1.0])}

End = tuple[str, Pose, Array]
"""What a joint is fastened to, by path; the frame there in the body's, and the scale of its units."""

_FRICTION = ("physxJoint:jointFriction", "mjc:frictionloss", "newton:friction")
_ARMATURE = ("physxJoint:armature", "mjc:armature", "newton:armature")
_DAMPING = ("mjc:damping", "newton:damping")


@dataclass
class UsdJoint:
    """A joint: body0 is its parent, body1 its child, until a tree turns it about.

    ``X_0`` and ``X_1`` are its frames in the two bodies; ``axis`` is in its own frame; limits [rad or m].
    """

    path: str
    type: str
    parent: str
    child: str
    X_0: Pose
    X_1: Pose
    axis: Array
    limits: tuple[float, float] | None = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    drive: DriveDraft | None = None
    closed: str | None = None

    def frame(self, body: str) -> Pose:
        """Its frame in one of its two bodies."""
        return self.X_0 if body == self.parent else self.X_1


def read_joint(
    draft: Draft, pxr: Any, prim: Any, end: Callable[[list[Any]], End], units: tuple[float, float]
) -> UsdJoint:
    """A joint of the stage; what of it cannot be said is noted. ``units`` are metres and kilograms per unit."""
    joint = pxr.UsdPhysics.Joint(prim)
    (parent, X_P, scale_0), (child, X_C, scale_1) = (
        end(list(r.GetTargets())) for r in (joint.GetBody0Rel(), joint.GetBody1Rel())
    )
    X_0 = X_P @ _local(joint.GetLocalPos0Attr().Get(), joint.GetLocalRot0Attr().Get(), scale_0)
    X_1 = X_C @ _local(joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get(), scale_1)
    made = UsdJoint(str(prim.GetPath()), "fixed", parent, child, X_0, X_1, AXES["X"])
    _kind(draft, pxr, prim, made, units)
    return made


def _local(position: Any, rotation: Any, scale: Array) -> Pose:
    p = np.array(position if position is not None else (0, 0, 0), dtype=np.float64) * scale
    q = (1.0, 0.0, 0.0, 0.0) if rotation is None else (rotation.GetReal(), *rotation.GetImaginary())
    return Pose.of(p, q if any(q) else (1.0, 0.0, 0.0, 0.0))


def _kind(draft: Draft, pxr: Any, prim: Any, made: UsdJoint, units: tuple[float, float]) -> None:
    physics, kind, what = pxr.UsdPhysics, prim.GetTypeName(), f"joint `{made.path}`"
    match kind:
        case "PhysicsFixedJoint":
            return
        case "PhysicsRevoluteJoint" | "PhysicsPrismaticJoint":
            turns = kind == "PhysicsRevoluteJoint"
            schema = physics.RevoluteJoint(prim) if turns else physics.PrismaticJoint(prim)
            made.axis = AXES[schema.GetAxisAttr().Get()]
            bounds = (schema.GetLowerLimitAttr().Get(), schema.GetUpperLimitAttr().Get())
            _limited(draft, made, what, turns, bounds, units[0])
            closed = prim.GetAttribute("simfoundry:closed")
            made.closed = closed.Get() if closed and closed.Get() in ("lower", "upper") else None
            _dynamics(draft, pxr, prim, made, "angular" if turns else "linear", units)
        case "PhysicsSphericalJoint":
            made.type = "ball"
            cones = (
                physics.SphericalJoint(prim).GetConeAngle0LimitAttr().Get(),
                physics.SphericalJoint(prim).GetConeAngle1LimitAttr().Get(),
            )
            if any(c is not None and 0 <= c < 180 for c in cones):
                draft.dropped(f"cone limit of {what}", "the language has no word for it")
        case "PhysicsJoint":
            _six_axes(draft, pxr, prim, made, what, units)
        case _:
            draft.dropped(f"motion of {what}", f"the language has no {kind}; it is fixed")


def _limited(draft: Draft, made: UsdJoint, what: str, turns: bool, bounds: tuple[Any, Any], to_m: float) -> None:
    """The type and limits of a joint with one axis."""
    factor = math.radians(1.0) if turns else to_m
    low, high = (None if b is None or not math.isfinite(b) or abs(b) > 1e30 else float(b) * factor for b in bounds)
    if low is not None and high is not None and low < high:
        made.type, made.limits = ("revolute" if turns else "prismatic"), (low, high)
    elif low is not None and high is not None and low == high:
        draft.changed(what, "its limits leave it no way, so it is fixed at zero")
    elif turns:
        made.type = "continuous"
        if (low is None) != (high is None):
            draft.dropped(f"the one limit of {what}", "a joint has two limits or none")
    else:
        made.type, made.limits = "prismatic", (-FAR if low is None else low, FAR if high is None else high)
        draft.changed(what, f"it has no limits; {FAR:g} m to either side stand for that")


def _dynamics(draft: Draft, pxr: Any, prim: Any, made: UsdJoint, token: str, units: tuple[float, float]) -> None:
    """Damping, friction, armature and drive; angular quantities are for degrees in the stage."""
    to_m, to_kg = units
    turns = token == "angular"
    force = to_kg * to_m * (to_m if turns else 1.0)
    per_unit = math.degrees(1.0) if turns else 1.0 / to_m
    made.friction = _first(prim, _FRICTION) * force
    made.armature = _first(prim, _ARMATURE) * to_kg * (to_m**2 if turns else 1.0)
    made.damping = _first(prim, _DAMPING) * (1.0 if prim.HasAttribute("mjc:damping") else force * per_unit)
    if not prim.HasAPI(pxr.UsdPhysics.DriveAPI, token):
        return
    drive = pxr.UsdPhysics.DriveAPI(prim, token)
    stiffness, damping = (float(a.Get() or 0.0) for a in (drive.GetStiffnessAttr(), drive.GetDampingAttr()))
    if stiffness <= 0 and damping <= 0:
        return
    if drive.GetTypeAttr().Get() == "acceleration":
        draft.dropped(f"drive of joint `{made.path}`", "it gives accelerations, and drives here give forces")
        return
    factor = to_kg * (to_m**2 * math.degrees(1.0) if turns else 1.0)
    made.drive = DriveDraft(max(0.0, stiffness) * factor, max(0.0, damping) * factor)
    limit = drive.GetMaxForceAttr().Get()
    if limit is not None and 0 < limit < 1e30 and math.isfinite(limit):
        made.drive.force_limit = float(limit) * force
    target = drive.GetTargetPositionAttr()
    if target.HasAuthoredValue() and stiffness > 0:
        made.drive.target = float(target.Get()) * (math.radians(1.0) if turns else to_m)


def _first(prim: Any, names: tuple[str, ...]) -> float:
    for name in names:
        value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
        if isinstance(value, int | float) and math.isfinite(value) and value > 0:
            return float(value)
    return 0.0


def _six_axes(draft: Draft, pxr: Any, prim: Any, made: UsdJoint, what: str, units: tuple[float, float]) -> None:
    """A joint whose axes are locked one by one: fixed, of one axis, a ball or free; any other is noted."""
    free = []
    for token in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ"):
        if not prim.HasAPI(pxr.UsdPhysics.LimitAPI, token):
            free.append(token)
            continue
        limit = pxr.UsdPhysics.LimitAPI(prim, token)
        low, high = limit.GetLowAttr().Get(), limit.GetHighAttr().Get()
        if low is None or high is None or low < high:
            free.append(token)
    if not free:
        return
    if len(free) == 6:
        made.type = "free"
        return
    if free == ["rotX", "rotY", "rotZ"]:
        made.type = "ball"
        return
    if len(free) == 1:
        (token,) = free
        made.axis = AXES[token[-1]]
        turns = token.startswith("rot")
        bounds: tuple[Any, Any] = (None, None)
        if prim.HasAPI(pxr.UsdPhysics.LimitAPI, token):
            limit = pxr.UsdPhysics.LimitAPI(prim, token)
            bounds = (limit.GetLowAttr().Get(), limit.GetHighAttr().Get())
        _limited(draft, made, what, turns, bounds, units[0])
        _dynamics(draft, pxr, prim, made, token, units)
        return
    draft.dropped(f"motion of {what}", "a joint here has one axis, is a ball, or is free; it is fixed", ", ".join(free))
