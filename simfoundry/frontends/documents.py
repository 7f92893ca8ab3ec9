"""Drafts to documents: an asset for each body, or a scene that uses them, with the mesh files beside."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.document_data import Built, Shelf, color_data, pose_data, rounded, text_of
from simfoundry.frontends.draft import BodyDraft, Draft, JointDraft, LinkDraft, MeshDraft, PartDraft
from simfoundry.frontends.names import Names, plain_name
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.write import to_data


def asset_spec(body: BodyDraft, name: str, shelf: Shelf, built: Built) -> AssetSpec:
    """The asset document of a body."""
    links, joints = Names("link"), Names("joint")
    order = [body.root, *(n for n in body.links if n != body.root)]
    link_names = {n: links.name(n) for n in order}
    joint_names = {j.name: joints.name(j.name) for j in body.joints}
    for renamed in (links.renamed, joints.renamed):
        built.names |= {f"{body.name}/{old}": new for old, new in renamed.items()}
    materials: dict[str, Any] = {}
    data: dict[str, Any] = {"simfoundry": "asset/1", "name": name, "materials": materials}
    if body.category is not None:
        data["category"] = plain_name(body.category)
    for link in body.links.values():
        for called, part in zip(part_names(link), link.parts, strict=True):
            built.parts[name, link_names[link.name], called] = (link, part)
    data["links"] = {link_names[n]: _link(body.links[n], shelf, materials) for n in order}
    data["joints"] = {joint_names[j.name]: _joint(j, link_names, joint_names) for j in body.joints}
    if body.no_contact:
        data["no_contact"] = tuple((link_names[a], link_names[b]) for a, b in body.no_contact)
    return AssetSpec.model_validate(_without_empty(rounded(data)))


def _without_empty(data: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if value not in ({}, ())}


def _link(link: LinkDraft, shelf: Shelf, materials: dict[str, Any]) -> dict[str, Any]:
    out = _surface(link)
    names = part_names(link)
    uniform = _uniform(link)
    parts = {}
    for name, part in zip(names, link.parts, strict=True):
        parts[name] = _part(part, shelf)
        if uniform is None and part.use != "visual":
            parts[name]["material"] = _material(part, link, materials)
    if uniform is not None:
        out |= uniform
    if any(isinstance(part.geometry, MeshDraft) and part.use != "visual" for part in link.parts):
        out["collision"] = link.collision
        if link.inertia is None:
            out["solid"] = "hull"
    return _without_empty({**out, "parts": parts}) if parts else out


def _surface(link: LinkDraft) -> dict[str, Any]:
    """Mass and inertia of a link."""
    out: dict[str, Any] = {}

    def quantity(value: float) -> Any:
        return {"value": value, "by": link.assumed} if link.assumed else value

    if link.mass:
        out["mass"] = quantity(float(link.mass))
        com = None if link.com is None else tuple(float(v) for v in link.com)
        if link.inertia is not None:
            i = link.inertia
            tensor = tuple(float(v) for v in (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]))
            out["inertial"] = {"com": com or (0.0, 0.0, 0.0), "inertia": tensor}
        elif com is not None:
            out["inertial"] = {"com": com}
    elif link.density is not None:
        out["density"] = quantity(float(link.density))
    return out


WORDS = (
    ("friction", "friction"), ("restitution", "restitution"),
    ("torsional", "torsional_friction"), ("rolling", "rolling_friction"),
)  # fmt: skip
"""What a surface says, in drafts and in documents."""


def _uniform(link: LinkDraft) -> dict[str, float] | None:
    """What all parts of a link say of their surface; None where they differ, or where only a material can say it."""
    touching = [_contact(part, link) for part in link.parts if part.use != "visual"]
    if not touching:
        return {}
    alike = all(surface == touching[0] for surface in touching)
    return touching[0] if alike and touching[0].keys() <= {"friction", "restitution"} else None


def _contact(part: PartDraft, link: LinkDraft) -> dict[str, float]:
    """What is said of the surface of a part, by the part or else by its link."""
    said = {}
    for word, name in WORDS:
        value = getattr(link, word) if getattr(part, word) is None else getattr(part, word)
        if value is not None and (value or name in ("friction", "restitution")):
            said[name] = float(value)
    return said


def _material(part: PartDraft, link: LinkDraft, materials: dict[str, Any]) -> str:
    """The name of a material with the surface of a part."""
    data = _contact(part, link)
    name = next((n for n, known in materials.items() if known == data), None)
    if name is None:
        name = f"surface_{len(materials) + 1}"
        materials[name] = data
    return name


def part_names(link: LinkDraft) -> Iterator[str]:
    """A name for each part; none starts like that of a mesh of the same use, whose pieces are numbered after it."""
    taken: list[tuple[str, PartDraft]] = []
    for part in link.parts:
        plain = plain_name(part.name, "part")[:50]
        numbered = (n for k in range(2, 100_000) for n in (f"{plain}{k}", f"part{k}_{plain}"))
        name = next(n for n in chain([plain], numbered) if not any(_clash((n, part), other) for other in taken))
        taken.append((name, part))
        yield name


def _clash(one: tuple[str, PartDraft], other: tuple[str, PartDraft]) -> bool:
    """Whether two parts, or pieces of them, would be called alike; what is seen and what touches are called apart."""
    (short, mesh), (long, part) = sorted((one, other), key=lambda named: len(named[0]))
    alike = mesh.use == part.use or "both" in (mesh.use, part.use)
    return short == long or (alike and isinstance(mesh.geometry, MeshDraft) and long.startswith(f"{short}_"))


def _part(part: PartDraft, shelf: Shelf) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if isinstance(part.geometry, MeshDraft):
        out["mesh"] = shelf.place(part.geometry)
        out["scale"] = float(part.geometry.scale)
    else:
        out["shape"] = to_data(part.geometry)
    pose = pose_data(part.X_LG)
    if pose:
        out["pose"] = pose
    if part.color is not None and part.use != "collision":
        out["color"] = color_data(part.color)
    if part.use != "both":
        out["use"] = part.use
    return out


def _joint(joint: JointDraft, links: dict[str, str], joints: dict[str, str]) -> dict[str, Any]:
    out: dict[str, Any] = {"type": joint.type, "parent": links[joint.parent], "child": links[joint.child]}
    pose = pose_data(joint.X_PC)
    if pose:
        out["pose"] = pose
    if joint.type in ("fixed", "free"):
        return out
    if joint.type != "ball":
        out["axis"] = tuple(float(v) for v in joint.axis)
    if joint.limits is not None and joint.type == "prismatic":
        out["limits"] = tuple(float(v) for v in joint.limits)
    elif joint.limits is not None and joint.type == "revolute":
        out["limits_deg"] = tuple(math.degrees(v) for v in joint.limits)
    if joint.closed is not None and joint.type in ("revolute", "prismatic"):
        out["closed"] = joint.closed
    out |= {key: float(getattr(joint, key)) for key in ("damping", "friction", "armature") if getattr(joint, key)}
    if joint.mimic is not None:
        out["mimic"] = {
            "joint": joints[joint.mimic.joint],
            "multiplier": joint.mimic.multiplier,
            "offset": joint.mimic.offset,
        }
    if joint.drive is not None:
        given = {k: getattr(joint.drive, k) for k in ("stiffness", "damping", "target", "force_limit")}
        out["drive"] = {k: float(v) for k, v in given.items() if v is not None}
    return out


def object_data(body: BodyDraft, asset: str) -> dict[str, Any]:
    """An object of a scene that is a body, described in an asset document."""
    out: dict[str, Any] = {"asset": asset}
    return out | _placed(body)


def _placed(body: BodyDraft) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if body.fixed:
        out["fixed"] = True
    pose = pose_data(body.X_WO)
    if pose:
        out["pose"] = pose
    if body.labels:
        out["labels"] = body.labels
    if body.note:
        out["origin"] = {"note": body.note}
    return out


def inline_data(body: BodyDraft) -> dict[str, Any] | None:
    """A body of one shape as an object that says so itself; None for any other."""
    if body.joints or len(body.links) != 1:
        return None
    (link,) = body.links.values()
    if body.exact and (link.name, *(part.name for part in link.parts)) != ("base", "shape"):
        return None
    if len(link.parts) != 1 or link.parts[0].use != "both":
        return None
    part = link.parts[0]
    if isinstance(part.geometry, MeshDraft) or pose_data(part.X_LG) or not _is_plain(link, part):
        return None
    if _uniform(link) is None:
        return None
    out = {"shape": to_data(part.geometry)} | _surface(link)
    out.pop("inertial", None)
    if body.fixed and link.assumed:
        out.pop("density", None)
    out |= _uniform(link) or {}
    if part.color is not None:
        out["color"] = color_data(part.color)
    if body.category is not None:
        out["category"] = plain_name(body.category)
    return out | _placed(body)


def _is_plain(link: LinkDraft, part: PartDraft) -> bool:
    """Whether the inertia of a link is that of its one shape at uniform density."""
    from simfoundry.scene.shape_bodies import shape_body

    assert not isinstance(part.geometry, MeshDraft)
    if not link.mass:
        return True
    if link.com is not None and np.abs(link.com).max() > 1e-9:
        return False
    solid = shape_body(part.geometry).solid
    inertia = solid.inertia * (link.mass / solid.volume)
    return link.inertia is None or bool(
        np.allclose(link.inertia, inertia, rtol=1e-6, atol=1e-6 * np.abs(inertia).max())
    )


def build_asset(draft: Draft, name: str, base: Path, root: Path | None) -> Built:
    """The documents and files of a draft that is one body, as NAME.asset.yaml in the folder ``base``."""
    built = Built()
    shelf = Shelf(base, f"{name}_files", root, built.files)
    spec = asset_spec(draft.bodies[0], plain_name(name, "thing"), shelf, built)
    built.documents[f"{name}.asset.yaml"] = text_of(spec, _head(draft))
    return built


def build_scene(draft: Draft, name: str, base: Path, root: Path | None) -> Built:
    """The documents and files of a draft, as NAME.scene.yaml in the folder ``base``."""
    built = Built()
    folder = f"{name}_files"
    shelf = Shelf(base / folder, ".", root)
    names, objects, assets = Names("thing"), {}, {}
    bodies: dict[str, str] = {}
    for body in draft.bodies:
        bodies[body.name] = called = names.name(body.name)
        inline = inline_data(body)
        if inline is None:
            assets[called] = asset_spec(body, called, shelf, built)
            inline = object_data(body, f"{folder}/{called}.asset.yaml")
            joints = dict(zip((j.name for j in body.joints), assets[called].joints, strict=True))
            state = {joints[j.name]: _state(j) for j in body.joints if j.mimic is None}
            if any(state.values()):
                inline["joints"] = {joint: value for joint, value in state.items() if value}
        objects[called] = inline
    built.names |= names.renamed
    data: dict[str, Any] = {"simfoundry": "scene/1", "name": plain_name(name, "scene"), "objects": objects}
    if draft.gravity is not None:
        data["gravity"] = draft.gravity
    data["robots"] = {
        names.name(r.name): {"model": r.model, "pose": pose_data(r.X_WB), **r.changed} for r in draft.robots
    }
    data["cameras"] = _cameras(draft, bodies, assets)
    data["no_contact"] = _no_contact(draft, bodies, assets)
    data["relations"] = tuple(draft.relations)
    if draft.background is not None:
        data["background"] = {"mesh": f"{folder}/{shelf.place(draft.background)}"}
    lights = Names("light")
    data["lights"] = {
        lights.name(light.name): {
            "type": light.type, "intensity": round(light.intensity, 4), "color": color_data((*light.color, 1.0)),
            **({"direction": light.direction} if light.type == "distant" else {}),
            **({"xyz": light.xyz} if light.type == "point" else {}),
        }
        for light in draft.lights
    }  # fmt: skip
    spec = SceneSpec.model_validate(_without_empty(rounded(data)))
    built.documents[f"{name}.scene.yaml"] = text_of(spec, _head(draft))
    built.documents |= {f"{folder}/{called}.asset.yaml": text_of(asset) for called, asset in assets.items()}
    built.files = {f"{folder}/{path.removeprefix('./')}": data for path, data in shelf.files.items()}
    return built


def _state(joint: JointDraft) -> Any:
    """Where a joint stands, as a scene says it; nothing where it is at zero."""
    return pose_data(joint.motion) if joint.type in ("ball", "free") else float(joint.position)


def _no_contact(draft: Draft, bodies: dict[str, str], assets: dict[str, AssetSpec]) -> tuple[tuple[str, str], ...]:
    """Pairs that pass through each other: whole things where all their links do."""
    links: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for (a, one), (b, other) in draft.no_contact:
        links.setdefault((a, b), []).append((one, other))
    by_name = {body.name: body for body in draft.bodies}
    out = []
    for (a, b), pairs in links.items():
        if len(set(pairs)) == len(by_name[a].links) * len(by_name[b].links):
            out.append((bodies[a], bodies[b]))
        else:
            ends = [[_link_path(by_name[n], link, bodies, assets) for n, link in ((a, x), (b, y))] for x, y in pairs]
            out += [(one, other) for one, other in ends]
    return tuple(out)


def _link_path(body: BodyDraft, link: str, bodies: dict[str, str], assets: dict[str, AssetSpec]) -> str:
    """A link as a scene names it: ``object.link``, or the object alone where that has no document of its own."""
    called = bodies[body.name]
    if called not in assets:
        return called
    order = [body.root, *(n for n in body.links if n != body.root)]
    return f"{called}.{list(assets[called].links)[order.index(link)]}"


def _cameras(draft: Draft, bodies: dict[str, str], assets: dict[str, AssetSpec]) -> dict[str, Any]:
    names, out = Names("camera"), {}
    originals = {body.name: body for body in draft.bodies}
    for camera in draft.cameras:
        data: dict[str, Any] = {"size": camera.size, "fx": camera.fx, "fy": camera.fy}
        data |= {k: v for k, v in (("cx", camera.cx), ("cy", camera.cy)) if v is not None}
        data["pose"] = {
            "xyz": tuple(float(v) for v in camera.X_WC.p),
            "quat_wxyz": tuple(float(v) for v in camera.X_WC.q),
        }
        if camera.mount is not None:
            body, link = camera.mount
            if body not in bodies:  # a robot, whose frames have names of their own
                data["mount"] = f"{body}.{link}" if link else body
                out[names.name(camera.name)] = data
                continue
            order = [originals[body].root, *(n for n in originals[body].links if n != originals[body].root)]
            asset = assets.get(bodies[body])
            called = (
                list(asset.links)[order.index(link)] if asset is not None and link != originals[body].root else None
            )
            data["mount"] = bodies[body] if called is None else f"{bodies[body]}.{called}"
        out[names.name(camera.name)] = data
    return out


def _head(draft: Draft) -> str:
    return draft.description
