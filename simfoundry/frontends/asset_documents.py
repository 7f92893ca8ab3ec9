"""Convert the draft of a body to an asset document or to an object with an inline shape."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from simfoundry.frontends.document_data import Data, color_data, native_data, pose_data, without_empty
from simfoundry.frontends.draft import BodyDraft, LinkDraft, MeshDraft, PartDraft
from simfoundry.frontends.joint_data import joint_entry
from simfoundry.frontends.meshes import FileShelf
from simfoundry.frontends.names import NameTable, plain_name
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import WORLD
from simfoundry.spec.yaml.write import to_data

# Contact parameters that a link can set without a material.
LINK_KEYS = {"friction", "restitution"}

# Relative tolerance for treating an inertia as the shape's inertia; files have six or more digits.
PLAIN_INERTIA = 1e-6


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
        compiled: Names in compiled files, keyed by the content of :class:`~simfoundry.frontends.draft.CompiledName`.
    """

    documents: dict[str, str] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    parts: dict[tuple[str, str, str], tuple[LinkDraft, PartDraft]] = field(default_factory=dict)
    compiled: dict[tuple[str, str, Any], str] = field(default_factory=dict)


def asset_spec(
    body: BodyDraft, name: str, shelf: FileShelf, built: BuiltDocuments, tidy: Callable[[Any], Any]
) -> AssetSpec:
    """Return the asset document for a body, in which numbers are rounded by ``tidy``."""
    links, joints = NameTable("link"), NameTable("joint")
    link_names = {n: links.name(n) for n in body.link_order}
    joint_names = {j.name: joints.name(j.name) for j in body.joints}
    built.names |= {f"{body.name}/{old}": new for old, new in (links.renamed | joints.renamed).items()}
    materials: Data = {}
    for link in body.links.values():
        for called, part in zip(part_names(link), link.parts, strict=True):
            built.parts[name, link_names[link.name], called] = (link, part)
    attached = _attachments(body, {"link": link_names, "joint": joint_names})
    built.compiled |= _compiled_names(body, name, link_names, joint_names, attached)
    data: Data = {
        "simfoundry": "asset/1",
        "name": name,
        "materials": materials,
        "links": {link_names[n]: _link_data(body.links[n], shelf, materials) for n in body.link_order},
        "joints": dict(joint_entry(group, link_names, joint_names, joints) for group in body.joint_groups),
        "no_contact": tuple((link_names[a], link_names[b]) for a, b in body.no_contact),
        **{f"{kind}s": dict(found.values()) for kind, found in attached.items()},
        **_category(body),
    }
    return AssetSpec.model_validate(without_empty(tidy(data)))


# The names in the file, and the names and the data in the document.
_Attached = dict[str, tuple[str, Data]]


def _attachments(body: BodyDraft, names: dict[str, dict[str, str]]) -> dict[str, _Attached]:
    """Return the sites, actuators and sensors of a body, given the document names of its links and joints."""
    out: dict[str, _Attached] = {}
    for kind in ("site", "actuator", "sensor"):
        table, found = NameTable(kind), {}
        for each in getattr(body, f"{kind}s"):
            found[each.name] = (table.name(each.name), {each.place: names[each.place][each.target], **each.data})
        names[kind] = {old: new for old, (new, _) in found.items()}
        out[kind] = found
    return out


def _compiled_names(
    body: BodyDraft, name: str, links: dict[str, str], joints: dict[str, str], attached: dict[str, _Attached]
) -> Iterator[tuple[tuple[str, str, Any], str]]:
    """Yield the names of a body's elements in compiled files."""
    for old, new in links.items():
        link, qualified = body.links[old], name if old == body.root else f"{name}.{new}"
        yield ("body", body.name, old), WORLD if link.native.get("merge") and old == body.root else qualified
        for called, part in zip(part_names(link), link.parts, strict=True):
            yield ("geom", body.name, part), f"{qualified}.{called}"
    yield from ((("joint", body.name, old), f"{name}.{new}") for old, new in joints.items())
    for kind, found in attached.items():
        yield from (((kind, body.name, old), f"{name}.{new}") for old, (new, _) in found.items())


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
    if link.gravity_compensation:
        out["gravity_compensation"] = float(link.gravity_compensation)
    if any(isinstance(part.geometry, MeshDraft) for part in link.colliders):
        out |= {"collision": link.collision} | ({"solid": "hull"} if link.inertia is None else {})
    return without_empty({**out, "parts": parts, **native_data(link.native)})


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
    out |= without_empty({"pose": pose_data(part.X_LG)})
    if part.color is not None and part.use != "collision":
        out["color"] = color_data(part.color)
    if part.use != "both":
        out["use"] = part.use
    return out | native_data(part.native)


def placement_data(body: BodyDraft) -> Data:
    """Return the pose, the labels and the origin of an object."""
    out: Data = {"fixed": True} if body.fixed else {}
    out |= without_empty({"pose": pose_data(body.X_WO), "labels": body.labels})
    return out | ({"origin": {"note": body.note}} if body.note else {})


def inline_data(body: BodyDraft) -> Data | None:
    """Return the data of an object with an inline shape, or None if the body needs an asset document."""
    link, *others = body.links.values()
    if body.joints or others or body.sites or [part.use for part in link.parts] != ["both"]:
        return None
    if link.native.keys() - {"merge", "exact"}:
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
    exact = part.native.get("exact", {}) | link.native.get("exact", {})
    native = part.native | link.native | ({"exact": exact} if exact else {})
    return out | _category(body) | placement_data(body) | native_data(native)


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
