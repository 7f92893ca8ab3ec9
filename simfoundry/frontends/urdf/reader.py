"""URDF in: links, joints, shapes and meshes, as the specification has them, with Bullet's `<contact>`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from simfoundry.assets.errors import LARGEST, MeshError
from simfoundry.frontends.draft import (
    BodyDraft,
    Draft,
    JointDraft,
    LinkDraft,
    MeshDraft,
    MimicDraft,
    PartDraft,
    PrimitiveShape,
    Rgba,
)
from simfoundry.frontends.file_search import NotFoundError, Search, refused
from simfoundry.frontends.mass_repair import make_sound
from simfoundry.frontends.meshes import mesh_draft, width
from simfoundry.frontends.obj_groups import group_drafts
from simfoundry.frontends.xmltree import Element, read_xml
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, Round, SphereShape

FAR = 1000.0
"""Limit [m] of a slide that has none."""

GROUND = (20.0, 20.0, 0.1)
"""Size [m] of the box that stands for an infinite plane; its top is the plane."""

_READ = ("link", "joint", "material")
_READ_IN_JOINT = ("origin", "axis", "limit", "dynamics", "mimic", "parent", "child")
_READ_IN_LINK = ("inertial", "visual", "collision", "contact")
_READ_IN_CONTACT = ("lateral_friction", "restitution", "spinning_friction", "rolling_friction", "inertia_scaling")


def read_urdf(path: Path, packages: Mapping[str, Path] | None = None, density: float | None = None) -> Draft:
    """The one body of a URDF, ``density`` [kg/m^3] for links that state no mass.

    Raises :class:`ImportRefusedError` with the line where it cannot be read.
    """
    return _Urdf(path, packages or {}, density).read()


class _Urdf:
    """One file while it is read."""

    def __init__(self, path: Path, packages: Mapping[str, Path], density: float | None) -> None:
        self.path, self.search = path, Search(path, packages)
        self.root = read_xml(path, "robot")
        self.draft = Draft(self.root.get("name") or path.stem, "URDF", density=density)
        self.left: Counter[str] = Counter()
        self.meshes: dict[tuple[Path, tuple[float, float, float]], MeshDraft] = {}
        self.pieces: dict[tuple[Path, tuple[float, float, float]], list[tuple[str, MeshDraft]]] = {}
        self.widths: dict[int, float] = {}
        self.colors: dict[str, Element] = {}
        for material in self.root.walk():
            name = material.get("name")
            if material.tag == "material" and name and material.children:
                self.colors.setdefault(name, material)

    def read(self) -> Draft:
        links: dict[str, LinkDraft] = {}
        for element in self.root.all("link"):
            link = self.link(element)
            if link.name in links:
                raise element.refused(f"a second link is called `{link.name}`")
            links[link.name] = link
        joints = [self.joint(element, links) for element in self.root.all("joint")]
        joint_names = Counter(joint.name for joint in joints)
        twice = next((e for e in self.root.all("joint") if joint_names[e.need("name")] > 1), None)
        if twice is not None:
            raise twice.refused(f"a second joint is called `{twice.need('name')}`")
        body = BodyDraft(self.draft.name, self.root_link(links, joints), links, joints)
        self.draft.bodies.append(body)
        self.mimics(body)
        self.count_left()
        make_sound(self.draft, str(self.path))
        for what, count in sorted(self.left.items()):
            self.draft.dropped(what, "the language has no word for it", f"{count} times" if count > 1 else "")
        return self.draft

    def root_link(self, links: dict[str, LinkDraft], joints: list[JointDraft]) -> str:
        """The link that no joint carries; links and joints must form one tree."""
        if not links:
            raise self.root.refused("it has no link")
        children = Counter(joint.child for joint in joints)
        roots = [name for name in links if name not in children]
        several = next((name for name, count in children.items() if count > 1), None)
        if several is not None:
            raise self.root.refused(f"link `{several}` is the child of {children[several]} joints")
        if not roots:
            raise self.root.refused("its joints form a ring: no link is the root")
        if len(roots) > 1:
            raise self.root.refused(
                f"it has {len(roots)} roots: `{'`, `'.join(roots[:4])}`", "join them by fixed joints"
            )
        reached, todo = set(), [roots[0]]
        while todo:
            link = todo.pop()
            reached.add(link)
            todo += [joint.child for joint in joints if joint.parent == link]
        lost = next((name for name in links if name not in reached), None)
        if lost is not None:
            raise self.root.refused(f"its joints form a ring: link `{lost}` hangs on itself")
        return roots[0]

    def link(self, element: Element) -> LinkDraft:
        link = LinkDraft(element.need("name"))
        inertial = element.first("inertial")
        if inertial is not None:
            self.inertial(link, inertial)
        contact = element.first("contact")
        if contact is not None:
            words = ("lateral_friction", "spinning_friction", "rolling_friction", "restitution")
            said = [None if (e := contact.first(w)) is None else max(0.0, e.number("value")) for w in words]
            link.friction, link.torsional, link.rolling, restitution = said
            link.restitution = None if restitution is None else min(1.0, restitution)
        shown = [p for e in element.all("visual") for p in self.part(e, "visual", link.name)]
        touching = [p for e in element.all("collision") for p in self.part(e, "collision", link.name)]
        link.parts = _united(shown, touching)
        return link

    def inertial(self, link: LinkDraft, inertial: Element) -> None:
        mass, inertia = inertial.first("mass"), inertial.first("inertia")
        if mass is None:
            return
        link.mass = mass.number("value")
        if link.mass < 0:
            raise mass.refused(f"link `{link.name}` has the mass {link.mass:g} kg")
        X_LG = _origin(inertial)
        link.com = X_LG.p.copy()
        if inertia is not None:
            names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            xx, yy, zz, xy, xz, yz = (inertia.number(name, 0.0) for name in names)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            link.inertia = X_LG.rotation @ tensor @ X_LG.rotation.T

    def part(self, element: Element, use: str, link: str) -> Iterator[PartDraft]:
        """The piece that a `<visual>` or `<collision>` describes."""
        geometry = element.first("geometry")
        shape = next(iter(geometry.children), None) if geometry is not None else None
        if shape is None:
            raise element.refused(f"a `<{element.tag}>` of link `{link}` has no geometry")
        X_LG = _origin(element)
        pieces = self.hulls(shape, link) if use == "collision" and shape.tag == "mesh" else []
        if pieces:
            yield from (PartDraft(element.get("name") or name, mesh, use, X_LG) for name, mesh in pieces)
            return
        made = self.geometry(shape, use, link)
        if made is None:
            return
        drafted, X_GS = made
        if use == "visual" and isinstance(drafted, MeshDraft) and self.too_wide(drafted):
            self.draft.dropped(f"visual mesh of `{link}`", f"it is wider than {LARGEST:g} m")
            return
        color = self.color(element.first("material"), drafted) if use == "visual" else None
        yield PartDraft(element.get("name") or use, drafted, use, X_LG @ X_GS, color)

    def geometry(self, shape: Element, use: str, link: str) -> tuple[PrimitiveShape | MeshDraft, Pose] | None:
        """A shape and its pose beyond that of its element; None, with a note, for one that cannot be said."""
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
                    return (
                        CylinderShape(cylinder=size) if shape.tag == "cylinder" else CapsuleShape(capsule=size)
                    ), Pose.of()
            case "mesh":
                return self.mesh(shape), Pose.of()
            case "plane":
                normal = np.array(shape.numbers("normal", 3, (0.0, 0.0, 1.0)))
                self.draft.changed(f"plane of `{link}`", f"a box of {GROUND[0]:g} x {GROUND[1]:g} m stands for it")
                return BoxShape(box=GROUND), _upright(normal) @ Pose.of([0, 0, -GROUND[2] / 2])
            case _:
                self.draft.dropped(f"{use} `{shape.tag}` of `{link}`", "the language has no such shape")
                return None
        if any(float(w) < 0 for text in shape.attributes.values() for w in text.split()):
            raise shape.refused(f"a `<{shape.tag}>` of link `{link}` has a negative size")
        self.draft.dropped(f"{use} `{shape.tag}` of `{link}`", "it has no size")
        return None

    def hulls(self, shape: Element, link: str) -> list[tuple[str, MeshDraft]]:
        """The groups of an OBJ, by name, each of which touches as a hull of its own; none where it has but one."""
        key = (self.file(shape), self.scale(shape))
        if key not in self.pieces:
            try:
                self.pieces[key] = group_drafts(*key)
            except MeshError as error:
                raise shape.refused(str(error), error.hint) from None
        pieces = self.pieces[key]
        if pieces:
            why = "each group of its OBJ touches as a convex hull, as in PyBullet; MuJoCo takes one hull of all"
            self.draft.changed(f"collision mesh of `{link}`", why, f"{len(pieces)} groups of {key[0].name}")
        return pieces

    def file(self, shape: Element) -> Path:
        """The file of a mesh."""
        reference = shape.need("filename")
        try:
            return self.search.find(reference)
        except NotFoundError as error:
            raise refused(self.path, shape.line, reference, error) from None

    def mesh(self, shape: Element) -> MeshDraft:
        file, scale = self.file(shape), self.scale(shape)
        if (file, scale) not in self.meshes:
            try:
                self.meshes[file, scale] = mesh_draft(file, scale, self.search)
            except MeshError as error:
                raise shape.refused(str(error), error.hint) from None
        return self.meshes[file, scale]

    def too_wide(self, mesh: MeshDraft) -> bool:
        """Whether a mesh is wider than anything around a table."""
        if id(mesh) not in self.widths:
            self.widths[id(mesh)] = width(mesh)
        return self.widths[id(mesh)] > LARGEST

    def scale(self, shape: Element) -> tuple[float, float, float]:
        text = shape.get("scale")
        count = 1 if text is not None and len(text.split()) == 1 else 3
        values = shape.numbers("scale", count, (1.0, 1.0, 1.0)[:count])
        return (values[0], values[0], values[0]) if count == 1 else (values[0], values[1], values[2])

    def color(self, material: Element | None, drafted: PrimitiveShape | MeshDraft) -> Rgba | None:
        if material is None:
            return None
        meant = material if material.children else self.colors.get(material.get("name") or "", material)
        if meant.first("texture") is not None:
            self.left["texture laid on a shape or mesh by the URDF"] += 1
        color = meant.first("color")
        if color is None:
            return None
        r, g, b, a = (min(max(v, 0.0), 1.0) for v in color.numbers("rgba", 4))
        return r, g, b, a

    def joint(self, element: Element, links: dict[str, LinkDraft]) -> JointDraft:
        name, kind = element.need("name"), element.need("type")
        ends = []
        for tag in ("parent", "child"):
            end = element.first(tag)
            if end is None:
                raise element.refused(f"joint `{name}` has no `<{tag}>`")
            if end.need("link") not in links:
                raise end.refused(f"joint `{name}` names the link `{end.need('link')}`, which does not exist")
            ends.append(end.need("link"))
        joint = JointDraft(name, kind, ends[0], ends[1], _origin(element))
        axis = element.first("axis")
        joint.axis = np.array(axis.numbers("xyz", 3, (1.0, 0.0, 0.0)) if axis is not None else (1.0, 0.0, 0.0))
        dynamics = element.first("dynamics")
        if dynamics is not None:
            joint.damping = max(0.0, dynamics.number("damping", 0.0))
            joint.friction = max(0.0, dynamics.number("friction", 0.0))
        self.kind(joint, element)
        if joint.type in ("revolute", "continuous", "prismatic") and float(np.linalg.norm(joint.axis)) < 1e-9:
            raise element.refused(f"the axis of joint `{name}` has no length")
        return joint

    def kind(self, joint: JointDraft, element: Element) -> None:
        """The type of a joint in words of the language, and its limits."""
        what = f"joint `{joint.name}`"
        limit = element.first("limit")
        bounds = None if limit is None else (limit.number("lower", 0.0), limit.number("upper", 0.0))
        if limit is not None:
            for name in ("effort", "velocity"):
                if limit.get(name) and limit.number(name):
                    self.left[f"{name} limit of a joint"] += 1
        match joint.type:
            case "fixed":
                return
            case "continuous":
                if bounds is not None and bounds != (0.0, 0.0):
                    self.draft.dropped(f"limits of {what}", "a continuous joint has none, by the specification of URDF")
            case "revolute" | "prismatic" if bounds is not None and bounds[0] < bounds[1]:
                joint.limits = bounds
            case "revolute" | "prismatic" if bounds is not None and bounds[0] == bounds[1] != 0.0:
                _lock(joint, bounds[0])
                self.draft.changed(what, f"both its limits are {bounds[0]:g}, so it is fixed there")
            case "revolute" | "prismatic" if (
                bounds is not None
                and bounds[0] == bounds[1]
                and limit is not None
                and (limit.get("lower") or limit.get("upper"))
            ):
                joint.type = "fixed"
                self.draft.changed(what, "both its limits are 0, so it is fixed")
            case "revolute":
                joint.type = "continuous"
                self.draft.changed(what, "it has no limits, so it turns without end")
            case "prismatic":
                joint.limits = (-FAR, FAR)
                self.draft.changed(what, f"it has no limits; {FAR:g} m to either side stand for that")
            case "spherical":
                joint.type = "ball"
            case "floating":
                joint.type = "free"
            case "planar":
                joint.type = "fixed"
                self.draft.dropped(f"motion of {what}", "the language has no planar joints; it is fixed")
            case _:
                raise element.refused(f"{what} is of the type `{joint.type}`, which URDF does not know")

    def mimics(self, body: BodyDraft) -> None:
        by_name = {joint.name: joint for joint in body.joints}
        for element in self.root.all("joint"):
            mimic = element.first("mimic")
            joint = by_name[element.need("name")]
            if mimic is None or joint.type == "fixed":
                continue
            leader = by_name.get(mimic.need("joint"))
            if leader is None:
                raise mimic.refused(f"joint `{joint.name}` mimics `{mimic.need('joint')}`, which does not exist")
            if leader is joint:
                raise mimic.refused(f"joint `{joint.name}` mimics itself")
            joint.mimic = MimicDraft(leader.name, mimic.number("multiplier", 1.0), mimic.number("offset", 0.0))

    def count_left(self) -> None:
        """Count what the file says beyond what is read, by its tag."""
        sections = {"link": _READ_IN_LINK, "joint": _READ_IN_JOINT, "contact": _READ_IN_CONTACT}
        for element in (e for top in self.root.children if top.tag in ("link", "joint") for e in top.walk()):
            for child in element.children:
                if (
                    element.tag in sections
                    and child.tag not in sections[element.tag]
                    and child.tag != "joint_properties"
                ):
                    self.left[f"`<{child.tag}>` of a {'link' if element.tag == 'contact' else element.tag}"] += 1
        for child in self.root.children:
            if child.tag not in _READ:
                self.left[f"`<{child.tag}>`"] += 1


def _origin(element: Element) -> Pose:
    origin = element.first("origin")
    if origin is None:
        return Pose.of()
    roll, pitch, yaw = origin.numbers("rpy", 3, (0.0, 0.0, 0.0))
    return Pose.of(origin.numbers("xyz", 3, (0.0, 0.0, 0.0)), quat_from_rpy(roll, pitch, yaw))


def _upright(normal: Array) -> Pose:
    """A rotation that takes z to a direction."""
    length = float(np.linalg.norm(normal))
    z = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    across = np.array([-z[1], z[0], 0.0])
    sine = float(np.linalg.norm(across))
    if sine < 1e-12:
        return Pose.of() if z[2] > 0 else Pose.of(q=(0.0, 1.0, 0.0, 0.0))
    half = math.atan2(sine, float(z[2])) / 2
    return Pose.of(q=(math.cos(half), *(across / sine * math.sin(half))))


def _lock(joint: JointDraft, position: float) -> None:
    """Fix a joint at a position."""
    axis = joint.axis / max(float(np.linalg.norm(joint.axis)), 1e-12)
    if joint.type == "prismatic":
        joint.X_PC = joint.X_PC @ Pose.of(axis * position)
    else:
        joint.X_PC = joint.X_PC @ Pose.of(q=(math.cos(position / 2), *(axis * math.sin(position / 2))))
    joint.type = "fixed"


def _united(shown: list[PartDraft], touching: list[PartDraft]) -> list[PartDraft]:
    """Parts of both kinds; what is shown and touches alike is one part."""
    left = list(touching)
    out = []
    for part in shown:
        twin = next((p for p in left if _alike(p, part)), None)
        if twin is not None:
            left.remove(twin)
            part.use = "both"
        out.append(part)
    return out + left


def _alike(a: PartDraft, b: PartDraft) -> bool:
    same = a.geometry is b.geometry if isinstance(a.geometry, MeshDraft) else a.geometry == b.geometry
    return same and bool(np.allclose(a.X_LG.matrix, b.X_LG.matrix, rtol=0, atol=1e-12))
