"""Objects and links: rigid bodies with explicit mass properties, their visuals and colliders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from simfoundry.backends.usd.geometry import define_geometry
from simfoundry.backends.usd.joints import define_anchor, define_joint
from simfoundry.backends.usd.materials import contact_material, visual_material
from simfoundry.backends.usd.prims import apply_schemas, attribute, define, place, quatf, relate, rounded, vec3f
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType, Link, Mesh, SceneObject, principal_inertia

if TYPE_CHECKING:
    from pxr import Sdf


VARIANTS = "variant"
"""The variant set of an object."""

DEFAULT = "default"
"""The variant that is the object as its document writes it."""


@dataclass(frozen=True)
class Scopes:
    """Where things go in the stage: objects, and the materials they share."""

    objects: Sdf.PrimSpec
    looks: Sdf.PrimSpec
    contacts: Sdf.PrimSpec


def is_static(item: SceneObject) -> bool:
    """Whether nothing of ``item`` can move: it then has colliders and no rigid bodies."""
    return item.fixed and all(joint.type is JointType.FIXED for joint in item.joints)


def define_object(scopes: Scopes, item: SceneObject) -> None:
    """Define ``item`` at its pose in the world, its links side by side below it at their joint positions.

    An articulation's root is the root link where it is free; where it is fixed, PhysX wants the root on a prim above
    the link and the joint that holds it, else it falls back to joints in maximal coordinates. Where it has variants,
    each holds all of it, in the variant set ``variant``. Labels are of the taxonomy ``class``, which Isaac Sim reads.
    """
    prim = define(scopes.objects, item.name, "Xform")
    prim.SetInfo("kind", "component")
    if not item.variants:
        _fill_object(scopes, prim, item)
        return
    from pxr import Sdf

    every = sorted((item, *item.variants), key=lambda one: one.variant != DEFAULT)
    prim.variantSetNameList.prependedItems = [VARIANTS]
    prim.variantSelections[VARIANTS] = item.variant
    choices = Sdf.VariantSetSpec(prim, VARIANTS)
    for one in every:
        _fill_object(scopes, Sdf.VariantSpec(choices, one.variant).primSpec, one)


def _fill_object(scopes: Scopes, prim: Sdf.PrimSpec, item: SceneObject) -> None:
    """What an object, or one variant of it, consists of."""
    from pxr import Vt

    apply_schemas(prim, ["SemanticsLabelsAPI:category", "SemanticsLabelsAPI:class"])
    attribute(prim, "semantics:labels:category", "token[]", Vt.TokenArray([item.category]))
    attribute(prim, "semantics:labels:class", "token[]", Vt.TokenArray(item.semantics))
    place(prim, item.X_WO)
    X_OL = link_poses(item)
    links = {}
    for link in item.links:
        links[link.name] = body = define(prim, link.name, "Xform")
        place(body, X_OL[link.name])
        _define_link(scopes, body, link)
    if is_static(item):
        return
    for body in links.values():
        apply_schemas(body, ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
    if item.joints:
        _articulate(prim, item, links)


def _articulate(prim: Sdf.PrimSpec, item: SceneObject, links: Mapping[str, Sdf.PrimSpec]) -> None:
    """Join the bodies of ``item``, which do not touch each other: they overlap at their joints by construction.

    PhysX and Newton read that from the articulation, other readers from the pairs.
    """
    root = prim if item.fixed else links[item.root.name]
    apply_schemas(root, ["PhysicsArticulationRootAPI", "PhysxArticulationAPI", "NewtonArticulationRootAPI"])
    attribute(root, "newton:selfCollisionEnabled", "bool", False)
    attribute(root, "physxArticulation:enabledSelfCollisions", "bool", False)
    bodies = list(links.values())
    for k, body in enumerate(bodies[:-1]):
        apply_schemas(body, ["PhysicsFilteredPairsAPI"])
        relate(body, "physics:filteredPairs", [other.path for other in bodies[k + 1 :]])
    scope = define(prim, "Joints", "Scope")
    if item.fixed:
        define_anchor(scope, prim.path, links[item.root.name].path)
    for joint in item.joints:
        define_joint(scope, joint, links[joint.parent].path, links[joint.child].path)


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
