"""Read URDF files, including Bullet's `<contact>` element.

This module parses the XML itself because yourdfpy ignores `<contact>`, capsules and planes, silently repairs broken
XML, resolves entities, and does not provide line numbers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from simfoundry.assets.errors import LARGEST, MeshError
from simfoundry.frontends.draft import (
    DEFAULTS,
    BodyDraft,
    ImportOptions,
    JointDraft,
    LinkDraft,
    MeshDraft,
    ModelDraft,
    PartDraft,
    PrimitiveShape,
    Rgba,
)
from simfoundry.frontends.files import Element, FileSearch, read_xml
from simfoundry.frontends.mass_repair import repair_masses
from simfoundry.frontends.meshes import Scale, group_drafts, mesh_draft, mesh_width
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.scene.model import Mimic
from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, Round, SphereShape

# Minimum length of an axis; shorter axes have no meaningful direction.
LEAST_AXIS = 1e-9

# Tolerance for comparing elements of transforms; allows for rounding.
SAME_POSE = 1e-12

# Contact parameters in documents, by the corresponding child element of Bullet's `<contact>`.
CONTACT = {
    "lateral_friction": "friction", "restitution": "restitution", "spinning_friction": "torsional_friction",
    "rolling_friction": "rolling_friction",
}  # fmt: skip

# Supported child elements by parent element; all others are counted and reported.
_READ = {
    "robot": ("link", "joint", "material"),
    "joint": ("origin", "axis", "limit", "dynamics", "mimic", "parent", "child", "joint_properties"),
    "link": ("inertial", "visual", "collision", "contact", "joint_properties"),
    "contact": (*CONTACT, "inertia_scaling", "joint_properties"),
}


def read_urdf(path: Path, options: ImportOptions = DEFAULTS) -> ModelDraft:
    """Read a URDF file into a draft with a single body.

    Raises :class:`ImportRefusedError` with a line number if the file is invalid.
    """
    return _UrdfReader(path, options).read()


class _UrdfReader:
    """Reads a single URDF file."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        self.path, self.search = path, FileSearch(path, options.packages)
        self.root = read_xml(path, "robot")
        self.draft = ModelDraft(self.root.get("name") or path.stem, "URDF", density=options.density)
        self.left_out: Counter[str] = Counter()
        self.meshes: dict[tuple[Path, Scale], MeshDraft] = {}
        self.groups: dict[tuple[Path, Scale], list[tuple[str, MeshDraft]]] = {}
        self.widths: dict[int, float] = {}
        """Longest side [m] of each mesh, by object id."""
        self.materials: dict[str, Element] = {}
        for material in self.root.walk():
            name = material.get("name")
            if material.tag == "material" and name and material.children:
                self.materials.setdefault(name, material)

    def read(self) -> ModelDraft:
        links: dict[str, LinkDraft] = {}
        for element in self.root.all("link"):
            link = self.link(element)
            if link.name in links:
                raise element.refused(f"there is more than one link named `{link.name}`")
            links[link.name] = link
        joints: dict[str, JointDraft] = {}
        for element in self.root.all("joint"):
            joint = self.joint(element, links)
            if joint.name in joints:
                raise element.refused(f"there is more than one joint named `{joint.name}`")
            joints[joint.name] = joint
        body = BodyDraft(self.draft.name, self.root_link(links, joints.values()), links, list(joints.values()))
        self.draft.bodies.append(body)
        self.mimics(joints)
        self.count_left_out()
        repair_masses(self.draft, str(self.path))
        for what, count in sorted(self.left_out.items()):
            self.draft.inexpressible(what, f"{count} times" if count > 1 else "")
        return self.draft

    def root_link(self, links: dict[str, LinkDraft], joints: Iterable[JointDraft]) -> str:
        """Return the name of the root link; raise an error unless links and joints form a single tree."""
        if not links:
            raise self.root.refused("the robot has no links")
        children = Counter(joint.child for joint in joints)
        roots = [name for name in links if name not in children]
        several = next((name for name, count in children.items() if count > 1), None)
        if several is not None:
            raise self.root.refused(f"link `{several}` is the child of {children[several]} joints")
        if not roots:
            raise self.root.refused("the joints form a cycle: there is no root link")
        if len(roots) > 1:
            message = f"the robot has {len(roots)} root links: `{'`, `'.join(roots[:4])}`"
            raise self.root.refused(message, "connect them with fixed joints")
        reached, waiting = set(), [roots[0]]
        while waiting:
            link = waiting.pop()
            reached.add(link)
            waiting += [joint.child for joint in joints if joint.parent == link]
        lost = next((name for name in links if name not in reached), None)
        if lost is not None:
            raise self.root.refused(f"the joints form a cycle: link `{lost}` is its own ancestor")
        return roots[0]

    def link(self, element: Element) -> LinkDraft:
        link = LinkDraft(element.need("name"))
        inertial = element.first("inertial")
        if inertial is not None:
            self.inertial(link, inertial)
        contact = element.first("contact")
        if contact is not None:
            given = ((key, contact.first(tag)) for tag, key in CONTACT.items())
            link.contact = {key: max(0.0, element.number("value")) for key, element in given if element is not None}
            if "restitution" in link.contact:
                link.contact["restitution"] = min(1.0, link.contact["restitution"])
        visuals = [p for e in element.all("visual") for p in self.parts(e, "visual", link.name)]
        colliders = [p for e in element.all("collision") for p in self.parts(e, "collision", link.name)]
        link.parts = _united(visuals, colliders)
        return link

    def inertial(self, link: LinkDraft, inertial: Element) -> None:
        mass, inertia = inertial.first("mass"), inertial.first("inertia")
        if mass is None:
            return
        link.mass = mass.number("value")
        if link.mass < 0:
            raise mass.refused(f"link `{link.name}` has an invalid mass of {link.mass:g} kg")
        X_LG = _origin(inertial)
        link.com = X_LG.p.copy()
        if inertia is not None:
            names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            xx, yy, zz, xy, xz, yz = (inertia.number(name, 0.0) for name in names)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            link.inertia = X_LG.rotation @ tensor @ X_LG.rotation.T

    def parts(self, element: Element, use: str, link: str) -> Iterator[PartDraft]:
        """Yield the parts of a `<visual>` or `<collision>` element: one, or one per group of an OBJ mesh."""
        geometry = element.first("geometry")
        shape = next(iter(geometry.children), None) if geometry is not None else None
        if shape is None:
            raise element.refused(f"a `<{element.tag}>` of link `{link}` has no geometry")
        X_LG = _origin(element)
        groups = self.mesh_groups(shape, link) if use == "collision" and shape.tag == "mesh" else []
        if groups:
            yield from (PartDraft(element.get("name") or name, mesh, use, X_LG) for name, mesh in groups)
            return
        found = self.geometry(shape, use, link)
        if found is None:
            return
        drafted, X_GS = found
        if use == "visual" and isinstance(drafted, MeshDraft) and self.width(drafted) > LARGEST:
            self.draft.dropped(f"visual mesh of `{link}`", f"it is larger than {LARGEST:g} m")
            return
        color = self.color(element.first("material")) if use == "visual" else None
        yield PartDraft(element.get("name") or use, drafted, use, X_LG @ X_GS, color)

    def geometry(self, shape: Element, use: str, link: str) -> tuple[PrimitiveShape | MeshDraft, Pose] | None:
        """Return a shape and its pose relative to its element, or record the shape and return None if unsupported."""
        match shape.tag:
            case "box":
                x, y, z = shape.numbers("size", 3)
                if min(x, y, z) > 0:
                    return BoxShape(box=(x, y, z)), Pose.of()
            case "sphere":
                radius = shape.number("radius")
                if radius > 0:
                    return SphereShape(sphere=radius), Pose.of()
            case "cylinder" | "capsule":
                radius, length = shape.number("radius"), shape.number("length")
                if radius > 0 and length > 0:
                    size = Round(radius=radius, height=length)
                    is_cylinder = shape.tag == "cylinder"
                    return (CylinderShape(cylinder=size) if is_cylinder else CapsuleShape(capsule=size)), Pose.of()
            case "mesh":
                return self.mesh(shape), Pose.of()
            case "plane":
                normal = np.array(shape.numbers("normal", 3, (0.0, 0.0, 1.0)))
                box, X_PB = self.draft.plane(f"plane of `{link}`")
                return box, _upright(normal) @ X_PB
            case _:
                self.draft.dropped(f"{use} `{shape.tag}` of `{link}`", "the scene language does not support this shape")
                return None
        if any(float(w) < 0 for text in shape.attributes.values() for w in text.split()):
            raise shape.refused(f"a `<{shape.tag}>` of link `{link}` has a negative size")
        self.draft.dropped(f"{use} `{shape.tag}` of `{link}`", "its size is zero")
        return None

    def mesh_groups(self, shape: Element, link: str) -> list[tuple[str, MeshDraft]]:
        """Return the name and mesh of each OBJ group, each of which collides as its own hull; empty without groups."""
        key = self.file_and_scale(shape)
        if key not in self.groups:
            try:
                self.groups[key] = group_drafts(*key)
            except MeshError as error:
                raise shape.refused(str(error), error.hint) from None
        groups = self.groups[key]
        if groups:
            why = "each OBJ group collides as its own convex hull, as in PyBullet; MuJoCo uses a single hull"
            self.draft.changed(f"collision mesh of `{link}`", why, f"{len(groups)} groups of {key[0].name}")
        return groups

    def mesh(self, shape: Element) -> MeshDraft:
        key = self.file_and_scale(shape)
        if key not in self.meshes:
            try:
                self.meshes[key] = mesh_draft(*key, self.search)
            except MeshError as error:
                raise shape.refused(str(error), error.hint) from None
        return self.meshes[key]

    def file_and_scale(self, shape: Element) -> tuple[Path, Scale]:
        text = shape.get("scale")
        count = 1 if text is not None and len(text.split()) == 1 else 3
        x, y, z = (shape.numbers("scale", count, (1.0, 1.0, 1.0)[:count]) * 3)[:3]
        return self.search.need(shape.need("filename"), self.path, shape.line), (x, y, z)

    def width(self, mesh: MeshDraft) -> float:
        if id(mesh) not in self.widths:
            self.widths[id(mesh)] = mesh_width(mesh)
        return self.widths[id(mesh)]

    def color(self, material: Element | None) -> Rgba | None:
        if material is None:
            return None
        defined = material if material.children else self.materials.get(material.get("name") or "", material)
        if defined.first("texture") is not None:
            self.left_out["texture that the URDF assigns to a shape or mesh"] += 1
        color = defined.first("color")
        if color is None:
            return None
        r, g, b, a = (min(max(v, 0.0), 1.0) for v in color.numbers("rgba", 4))
        return r, g, b, a

    def joint(self, element: Element, links: dict[str, LinkDraft]) -> JointDraft:
        name, kind, ends = element.need("name"), element.need("type"), []
        for tag in ("parent", "child"):
            end = element.first(tag)
            if end is None:
                raise element.refused(f"joint `{name}` has no `<{tag}>`")
            if end.need("link") not in links:
                raise end.refused(f"joint `{name}` refers to link `{end.need('link')}`, which does not exist")
            ends.append(end.need("link"))
        joint = JointDraft(name, kind, ends[0], ends[1], _origin(element))
        axis, x_axis = element.first("axis"), (1.0, 0.0, 0.0)
        joint.axis = np.array(axis.numbers("xyz", 3, x_axis) if axis is not None else x_axis)
        dynamics = element.first("dynamics")
        if dynamics is not None:
            joint.damping = max(0.0, dynamics.number("damping", 0.0))
            joint.friction = max(0.0, dynamics.number("friction", 0.0))
        self.set_type_and_limits(joint, element)
        turns_or_slides = joint.type in ("revolute", "continuous", "prismatic")
        if turns_or_slides and float(np.linalg.norm(joint.axis)) < LEAST_AXIS:
            raise element.refused(f"the axis of joint `{name}` is zero")
        return joint

    def set_type_and_limits(self, joint: JointDraft, element: Element) -> None:
        """Set the type and the limits of a joint as in documents."""
        what, limit = f"joint `{joint.name}`", element.first("limit")
        bounds, is_stated = None, False
        if limit is not None:
            bounds = (limit.number("lower", 0.0), limit.number("upper", 0.0))
            is_stated = bool(limit.get("lower") or limit.get("upper"))
            for name in ("effort", "velocity"):
                if limit.get(name) and limit.number(name):
                    self.left_out[f"{name} limit of a joint"] += 1
        match joint.type:
            case "fixed":
                pass
            case "continuous":
                if bounds is not None and bounds != (0.0, 0.0):
                    self.draft.dropped(f"limits of {what}", "continuous joints have no limits in URDF")
            case "revolute" | "prismatic" if bounds is not None and bounds[0] < bounds[1]:
                joint.limits = bounds
            case "revolute" | "prismatic" if bounds is not None and bounds[0] == bounds[1] != 0.0:
                _lock(joint, bounds[0])
                self.draft.changed(what, f"both limits are {bounds[0]:g}, so it is fixed at that position")
            case "revolute" | "prismatic" if bounds is not None and bounds[0] == bounds[1] and is_stated:
                joint.type = "fixed"
                self.draft.changed(what, "both limits are 0, so it is fixed")
            case "revolute":
                joint.type = "continuous"
                self.draft.changed(what, "it has no limits, so it becomes a continuous joint")
            case "prismatic":
                joint.limits = self.draft.unlimited_slide(what)
            case "spherical":
                joint.type = "ball"
            case "floating":
                joint.type = "free"
            case "planar":
                joint.type = "fixed"
                self.draft.dropped(
                    f"motion of {what}", "planar joints are not supported, so the joint became a fixed joint"
                )
            case _:
                raise element.refused(f"{what} has the type `{joint.type}`, which is not a URDF joint type")

    def mimics(self, joints: dict[str, JointDraft]) -> None:
        for element in self.root.all("joint"):
            mimic, joint = element.first("mimic"), joints[element.need("name")]
            if mimic is None or joint.type == "fixed":
                continue
            leader = mimic.need("joint")
            if leader not in joints:
                raise mimic.refused(f"joint `{joint.name}` mimics `{leader}`, which does not exist")
            if leader == joint.name:
                raise mimic.refused(f"joint `{joint.name}` mimics itself")
            joint.mimic = Mimic(leader, mimic.number("multiplier", 1.0), mimic.number("offset", 0.0))

    def count_left_out(self) -> None:
        """Count the unsupported elements by tag."""
        for child in self.root.children:
            if child.tag not in _READ["robot"]:
                self.left_out[f"`<{child.tag}>`"] += 1
            for element in child.walk() if child.tag in ("link", "joint") else ():
                owner = "link" if element.tag == "contact" else element.tag
                unread = [e.tag for e in element.children if e.tag not in _READ.get(element.tag, (e.tag,))]
                self.left_out.update(f"`<{tag}>` of a {owner}" for tag in unread)


def _origin(element: Element) -> Pose:
    origin = element.first("origin")
    if origin is None:
        return Pose.of()
    roll, pitch, yaw = origin.numbers("rpy", 3, (0.0, 0.0, 0.0))
    return Pose.of(origin.numbers("xyz", 3, (0.0, 0.0, 0.0)), quat_from_rpy(roll, pitch, yaw))


def _upright(normal: Array) -> Pose:
    """Return a pose that rotates the z axis to the direction ``normal``."""
    length = float(np.linalg.norm(normal))
    z = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    across = np.array([-z[1], z[0], 0.0])
    sine = float(np.linalg.norm(across))
    if sine < SAME_POSE:
        return Pose.of() if z[2] > 0 else Pose.of(q=(0.0, 1.0, 0.0, 0.0))
    return Pose.about(across / sine, math.atan2(sine, float(z[2])))


def _lock(joint: JointDraft, position: float) -> None:
    """Convert a joint to a fixed joint at the given position."""
    axis = joint.axis / max(float(np.linalg.norm(joint.axis)), SAME_POSE)
    moved = Pose.of(axis * position) if joint.type == "prismatic" else Pose.about(axis, position)
    joint.X_PC = joint.X_PC @ moved
    joint.type = "fixed"


def _united(visuals: list[PartDraft], colliders: list[PartDraft]) -> list[PartDraft]:
    """Combine visuals and colliders; a visual and a collider with the same geometry and pose become one part."""
    left, out = list(colliders), []
    for part in visuals:
        proxy = next((p for p in left if _same_geometry(p, part)), None)
        if proxy is not None:
            left.remove(proxy)
            part.use = "both"
        out.append(part)
    return out + left


def _same_geometry(a: PartDraft, b: PartDraft) -> bool:
    same = a.geometry is b.geometry if isinstance(a.geometry, MeshDraft) else a.geometry == b.geometry
    return same and bool(np.allclose(a.X_LG.matrix, b.X_LG.matrix, rtol=0, atol=SAME_POSE))
