"""What a MuJoCo model has beside its bodies: equalities, actuators, contact rules, cameras, lights, and the rest."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np

from simfoundry.frontends.draft import (
    BodyDraft,
    CameraDraft,
    Draft,
    DriveDraft,
    JointDraft,
    LightDraft,
    MimicDraft,
)
from simfoundry.frontends.xmltree import Element
from simfoundry.geometry.frames import Pose

Owners = dict[int, tuple[BodyDraft, str, Pose]]
JointOwners = dict[int, tuple[BodyDraft, JointDraft]]

PICTURE = (640, 480)
"""Size [px] of a camera that gives none."""

MAX_PAIRS = 2_000_000
"""Pairs of geoms that are looked at for contact masks."""


def _named(mujoco: Any, model: Any, kind: str, number: int) -> str:
    name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number)
    return f"`{name}`" if name else f"number {number + 1}"


def add_equalities(draft: Draft, mujoco: Any, model: Any, joints: JointOwners) -> None:
    """Joints that follow joints; every other equality is noted."""
    for k in range(model.neq):
        kind = mujoco.mjtEq(int(model.eq_type[k]))
        word = kind.name.removeprefix("mjEQ_").lower()
        what = f"{word} equality {_named(mujoco, model, 'equality', k)}"
        one, two = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if kind != mujoco.mjtEq.mjEQ_JOINT or one not in joints or two not in joints:
            draft.dropped(what, "the language has no word for it")
            continue
        (body, follower), (other, leader) = joints[one], joints[two]
        coefficients = [float(v) for v in model.eq_data[k][:5]]
        if body is not other or any(coefficients[2:]) or not bool(model.eq_active0[k]):
            draft.dropped(what, "only a joint that follows another of the same thing, in proportion, can be said")
            continue
        zero_one = float(model.qpos0[model.jnt_qposadr[one]])
        zero_two = float(model.qpos0[model.jnt_qposadr[two]])
        offset = zero_one + coefficients[0] - coefficients[1] * zero_two
        follower.mimic = MimicDraft(leader.name, coefficients[1], offset)


def add_actuators(draft: Draft, mujoco: Any, model: Any, data: Any, joints: JointOwners) -> None:
    """Position and velocity servos as drives, springs of joints too; every other actuator is noted."""
    for k in range(model.nu):
        what = f"actuator {_named(mujoco, model, 'actuator', k)}"
        joint = int(model.actuator_trnid[k, 0])
        on_joint = int(model.actuator_trntype[k]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
        plain = int(model.actuator_gaintype[k]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        affine = int(model.actuator_biastype[k]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        stiffness, damping = -float(bias[1]), -float(bias[2])
        servo = plain and affine and float(bias[0]) == 0 and stiffness >= 0 and damping >= 0 and stiffness + damping > 0
        matches = float(gain[0]) == (stiffness if stiffness > 0 else damping)
        if not on_joint or joint not in joints or not servo or not matches or joints[joint][1].type == "ball":
            draft.dropped(what, "only servos that hold a joint's position or velocity can be said")
            continue
        made = joints[joint][1]
        if made.drive is not None:
            draft.dropped(what, "its joint has a drive already")
            continue
        gear = float(model.actuator_gear[k, 0])
        limit = max(abs(float(v)) for v in model.actuator_forcerange[k]) * abs(gear)
        made.drive = DriveDraft(stiffness * gear**2, damping * gear**2)
        if bool(model.actuator_forcelimited[k]) and limit > 0:
            made.drive.force_limit = limit
        if stiffness > 0 and model.nkey and gear:
            made.drive.target = float(data.ctrl[k]) / gear
    for joint, (_, made) in joints.items():
        stiffness = float(np.ravel(model.jnt_stiffness[joint])[0])
        if not stiffness:
            continue
        what = f"spring of joint `{made.name}`"
        if made.type == "ball" or made.drive is not None:
            draft.dropped(what, "a joint has one drive, and no spring beside it")
            continue
        made.drive = DriveDraft(stiffness, 0.0, float(model.qpos_spring[model.jnt_qposadr[joint]]))
        draft.changed(what, "a drive holds the joint with the same stiffness")


def add_contacts(draft: Draft, mujoco: Any, model: Any, owners: Owners, own: bool = False) -> None:
    """Pairs of links that never touch, by `<exclude>` and by masks; what goes beyond that is noted.

    The pairs and masks of a file of our ``own`` follow from the surfaces of their geoms.
    """
    for k in range(model.nexclude):
        signature = int(model.exclude_signature[k])
        one, two = signature >> 16, signature & 0xFFFF
        if not own or (one in owners and two in owners):  # and not a part of our own of how a link touches
            _exclude(draft, owners, one, two, f"exclusion {_named(mujoco, model, 'exclude', k)}")
    if own:
        return
    if model.npair:
        draft.dropped("contact pairs with parameters of their own", "the language has no word for it", f"{model.npair}")
    touching = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    masks = {(int(model.geom_contype[g]), int(model.geom_conaffinity[g])) for g in touching}
    apart = [(a, b) for a in masks for b in masks if not (a[0] & b[1] or b[0] & a[1])]
    if not apart or len(touching) ** 2 > MAX_PAIRS:
        if apart:
            draft.dropped("contact masks", "there are too many geoms to look at")
        return
    by_body: dict[int, list[int]] = {}
    for geom in touching:
        by_body.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    bodies = sorted(by_body)
    partly = 0
    for i, one in enumerate(bodies):
        for two in bodies[i + 1 :]:
            meets = [_meet(model, a, b) for a in by_body[one] for b in by_body[two]]
            if all(meets) or _linked(model, one, two):
                continue
            same = one in owners and two in owners and owners[one][0] is owners[two][0]
            if any(meets) or not same:
                partly += 1
            else:
                _exclude(draft, owners, one, two, "contact masks")
    if partly:
        why = "contact is left out between links of one thing, whole or not at all"
        draft.dropped("contact masks", why, f"{partly} pairs of bodies")


def _meet(model: Any, a: int, b: int) -> bool:
    return bool(
        int(model.geom_contype[a]) & int(model.geom_conaffinity[b])
        or int(model.geom_contype[b]) & int(model.geom_conaffinity[a])
    )


def _linked(model: Any, one: int, two: int) -> bool:
    return int(model.body_parentid[two]) == one or int(model.body_parentid[one]) == two


def _exclude(draft: Draft, owners: Owners, one: int, two: int, what: str) -> None:
    if one not in owners or two not in owners:
        draft.dropped(what, "contact is left out between links of things, not with the world")
        return
    body = owners[one][0]
    if body is not owners[two][0]:
        a, b = ((owners[k][0].name, owners[k][1]) for k in (one, two))
        draft.no_contact.append((a, b))
        return
    pair = (owners[one][1], owners[two][1])
    joined = any({j.parent, j.child} == set(pair) for j in body.joints)
    if not joined and pair not in body.no_contact and pair[::-1] not in body.no_contact:
        body.no_contact.append(pair)


def add_cameras(draft: Draft, mujoco: Any, model: Any, owners: Owners) -> None:
    """Cameras that are fixed in the world or to a body."""
    for k in range(model.ncam):
        camera = read_camera(draft, mujoco, model, k)
        if camera is None:
            continue
        body = int(model.cam_bodyid[k])
        if body != 0:
            owner, link, X_BL = owners[body]
            camera.X_WC = X_BL.inverse() @ camera.X_WC
            camera.mount = (owner.name, link)
        draft.cameras.append(camera)


def read_camera(draft: Draft, mujoco: Any, model: Any, k: int) -> CameraDraft | None:
    """The k-th camera, in the frame of its body; None, with a note, where it is no pinhole."""
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_CAMERA, k) or f"camera_{k}"
    if int(model.cam_mode[k]) != int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED):
        draft.changed(f"camera `{name}`", "it follows what moves; here it stays where it is in its body")
    if _is_orthographic(model, k):
        draft.dropped(f"camera `{name}`", "it is orthographic, and cameras are pinholes here")
        return None
    X_BC = Pose.of(model.cam_pos[k], model.cam_quat[k]) @ Pose.of(q=(0.0, 1.0, 0.0, 0.0))
    width, height = (int(v) for v in model.cam_resolution[k])
    if width <= 1 or height <= 1:
        width, height = PICTURE
        draft.assumed(f"picture size of camera `{name}`", f"none is given; {width} x {height} px")
    fy = height / 2 / math.tan(math.radians(float(model.cam_fovy[k])) / 2)
    camera = CameraDraft(name, (width, height), fy, fy, X_BC)
    sensor = [float(v) for v in model.cam_sensorsize[k]]
    if sensor[0] > 0 and sensor[1] > 0:
        fx, fy, cx, cy = (float(v) for v in model.cam_intrinsic[k])
        camera.fx, camera.fy = fx / sensor[0] * width, fy / sensor[1] * height
        camera.cx = (width - 1) / 2 - cx / sensor[0] * width
        camera.cy = (height - 1) / 2 + cy / sensor[1] * height
    return camera


def _is_orthographic(model: Any, camera: int) -> bool:
    if hasattr(model, "cam_projection"):
        return int(model.cam_projection[camera]) == 1
    return bool(getattr(model, "cam_orthographic", np.zeros(model.ncam))[camera])


def add_lights(draft: Draft, mujoco: Any, model: Any) -> None:
    """Lights that stand in the world."""
    for k in range(model.nlight):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_LIGHT, k) or f"light_{k + 1}"
        if int(model.light_bodyid[k]) != 0:
            draft.dropped(f"light `{name}`", "it is carried by a body, and lights stand still here")
            continue
        if not bool(model.light_active[k]):
            continue
        diffuse = [max(0.0, float(v)) for v in model.light_diffuse[k]]
        strength = max(*diffuse, 1e-9)
        color = (diffuse[0] / strength, diffuse[1] / strength, diffuse[2] / strength)
        x, y, z = (float(v) for v in model.light_pos[k])
        dx, dy, dz = (float(v) for v in model.light_dir[k])
        distant = int(model.light_type[k]) == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
        kind = "distant" if distant else "point"
        if not distant and float(model.light_cutoff[k]) < 90:
            draft.changed(f"spotlight `{name}`", "it shines all around: a point light")
        draft.lights.append(LightDraft(name, kind, max(diffuse), color, (dx, dy, dz), (x, y, z)))


_COUNTED = (
    ("ntendon", "tendon"), ("nsensor", "sensor"), ("nsite", "site"), ("nflex", "flex"), ("nskin", "skin"),
    ("nhfield", "hfield"), ("nnumeric", "numeric"), ("ntext", "text"), ("ntuple", "tuple"),
)  # fmt: skip


def count_left_out(draft: Draft, mujoco: Any, model: Any, roots: list[Element]) -> None:
    """Note every element that is left out, by kind and name."""
    for field, kind in _COUNTED:
        for k in range(int(getattr(model, field, 0))):
            draft.dropped(f"{kind} {_named(mujoco, model, kind, k)}", "the language has no word for it")
    if model.nkey > 1:
        for k in range(1, model.nkey):
            draft.dropped(f"keyframe {_named(mujoco, model, 'key', k)}", "a scene has one state; the first is taken")
    options: Counter[str] = Counter()
    for root in roots:
        for element in root.walk():
            if element.tag == "option":
                options.update(f"option `{name}`" for name in element.attributes if name != "gravity")
            elif element.tag == "flag":
                options.update(f"flag `{name}`" for name in element.attributes)
    for what in sorted(options):
        draft.dropped(what, "how a simulator computes is for its target to say")
    for field, word in (("body_gravcomp", "gravity compensation"),):
        bodies = [k for k in range(model.nbody) if float(getattr(model, field)[k])]
        for body in bodies:
            draft.dropped(f"{word} of body {_named(mujoco, model, 'body', body)}", "the language has no word for it")
    _contact_details(draft, model)


def _contact_details(draft: Draft, model: Any) -> None:
    """Note contact parameters beyond Coulomb friction."""
    touching = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    counts = {
        "`solref` and `solimp` of geoms": sum(
            not (
                np.allclose(model.geom_solref[g], (0.02, 1))
                and np.allclose(model.geom_solimp[g], (0.9, 0.95, 0.001, 0.5, 2))
            )
            for g in touching
        ),
        "`margin` and `gap` of geoms": sum(bool(model.geom_margin[g]) or bool(model.geom_gap[g]) for g in touching),
        "`priority` of geoms": sum(bool(model.geom_priority[g]) for g in touching),
    }
    for what, count in counts.items():
        if count:
            draft.dropped(what, "the language has no word for it", f"{count}")
