"""Check assets: materials, masses, meshes, joints and joint positions, and the link tree."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice, takewhile
from typing import TYPE_CHECKING

from simfoundry.spec.check.checker import Checker, Path_, volume
from simfoundry.spec.check.outliers import check_asset_outliers
from simfoundry.spec.check.plausible import check_friction, check_size, check_travel
from simfoundry.spec.files import MESH_SUFFIXES
from simfoundry.spec.models.base import WORLD, PoseSpec
from simfoundry.spec.models.scene import Degrees, Written, position

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec
    from simfoundry.spec.models.joint import JointSpec


def check_asset(c: Checker, spec: AssetSpec) -> None:
    """Check an asset."""
    for name, link in spec.links.items():
        path = ("links", name)
        c.material(link, path)
        check_friction(c, link, path)
        solid_parts = [part for part in link.parts.values() if part.use != "visual"]
        c.mass(link, [part.material or link.material for part in solid_parts], spec.materials, path)
        shapes = [part.shape for part in solid_parts]
        solid = sum(volume(shape) for shape in shapes if shape is not None)
        c.density(link, path, None if None in shapes else solid)
        for part_name, part in link.parts.items():
            part_path = (*path, "parts", part_name)
            c.file(part.mesh, (*part_path, "mesh"), MESH_SUFFIXES)
            c.material(part, part_path)
            if part.shape is not None:
                check_size(c, part.shape, (*part_path, "shape"))
    if WORLD in c.names("links"):
        c.reserved(("links", WORLD), "link")
    links = spec.links.values()
    c.unused(spec.materials, {link.material for link in links} | {p.material for k in links for p in k.parts.values()})
    c.materials(spec.materials)
    _tree(c, spec)
    places = _places(c, spec)
    _mimics(c, spec, places)
    for name, joint in spec.single_joints.items():
        check_travel(c, joint.limits, places[name])
        if joint.drive is not None and joint.drive.target is not None:
            _within(c, f"the target of `{name}`", joint, joint.drive.target, (*places[name], "drive", "target"))
    check_asset_outliers(c, spec)
    _attachments(c, spec)
    check_pairs(c, spec.no_contact, lambda link, path: c.name(link, c.names("links"), path, "link"))


# Maximum depth of the link tree, because XML readers and simulators traverse chains recursively.
MAX_CHAIN = 200


def _tree(c: Checker, spec: AssetSpec) -> None:
    """Check that every link except the first is the child of exactly one joint, and that there are no cycles."""
    parents: dict[str, str] = {}
    carriers: dict[str, str] = {}
    links = c.names("links")
    root = next(iter(links))
    for name, joint in spec.joints.items():
        path = ("joints", name, "child")
        c.name(joint.parent, links, ("joints", name, "parent"), "link")
        c.name(joint.child, links, path, "link")
        if joint.child in parents:
            c.add("SF206", path, f"`{joint.child}` is the child of two joints")
        if joint.child == root:
            message = f"`{root}` is the first link, so it is the root and cannot be the child of a joint"
            c.add("SF206", path, message)
        parents[joint.child] = joint.parent
        carriers[joint.child] = name
    for link in spec.links if c.whole else ():
        place = ("joints", carriers.get(link, ""), "parent")
        if link != root and link not in parents:
            c.add(
                "SF206", ("links", link), f"`{link}` is not the child of any joint", f"add a joint with `child: {link}`"
            )
        elif link in set(_ancestors(link, parents)):
            c.add("SF206", place, f"`{link}` is its own ancestor through a cycle of joints")
        elif sum(1 for _ in islice(_ancestors(link, parents), MAX_CHAIN)) == MAX_CHAIN:
            message = f"`{link}` is at the end of a chain of more than {MAX_CHAIN} links"
            c.add("SF206", place, message, "merge links that do not move relative to each other")
            return


def _places(c: Checker, spec: AssetSpec) -> dict[str, Path_]:
    """Return the path of each joint and of each axis, and check that no two of them have the same name."""
    places: dict[str, Path_] = {name: ("joints", name) for name in spec.joints}
    for name, joint in spec.joints.items():
        for axis in joint.axes:
            path = ("joints", name, "axes", axis)
            if axis in places:
                other = "another axis" if len(places[axis]) > 2 else "a joint"
                message = f"`{axis}` is also the name of {other}, so that its position would be ambiguous"
                c.add("SF206", path, message, "give each axis a name of its own")
            places[axis] = path
    return places


def _joint_names(c: Checker, spec: AssetSpec) -> set[str]:
    """Return the names of joints with one axis and of axes, including those of invalid joints in the text."""
    return {*spec.single_joints, *(name for name in c.names("joints") if name not in spec.joints)}


def _mimics(c: Checker, spec: AssetSpec, places: Mapping[str, Path_]) -> None:
    """Check that each mimic joint follows a joint with one axis, and that there are no cycles."""
    joints = spec.single_joints
    leaders = {name: joint.mimic.joint for name, joint in joints.items() if joint.mimic is not None}
    known = _joint_names(c, spec)
    for name, leader in leaders.items():
        path = (*places[name], "mimic", "joint")
        if not c.name(leader, known, path, "joint"):
            continue
        kind = joints[leader].type if leader in joints else ""
        if kind in ("fixed", "ball", "free"):
            c.add("SF211", path, f"`{leader}` is a {kind} joint, which has no single position to follow")
        elif name == leader:
            c.add("SF211", path, f"`{name}` follows itself", "name another joint, or remove `mimic`")
        elif name in _ancestors(name, leaders):
            between = takewhile(name.__ne__, _ancestors(name, leaders))
            cycle = " → ".join(f"`{joint}`" for joint in (name, *between, name))
            message = f"`{name}` follows itself through other joints: {cycle}"
            c.add("SF211", path, message, "remove `mimic` from one of them")


def _attachments(c: Checker, spec: AssetSpec) -> None:
    """Check that sites, actuators and sensors name existing elements."""
    for name, site in spec.sites.items():
        c.name(site.link, c.names("links"), ("sites", name, "link"), "link")
    for name, actuator in spec.actuators.items():
        path = ("actuators", name, "joint")
        kind = spec.single_joints[actuator.joint].type if actuator.joint in spec.single_joints else ""
        if c.name(actuator.joint, _joint_names(c, spec), path, "joint") and kind in ("fixed", "ball", "free"):
            c.add("SF107", path, f"`{actuator.joint}` is a {kind} joint, which has no single axis to drive")
    for name, sensor in spec.sensors.items():
        for key in ("site", "joint", "link"):
            if (target := getattr(sensor, key)) is not None:
                names = _joint_names(c, spec) if key == "joint" else c.names(f"{key}s")
                c.name(target, names, ("sensors", name, key), key)


def _ancestors(link: str, parents: dict[str, str]) -> Iterator[str]:
    seen: set[str] = set()
    while link in parents and link not in seen:
        seen.add(link)
        link = parents[link]
        yield link


def check_joints(c: Checker, asset: AssetSpec, given: Mapping[str, Written], path: Path_, resting: bool = True) -> None:
    """Check the joint positions ``given`` at ``path``.

    If ``resting`` is set, missing positions are checked as 0.
    """
    for name in given:
        c.name(name, asset.single_joints, (*path, name), "joint")
    for name, joint in asset.single_joints.items():
        if name not in given and not resting:
            continue
        place = (*path, name)
        if name in given and not _fits(c, name, joint, given[name], place):
            continue
        _within(c, f"`{name}`", joint, position(asset, name, given), place, "" if name in given else _remedy(joint))


def check_pairs(c: Checker, pairs: Sequence[tuple[str, str]], check_name: Callable[[str, Path_], object]) -> None:
    """Check that each pair in `no_contact` is unique and contains two different objects."""
    seen: set[frozenset[str]] = set()
    for k, (a, b) in enumerate(pairs):
        path: Path_ = ("no_contact", k)
        check_name(a, (*path, 0))
        check_name(b, (*path, 1))
        if a == b:
            c.add("SF212", path, f"`{a}` is paired with itself", "name two different objects")
        elif {a, b} in seen:
            c.add("SF212", path, f"the pair `{a}` and `{b}` is listed twice", "remove one of them")
        seen.add(frozenset((a, b)))


def _fits(c: Checker, name: str, joint: JointSpec, written: Written, place: Path_) -> bool:
    """Check that a position has the form that the joint type requires."""
    if joint.type == "fixed":
        c.add("SF205", place, f"`{name}` is fixed and has no position", "remove it")
    elif joint.mimic is not None:
        hint = "remove it, and specify the position of the other joint"
        c.add("SF205", place, f"`{name}` follows `{joint.mimic.joint}`, so its position cannot be set", hint)
    elif joint.type in ("ball", "free") and not isinstance(written, PoseSpec):
        hint = "specify a rotation, such as `{rpy_deg: [10, 0, 20]}`" if joint.type == "ball" else "specify a pose"
        c.add("SF103", place, f"`{name}` is a {joint.type} joint: its position cannot be a single number", hint)
    elif joint.type not in ("ball", "free") and isinstance(written, PoseSpec):
        c.add("SF103", place, f"`{name}` is a {joint.type} joint: its position is a single number, not a pose")
    elif joint.type == "ball" and isinstance(written, PoseSpec) and any(written.xyz):
        c.add("SF205", place, f"`{name}` is a ball joint and cannot be moved by `xyz`", "specify only a rotation")
    elif isinstance(written, Degrees) and joint.type == "prismatic":
        c.add("SF103", place, f"`{name}` is a prismatic joint: its position is in meters, not degrees")
    else:
        return True
    return False


def _within(c: Checker, what: str, joint: JointSpec, value: float, place: Path_, hint: str = "") -> None:
    """Check that a position [m or rad] is within the limits of a joint."""
    limits, unit = joint.limits, "m"
    if joint.limits_deg is not None:
        limits, unit, value = joint.limits_deg, "deg", math.degrees(value)
    if limits is not None and not limits[0] - 1e-9 <= value <= limits[1] + 1e-9:
        message = f"{what} at {value:g} {unit} is outside its limits, {limits[0]:g} to {limits[1]:g} {unit}"
        c.add("SF205", place, message, hint)


def _remedy(joint: JointSpec) -> str:
    if joint.mimic is not None:
        return f"it follows `{joint.mimic.joint}`: specify a different position for that joint in `joints`"
    return "specify its position in `joints`"
