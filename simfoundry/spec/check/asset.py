"""Check assets: materials, masses, meshes, and the tree of links and joints."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, takewhile

from simfoundry.spec.check.checker import Checker
from simfoundry.spec.check.joints import check_pair, check_target
from simfoundry.spec.check.plausible import volume
from simfoundry.spec.files import MESH_SUFFIXES
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import WORLD


def check_asset(c: Checker, spec: AssetSpec) -> None:
    """Check an asset."""
    for name, link in spec.links.items():
        path = ("links", name)
        c.material(link, path)
        solid_parts = [part for part in link.parts.values() if part.use != "visual"]
        c.mass(link, [part.material or link.material for part in solid_parts], spec.materials, path)
        shapes = [part.shape for part in solid_parts]
        solid = sum(volume(shape) for shape in shapes if shape is not None)
        c.density(link, path, None if None in shapes else solid)
        for part_name, part in link.parts.items():
            part_path = (*path, "parts", part_name)
            if part.mesh is not None:
                c.file(part.mesh, (*part_path, "mesh"), MESH_SUFFIXES)
            if part.material is not None:
                c.name(part.material, c.names("materials"), (*part_path, "material"), "material")
    if WORLD in c.names("links"):
        c.reserved(("links", WORLD), "link")
    links = spec.links.values()
    c.unused(spec.materials, {link.material for link in links} | {p.material for k in links for p in k.parts.values()})
    c.densities(spec.materials)
    _tree(c, spec)
    _mimics(c, spec)
    for name, joint in spec.joints.items():
        if joint.drive is not None and joint.drive.target is not None:
            check_target(c, name, joint, joint.drive.target, ("joints", name, "drive", "target"))
    seen: set[frozenset[str]] = set()
    for k, pair in enumerate(spec.no_contact):
        for i, end in enumerate(pair):
            c.name(end, c.names("links"), ("no_contact", k, i), "link")
        check_pair(c, pair, k, seen)


MAX_CHAIN = 200
"""Largest depth of the link tree: XML readers and simulators traverse a chain recursively."""


def _tree(c: Checker, spec: AssetSpec) -> None:
    """Check that every link except the first is the child of exactly one joint, and that there are no cycles."""
    parents: dict[str, str] = {}
    carriers: dict[str, str] = {}
    links = c.names("links")
    root = next(iter(links))
    for name, joint in spec.joints.items():
        path = ("joints", name)
        c.name(joint.parent, links, (*path, "parent"), "link")
        c.name(joint.child, links, (*path, "child"), "link")
        if joint.child in parents:
            c.add("SF206", (*path, "child"), f"`{joint.child}` is the child of two joints")
        if joint.child == root:
            c.add("SF206", (*path, "child"), f"`{root}` is the first link, so it is the root and no joint's child")
        parents[joint.child] = joint.parent
        carriers[joint.child] = name
    for link in spec.links if c.whole else ():
        if link != root and link not in parents:
            c.add("SF206", ("links", link), f"`{link}` is not the child of any joint", "add a joint with it as `child`")
        elif link in set(_ancestors(link, parents)):
            place = ("joints", carriers[link], "parent")
            c.add("SF206", place, f"`{link}` is its own ancestor through a cycle of joints")
        elif sum(1 for _ in islice(_ancestors(link, parents), MAX_CHAIN)) == MAX_CHAIN:
            message = f"`{link}` is at the end of a chain of more than {MAX_CHAIN} links"
            c.add(
                "SF206", ("joints", carriers[link], "parent"), message, "join links that do not move against each other"
            )
            return


def _mimics(c: Checker, spec: AssetSpec) -> None:
    """Check that each mimic joint follows a joint with one axis, and that there are no cycles."""
    leaders = {name: joint.mimic.joint for name, joint in spec.joints.items() if joint.mimic is not None}
    for name, leader in leaders.items():
        path = ("joints", name, "mimic", "joint")
        if not c.name(leader, c.names("joints"), path, "joint"):
            continue
        kind = spec.joints[leader].type if leader in spec.joints else ""
        if kind in ("fixed", "ball", "free"):
            c.add("SF211", path, f"`{leader}` is {kind}: it has no single position to follow")
        elif name == leader:
            c.add("SF211", path, f"`{name}` follows itself", "name another joint, or remove `mimic`")
        elif name in _ancestors(name, leaders):
            between = takewhile(name.__ne__, _ancestors(name, leaders))
            cycle = " → ".join(f"`{joint}`" for joint in (name, *between, name))
            c.add("SF211", path, f"`{name}` follows itself through others: {cycle}", "remove `mimic` from one of them")


def _ancestors(link: str, parents: dict[str, str]) -> Iterator[str]:
    seen: set[str] = set()
    while link in parents and link not in seen:
        seen.add(link)
        link = parents[link]
        yield link
