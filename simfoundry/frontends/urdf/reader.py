"""Read URDF files, including Bullet's `<contact>` element.

This module parses the XML itself because yourdfpy ignores `<contact>`, capsules and planes, silently repairs broken
XML, resolves entities, and does not provide line numbers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from simfoundry.assets.errors import LARGEST, MeshError
from simfoundry.backends.urdf.features import UNLIMITED
from simfoundry.frontends.draft import BodyDraft, ImportOptions, JointDraft, LinkDraft, MeshDraft, ModelDraft, PartDraft
from simfoundry.frontends.files import Element, FileSearch, read_xml
from simfoundry.frontends.mass_repair import repair_masses
from simfoundry.frontends.meshes import Scale, group_drafts, mesh_draft, mesh_width
from simfoundry.frontends.shapes import PrimitiveShape, Rgba, clamped_rgba, primitive
from simfoundry.geometry.frames import IDENTITY, Array, Pose, quat_from_rpy
from simfoundry.scene.model import Mimic

# Minimum length of an axis; shorter axes have no meaningful direction.
LEAST_AXIS = 1e-9

# Tolerance for comparing elements of transforms; allows for rounding.
SAME_POSE = 1e-12

# Contact parameters in documents, by the corresponding child element of Bullet's `<contact>`.
CONTACT = {
    "lateral_friction": "friction", "restitution": "restitution", "spinning_friction": "torsional_friction",
    "rolling_friction": "rolling_friction",
}  # fmt: skip

# Attributes with the size of each primitive, and the number of values in each attribute.
_TUBE = {"radius": 1, "length": 1}
_SIZES = {"box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": _TUBE, "capsule": _TUBE}

# Supported child elements by parent element; all others are counted and reported.
_READ = {
    "robot": ("link", "joint", "material"),
    "joint": ("origin", "axis", "limit", "dynamics", "mimic", "parent", "child", "joint_properties"),
    "link": ("inertial", "visual", "collision", "contact", "joint_properties"),
    "contact": (*CONTACT, "inertia_scaling", "joint_properties"),
}


def read_urdf(path: Path, options: ImportOptions) -> ModelDraft:
    """Read a URDF file into a draft with a single body.

    Raises:
        ImportRefusedError: If the file is invalid. The error includes a line number.
    """
    return _UrdfReader(path, options).read()


Named = TypeVar("Named", LinkDraft, JointDraft)


class _UrdfReader:
    """A reader for a single URDF file."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        self.path, self.search = path, FileSearch(path, options.packages)
        self.root = read_xml(path, "robot")
        self.draft = ModelDraft(self.root.get("name") or path.stem, "URDF", density=options.density)
        self.left_out: Counter[str] = Counter()
        self.mesh_draft = cache(lambda path, scale: mesh_draft(path, scale, self.search))
        self.group_drafts, self.mesh_width = cache(group_drafts), cache(mesh_width)
        self.materials: dict[str, Element] = {}
        for material in self.root.walk():
            name = material.get("name")
            if material.tag == "material" and name and material.children:
                self.materials.setdefault(name, material)

    def named(self, tag: str, read: Callable[[Element], Named]) -> dict[str, Named]:
        """Read all elements with the given tag and return them, keyed by name."""
        found: dict[str, Named] = {}
        for element in self.root.all(tag):
            draft = read(element)
            if draft.name in found:
                raise element.refused(f"there is more than one {tag} named `{draft.name}`")
            found[draft.name] = draft
        return found

    def read(self) -> ModelDraft:
        links = self.named("link", self.link)
        joints = self.named("joint", lambda element: self.joint(element, links))
        self.mimics(joints)
        each = [
            axis
            for joint in joints.values()
            for axis in (planar_axes(joint, self.draft.unlimited_slide) if joint.type == "planar" else [joint])
        ]
        self.draft.bodies.append(BodyDraft(self.draft.name, self.root_link(links, joints.values()), links, each))
        self.count_left_out()
        repair_masses(self.draft, str(self.path))
        for what, count in sorted(self.left_out.items()):
            self.draft.inexpressible(what, f"{count} times" if count > 1 else "")
        return self.draft

    def root_link(self, links: dict[str, LinkDraft], joints: Iterable[JointDraft]) -> str:
        """Return the name of the root link.

        Raises:
            ImportRefusedError: If the links and joints do not form a single tree.
        """
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
        reached = roots[:1]
        for link in reached:  # grows while it is read
            reached += [joint.child for joint in joints if joint.parent == link]
        lost = next((name for name in links if name not in reached), None)
        if lost is not None:
            raise self.root.refused(f"the joints form a cycle: link `{lost}` is its own ancestor")
        return roots[0]

    def link(self, element: Element) -> LinkDraft:
        link = LinkDraft(element.need("name"))
        if (inertial := element.first("inertial")) is not None:
            self.inertial(link, inertial)
        if (contact := element.first("contact")) is not None:
            given = ((key, contact.first(tag)) for tag, key in CONTACT.items())
            link.contact = {key: max(0.0, element.number("value")) for key, element in given if element is not None}
            if "restitution" in link.contact:
                link.contact["restitution"] = min(1.0, link.contact["restitution"])
        uses = ("visual", "collision")
        link.parts = _united(*([p for e in element.all(use) for p in self.parts(e, use, link.name)] for use in uses))
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
            xx, yy, zz, xy, xz, yz = (inertia.number(name, 0.0) for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            link.inertia = X_LG.rotation @ tensor @ X_LG.rotation.T

    def parts(self, element: Element, use: str, link: str) -> Iterator[PartDraft]:
        """Yield the parts of a `<visual>` or `<collision>` element.

        An OBJ collision mesh with several groups has one part per group. Any other element has a single part.
        """
        geometry = element.first("geometry")
        shape = next(iter(geometry.children), None) if geometry is not None else None
        if shape is None:
            raise element.refused(f"a `<{element.tag}>` of link `{link}` has no geometry")
        X_LG = _origin(element)
        groups = self.mesh_groups(shape, link) if use == "collision" and shape.tag == "mesh" else []
        if groups:
            yield from (PartDraft(element.get("name") or name, mesh, use, X_LG) for name, mesh in groups)
            return
        drafted, X_GS = self.geometry(shape, use, link)
        if drafted is None:
            return
        if use == "visual" and isinstance(drafted, MeshDraft) and self.mesh_width(drafted) > LARGEST:
            self.draft.dropped(f"visual mesh of `{link}`", f"the mesh is larger than {LARGEST:g} m")
            return
        color = self.color(element.first("material")) if use == "visual" else None
        yield PartDraft(element.get("name") or use, drafted, use, X_LG @ X_GS, color)

    def geometry(self, shape: Element, use: str, link: str) -> tuple[PrimitiveShape | MeshDraft | None, Pose]:
        """Return a shape and its pose in the element.

        Unsupported shapes are recorded, and None is returned instead of the shape.
        """
        if shape.tag == "mesh":
            return self.mesh(shape), IDENTITY
        if shape.tag == "plane":
            normal = np.array(shape.numbers("normal", 3, (0.0, 0.0, 1.0)))
            box, X_PB = self.draft.plane(f"plane of `{link}`")
            return box, _upright(normal) @ X_PB
        what = f"{use} `{shape.tag}` of `{link}`"
        if shape.tag not in _SIZES:
            self.draft.dropped(what, "the scene language does not support this shape")
            return None, IDENTITY
        sizes = [size for name, count in _SIZES[shape.tag].items() for size in shape.numbers(name, count)]
        if min(sizes) < 0:
            raise shape.refused(f"a `<{shape.tag}>` of link `{link}` has a negative size")
        if min(sizes) == 0:
            self.draft.dropped(what, "the size is zero")
            return None, IDENTITY
        return primitive(shape.tag, *sizes), IDENTITY

    def mesh_groups(self, shape: Element, link: str) -> list[tuple[str, MeshDraft]]:
        """Return the name and mesh of each OBJ group, or an empty list if the mesh has no groups."""
        path, scale = self.file_and_scale(shape)
        groups = self.group_drafts(path, scale)
        if groups:
            why = "each OBJ group collides as its own convex hull, as in PyBullet; MuJoCo uses a single hull"
            self.draft.changed(f"collision mesh of `{link}`", why, f"{len(groups)} groups of {path.name}")
        return groups

    def mesh(self, shape: Element) -> MeshDraft:
        try:
            return self.mesh_draft(*self.file_and_scale(shape))
        except MeshError as error:
            raise shape.refused(str(error), error.hint) from None

    def file_and_scale(self, shape: Element) -> tuple[Path, Scale]:
        text = shape.get("scale")
        count = 1 if text is not None and len(text.split()) == 1 else 3
        x, y, z = (shape.numbers("scale", count, (1.0, 1.0, 1.0)[:count]) * 3)[:3]
        return self.search.need(shape.need("filename"), self.path, shape.line), (x, y, z)

    def color(self, material: Element | None) -> Rgba | None:
        if material is None:
            return None
        defined = material if material.children else self.materials.get(material.get("name") or "", material)
        if defined.first("texture") is not None:
            self.left_out["texture that the URDF assigns to a shape or mesh"] += 1
        color = defined.first("color")
        return None if color is None else clamped_rgba(color.numbers("rgba", 4))

    def joint(self, element: Element, links: dict[str, LinkDraft]) -> JointDraft:
        name, kind, ends = element.need("name"), element.need("type"), []
        for tag in ("parent", "child"):
            if (end := element.first(tag)) is None:
                raise element.refused(f"joint `{name}` has no `<{tag}>`")
            if end.need("link") not in links:
                raise end.refused(f"joint `{name}` refers to link `{end.need('link')}`, which does not exist")
            ends.append(end.need("link"))
        joint = JointDraft(name, kind, ends[0], ends[1], _origin(element))
        axis, x_axis = element.first("axis"), (1.0, 0.0, 0.0)
        joint.axis = np.array(axis.numbers("xyz", 3, x_axis) if axis is not None else x_axis)
        if (dynamics := element.first("dynamics")) is not None:
            joint.damping = max(0.0, dynamics.number("damping", 0.0))
            joint.friction = max(0.0, dynamics.number("friction", 0.0))
        self.set_type_and_limits(joint, element)
        if joint.type in ("revolute", "continuous", "prismatic") and float(np.linalg.norm(joint.axis)) < LEAST_AXIS:
            raise element.refused(f"the axis of joint `{name}` is zero")
        return joint

    def set_type_and_limits(self, joint: JointDraft, element: Element) -> None:
        """Set the type and the limits of a joint in the form that documents use."""
        what, limit = f"joint `{joint.name}`", element.first("limit")
        bounds, is_stated = None, False
        if limit is not None:
            bounds = (limit.number("lower", 0.0), limit.number("upper", 0.0))
            is_stated = bool(limit.get("lower") or limit.get("upper"))
            effort, velocity = (limit.number(name, 0.0) for name in ("effort", "velocity"))
            joint.effort, joint.velocity = (v if 0 < v < UNLIMITED else None for v in (effort, velocity))
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
                self.draft.changed(what, f"both limits are {bounds[0]:g}, so the joint is fixed at that position")
            case "revolute" | "prismatic" if bounds is not None and bounds[0] == bounds[1] and is_stated:
                joint.type = "fixed"
                self.draft.changed(what, "both limits are 0, so the joint is fixed")
            case "revolute":
                joint.type = "continuous"
                self.draft.changed(what, "the joint has no limits, so it became a continuous joint")
            case "prismatic":
                joint.limits = self.draft.unlimited_slide(what)
            case "spherical":
                joint.type = "ball"
            case "floating":
                joint.type = "free"
            case "planar":
                pass  # a joint with several axes
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
    if (origin := element.first("origin")) is None:
        return Pose.of()
    roll, pitch, yaw = origin.numbers("rpy", 3, (0.0, 0.0, 0.0))
    return Pose.of(origin.numbers("xyz", 3, (0.0, 0.0, 0.0)), quat_from_rpy(roll, pitch, yaw))


def _upright(normal: Array) -> Pose:
    """Return a rotation that aligns the z axis with ``normal``."""
    length = float(np.linalg.norm(normal))
    z = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    across = np.array([-z[1], z[0], 0.0])
    sine = float(np.linalg.norm(across))
    if sine < SAME_POSE:
        return Pose.of() if z[2] > 0 else Pose.of(q=(0.0, 1.0, 0.0, 0.0))
    return Pose.about(across / sine, math.atan2(sine, float(z[2])))


def planar_axes(joint: JointDraft, unlimited: Callable[[str], tuple[float, float]]) -> list[JointDraft]:
    """Return the axes of a planar joint, which slides perpendicular to its axis and turns about it."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    nearest = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = nearest - (nearest @ axis) * axis
    first /= np.linalg.norm(first)
    slides = []
    for letter, along in (("x", first), ("y", np.cross(axis, first))):
        name = f"{joint.name}_{letter}"
        slides.append(replace(joint, name=name, type="prismatic", axis=along, limits=unlimited(f"joint `{name}`")))
    turn = replace(joint, name=f"{joint.name}_turn", type="continuous", limits=None)
    return [slides[0], *(replace(each, X_PC=IDENTITY) for each in (slides[1], turn))]


def _lock(joint: JointDraft, position: float) -> None:
    """Convert a joint to a fixed joint at the given position."""
    axis = joint.axis / max(float(np.linalg.norm(joint.axis)), SAME_POSE)
    moved = Pose.of(axis * position) if joint.type == "prismatic" else Pose.about(axis, position)
    joint.X_PC = joint.X_PC @ moved
    joint.type = "fixed"


def _united(visuals: list[PartDraft], colliders: list[PartDraft]) -> list[PartDraft]:
    """Combine visuals and colliders.

    A visual and a collider with the same geometry and pose become a single part.
    """
    left = list(colliders)
    for part in visuals:
        proxy = next((p for p in left if _same_geometry(p, part)), None)
        if proxy is not None:
            left.remove(proxy)
            part.use = "both"
    return visuals + left


def _same_geometry(a: PartDraft, b: PartDraft) -> bool:
    same = a.geometry is b.geometry if isinstance(a.geometry, MeshDraft) else a.geometry == b.geometry
    return same and bool(np.allclose(a.X_LG.matrix, b.X_LG.matrix, rtol=0, atol=SAME_POSE))
