"""MJCF that SimFoundry compiled: its names and texts say which scene it was, so that the same scene comes back.

See :mod:`simfoundry.backends.mjcf` for the names and :mod:`simfoundry.backends.mjcf.custom` for the texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.backends.mjcf.custom import MARK
from simfoundry.frontends.draft import BodyDraft, Draft, JointDraft, LightDraft, LinkDraft, MeshDraft, PartDraft
from simfoundry.frontends.mass_repair import SURFACE
from simfoundry.geometry.frames import Pose

TWIN = ":touch"
"""How the names of bodies go on after that of a link where they say how it touches some things, and nothing more."""

BACKGROUND = ":background:"
"""How the names of geoms start that are seen around the scene."""


@dataclass(frozen=True)
class Said:
    """The custom texts and numbers of a file of ours, by name."""

    texts: Mapping[str, str]
    numbers: Mapping[str, tuple[float, ...]]


def said(mujoco: Any, model: Any) -> Said | None:
    """What a compiled model says in custom texts and numbers; None where it is not of our making."""
    kinds = mujoco.mjtObj
    texts, numbers = {}, {}
    data = bytes(model.text_data)
    for k in range(model.ntext):
        start, size = int(model.text_adr[k]), int(model.text_size[k])
        text = data[start : start + size].rstrip(b"\0").decode("utf-8", "replace")
        texts[mujoco.mj_id2name(model, kinds.mjOBJ_TEXT, k)] = text
    for k in range(model.nnumeric):
        start, size = int(model.numeric_adr[k]), int(model.numeric_size[k])
        values = tuple(float(v) for v in model.numeric_data[start : start + size])
        numbers[mujoco.mj_id2name(model, kinds.mjOBJ_NUMERIC, k)] = values
    return Said(texts, numbers) if MARK in texts else None


def restore(draft: Draft, own: Said, placed: Mapping[str, Pose], free: Mapping[str, str]) -> None:
    """Give a draft the names of its scene, and put together what are parts of one object.

    ``placed`` are the poses of MuJoCo's bodies in the world, and ``free`` the names of their free joints, by body.
    """
    owners = {body.name: body for body in draft.bodies if f"{body.name}:root" in own.texts}
    _name_places(draft, owners, own)
    for body in list(draft.bodies):
        owner = body.name.partition(".")[0]
        if owner not in owners:
            continue
        _name_links(body, owner, own)
        if body.name in owners:
            _describe(body, own)
        elif f"{body.name}:parent" in own.texts:
            joint = _free_joint(body, owner, own, placed, free)
            owners[owner].links |= body.links
            owners[owner].joints += [joint, *body.joints]
            draft.bodies.remove(body)
    draft.relations = [text for text in own.texts.get("relations", "").split("; ") if text]
    for name, values in own.numbers.items():
        if name.endswith(":dome"):
            strength = max(*values, 1e-9)
            red, green, blue = (v / strength for v in values)
            draft.lights.append(LightDraft(name.removesuffix(":dome"), "dome", max(values), (red, green, blue)))


def _link_name(qualified: str, owner: str, own: Said) -> str:
    return own.texts[f"{owner}:root"] if qualified == owner else qualified.removeprefix(f"{owner}.")


def _name_places(draft: Draft, owners: Mapping[str, BodyDraft], own: Said) -> None:
    """Rename the links of what is said of several bodies: of cameras that ride on them, of contacts left out."""

    def place(body: str, link: str) -> tuple[str, str]:
        owner = body.partition(".")[0]
        return (owner, _link_name(link, owner, own)) if owner in owners else (body, link)

    for camera in draft.cameras:
        if camera.mount is not None:
            camera.mount = place(*camera.mount)
    pairs = [(place(*a), place(*b)) for a, b in draft.no_contact]
    draft.no_contact = [(a, b) for a, b in pairs if a[0] != b[0]]
    for a, b in pairs:
        if a[0] == b[0]:
            within = next(body for body in draft.bodies if body.name == a[0])
            within.no_contact.append((a[1], b[1]))


def _name_links(body: BodyDraft, owner: str, own: Said) -> None:
    """Names of links, joints and parts without the object's before them."""
    for link in body.links.values():
        for part in link.parts:
            part.name = part.name.removeprefix(link.name)[1:] or part.name
        _feel(link, own.numbers.get(f"{link.name}:surface", ()))
        _bounce(link, own.numbers.get(f"{link.name}:restitution", ()))
    names = {old: _link_name(old, owner, own) for old in body.links}
    joints = {}
    for joint in body.joints:
        joint.closed = own.texts.get(f"{joint.name}:closed")
        joints[joint.name] = own.texts.get(f"{joint.child}:joint", joint.name.removeprefix(f"{owner}."))
        joint.name = joints[joint.name]
        joint.parent, joint.child = names[joint.parent], names[joint.child]
    for joint in body.joints:
        if joint.mimic is not None:
            joint.mimic.joint = joints[joint.mimic.joint]
    for old, link in list(body.links.items()):
        link.name = names[old]
    body.links = {link.name: link for link in body.links.values()}
    body.root = names[body.root]
    # What is said of its own links came before or after the names: it is told apart by whether it has them.
    body.no_contact = [(names.get(a, a), names.get(b, b)) for a, b in body.no_contact]


def _feel(link: LinkDraft, said: tuple[float, ...]) -> None:
    """Surfaces of geoms that are written as the contacts which they decide on."""
    felt = [part for part in link.parts if part.use != "visual"]
    rows = list(zip(*[iter(said)] * len(SURFACE), strict=False))
    for part, row in zip(felt, rows * len(felt) if len(rows) == 1 else rows, strict=False):
        for word, value in zip(SURFACE, row, strict=True):
            setattr(part, word, value or (0.0 if word in ("friction", "restitution") else None))


def _bounce(link: LinkDraft, said: tuple[float, ...]) -> None:
    """Restitutions that are too small for a contact of MuJoCo's to have, so that its geoms do not say them."""
    felt = [part for part in link.parts if part.use != "visual"]
    for part, value in zip(felt, said * len(felt) if len(said) == 1 else said, strict=False):
        if not part.restitution:
            part.restitution = value
    link.parts = _united(link)


def _united(link: LinkDraft) -> list[PartDraft]:
    """What is seen and what touches under one name as one part, where they are one shape."""
    seen = {part.name: part for part in link.parts if part.use == "visual"}
    out = list(seen.values())
    for part in (part for part in link.parts if part.use != "visual"):
        twin = seen.get(part.name)
        if twin is None or not _is_shape_of(part, twin):
            out.append(part)
            continue
        twin.use = "both"
        for word in SURFACE:
            setattr(twin, word, getattr(part, word))
    return out


def _is_shape_of(felt: PartDraft, seen: PartDraft) -> bool:
    still = bool(np.allclose(felt.X_LG.matrix, seen.X_LG.matrix, rtol=0, atol=1e-12))
    return not isinstance(felt.geometry, MeshDraft) and felt.geometry == seen.geometry and still


def _describe(body: BodyDraft, own: Said) -> None:
    body.exact = True
    body.category = own.texts.get(f"{body.name}.category")
    body.labels = tuple(own.texts.get(f"{body.name}.labels", "").split())


def _free_joint(
    body: BodyDraft, owner: str, own: Said, placed: Mapping[str, Pose], free: Mapping[str, str]
) -> JointDraft:
    """The free joint between a part of an object that lies loose and what it is said to lie on."""
    parent, zero = own.texts[f"{body.name}:parent"], own.numbers[f"{body.name}:zero"]
    X_PC = Pose.of(zero[:3], zero[3:])
    below = owner if parent == own.texts[f"{owner}:root"] else f"{owner}.{parent}"
    motion = (placed[below] @ X_PC).inverse() @ body.X_WO
    name = free[body.name].removeprefix(f"{owner}.")
    return JointDraft(name, "free", parent, body.root, X_PC, motion=motion)
