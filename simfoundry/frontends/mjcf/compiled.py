"""MJCF that SimFoundry compiled: its names and texts say which scene it was, so that the same scene comes back.

See :mod:`simfoundry.backends.mjcf` for the names and :mod:`simfoundry.backends.mjcf.custom` for the texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from simfoundry.backends.mjcf.custom import MARK
from simfoundry.frontends.draft import BodyDraft, Draft, JointDraft, LightDraft
from simfoundry.geometry.frames import Pose

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
