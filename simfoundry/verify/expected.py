"""The read-back that an engine should return for a scene, derived from the lowered scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from simfoundry.backends.urdf.elements import capsule_parts
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from simfoundry.scene.kinematics import excluded_link_pairs, link_poses
from simfoundry.scene.model import Collider, Joint, JointType, Link, Scene, SceneObject, pair_friction
from simfoundry.verify.readback import (
    FREE,
    WORLD,
    ColliderReadback,
    JointReadback,
    LinkReadback,
    WorldReadback,
    mesh_bounds,
    numbers,
    pair_name,
    pose_numbers,
    shape_bounds,
)

SPLIT_CAPSULES = ("urdf",)
"""Targets that write a capsule as a cylinder and two spheres, which have the same shape."""

_NO_JOINT = (JointType.FIXED, JointType.FREE)
"""Joint types that are not reported; a free joint appears in the parent and pose of its link."""


def expected_readback(scene: Scene, target: str) -> WorldReadback:
    """Return the read-back of ``scene`` as written by ``target``, with all pairs of colliders whose surfaces differ."""
    links: dict[str, LinkReadback] = {}
    joints: dict[str, JointReadback] = {}
    for item in scene.objects:
        X_OL = link_poses(item)
        for link in item.links:
            X_WL = item.X_WO @ X_OL[link.name]
            links[item.qualified(link.name)] = _link(X_WL, link, _held_by(item, link), target)
        joints |= {f"{item.name}.{j.name}": _joint(item, j) for j in item.joints if j.type not in _NO_JOINT}
    return WorldReadback(links, joints, numbers(scene.gravity), dict(_pairs(scene)), tuple(_silent(scene)))


def static_links(scene: Scene) -> set[str]:
    """Return the qualified names of links that can never move; their mass has no effect."""
    found: set[str] = set()
    for item in scene.objects:
        held = _held(item)
        found |= {item.qualified(link) for link in held}
    return found


def _held(item: SceneObject) -> set[str]:
    held = {item.root.name} if item.fixed else set()
    for link in item.links:  # parents come before their children
        joint = item.joint_above.get(link.name)
        if joint is not None and joint.type is JointType.FIXED and joint.parent in held:
            held.add(link.name)
    return held


def _held_by(item: SceneObject, link: Link) -> str:
    joint = next((j for j in item.joints if j.child == link.name), None)
    if joint is None:
        return WORLD if item.fixed else FREE
    return FREE if joint.type is JointType.FREE else item.qualified(joint.parent)


def _link(X_WL: Pose, link: Link, held: str, target: str) -> LinkReadback:
    colliders = tuple(part for collider in link.colliders for part in _collider(collider, target))
    return LinkReadback(pose_numbers(X_WL), link.mass, numbers(link.com), numbers(link.inertia), held, colliders)


def _collider(collider: Collider, target: str) -> Iterator[ColliderReadback]:
    whole = [("", collider.geometry, Pose.of())]
    for suffix, geometry, X_GP in capsule_parts(collider.geometry) if target in SPLIT_CAPSULES else whole:
        kind, bounds = _shape(geometry, collider.X_LG @ X_GP)
        yield ColliderReadback(
            collider.name + suffix, kind, bounds, collider.friction, collider.restitution,
            collider.torsional_friction, collider.rolling_friction,
        )  # fmt: skip


def _shape(geometry: Geometry, X_LG: Pose) -> tuple[str, tuple[float, ...]]:
    match geometry:
        case Box(size=size):
            return "box", shape_bounds("box", size.tolist(), X_LG)
        case Sphere(radius=radius):
            return "sphere", shape_bounds("sphere", [radius], X_LG)
        case Cylinder(radius=radius, height=height):
            return "cylinder", shape_bounds("cylinder", [radius, height], X_LG)
        case Capsule(radius=radius, height=height):
            return "capsule", shape_bounds("capsule", [radius, height], X_LG)
        case Mesh(vertices=vertices):
            return "mesh", mesh_bounds(vertices, X_LG)


def _joint(item: SceneObject, joint: Joint) -> JointReadback:
    limited = joint.limits is not None and joint.type is not JointType.CONTINUOUS
    mimic, drive = joint.mimic, joint.drive
    return JointReadback(
        type="revolute" if joint.type is JointType.CONTINUOUS else joint.type.value,
        axis=numbers(joint.axis / np.linalg.norm(joint.axis)) if joint.has_axis else None,
        limits=numbers(joint.limits) if limited else (),
        damping=joint.damping,
        friction=joint.friction,
        armature=joint.armature,
        position=joint.position if joint.has_axis else numbers(joint.motion.q),
        follows=f"{item.name}.{mimic.joint}" if mimic is not None else "",
        law=(mimic.multiplier, mimic.offset) if mimic is not None else (),
        drive=(drive.stiffness, drive.damping, drive.target) if drive is not None else (),
        effort=() if drive is None or drive.force_limit is None else (drive.force_limit,),
    )


def _silent(scene: Scene) -> Iterator[str]:
    """Yield pairs of links whose collisions are disabled: those listed in the spec, and neighboring links."""
    static = static_links(scene)
    felt = {o.qualified(k.name) for o in scene.objects for k in o.links if k.colliders}
    pairs = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in excluded_link_pairs(o)]
    for a, b in (*pairs, *scene.no_contact):
        if felt >= {a, b} and not static >= {a, b}:
            yield pair_name(a, b)


def _pairs(scene: Scene) -> Iterator[tuple[str, float]]:
    """Yield pairs of colliders of different objects that can meet and whose frictions differ, with their friction."""
    unheard = {frozenset(pair) for pair in scene.no_contact}
    by_friction: dict[float, list[tuple[str, str, bool]]] = {}
    for item in scene.objects:
        held = _held(item)
        for link in item.links:
            for collider in link.colliders:
                entry = (f"{item.qualified(link.name)}.{collider.name}", item.name, link.name in held)
                by_friction.setdefault(collider.friction, []).append(entry)
    for (mu_a, ours), (mu_b, theirs) in combinations(by_friction.items(), 2):
        mu = pair_friction(mu_a, mu_b)
        for (a, owner_a, held_a), (b, owner_b, held_b) in product(ours, theirs):
            silent = unheard and frozenset((a.rpartition(".")[0], b.rpartition(".")[0])) in unheard
            if owner_a != owner_b and not (held_a and held_b) and not silent and not math.isnan(mu):
                yield pair_name(a, b), mu
