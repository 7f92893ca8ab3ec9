"""Load this world into SAPIEN.

``load()`` returns a scene and its objects by name:

    scene, objects = load()
    scene.step()

An object with joints becomes a ``PhysxArticulation``, and any other object becomes an ``Entity``. Contact materials,
gravity, armature, motors and joint friction are read from ``physics.json``, because URDF cannot represent them. PhysX
averages the friction coefficients of two surfaces. Motor targets are initially those in the scene. Change them with
``joint.set_drive_target``.
"""

from __future__ import annotations

import json
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import sapien
from sapien import physx

HERE = Path(__file__).resolve().parent

HOLD = 1e5
"""Damping [N s/m or N m s/rad] of the drive that models Coulomb friction.

Its force is limited to that of the friction.
"""

FAR = 3.4e38
"""The force limit that represents an unlimited motor [N or N m]. This is the largest value that PhysX accepts."""

TENDON = 1e5
"""Stiffness of the tendon that couples a joint to its leader [N/m or N m/rad]."""

FIRST, EVERY = 1, 0xFFFFFFFF
"""The collision category of most shapes, and the mask that matches all categories."""

SOFT = 1e3
"""Tendon stiffness for a joint whose leader is driven by a tendon as well. Stiffer chains of tendons oscillate."""


class Law(NamedTuple):
    """The position of a joint as ``multiplier`` times the position of its ``leader``, plus ``offset`` [rad or m]."""

    leader: str
    multiplier: float
    offset: float


Loaded: TypeAlias = physx.PhysxArticulation | sapien.Entity
Link: TypeAlias = tuple[str, str]
"""The name of an object and the name of one of its links."""


def load(scene: sapien.Scene | None = None, visuals: bool = False) -> tuple[sapien.Scene, dict[str, Loaded]]:
    """Load all objects into ``scene``, which is a new scene on the CPU by default.

    ``visuals`` requires a rendering device. Without one, SAPIEN's URDF reader crashes.
    """
    physics = json.loads((HERE / "physics.json").read_text(encoding="utf-8"))
    if scene is None:
        scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.physx_system.config.gravity = np.array(physics["gravity"])
    poses = json.loads((HERE / "poses.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as temporary:
        world = {}
        for group, (name, item) in enumerate(poses.items(), start=1):
            path = prepared(HERE / item["urdf"], Path(temporary), item["fixed"], visuals)
            world[name] = load_object(scene, path, item, physics["objects"].get(name), group)
            if name in physics.get("robots", {}):
                drive_robot(world[name], physics["robots"][name])
    part(world, physics.get("no_contact", []))
    return scene, world


def part(world: dict[str, Loaded], pairs: list[list[list[str]]]) -> None:
    """Disable collisions between links of different objects.

    A link is given by the names of its object and of the link.
    """
    found = kinds([((a, link_a), (b, link_b)) for (a, link_a), (b, link_b) in pairs])
    for (name, link), (kind, met) in found.items():
        for shape in link_of(world[name], link).collision_shapes:
            _, _, ignored, group = shape.collision_groups
            shape.set_collision_groups([kind, met, ignored, group])


def kinds(pairs: list[tuple[Link, Link]]) -> dict[Link, tuple[int, int]]:
    """Return a collision category and a mask for each link, such that the links of an excluded pair never match.

    Links with the same excluded links share a category, and all other links have the first category. PhysX supports
    only 32 categories, so any remaining links keep all of their collisions.
    """
    passed: dict[Link, set[Link]] = {}
    for a, b in pairs:
        passed.setdefault(a, set()).add(b)
        passed.setdefault(b, set()).add(a)
    groups = sorted({tuple(sorted(others)) for others in passed.values()})
    if (left := len(groups) - 31) > 0:
        print(f"PhysX has too few categories for {len(groups)} groups of excluded links; {left} of them still collide")
    bits = {group: 1 << k for k, group in enumerate(groups[:31], start=1)}
    own = {link: bits.get(tuple(sorted(others)), FIRST) for link, others in passed.items()}
    found = {}
    for link, others in passed.items():
        silent = {own[other] for other in others} - {FIRST} if own[link] != FIRST else set()
        found[link] = own[link], EVERY & ~sum(silent)
    return found


def link_of(thing: Loaded, name: str) -> physx.PhysxRigidBaseComponent:
    """Return the link of an object with the given name. An object without joints has only one link."""
    if isinstance(thing, physx.PhysxArticulation):
        return thing.find_link_by_name(name)
    return component_of(thing)


def drive_robot(robot: physx.PhysxArticulation, said: dict[str, Any]) -> None:
    """Set the motors and mimic joints that the file of a robot with its own URDF does not contain."""
    for name, drive in said["motors"].items():
        set_drive(robot.find_joint_by_name(name), drive)
    follow(robot, {name: Law(law["joint"], law["multiplier"], law["offset"]) for name, law in said["follow"].items()})


def prepared(urdf: Path, folder: Path, fixed: bool, visuals: bool) -> Path:
    """Copy a URDF to ``folder`` in a form that SAPIEN can read, with absolute paths to its meshes.

    Visuals are omitted unless ``visuals`` is set. The inertial element of a single fixed link is also omitted, because
    SAPIEN does not accept it for a static body.
    """
    tree = ET.parse(urdf)
    root = tree.getroot()
    unread = ([] if visuals else ["visual"]) + (["inertial"] if fixed and root.find("joint") is None else [])
    for link in root.findall("link"):
        for part in (part for kind in unread for part in link.findall(kind)):
            link.remove(part)
    for element in (*root.iter("mesh"), *root.iter("texture")):
        element.set("filename", str(urdf.parent / element.get("filename", "")))
    tree.write(folder / urdf.name)
    return folder / urdf.name


def load_object(
    scene: sapien.Scene, urdf: Path, item: dict[str, Any], physics: dict[str, Any] | None, group: int
) -> Loaded:
    """Load one object at its pose, with its materials, joint positions and collision filters.

    ``physics`` is None for a robot with its own URDF. Such a robot keeps SAPIEN's default surfaces, and its links do
    not collide with each other.
    """
    loader = scene.create_urdf_loader()
    loader.fix_root_link = item["fixed"]
    articulations, actors, _ = loader.parse(str(urdf))
    pose = sapien.Pose(item["p"], item["q_wxyz"])
    if actors:
        actors[0].set_initial_pose(pose)
        name = actors[0].name
        entity = actors[0].build_static(name) if item["fixed"] else actors[0].build(name)
        if physics is not None:
            set_surfaces(component_of(entity), physics["links"][name])
        set_masks(component_of(entity), 0, group)
        return entity
    articulations[0].set_initial_pose(pose)
    articulation = articulations[0].build(fix_root_link=item["fixed"], build_mimic_joints=False)
    if physics is not None:  # drive_robot() sets the mimic joints of a robot with its own URDF
        records = articulations[0].mimic_joint_records
        follow(articulation, {m.joint: Law(m.mimic, m.multiplier, m.offset) for m in records})
    names = {link.name for link in articulation.links}
    silent = physics["silent"] if physics is not None else combinations(sorted(names), 2)
    bits = silence(names, {frozenset(pair) for pair in silent})
    for link in articulation.links:
        if physics is not None:
            set_surfaces(link, physics["links"][link.name])
        set_masks(link, bits[link.name], group)
    for joint in articulation.active_joints:
        if physics is not None:
            set_joint(joint, physics["joints"][joint.name])
    articulation.set_qpos([item["joints"][joint.name] for joint in articulation.active_joints])
    return articulation


def follow(articulation: physx.PhysxArticulation, laws: dict[str, Law]) -> None:
    """Couple mimic joints to their leaders, and print a message for each joint that cannot be coupled."""
    for name, law in laws.items():
        direct, *around = ways(name, laws)
        if not (tie(articulation, name, direct, TENDON) or any(tie(articulation, name, way, SOFT) for way in around)):
            print(f"{articulation.root.name}: PhysX cannot couple {name} to {law.leader}; {name} moves freely")


def ways(name: str, laws: dict[str, Law]) -> Iterator[Law]:
    """Yield the law of a joint, followed by equivalent laws relative to other joints that have the same leader."""
    own = laws[name]
    yield own
    for other, law in laws.items():
        if other != name and law.leader == own.leader and law.multiplier != 0:
            ratio = own.multiplier / law.multiplier
            yield Law(other, ratio, own.offset - ratio * law.offset)


def tie(articulation: physx.PhysxArticulation, name: str, law: Law, stiffness: float) -> bool:
    """Couple a joint to another joint with a stiff tendon, or return False if PhysX cannot couple them.

    PhysX can couple a joint only to its parent joint or to a sibling. SAPIEN's own URDF reader uses the same method,
    but inverts the ratio between siblings.
    """
    joint, other = articulation.find_joint_by_name(name), articulation.find_joint_by_name(law.leader)
    above, beside = joint.parent_link == other.child_link, joint.parent_link == other.parent_link
    root, multiplier = other.parent_link, law.multiplier
    if multiplier == 0 or root is None or not (above or beside):
        return False
    if above:
        links, ratios, inverse = (
            [root, other.child_link, joint.child_link],
            [0, -multiplier, 1],
            [0, -1 / multiplier, 1],
        )
    else:
        links, ratios, inverse = (
            [root, joint.child_link, other.child_link],
            [0, 1, -multiplier],
            [0, 1, -1 / multiplier],
        )
    articulation.create_fixed_tendon(links, ratios, inverse, rest_length=law.offset, stiffness=stiffness)
    return True


def component_of(entity: sapien.Entity) -> physx.PhysxRigidBaseComponent:
    """Return the rigid body component of an entity."""
    return next(c for c in entity.components if isinstance(c, physx.PhysxRigidBaseComponent))


def silence(links: set[str], silent: set[frozenset[str]]) -> dict[str, int]:
    """Return a 32-bit mask for each link such that two links share a bit if and only if they do not collide.

    Each bit represents a maximal set of links in which no two links collide.
    """
    masks, left, bit = dict.fromkeys(links, 0), set(silent), 0
    while left:
        first = min(left, key=sorted)
        quiet = sorted(first)
        quiet += [a for a in sorted(links - first) if all(frozenset((a, b)) in silent for b in quiet)]
        quiet = [a for k, a in enumerate(quiet) if all(frozenset((a, b)) in silent for b in quiet[:k])]
        if bit == 32:
            raise RuntimeError("PhysX has too few mask bits for the excluded link pairs in this object")
        for link in quiet:
            masks[link] |= 1 << bit
        left -= {frozenset((a, b)) for a in quiet for b in quiet if a != b}
        bit += 1
    return masks


def set_surfaces(link: physx.PhysxRigidBaseComponent, surfaces: dict[str, dict[str, float]]) -> None:
    """Set the material of each collision shape."""
    if hasattr(link, "angular_damping"):  # PhysX adds angular damping by default
        link.linear_damping = link.angular_damping = 0.0
    shapes = link.collision_shapes
    if len(shapes) != len(surfaces):
        raise RuntimeError(f"{link.name}: PhysX loaded only {len(shapes)} of {len(surfaces)} collision shapes")
    for shape, surface in zip(shapes, surfaces.values(), strict=True):
        mu = surface["friction"]
        shape.physical_material = physx.PhysxMaterial(mu, mu, surface["restitution"])


def set_masks(link: physx.PhysxRigidBaseComponent, mask: int, group: int) -> None:
    """Set the mask of each collision shape within its object's group."""
    for shape in link.collision_shapes:
        first, second, ignored, _ = shape.collision_groups
        shape.set_collision_groups([first, second, ignored | mask, group])


def set_joint(joint: physx.PhysxArticulationJoint, values: dict[str, Any]) -> None:
    """Set a joint's armature, and either its motor or a drive that models the joint's Coulomb friction.

    PhysX has one drive per joint, which also models its damping, so friction is omitted if there is damping or a motor.
    """
    joint.armature = np.full(joint.dof, values["armature"], dtype=np.float32)
    joint.friction = 0.0
    if "drive" in values:
        set_drive(joint, values["drive"])
    elif values["friction"] > 0 and joint.damping == 0:
        joint.set_drive_property(0.0, HOLD, values["friction"], "force")


def set_drive(joint: physx.PhysxArticulationJoint, drive: dict[str, float]) -> None:
    """Set a motor that pulls the joint toward its target like a spring and damper, and add the joint's damping."""
    limit = drive.get("force_limit", FAR)
    joint.set_drive_property(drive["stiffness"], drive["damping"] + joint.damping, limit, "force")
    joint.set_drive_target(drive["target"])


def main() -> None:
    """Load the world and print a summary."""
    _, world = load()
    print(f"loaded {HERE / 'poses.json'}: {', '.join(world)}")


if __name__ == "__main__":
    main()
