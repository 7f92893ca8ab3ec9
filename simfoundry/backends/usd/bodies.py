"""Objects and links: rigid bodies with explicit mass properties, their visuals and colliders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from simfoundry.backends.usd.geometry import define_geometry
from simfoundry.backends.usd.joints import define_anchor, define_joint
from simfoundry.backends.usd.materials import contact_material, visual_material
from simfoundry.backends.usd.prims import (
    apply_schemas,
    attribute,
    define,
    place,
    quatf,
    relate,
    rounded,
    settled,
    vec3f,
)
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, JointType, Link, Mesh, Scene, SceneObject, principal_inertia
from simfoundry.scene.touching import silent_pairs, touching_pairs
from simfoundry.scene.trees import Tree, trees

if TYPE_CHECKING:
    from pxr import Sdf


@dataclass(frozen=True)
class Scopes:
    """Where things go in the stage: objects, and the materials they share."""

    objects: Sdf.PrimSpec
    looks: Sdf.PrimSpec
    contacts: Sdf.PrimSpec


def is_static(tree: Tree) -> bool:
    """Whether nothing of a part of an object can move: it then has colliders and no rigid bodies."""
    return tree.fixed and all(joint.type is JointType.FIXED for joint in tree.joints)


def define_object(scopes: Scopes, item: SceneObject) -> None:
    """Define ``item`` at its pose in the world, its links side by side below it at their joint positions.

    An articulation's root is the root link where it is free; where it is fixed, PhysX wants the root on a prim above
    the link and the joint that holds it, else it falls back to joints in maximal coordinates.
    """
    from pxr import Vt

    prim = define(scopes.objects, item.name, "Xform", ["SemanticsLabelsAPI:category"])
    prim.SetInfo("kind", "component")
    attribute(prim, "semantics:labels:category", "token[]", Vt.TokenArray([item.category]))
    place(prim, item.X_WO)
    X_OL = link_poses(item)
    links = {}
    for link in item.links:
        links[link.name] = body = define(prim, link.name, "Xform")
        place(body, X_OL[link.name])
        _define_link(scopes, body, link)
    moving = [tree for tree in trees(item) if not is_static(tree)]
    for tree in moving:
        for link in tree.links:
            apply_schemas(links[link.name], ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
        if tree.free_joint is not None:
            _set_free(links[tree.root.name], tree.free_joint, links[tree.free_joint.parent].path)
    joined = [tree for tree in moving if tree.joints]
    if joined:
        scope = define(prim, "Joints", "Scope")
        for tree in joined:
            _articulate(prim, scope, tree, links, alone=len(joined) == 1)


def _set_free(body: Sdf.PrimSpec, joint: Joint, parent: Sdf.Path) -> None:
    """State the free joint of a body, for which UsdPhysics has no prim: a body without a joint is free.

    ``simfoundry:freePose`` is where it is at zero in its parent, as a matrix of USD, which multiplies row vectors.
    """
    from pxr import Gf

    matrix = Gf.Matrix4d(*(settled(v) for v in joint.X_PC.matrix.T.ravel()))
    attribute(body, "simfoundry:freeJoint", "token", joint.name, uniform=True)
    attribute(body, "simfoundry:freePose", "matrix4d", matrix, uniform=True)
    relate(body, "simfoundry:freeParent", [parent])


def _articulate(
    prim: Sdf.PrimSpec, scope: Sdf.PrimSpec, tree: Tree, links: Mapping[str, Sdf.PrimSpec], alone: bool
) -> None:
    """Join the bodies of a tree. Whether any of them may touch is the articulation's to say; which, the pairs'.

    Where the object has another articulation beside a fixed one, the joint that holds the latter is its root.
    """
    root = links[tree.root.name]
    if tree.fixed:
        anchor = define_anchor(scope, prim.path, root.path)
        root = prim if alone else anchor
    names = {link.name for link in tree.links}
    touching = any(names.issuperset(pair) for pair in touching_pairs(tree.owner))
    apply_schemas(root, ["PhysicsArticulationRootAPI", "PhysxArticulationAPI", "NewtonArticulationRootAPI"])
    attribute(root, "newton:selfCollisionEnabled", "bool", touching)
    attribute(root, "physxArticulation:enabledSelfCollisions", "bool", touching)
    by_name = {joint.name: joint for joint in tree.joints}
    for joint in tree.joints:
        leader = by_name.get(joint.mimic.joint) if joint.mimic is not None else None
        define_joint(scope, joint, links[joint.parent].path, links[joint.child].path, leader)


def filter_pairs(scopes: Scopes, scene: Scene) -> None:
    """State which links do not touch. What cannot move has no body to name: its colliders stand for it."""
    bodies: dict[str, Sdf.PrimSpec] = {}
    felt: dict[str, list[Sdf.Path]] = {}
    for item in scene.objects:
        for tree in trees(item):
            for link in tree.links:
                prim = scopes.objects.nameChildren[item.name].nameChildren[link.name]
                name, static = item.qualified(link.name), is_static(tree)
                if not static:
                    bodies[name] = prim
                if link.colliders:
                    colliders = prim.path.AppendChild("Colliders")
                    felt[name] = [colliders.AppendChild(c.name) for c in link.colliders] if static else [prim.path]
    found: dict[str, list[Sdf.Path]] = {}
    own = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in silent_pairs(o)]
    for a, b in (*own, *scene.no_contact):
        mover, other = (a, b) if a in bodies else (b, a)
        if mover in bodies and mover in felt and other in felt:
            found.setdefault(mover, []).extend(felt[other])
    for name, paths in found.items():
        apply_schemas(bodies[name], ["PhysicsFilteredPairsAPI"])
        relate(bodies[name], "physics:filteredPairs", paths)


def _define_link(scopes: Scopes, body: Sdf.PrimSpec, link: Link) -> None:
    moments, axes = principal_inertia(link.inertia)
    # A static link has these too, without the schema, which is for bodies: nothing may read them, nothing is lost.
    attribute(body, "physics:centerOfMass", "point3f", vec3f(link.com))
    attribute(body, "physics:diagonalInertia", "float3", vec3f(moments))
    attribute(body, "physics:mass", "float", rounded(link.mass))
    attribute(body, "physics:principalAxes", "quatf", quatf(axes))
    if link.visuals:
        _define_visuals(scopes, define(body, "Visuals", "Scope"), link)
    if link.colliders:
        _define_colliders(scopes, define(body, "Colliders", "Scope"), link)


def _define_visuals(scopes: Scopes, parent: Sdf.PrimSpec, link: Link) -> None:
    for visual in link.visuals:
        prim = define_geometry(parent, visual.name, visual.geometry, visual.X_LG, ["MaterialBindingAPI"])
        relate(prim, "material:binding", [visual_material(scopes.looks, visual)])


def _define_colliders(scopes: Scopes, parent: Sdf.PrimSpec, link: Link) -> None:
    for collider in link.colliders:
        convex = isinstance(collider.geometry, Mesh)
        schemas = ["PhysicsCollisionAPI", "MaterialBindingAPI", *(["PhysicsMeshCollisionAPI"] if convex else [])]
        prim = define_geometry(parent, collider.name, collider.geometry, collider.X_LG, schemas)
        if convex:
            attribute(prim, "physics:approximation", "token", "convexHull", uniform=True)
        attribute(prim, "purpose", "token", "guide", uniform=True)
        relate(prim, "material:binding:physics", [contact_material(scopes.contacts, collider)])
