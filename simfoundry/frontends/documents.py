"""Convert drafts to asset and scene documents, together with their mesh files."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, JointDraft, LinkDraft, LinkPath, MeshDraft, ModelDraft, PartDraft
from simfoundry.frontends.meshes import FileShelf
from simfoundry.frontends.names import NameTable, plain_name
from simfoundry.geometry.frames import Pose, rpy_from_quat
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, write_tree

# Number of significant digits in imported numbers: more than any simulator keeps, but without rounding noise.
DIGITS = 9

# Positions [m] and quaternion components below these values are rounding noise in double precision.
NO_LENGTH_M, NO_TURN = 1e-12, 1e-10


@dataclass
class BuiltDocuments:
    """Documents and other files, keyed by path, with the requested document first.

    Paths are relative to the folder that contains the requested document.

    Attributes:
        documents: Text of each document, by path.
        files: Contents of all other files, by path.
        names: New names of renamed elements, keyed by their names in the file; links and joints are qualified by their
            body.
        parts: Drafts of each part and its link, keyed by the names of the asset, link, and part in the documents.
    """

    documents: dict[str, str] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    parts: dict[tuple[str, str, str], tuple[LinkDraft, PartDraft]] = field(default_factory=dict)


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Return plain data in which all numbers are rounded to ``digits`` significant digits."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") + 0.0
    if isinstance(value, dict):
        return {key: rounded(item, digits) for key, item in value.items()}
    return tuple(rounded(item, digits) for item in value) if isinstance(value, list | tuple) else value


def document_text(spec: Model) -> str:
    """Return the canonical text of a document, in which numbers are rounded to :data:`DIGITS` significant digits."""
    return write_tree(plain_tree(rounded(to_data(spec))), type(spec))


def pose_data(X_AB: Pose) -> dict[str, Any]:
    """Return a pose as document data, with its rotation in the simplest possible representation."""
    out: dict[str, Any] = {}
    if np.abs(X_AB.p).max() > NO_LENGTH_M:
        out["xyz"] = tuple(X_AB.p.tolist())
    if abs(abs(X_AB.q[0]) - 1) < 1e-15 or np.abs(X_AB.q[1:]).max() < NO_TURN:
        return out
    rpy = tuple(math.degrees(v) for v in rpy_from_quat(X_AB.q))
    if np.abs(X_AB.q[1:3]).max() < NO_TURN:
        out["yaw_deg"] = rpy[2]
    elif all(abs(v - round(v, 3)) < 1e-7 for v in rpy):
        out["rpy_deg"] = rpy
    else:
        out["quat_wxyz"] = tuple(X_AB.q.tolist())
    return out


def color_data(color: tuple[float, ...]) -> tuple[float, ...]:
    """Return an RGBA color as document data, omitting an alpha of 1.

    Values are rounded to four decimals to remove single-precision noise.
    """
    values = tuple(round(v, 4) for v in color)
    return values if values[3] < 1 else values[:3]


def relative_path(file: Path, document: Path) -> str:
    """Return the path of a file relative to the folder of a document."""
    return Path(os.path.relpath(file.resolve(), document.resolve().parent)).as_posix()


Data = dict[str, Any]

# Contact parameters that a link can set without a material.
LINK_KEYS = {"friction", "restitution"}

# Relative tolerance for treating an inertia as the shape's inertia; files have six or more digits.
PLAIN_INERTIA = 1e-6


def build_asset(draft: ModelDraft, name: str, base: Path, root: Path | None) -> BuiltDocuments:
    """Build NAME.asset.yaml for the ``base`` folder from a draft that contains one body.

    Mesh files below ``root`` are referenced in place instead of being copied.
    """
    built = BuiltDocuments()
    shelf = FileShelf(base, f"{name}_files", root, built.files)
    built.documents[f"{name}.asset.yaml"] = document_text(_asset_spec(draft.bodies[0], plain_name(name), shelf, built))
    return built


def build_scene(draft: ModelDraft, name: str, base: Path, root: Path | None) -> BuiltDocuments:
    """Build NAME.scene.yaml for the ``base`` folder, along with an asset document for each body that needs one.

    Mesh files below ``root`` are referenced in place instead of being copied.
    """
    return _SceneBuilder(draft, f"{name}_files", base, root).build(name)


class _SceneBuilder:
    """A builder that converts a draft to a scene.

    ``objects`` maps body names to object names, and ``assets`` maps object names to asset documents.
    """

    def __init__(self, draft: ModelDraft, folder: str, base: Path, root: Path | None) -> None:
        self.draft, self.folder, self.built = draft, folder, BuiltDocuments()
        self.shelf = FileShelf(base / folder, ".", root)
        self.names = NameTable()
        self.assets: dict[str, AssetSpec] = {}
        self.objects: dict[str, str] = {}
        self.bodies = {body.name: body for body in draft.bodies}

    def build(self, name: str) -> BuiltDocuments:
        draft, built = self.draft, self.built
        data: Data = {"simfoundry": "scene/1", "name": plain_name(name, "scene"), "objects": {}}
        for body in draft.bodies:
            self.objects[body.name] = called = self.names.name(body.name)
            data["objects"][called] = self.object_data(body, called)
        built.names |= self.names.renamed
        if draft.gravity is not None:
            data["gravity"] = draft.gravity
        data["robots"] = {
            self.names.name(r.name): {"model": r.model, "pose": pose_data(r.X_WB), **r.changed} for r in draft.robots
        }
        data["cameras"], data["lights"] = self.cameras(), self.lights()
        data["no_contact"], data["relations"] = self.no_contact(), tuple(draft.relations)
        if draft.background is not None:
            data["background"] = {"mesh": f"{self.folder}/{self.shelf.place(draft.background)}"}
        built.documents[f"{name}.scene.yaml"] = document_text(SceneSpec.model_validate(_without_empty(rounded(data))))
        built.documents |= {f"{self.folder}/{n}.asset.yaml": document_text(a) for n, a in self.assets.items()}
        built.files = {f"{self.folder}/{path.removeprefix('./')}": data for path, data in self.shelf.files.items()}
        return built

    def object_data(self, body: BodyDraft, called: str) -> Data:
        """Return the data of an object, using an inline shape if possible and an asset document otherwise."""
        if (inline := inline_data(body)) is not None:
            return inline
        asset = self.assets[called] = _asset_spec(body, called, self.shelf, self.built)
        data: Data = {"asset": f"{self.folder}/{called}.asset.yaml", **_placement(body)}
        states = {
            name: pose_data(joint.motion) if joint.type in ("ball", "free") else float(joint.position)
            for name, joint in zip(asset.joints, body.joints, strict=True)
            if joint.mimic is None
        }
        return data | _without_empty({"joints": {name: state for name, state in states.items() if state}})

    def link_path(self, body: str, link: str) -> str:
        """Return the ``object.link`` path of a link, or only the object's name if the object has an inline shape."""
        called = self.objects[body]
        if called not in self.assets:
            return called
        return f"{called}.{list(self.assets[called].links)[self.bodies[body].link_order.index(link)]}"

    def no_contact(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of links that do not collide.

        If all links of two objects are excluded, the two objects are listed as a single pair instead.
        """
        pairs: dict[tuple[str, str], list[tuple[LinkPath, LinkPath]]] = {}
        for one, other in self.draft.no_contact:
            pairs.setdefault((one[0], other[0]), []).append((one, other))
        out: list[tuple[str, str]] = []
        for (a, b), ends in pairs.items():
            if len(set(ends)) == len(self.bodies[a].links) * len(self.bodies[b].links):
                out.append((self.objects[a], self.objects[b]))
            else:
                out += [(self.link_path(*one), self.link_path(*other)) for one, other in ends]
        return tuple(out)

    def cameras(self) -> Data:
        names, out = NameTable("camera"), {}
        for camera in self.draft.cameras:
            keys = ("size", "fx", "fy", "cx", "cy")
            data: Data = {key: value for key in keys if (value := getattr(camera, key)) is not None}
            data["pose"] = {"xyz": tuple(camera.X_WC.p.tolist()), "quat_wxyz": tuple(camera.X_WC.q.tolist())}
            if camera.mount is not None:
                body, link = camera.mount
                if body not in self.objects:  # a robot, whose frame names are not changed
                    data["mount"] = f"{body}.{link}" if link else body
                else:
                    is_root = link == self.bodies[body].root
                    data["mount"] = self.objects[body] if is_root else self.link_path(body, link)
            out[names.name(camera.name)] = data
        return out

    def lights(self) -> Data:
        names, out = NameTable("light"), {}
        for light in self.draft.lights:
            data = {"type": light.type, "intensity": round(light.intensity, 4), "color": color_data((*light.color, 1))}
            if light.type != "dome":
                place = "direction" if light.type == "distant" else "xyz"
                data[place] = getattr(light, place)
            if light.panorama is not None:
                data["texture"] = f"{self.folder}/{self.shelf.place_file(*light.panorama)}"
            out[names.name(light.name)] = data
        return out


def _asset_spec(body: BodyDraft, name: str, shelf: FileShelf, built: BuiltDocuments) -> AssetSpec:
    """Return the asset document for a body."""
    links, joints = NameTable("link"), NameTable("joint")
    link_names = {n: links.name(n) for n in body.link_order}
    joint_names = {j.name: joints.name(j.name) for j in body.joints}
    built.names |= {f"{body.name}/{old}": new for old, new in (links.renamed | joints.renamed).items()}
    materials: Data = {}
    for link in body.links.values():
        for called, part in zip(part_names(link), link.parts, strict=True):
            built.parts[name, link_names[link.name], called] = (link, part)
    data: Data = {
        "simfoundry": "asset/1",
        "name": name,
        "materials": materials,
        "links": {link_names[n]: _link_data(body.links[n], shelf, materials) for n in body.link_order},
        "joints": {joint_names[j.name]: _joint_data(j, link_names, joint_names) for j in body.joints},
        "no_contact": tuple((link_names[a], link_names[b]) for a, b in body.no_contact),
        **_category(body),
    }
    return AssetSpec.model_validate(_without_empty(rounded(data)))


def _without_empty(data: Data) -> Data:
    return {key: value for key, value in data.items() if value not in ({}, ())}


def _category(body: BodyDraft) -> Data:
    return {} if body.category is None else {"category": plain_name(body.category)}


def _link_data(link: LinkDraft, shelf: FileShelf, materials: Data) -> Data:
    out, uniform, parts = _mass_data(link), _uniform_contact(link), {}
    for name, part in zip(part_names(link), link.parts, strict=True):
        parts[name] = _part_data(part, shelf)
        material: Data = dict(_contact_data(part, link)) if uniform is None and part.collides else {}
        if part.texture is not None and part.use != "collision":
            material |= {"texture": shelf.place_texture(part.texture)}
            material |= {"texture_size": part.texture.size} if part.texture.size is not None else {}
        if material or (uniform is None and part.collides):
            parts[name]["material"] = _material_name(material, materials)
    out |= uniform or {}
    if any(isinstance(part.geometry, MeshDraft) for part in link.colliders):
        out |= {"collision": link.collision} | ({"solid": "hull"} if link.inertia is None else {})
    return _without_empty({**out, "parts": parts})


def _mass_data(link: LinkDraft) -> Data:
    """Return the mass, density and inertia of a link."""
    out: Data = {}

    def quantity(value: float) -> Any:
        return {"value": float(value), "source": link.assumed} if link.assumed else float(value)

    if link.mass:
        out["mass"] = quantity(link.mass)
        if link.com is not None or link.inertia is not None:
            out["inertial"] = {"com": (0.0, 0.0, 0.0) if link.com is None else tuple(link.com.tolist())}
        if link.inertia is not None:  # ixx, iyy, izz, ixy, ixz, iyz
            out["inertial"]["inertia"] = tuple(link.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist())
    elif link.density is not None:
        out["density"] = quantity(link.density)
    return out


def _uniform_contact(link: LinkDraft) -> dict[str, float] | None:
    """Return the contact parameters shared by all parts of a link, or None if they differ or require a material."""
    first, *others = [_contact_data(part, link) for part in link.colliders] or [{}]
    return first if first.keys() <= LINK_KEYS and all(contact == first for contact in others) else None


def _contact_data(part: PartDraft, link: LinkDraft) -> dict[str, float]:
    """Return the contact parameters of a part. Parameters that the part does not specify come from its link.

    Torsional and rolling friction are omitted if they are zero.
    """
    return {key: v for key, v in (link.contact | part.contact).items() if v or key in LINK_KEYS}


def _material_name(data: Data, materials: Data) -> str:
    """Return the name of the material with these parameters, adding the material if it does not exist yet."""
    name = next((n for n, known in materials.items() if known == data), f"surface_{len(materials) + 1}")
    materials[name] = data
    return name


def part_names(link: LinkDraft) -> Iterator[str]:
    """Yield a unique name for each part.

    The pieces of a mesh are numbered and named after the mesh. Therefore, no part with the same use may have a name
    that starts with the name of the mesh and an underscore.
    """
    taken: list[tuple[str, PartDraft]] = []
    for part in link.parts:
        plain = plain_name(part.name, "part")[:50]
        numbered = (n for k in range(2, 100_000) for n in (f"{plain}{k}", f"part{k}_{plain}"))
        name = next(n for n in chain([plain], numbered) if not any(_clash((n, part), other) for other in taken))
        taken.append((name, part))
        yield name


def _clash(one: tuple[str, PartDraft], other: tuple[str, PartDraft]) -> bool:
    """Return True if the names of two parts or of their pieces conflict.

    Visual and collision parts are in separate namespaces.
    """
    (short, mesh), (long, part) = sorted((one, other), key=lambda named: len(named[0]))
    alike = mesh.use == part.use or "both" in (mesh.use, part.use)
    return short == long or (alike and isinstance(mesh.geometry, MeshDraft) and long.startswith(f"{short}_"))


def _part_data(part: PartDraft, shelf: FileShelf) -> Data:
    if isinstance(part.geometry, MeshDraft):
        out: Data = {"mesh": shelf.place(part.geometry), "scale": float(part.geometry.scale)}
    else:
        out = {"shape": to_data(part.geometry)}
    out |= _without_empty({"pose": pose_data(part.X_LG)})
    if part.color is not None and part.use != "collision":
        out["color"] = color_data(part.color)
    if part.use != "both":
        out["use"] = part.use
    return out


def _joint_data(joint: JointDraft, links: Mapping[str, str], joints: Mapping[str, str]) -> Data:
    out: Data = {"type": joint.type, "parent": links[joint.parent], "child": links[joint.child]}
    out |= _without_empty({"pose": pose_data(joint.X_PC)})
    if joint.type in ("fixed", "free"):
        return out
    if joint.type != "ball":
        out["axis"] = tuple(joint.axis.tolist())
    if joint.limits is not None and joint.type == "prismatic":
        out["limits"] = tuple(map(float, joint.limits))
    elif joint.limits is not None and joint.type == "revolute":
        out["limits_deg"] = tuple(map(math.degrees, joint.limits))
    if joint.closed is not None and joint.type in ("revolute", "prismatic"):
        out["closed"] = joint.closed
    out |= {key: float(getattr(joint, key)) for key in ("damping", "friction", "armature") if getattr(joint, key)}
    if joint.effort is not None and joint.type != "ball":
        out["effort"] = float(joint.effort)
    if joint.velocity is not None and joint.type == "prismatic":
        out["velocity"] = float(joint.velocity)
    elif joint.velocity is not None and joint.type != "ball":
        out["velocity_deg"] = math.degrees(joint.velocity)
    if joint.mimic is not None:
        out["mimic"] = asdict(joint.mimic) | {"joint": joints[joint.mimic.joint]}
    if joint.drive is not None:
        out["drive"] = to_data(joint.drive)
    return out


def _placement(body: BodyDraft) -> Data:
    out: Data = {"fixed": True} if body.fixed else {}
    out |= _without_empty({"pose": pose_data(body.X_WO), "labels": body.labels})
    return out | ({"origin": {"note": body.note}} if body.note else {})


def inline_data(body: BodyDraft) -> Data | None:
    """Return the data of an object with an inline shape, or None if the body needs an asset document."""
    link, *others = body.links.values()
    if body.joints or others or [part.use for part in link.parts] != ["both"]:
        return None
    (part,) = link.parts
    if body.exact and (link.name, part.name) != ("base", "shape"):
        return None
    contact = _uniform_contact(link)
    if part.texture is not None:  # materials belong to asset documents
        return None
    if isinstance(part.geometry, MeshDraft) or pose_data(part.X_LG) or contact is None or not _is_plain(link, part):
        return None
    unneeded = ("inertial", "density") if body.fixed and link.assumed else ("inertial",)
    out: Data = {"shape": to_data(part.geometry)} | {k: v for k, v in _mass_data(link).items() if k not in unneeded}
    out |= contact
    if part.color is not None:
        out["color"] = color_data(part.color)
    return out | _category(body) | _placement(body)


def _is_plain(link: LinkDraft, part: PartDraft) -> bool:
    """Return True if a link has only one shape and the inertia of that shape at uniform density."""
    from simfoundry.scene.bodies import shape_body

    assert not isinstance(part.geometry, MeshDraft)
    if not link.mass:
        return True
    if link.com is not None and np.abs(link.com).max() > 1e-9:
        return False
    solid = shape_body(part.geometry).solid
    inertia = solid.inertia * (link.mass / solid.volume)
    tolerance = PLAIN_INERTIA * np.abs(inertia).max()
    return link.inertia is None or bool(np.allclose(link.inertia, inertia, rtol=PLAIN_INERTIA, atol=tolerance))
