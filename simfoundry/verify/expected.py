"""What an engine should say of a scene: the same facts, taken from the lowered scene itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from simfoundry.backends.urdf import capsule_parts
from simfoundry.scene.frames import Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import (
    Box,
    Capsule,
    Collider,
    Cylinder,
    Geometry,
    Joint,
    JointType,
    Link,
    Mesh,
    Scene,
    SceneObject,
    Sphere,
    pair_friction,
)
from simfoundry.verify.facts import (
    ColliderFacts,
    Facts,
    JointFacts,
    LinkFacts,
    mesh_bounds,
    numbers,
    pose_numbers,
    shape_bounds,
)

SPLIT_CAPSULES = ("urdf",)
"""Targets that write a capsule as a cylinder and two spheres, the same solid."""


def expected_facts(scene: Scene, target: str) -> Facts:
    """The facts of ``scene`` as ``target`` writes them, with every pair of colliders whose surfaces differ."""
    links: dict[str, LinkFacts] = {}
    joints: dict[str, JointFacts] = {}
    for item in scene.objects:
        X_OL = link_poses(item)
        for link in item.links:
            links[item.qualified(link.name)] = _link(item.X_WO @ X_OL[link.name], link, target)
        joints |= {f"{item.name}.{j.name}": _joint(j) for j in item.joints if j.type is not JointType.FIXED}
    return Facts(links, joints, numbers(scene.gravity), dict(_pairs(scene)))


def static_links(scene: Scene) -> set[str]:
    """Links that can never move, by qualified name: nothing that happens depends on their mass."""
    found: set[str] = set()
    for item in scene.objects:
        held = _held(item)
        found |= {item.qualified(link) for link in held}
    return found


def _held(item: SceneObject) -> set[str]:
    held = {item.root.name} if item.fixed else set()
    by_child = {joint.child: joint for joint in item.joints}
    for link in item.links:  # parents come before their children
        joint = by_child.get(link.name)
        if joint is not None and joint.type is JointType.FIXED and joint.parent in held:
            held.add(link.name)
    return held


def _link(X_WL: Pose, link: Link, target: str) -> LinkFacts:
    colliders = tuple(part for collider in link.colliders for part in _collider(collider, target))
    return LinkFacts(pose_numbers(X_WL), link.mass, numbers(link.com), numbers(link.inertia), colliders)


def _collider(collider: Collider, target: str) -> Iterator[ColliderFacts]:
    whole = [("", collider.geometry, Pose.of())]
    for suffix, geometry, X_GP in capsule_parts(collider.geometry) if target in SPLIT_CAPSULES else whole:
        kind, bounds = _shape(geometry, collider.X_LG @ X_GP)
        yield ColliderFacts(collider.name + suffix, kind, bounds, collider.friction, collider.restitution)


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


def _joint(joint: Joint) -> JointFacts:
    limited = joint.limits is not None and joint.type is not JointType.CONTINUOUS
    return JointFacts(
        type="revolute" if joint.type is JointType.CONTINUOUS else joint.type.value,
        axis=numbers(joint.axis / np.linalg.norm(joint.axis)),
        limits=numbers(joint.limits) if limited else (),
        damping=joint.damping,
        friction=joint.friction,
        armature=joint.armature,
        position=joint.position,
    )


def _pairs(scene: Scene) -> Iterator[tuple[str, float]]:
    """Pairs of colliders of different objects that can meet and whose frictions differ, with their friction."""
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
            if owner_a != owner_b and not (held_a and held_b) and not math.isnan(mu):
                yield "|".join(sorted((a, b))), mu
