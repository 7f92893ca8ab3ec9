"""Conversion of objects to USD: rigid bodies with explicit mass properties, visuals, colliders and joints."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simfoundry.backends.artifact import rounded
from simfoundry.backends.usd.prims import Prim, quat, settled, vec3
from simfoundry.backends.usd.shapes import contact_material, define_geometry, define_visual
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.kinematics import Tree, contact_pairs, excluded_link_pairs, link_poses, trees
from simfoundry.scene.model import Joint, JointType, Link, Mimic, Scene, SceneObject

# The name of the variant that represents the object as written in its document.
DEFAULT = "default"


@dataclass(frozen=True)
class Scopes:
    """The prims that contain the objects and the shared materials on a stage."""

    objects: Prim
    looks: Prim
    contacts: Prim


def is_static(tree: Tree) -> bool:
    """Return true if no link in the tree can move. Such links have colliders but no rigid bodies."""
    return tree.fixed and all(joint.type is JointType.FIXED for joint in tree.joints)


def define_object(scopes: Scopes, item: SceneObject) -> None:
    """Define ``item`` at its world pose, with its links as sibling prims below it at the given joint positions.

    The articulation root of a free object is its root link. For a fixed object, PhysX requires the articulation root on
    a prim above both the root link and the joint that fixes it; otherwise PhysX simulates the joints in maximal
    coordinates. If the object has variants, each variant in the variant set ``variant`` contains the complete object.
    Labels use the taxonomy ``class``, which Isaac Sim reads.
    """
    prim = scopes.objects.define(item.name, "Xform")
    prim.kind = "component"
    if not item.variants:
        _fill_object(scopes, prim, item)
        return
    prim.selected = item.variant
    for one in sorted((item, *item.variants), key=lambda one: one.variant != DEFAULT):
        _fill_object(scopes, prim.variant(one.variant), one)


def _fill_object(scopes: Scopes, prim: Prim, item: SceneObject) -> None:
    """Define the links and joints of an object or of one of its variants."""
    prim.schemas += ["SemanticsLabelsAPI:category", "SemanticsLabelsAPI:class"]
    prim.attribute("semantics:labels:category", "token[]", [item.category])
    prim.attribute("semantics:labels:class", "token[]", list(item.semantics))
    prim.place(item.X_WO)
    X_OL = link_poses(item)
    links = {}
    for link in item.links:
        links[link.name] = body = prim.define(link.name, "Xform")
        body.place(X_OL[link.name])
        _define_link(scopes, body, link)
    moving = [tree for tree in trees(item) if not is_static(tree)]
    for tree in moving:
        for link in tree.links:
            links[link.name].schemas += ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
        if tree.free_joint is not None:
            _set_free(links[tree.root.name], tree.free_joint, links[tree.free_joint.parent])
    joined = [tree for tree in moving if tree.joints]
    if joined:
        scope = prim.define("Joints", "Scope")
        for tree in joined:
            _articulate(prim, scope, tree, links, alone=len(joined) == 1)


def _set_free(body: Prim, joint: Joint, parent: Prim) -> None:
    """Author the free joint of a body as attributes, because UsdPhysics has no prim type for free joints.

    ``simfoundry:freePose`` is the body's pose in its parent frame at the zero position, written as a USD matrix (for
    row vectors).
    """
    matrix = tuple(tuple(settled(v) for v in row) for row in joint.X_PC.matrix.T)
    body.attribute("simfoundry:freeJoint", "token", joint.name, uniform=True)
    body.attribute("simfoundry:freePose", "matrix4d", matrix, uniform=True)
    body.relate("simfoundry:freeParent", [parent])


def _articulate(prim: Prim, scope: Prim, tree: Tree, links: Mapping[str, Prim], alone: bool) -> None:
    """Define the joints and the articulation of a tree.

    The articulation specifies whether its links can collide with each other; filtered pairs exclude individual pairs of
    links. If a fixed object also has a freely moving part, the articulation root of the fixed part is its anchor joint.
    """
    root = links[tree.root.name]
    if tree.fixed:
        anchor = define_anchor(scope, prim, root)
        root = prim if alone else anchor
    names = {link.name for link in tree.links}
    touching = any(names.issuperset(pair) for pair in contact_pairs(tree.owner))
    root.schemas += ["PhysicsArticulationRootAPI", "PhysxArticulationAPI", "NewtonArticulationRootAPI"]
    root.attribute("newton:selfCollisionEnabled", "bool", touching)
    root.attribute("physxArticulation:enabledSelfCollisions", "bool", touching)
    by_name = {joint.name: joint for joint in tree.joints}
    for joint in tree.joints:
        leader = by_name.get(joint.mimic.joint) if joint.mimic is not None else None
        define_joint(scope, joint, links[joint.parent], links[joint.child], leader)


def filter_pairs(scopes: Scopes, scene: Scene) -> None:
    """Exclude pairs of links from contact.

    A static link is represented by its colliders, because it has no rigid body.
    """
    every_mover, every_touched = defaultdict[str, list[Prim]](list), defaultdict[str, list[Prim]](list)
    found = defaultdict[Prim, list[Prim]](list)

    def exclude(movers: Mapping[str, list[Prim]], touched: Mapping[str, list[Prim]], a: str, b: str) -> None:
        mover, other = (a, b) if a in movers else (b, a)
        if mover in touched and other in touched:
            for body in movers.get(mover, ()):
                found[body] += touched[other]

    for item in (item for each in scene.objects for item in (each, *each.variants)):
        excluded = excluded_link_pairs(item)
        if excluded or scene.no_contact:
            movers, touched = _touchable(content_prim(scopes, item), item)
            for a, b in excluded:
                exclude(movers, touched, item.qualified(a), item.qualified(b))
            for total, own in ((every_mover, movers), (every_touched, touched)):
                for name, prims in own.items():
                    total[name] += prims
    for a, b in scene.no_contact:
        exclude(every_mover, every_touched, a, b)
    for body, prims in found.items():
        body.schemas += ["PhysicsFilteredPairsAPI"]
        body.relate("physics:filteredPairs", dict.fromkeys(prim.path for prim in prims))


def content_prim(scopes: Scopes, item: SceneObject) -> Prim:
    """Return the prim that contains an object's links, which is the prim of the object or of its variant."""
    prim = scopes.objects.children[item.name]
    return prim.variants[item.variant] if item.variant else prim


def _touchable(parent: Prim, item: SceneObject) -> tuple[dict[str, list[Prim]], dict[str, list[Prim]]]:
    """Return the rigid bodies of an object, and the collision prims of each link, keyed by qualified name."""
    bodies: dict[str, list[Prim]] = {}
    touched_by_link: dict[str, list[Prim]] = {}
    for tree in trees(item):
        for link in tree.links:
            prim, name = parent.children[link.name], item.qualified(link.name)
            if not is_static(tree):
                bodies[name] = [prim]
            if link.colliders:
                touched_by_link[name] = [*prim.children["Colliders"].children.values()] if is_static(tree) else [prim]
    return bodies, touched_by_link


def _define_link(scopes: Scopes, body: Prim, link: Link) -> None:
    moments, axes = link.principal
    # Static links also get these attributes, so that no data is lost, but not the schema, which requires a rigid body.
    # Readers may ignore such attributes.
    body.attribute("physics:centerOfMass", "point3f", vec3(link.com.tolist()))
    body.attribute("physics:diagonalInertia", "float3", vec3(moments.tolist()))
    body.floats(link.mass, "physics:mass")
    if link.gravity_compensation:
        body.attribute("mjc:gravcomp", "double", rounded(link.gravity_compensation), uniform=True)
    if link.gravity_compensation == 1.0:
        body.schemas += ["PhysxRigidBodyAPI"]
        body.attribute("physxRigidBody:disableGravity", "bool", True)
    body.attribute("physics:principalAxes", "quatf", quat(axes.tolist()))
    if link.visuals:
        parent = body.define("Visuals", "Scope")
        for visual in link.visuals:
            define_visual(parent, scopes.looks, visual)
    if link.colliders:
        parent = body.define("Colliders", "Scope")
    for collider in link.colliders:
        convex = isinstance(collider.geometry, Mesh)
        schemas = ["PhysicsCollisionAPI", "MaterialBindingAPI", *(["PhysicsMeshCollisionAPI"] if convex else [])]
        prim = define_geometry(parent, collider.name, collider.geometry, collider.X_LG, schemas)
        if convex:
            prim.attribute("physics:approximation", "token", "convexHull", uniform=True)
        prim.attribute("purpose", "token", "guide", uniform=True)
        prim.relate("material:binding:physics", [contact_material(scopes.contacts, collider)])


_TYPE = {
    JointType.FIXED: "PhysicsFixedJoint",
    JointType.REVOLUTE: "PhysicsRevoluteJoint",
    JointType.CONTINUOUS: "PhysicsRevoluteJoint",
    JointType.PRISMATIC: "PhysicsPrismaticJoint",
    JointType.BALL: "PhysicsSphericalJoint",
}

# The instance name of PhysX's mimic joint schema, which single-axis joints use for any axis.
_MIMIC = "rotX"
_LIMIT = (0.02, 1.0)
# MuJoCo's constraint parameters for joint limits and Coulomb friction, as in our MJCF. With the defaults of Newton's
# MuJoCo solver, a load of 10 N rests 20 mm below its stop, and a joint held by friction creeps at 10 mm/s.
_FRICTION = (0.999, 0.999, 0.001, 0.5, 2.0)


def define_anchor(scope: Prim, carrier: Prim, root: Prim) -> Prim:
    """Weld the root link of a fixed object to the world relative to the object's prim.

    Moving the prim therefore moves both the object and its anchor. The joint's name starts with a capital letter,
    unlike joint names in a scene.
    """
    prim = scope.define("Anchor", "PhysicsFixedJoint")
    _frames(prim, carrier, root, Pose.of(), Pose.of())
    return prim


def define_joint(scope: Prim, joint: Joint, parent: Prim, child: Prim, leader: Joint | None) -> None:
    """Define ``joint`` between the ``parent`` and ``child`` links. If ``leader`` is given, the joint follows it.

    In UsdPhysics, angles are in degrees and joints rotate about a coordinate axis of the joint frames. Both frames are
    therefore rotated so that the coordinate axis closest to the scene's joint axis coincides with it.
    """
    prim = scope.define(joint.name, _TYPE[joint.type])
    if not joint.has_axis:
        _frames(prim, parent, child, joint.X_PC, Pose.of())
        if joint.type is JointType.BALL and (joint.damping or joint.friction or joint.armature):
            _ball(prim, joint)
        return
    token, X_CJ = joint_frame(joint.axis)
    _frames(prim, parent, child, joint.X_PC @ X_CJ, X_CJ)
    prim.attribute("physics:axis", "token", token, uniform=True)
    prim.attribute("simfoundry:type", "token", joint.type.value, uniform=True)
    unit = 1.0 if joint.type is JointType.PRISMATIC else math.degrees(1.0)
    if joint.limits is not None and joint.type is not JointType.CONTINUOUS:
        lower, upper = joint.limits
        prim.floats(lower * unit, "physics:lowerLimit")
        prim.floats(upper * unit, "physics:upperLimit")
        prim.attribute("mjc:solreflimit", "double[]", list(_LIMIT), uniform=True)
    if joint.closed is not None:
        prim.attribute("simfoundry:closed", "token", joint.closed, uniform=True)
    _dynamics(prim, joint, unit)
    if joint.mimic is not None and leader is not None:
        _follow(prim, scope, joint.mimic, unit, 1.0 if leader.type is JointType.PRISMATIC else math.degrees(1.0))


def _ball(prim: Prim, joint: Joint) -> None:
    """Add a ball joint's damping, friction and armature about each axis for Newton, and its armature for PhysX."""
    prim.schemas += ["PhysxJointAPI", "NewtonJointAPI"]
    prim.floats(joint.armature, "newton:armature", "physxJoint:armature")
    prim.floats(joint.damping / math.degrees(1.0), "newton:damping")
    prim.floats(joint.friction, "newton:friction")


def _follow(prim: Prim, scope: Prim, mimic: Mimic, unit: float, unit_of_leader: float) -> None:
    """Make a joint follow another joint in Newton and PhysX.

    Newton uses the same equation as the scene, whereas PhysX moves all terms to one side. PhysX can soften the
    constraint with a natural frequency; zero makes the gear rigid.
    """
    physx, leader = f"physxMimicJoint:{_MIMIC}", f"{scope.path}/{mimic.joint}"
    multiplier, offset = mimic.multiplier * unit / unit_of_leader, mimic.offset * unit
    prim.schemas += [f"PhysxMimicJointAPI:{_MIMIC}", "NewtonMimicAPI"]
    prim.floats(offset, "newton:mimicCoef0")
    prim.floats(multiplier, "newton:mimicCoef1")
    prim.relate("newton:mimicJoint", [leader])
    prim.floats(-multiplier, f"{physx}:gearing")
    prim.floats(-offset, f"{physx}:offset")
    prim.floats(0.0, f"{physx}:dampingRatio", f"{physx}:naturalFrequency")
    prim.relate(f"{physx}:referenceJoint", [leader])
    prim.attribute(f"{physx}:referenceJointAxis", "token", _MIMIC, uniform=True)


def joint_frame(axis: Array) -> tuple[str, Pose]:
    """Return the coordinate axis (``X``, ``Y`` or ``Z``) closest to ``axis``, and the rotation from it to ``axis``."""
    k = int(np.argmax(np.abs(axis)))
    unit = np.eye(3)[k]
    cosine = float(unit @ axis)
    if cosine < 0:  # first rotate by 180 degrees about the next axis, which leaves less than 90 degrees
        half = np.concatenate([[0.0], np.eye(3)[(k + 1) % 3]])
        flipped = Pose.of(q=half)
        _, rest = joint_frame(flipped.inverse().apply(axis))
        return "XYZ"[k], flipped @ rest
    return "XYZ"[k], Pose.of(q=np.concatenate([[1.0 + cosine], np.cross(unit, axis)]))


def _frames(prim: Prim, body0: Prim, body1: Prim, X_0J: Pose, X_1J: Pose) -> None:
    prim.relate("physics:body0", [body0])
    prim.relate("physics:body1", [body1])
    for k, pose in enumerate([X_0J, X_1J]):
        prim.attribute(f"physics:localPos{k}", "point3f", vec3(pose.p))
        prim.attribute(f"physics:localRot{k}", "quatf", quat(pose.q))


def _dynamics(prim: Prim, joint: Joint, unit: float) -> None:
    """Add a joint's passive dynamics, limits of force and speed, drive and position.

    UsdPhysics supports only drives. The other values are PhysX and Newton attributes, and the limit of force is a
    MuJoCo attribute that Newton reads as well. Dampings and speeds are per degree, but torques [N m] and armatures
    [kg m^2] do not depend on the angle unit. ``unit`` is 1 for a position in meters, and the number of degrees per
    radian for an angle.
    """
    kind = "linear" if joint.type is JointType.PRISMATIC else "angular"
    motor, axis, state = f"drive:{kind}:physics", f"physxJointAxis:{kind}", f"state:{kind}:physics"
    if joint.drive is not None:
        prim.schemas += [f"PhysicsDriveAPI:{kind}"]
        prim.floats(joint.drive.damping / unit, f"{motor}:damping")
        prim.floats(joint.drive.stiffness / unit, f"{motor}:stiffness")
        prim.attribute(f"{motor}:type", "token", "force", uniform=True)
        prim.floats(joint.drive.target * unit, f"{motor}:targetPosition")
        if joint.drive.force_limit is not None:
            prim.floats(joint.drive.force_limit, f"{motor}:maxForce")
    if joint.damping or joint.friction or joint.armature or joint.velocity:
        prim.schemas += ["PhysxJointAPI", f"PhysxJointAxisAPI:{kind}", "NewtonJointAPI"]
        prim.floats(joint.armature, "newton:armature", "physxJoint:armature", f"{axis}:armature")
        prim.floats(joint.damping / unit, "newton:damping", f"{axis}:viscousFrictionCoefficient")
        prim.floats(joint.friction, "newton:friction", f"{axis}:dynamicFrictionEffort", f"{axis}:staticFrictionEffort")
    if joint.velocity is not None:
        most = joint.velocity * unit
        prim.floats(most, "newton:velocityLimit", "physxJoint:maxJointVelocity", f"{axis}:maxJointVelocity")
    if joint.effort is not None:
        prim.attribute("mjc:actuatorfrcrange:min", "double", rounded(-joint.effort), uniform=True)
        prim.attribute("mjc:actuatorfrcrange:max", "double", rounded(joint.effort), uniform=True)
    if joint.friction:
        prim.attribute("mjc:solimpfriction", "double[]", list(_FRICTION), uniform=True)
    prim.schemas += [f"PhysicsJointStateAPI:{kind}"]
    prim.floats(joint.position * unit, f"newton:{kind}:position", f"{state}:position")
    prim.floats(0.0, f"{state}:velocity")
