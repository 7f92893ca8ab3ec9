"""Joints between the links of an object, and the joint that fixes the root of a fixed object."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.backends.artifact import rounded
from simfoundry.backends.usd.prims import Prim, apply_schemas, attribute, define, quat, relate, vec3
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import Drive, Joint, JointType, Mimic

_TYPE = {
    JointType.FIXED: "PhysicsFixedJoint",
    JointType.REVOLUTE: "PhysicsRevoluteJoint",
    JointType.CONTINUOUS: "PhysicsRevoluteJoint",
    JointType.PRISMATIC: "PhysicsPrismaticJoint",
    JointType.BALL: "PhysicsSphericalJoint",
}

_MIMIC = "rotX"
"""The instance of PhysX's mimic schema; single-axis joints use this one for any axis."""
_LIMIT = (0.02, 1.0)
_FRICTION = (0.999, 0.999, 0.001, 0.5, 2.0)
"""Stiffness of MuJoCo's limits and Coulomb friction, as in our MJCF. Without it, Newton's MuJoCo solver lets a load of
10 N hang 20 mm below its stop, and a joint held by friction creep at 10 mm/s."""


def define_anchor(scope: Prim, carrier: Prim, root: Prim) -> Prim:
    """Weld a fixed object's root link to the world at the object's prim, so that it moves together with the prim.

    Its name starts with a capital letter, unlike the joints of a scene.
    """
    prim = define(scope, "Anchor", "PhysicsFixedJoint")
    _frames(prim, carrier, root, Pose.of(), Pose.of())
    return prim


def define_joint(scope: Prim, joint: Joint, parent: Prim, child: Prim, leader: Joint | None) -> None:
    """Define ``joint`` between the links ``parent`` and ``child``; it follows ``leader`` if one is given.

    UsdPhysics measures angles in degrees and rotates about a coordinate axis of the joint frames. Both frames are
    rotated so that the coordinate axis closest to the scene's axis coincides with it.
    """
    prim = define(scope, joint.name, _TYPE[joint.type])
    token, X_CJ = joint_frame(joint.axis)
    if joint.type is JointType.FIXED:
        _frames(prim, parent, child, joint.X_PC, Pose.of())
        return
    if joint.type is JointType.BALL:
        _frames(prim, parent, child, joint.X_PC, Pose.of())
        _ball(prim, joint)
        return
    _frames(prim, parent, child, joint.X_PC @ X_CJ, X_CJ)
    attribute(prim, "physics:axis", "token", token, uniform=True)
    attribute(prim, "simfoundry:type", "token", joint.type.value, uniform=True)
    unit = 1.0 if joint.type is JointType.PRISMATIC else math.degrees(1.0)
    if joint.limits is not None and joint.type is not JointType.CONTINUOUS:
        lower, upper = joint.limits
        attribute(prim, "physics:lowerLimit", "float", rounded(lower * unit))
        attribute(prim, "physics:upperLimit", "float", rounded(upper * unit))
        attribute(prim, "mjc:solreflimit", "double[]", list(_LIMIT), uniform=True)
    if joint.closed is not None:
        attribute(prim, "simfoundry:closed", "token", joint.closed, uniform=True)
    _dynamics(prim, joint, unit)
    if joint.mimic is not None and leader is not None:
        _follow(prim, scope, joint.mimic, unit, 1.0 if leader.type is JointType.PRISMATIC else math.degrees(1.0))


def _ball(prim: Prim, joint: Joint) -> None:
    """Add damping, friction and armature of a ball joint about each axis, for Newton; PhysX gets only the armature."""
    if joint.damping or joint.friction or joint.armature:
        apply_schemas(prim, ["PhysxJointAPI", "NewtonJointAPI"])
        attribute(prim, "newton:armature", "float", rounded(joint.armature))
        attribute(prim, "newton:damping", "float", rounded(joint.damping / math.degrees(1.0)))
        attribute(prim, "newton:friction", "float", rounded(joint.friction))
        attribute(prim, "physxJoint:armature", "float", rounded(joint.armature))


def _follow(prim: Prim, scope: Prim, mimic: Mimic, unit: float, unit_of_leader: float) -> None:
    """Make a joint follow another: Newton's equation as in the scene, PhysX's with all terms on one side.

    PhysX softens the constraint by a natural frequency; zero means a rigid gear.
    """
    leader = f"{scope.path}/{mimic.joint}"
    multiplier, offset = rounded(mimic.multiplier * unit / unit_of_leader), rounded(mimic.offset * unit)
    apply_schemas(prim, [f"PhysxMimicJointAPI:{_MIMIC}", "NewtonMimicAPI"])
    attribute(prim, "newton:mimicCoef0", "float", offset)
    attribute(prim, "newton:mimicCoef1", "float", multiplier)
    relate(prim, "newton:mimicJoint", [leader])
    attribute(prim, f"physxMimicJoint:{_MIMIC}:dampingRatio", "float", 0.0)
    attribute(prim, f"physxMimicJoint:{_MIMIC}:gearing", "float", rounded(-multiplier))
    attribute(prim, f"physxMimicJoint:{_MIMIC}:naturalFrequency", "float", 0.0)
    attribute(prim, f"physxMimicJoint:{_MIMIC}:offset", "float", rounded(-offset))
    relate(prim, f"physxMimicJoint:{_MIMIC}:referenceJoint", [leader])
    attribute(prim, f"physxMimicJoint:{_MIMIC}:referenceJointAxis", "token", _MIMIC, uniform=True)


def joint_frame(axis: Array) -> tuple[str, Pose]:
    """Return the coordinate axis (``X``, ``Y``, ``Z``) closest to ``axis``, and the rotation from it to ``axis``."""
    k = int(np.argmax(np.abs(axis)))
    unit = np.eye(3)[k]
    cosine = float(unit @ axis)
    if cosine < 0:  # rotate half a turn about the next axis first; the rest is then below a quarter turn
        half = np.concatenate([[0.0], np.eye(3)[(k + 1) % 3]])
        flipped = Pose.of(q=half)
        _, rest = joint_frame(flipped.inverse().apply(axis))
        return "XYZ"[k], flipped @ rest
    return "XYZ"[k], Pose.of(q=np.concatenate([[1.0 + cosine], np.cross(unit, axis)]))


def _frames(prim: Prim, body0: Prim, body1: Prim, X_0J: Pose, X_1J: Pose) -> None:
    relate(prim, "physics:body0", [body0])
    relate(prim, "physics:body1", [body1])
    for k, pose in enumerate([X_0J, X_1J]):
        attribute(prim, f"physics:localPos{k}", "point3f", vec3(pose.p))
        attribute(prim, f"physics:localRot{k}", "quatf", quat(pose.q))


def _dynamics(prim: Prim, joint: Joint, unit: float) -> None:
    """Add damping, drive, Coulomb friction, armature and position of a joint; ``unit`` is 1 m, or 1 rad in degrees.

    UsdPhysics supports only the first two, as one drive whose gains are per degree. ``simfoundry:damping`` is the part
    of that damping which belongs to the joint itself. The other values are attributes of PhysX and Newton, in which
    torques [N m] and armatures [kg m^2] do not depend on the unit of the angle.
    """
    kind = "linear" if joint.type is JointType.PRISMATIC else "angular"
    drive = joint.drive if joint.drive is not None else Drive(0.0, 0.0)
    if joint.damping or joint.drive is not None:
        apply_schemas(prim, [f"PhysicsDriveAPI:{kind}"])
        attribute(prim, f"drive:{kind}:physics:damping", "float", rounded((joint.damping + drive.damping) / unit))
        attribute(prim, f"drive:{kind}:physics:stiffness", "float", rounded(drive.stiffness / unit))
        attribute(prim, f"drive:{kind}:physics:type", "token", "force", uniform=True)
    if joint.drive is not None:
        attribute(prim, f"drive:{kind}:physics:targetPosition", "float", rounded(drive.target * unit))
        if drive.force_limit is not None:
            attribute(prim, f"drive:{kind}:physics:maxForce", "float", rounded(drive.force_limit))
        attribute(prim, "simfoundry:damping", "double", rounded(joint.damping))
    if joint.friction or joint.armature:
        apply_schemas(prim, ["PhysxJointAPI", f"PhysxJointAxisAPI:{kind}", "NewtonJointAPI"])
        friction, armature = rounded(joint.friction), rounded(joint.armature)
        attribute(prim, "newton:armature", "float", armature)
        attribute(prim, "newton:friction", "float", friction)
        attribute(prim, "physxJoint:armature", "float", armature)
        attribute(prim, f"physxJointAxis:{kind}:armature", "float", armature)
        attribute(prim, f"physxJointAxis:{kind}:dynamicFrictionEffort", "float", friction)
        attribute(prim, f"physxJointAxis:{kind}:staticFrictionEffort", "float", friction)
    if joint.friction:
        attribute(prim, "mjc:solimpfriction", "double[]", list(_FRICTION), uniform=True)
    position = rounded(joint.position * unit)
    apply_schemas(prim, [f"PhysicsJointStateAPI:{kind}"])
    attribute(prim, f"newton:{kind}:position", "float", position)
    attribute(prim, f"state:{kind}:physics:position", "float", position)
    attribute(prim, f"state:{kind}:physics:velocity", "float", 0.0)
