"""Objects and links: rigid bodies with explicit mass properties, visuals and colliders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simfoundry.backends.artifact import rounded
from simfoundry.backends.usd.geometry import define_geometry
from simfoundry.backends.usd.joints import define_anchor, define_joint
from simfoundry.backends.usd.materials import contact_material, visual_material
from simfoundry.backends.usd.prims import (
    Prim,
    apply_schemas,
    attribute,
    define,
    place,
    quat,
    relate,
    settled,
    vec3,
)
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.kinematics import Tree, contact_pairs, excluded_link_pairs, link_poses, trees
from simfoundry.scene.model import Joint, JointType, Link, Scene, SceneObject

DEFAULT = "default"
"""The name of the variant that represents the object as written in its document."""


@dataclass(frozen=True)
class Scopes:
    """The scopes of a stage for objects and shared materials."""

    objects: Prim
    looks: Prim
    contacts: Prim


def is_static(tree: Tree) -> bool:
    """Return true if no part of the tree can move; it then has colliders but no rigid bodies."""
    return tree.fixed and all(joint.type is JointType.FIXED for joint in tree.joints)


def define_object(scopes: Scopes, item: SceneObject) -> None:
    """Define ``item`` at its pose in the world, its links side by side below it at their joint positions.

    The articulation root of a free object is its root link. For a fixed object, PhysX requires it on a prim above both
    the link and the joint that fixes it; otherwise PhysX uses joints in maximal coordinates. If the object has
    variants, each variant in the variant set ``variant`` contains the complete object. Labels use the taxonomy
    ``class``, which Isaac Sim reads.
    """
    prim = define(scopes.objects, item.name, "Xform")
    prim.kind = "component"
    if not item.variants:
        _fill_object(scopes, prim, item)
        return
    prim.selected = item.variant
    for one in sorted((item, *item.variants), key=lambda one: one.variant != DEFAULT):
        _fill_object(scopes, prim.variant(one.variant), one)


def _fill_object(scopes: Scopes, prim: Prim, item: SceneObject) -> None:
    """Define the links and joints of an object or of one of its variants."""
    apply_schemas(prim, ["SemanticsLabelsAPI:category", "SemanticsLabelsAPI:class"])
    attribute(prim, "semantics:labels:category", "token[]", [item.category])
    attribute(prim, "semantics:labels:class", "token[]", list(item.semantics))
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
            _set_free(links[tree.root.name], tree.free_joint, links[tree.free_joint.parent])
    joined = [tree for tree in moving if tree.joints]
    if joined:
        scope = define(prim, "Joints", "Scope")
        for tree in joined:
            _articulate(prim, scope, tree, links, alone=len(joined) == 1)


def _set_free(body: Prim, joint: Joint, parent: Prim) -> None:
    """State the free joint of a body as attributes, because UsdPhysics has no prim for free joints.

    ``simfoundry:freePose`` is the pose at zero in the parent, as a USD matrix, which multiplies row vectors.
    """
    matrix = tuple(tuple(settled(v) for v in row) for row in joint.X_PC.matrix.T)
    attribute(body, "simfoundry:freeJoint", "token", joint.name, uniform=True)
    attribute(body, "simfoundry:freePose", "matrix4d", matrix, uniform=True)
    relate(body, "simfoundry:freeParent", [parent])


def _articulate(prim: Prim, scope: Prim, tree: Tree, links: Mapping[str, Prim], alone: bool) -> None:
    """Join the bodies of a tree. The articulation sets whether links may collide; filtered pairs set which.

    If a fixed object has another articulation beside the fixed one, the joint that fixes the latter is its root.
    """
    root = links[tree.root.name]
    if tree.fixed:
        anchor = define_anchor(scope, prim, root)
        root = prim if alone else anchor
    names = {link.name for link in tree.links}
    touching = any(names.issuperset(pair) for pair in contact_pairs(tree.owner))
    apply_schemas(root, ["PhysicsArticulationRootAPI", "PhysxArticulationAPI", "NewtonArticulationRootAPI"])
    attribute(root, "newton:selfCollisionEnabled", "bool", touching)
    attribute(root, "physxArticulation:enabledSelfCollisions", "bool", touching)
    by_name = {joint.name: joint for joint in tree.joints}
    for joint in tree.joints:
        leader = by_name.get(joint.mimic.joint) if joint.mimic is not None else None
        define_joint(scope, joint, links[joint.parent], links[joint.child], leader)


def filter_pairs(scopes: Scopes, scene: Scene) -> None:
    """Exclude pairs of links from contact. A static link has no body, so its colliders are named instead."""
    bodies: dict[str, list[Prim]] = {}
    touched_by_link: dict[str, list[Prim]] = {}
    found: dict[Prim, list[Prim]] = {}

    def exclude(movers: Mapping[str, list[Prim]], touched: Mapping[str, list[Prim]], a: str, b: str) -> None:
        mover, other = (a, b) if a in movers else (b, a)
        if mover in touched and other in touched:
            for body in movers.get(mover, ()):
                found.setdefault(body, []).extend(touched[other])

    for each in scene.objects:
        for item in (each, *each.variants):
            excluded = excluded_link_pairs(item)
            if not excluded and not scene.no_contact:
                continue
            movers, touched = _touchable(content_prim(scopes, item), item)
            for a, b in excluded:
                exclude(movers, touched, item.qualified(a), item.qualified(b))
            for name, prims in movers.items():
                bodies.setdefault(name, []).extend(prims)
            for name, prims in touched.items():
                touched_by_link.setdefault(name, []).extend(prims)
    for a, b in scene.no_contact:
        exclude(bodies, touched_by_link, a, b)
    for body, prims in found.items():
        apply_schemas(body, ["PhysicsFilteredPairsAPI"])
        relate(body, "physics:filteredPairs", dict.fromkeys(prim.path for prim in prims))


def content_prim(scopes: Scopes, item: SceneObject) -> Prim:
    """Return the prim below which the links of an object are defined: its own or that of its variant."""
    prim = scopes.objects.children[item.name]
    return prim.variants[item.variant] if item.variant else prim


def _touchable(parent: Prim, item: SceneObject) -> tuple[dict[str, list[Prim]], dict[str, list[Prim]]]:
    """Return the bodies of an object, and the collision prims of each link, by qualified name."""
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
    # Static links also get these attributes, without the schema, which requires a body; readers may ignore them, but no
    # data is lost.
    attribute(body, "physics:centerOfMass", "point3f", vec3(link.com.tolist()))
    attribute(body, "physics:diagonalInertia", "float3", vec3(moments.tolist()))
    attribute(body, "physics:mass", "float", rounded(link.mass))
    attribute(body, "physics:principalAxes", "quatf", quat(axes.tolist()))
    if link.visuals:
        _define_visuals(scopes, define(body, "Visuals", "Scope"), link)
    if link.colliders:
        _define_colliders(scopes, define(body, "Colliders", "Scope"), link)


def _define_visuals(scopes: Scopes, parent: Prim, link: Link) -> None:
    for visual in link.visuals:
        prim = define_geometry(parent, visual.name, visual.geometry, visual.X_LG, ["MaterialBindingAPI"])
        relate(prim, "material:binding", [visual_material(scopes.looks, visual)])


def _define_colliders(scopes: Scopes, parent: Prim, link: Link) -> None:
    for collider in link.colliders:
        convex = isinstance(collider.geometry, Mesh)
        schemas = ["PhysicsCollisionAPI", "MaterialBindingAPI", *(["PhysicsMeshCollisionAPI"] if convex else [])]
        prim = define_geometry(parent, collider.name, collider.geometry, collider.X_LG, schemas)
        if convex:
            attribute(prim, "physics:approximation", "token", "convexHull", uniform=True)
        attribute(prim, "purpose", "token", "guide", uniform=True)
        relate(prim, "material:binding:physics", [contact_material(scopes.contacts, collider)])
