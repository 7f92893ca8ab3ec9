"""Restore scenes from MJCF files compiled by SimFoundry.

The names and custom fields in these files encode data that MJCF cannot express. See :mod:`simfoundry.backends.mjcf` for
the names and :mod:`simfoundry.backends.mjcf.surroundings` for the fields.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from simfoundry.backends.mjcf.surroundings import MARK
from simfoundry.frontends.draft import BodyDraft, JointDraft, LightDraft, LinkPath, ModelDraft, robot_draft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.mjcf.elements import read_camera, split_color
from simfoundry.frontends.mjcf.geoms import MjcfSource
from simfoundry.geometry.frames import Pose

# Name prefix of visual geoms that belong to the background.
BACKGROUND = ":background:"

# Name suffixes of custom texts: ``ROBOT`` texts contain robot fields, and ``MOUNT`` texts a camera's parent frame.
ROBOT, MOUNT = ":robot", ":mount"


@dataclass(frozen=True)
class CustomFields:
    """The custom texts and numbers in a compiled file, keyed by name."""

    texts: Mapping[str, str]
    numbers: Mapping[str, list[float]]


def custom_fields(mujoco: Any, model: Any) -> CustomFields | None:
    """Return the custom texts and numbers in a model, or None if the model was not compiled by SimFoundry."""
    texts = {}
    for k in range(model.ntext):
        start, size = int(model.text_adr[k]), int(model.text_size[k])
        text = bytes(model.text_data[start : start + size]).rstrip(b"\0").decode("utf-8", "replace")
        texts[mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, k)] = text
    numbers = {model.numeric(k).name: model.numeric(k).data.tolist() for k in range(model.nnumeric)}
    return CustomFields(texts, numbers) if MARK in texts else None


def take_robots(draft: ModelDraft, path: Path, mujoco: Any, model: Any, own: CustomFields) -> Any:
    """Add a model's robots and their cameras to ``draft``, and return the model without these elements."""
    names = [name.removesuffix(ROBOT) for name in own.texts if name.endswith(ROBOT)]
    roots = {mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name): name for name in names}
    roots.pop(-1, None)
    if not roots:
        return model
    source = MjcfSource(mujoco, model, None, draft, is_own=True)
    for body, name in roots.items():
        try:
            words = dict(json.loads(own.texts[f"{name}{ROBOT}"]))
        except (TypeError, ValueError):
            message = f"robot `{name}` has invalid data for a compiled file: its custom text is not a JSON object"
            raise ImportRefusedError(path, message) from None
        draft.robots.append(robot_draft(path, name, words, Pose.of(model.body_pos[body], model.body_quat[body])))
    for k in range(model.ncam):
        robot = roots.get(int(model.body_rootid[model.cam_bodyid[k]]))
        camera = read_camera(source, k) if robot is not None else None
        if camera is None or robot is None:
            continue
        # The camera is mounted on a frame of the robot or, if no text specifies the frame, on the body it belongs to.
        frame = own.texts.get(f"{camera.name}{MOUNT}", "")
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"{robot}.{frame}")
        if site >= 0:
            camera.X_WC = Pose.of(model.site_pos[site], model.site_quat[site]).inverse() @ camera.X_WC
        body_name = source.name("body", int(model.cam_bodyid[k]))
        camera.mount = (robot, frame or body_name.removeprefix(robot).removeprefix("."))
        draft.cameras.append(camera)
    # Robots come after all objects, so their joint coordinates are at the end of the states and can be truncated.
    spec = mujoco.MjSpec.from_file(str(path))
    states = [(key.name, list(key.qpos), list(key.ctrl)) for key in spec.keys]
    for key in list(spec.keys):
        spec.delete(key)
    for name in roots.values():
        spec.delete(spec.body(name))
    model = spec.compile()
    for name, qpos, ctrl in states:
        spec.add_key(name=name, qpos=qpos[: model.nq], ctrl=ctrl[: model.nu])
    return spec.compile()


def restore(draft: ModelDraft, own: CustomFields, poses: Mapping[str, Pose], free_joints: Mapping[str, str]) -> None:
    """Restore the original names in a draft, and reunite the links of each object.

    Args:
        draft: Draft to change in place.
        own: Custom fields of the compiled file.
        poses: Poses of MuJoCo's bodies in the world, by body name.
        free_joints: Names of free joints, by body name.
    """
    owners = {body.name: body for body in draft.bodies if f"{body.name}:root" in own.texts}
    _rename_places(draft, owners, own)
    for body in list(draft.bodies):
        owner = body.name.partition(".")[0]
        if owner not in owners:
            continue
        _rename_links(body, owner, own)
        if body.name in owners:
            body.exact = True
            body.category = own.texts.get(f"{body.name}.category")
            body.labels = tuple(own.texts.get(f"{body.name}.labels", "").split())
        elif f"{body.name}:parent" in own.texts:
            joint = _free_joint(body, owner, own, poses, free_joints[body.name])
            owners[owner].links |= body.links
            owners[owner].joints += [joint, *body.joints]
            for kind in ("sites", "actuators", "sensors"):
                getattr(owners[owner], kind).extend(getattr(body, kind))
            draft.bodies.remove(body)
    draft.relations = [text for text in own.texts.get("relations", "").split("; ") if text]
    for name, values in own.numbers.items():
        if name.endswith(":dome"):
            draft.lights.append(LightDraft(name.removesuffix(":dome"), "dome", *split_color(values)))


def _link_name(qualified: str, owner: str, own: CustomFields) -> str:
    return own.texts[f"{owner}:root"] if qualified == owner else qualified.removeprefix(f"{owner}.")


def _rename_places(draft: ModelDraft, owners: Mapping[str, BodyDraft], own: CustomFields) -> None:
    """Restore the link names in camera mounts and excluded contact pairs."""

    def place(end: LinkPath) -> LinkPath:
        owner = end[0].partition(".")[0]
        return (owner, _link_name(end[1], owner, own)) if owner in owners else end

    for camera in draft.cameras:
        if camera.mount is not None:
            camera.mount = place(camera.mount)
    pairs = [(place(a), place(b)) for a, b in draft.no_contact]
    draft.no_contact = [(a, b) for a, b in pairs if a[0] != b[0]]
    for (owner, a), (other, b) in pairs:
        if owner == other:
            owners[owner].no_contact.append((a, b))


def _rename_links(body: BodyDraft, owner: str, own: CustomFields) -> None:
    """Restore the names of links, joints and parts by removing the object's prefix."""
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
            joint.mimic = replace(joint.mimic, joint=joints[joint.mimic.joint])
    for old, link in list(body.links.items()):
        link.name = names[old]
    body.links = {link.name: link for link in body.links.values()}
    body.root = names[body.root]
    for found, targets in ((body.sites, names), (body.actuators, joints), (body.sensors, names | joints)):
        for each in found:
            each.name = each.name.removeprefix(f"{owner}.")
            each.target = targets.get(each.target, each.target.removeprefix(f"{owner}."))
    # Pairs within the body may have been added before or after renaming, so they can use either name.
    body.no_contact = [(names.get(a, a), names.get(b, b)) for a, b in body.no_contact]


def _free_joint(body: BodyDraft, owner: str, own: CustomFields, poses: Mapping[str, Pose], name: str) -> JointDraft:
    """Return the free joint that connects a separate body to its parent link within the same object."""
    parent, zero = own.texts[f"{body.name}:parent"], own.numbers[f"{body.name}:zero"]
    X_PC = Pose.of(zero[:3], zero[3:])
    below = owner if parent == own.texts[f"{owner}:root"] else f"{owner}.{parent}"
    motion = (poses[below] @ X_PC).inverse() @ body.X_WO
    return JointDraft(name.removeprefix(f"{owner}."), "free", parent, body.root, X_PC, motion=motion)
