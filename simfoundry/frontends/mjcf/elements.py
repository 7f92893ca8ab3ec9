"""Read the elements of a MuJoCo model other than bodies, such as equalities, actuators, cameras and lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from simfoundry.frontends.draft import CameraDraft, LightDraft
from simfoundry.frontends.mjcf.geoms import MjcfSource
from simfoundry.frontends.mjcf.native import NativeReader
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Mimic
from simfoundry.spec.models.joint import DriveSpec

# Default image size of a camera [px], which is the size of MuJoCo's offscreen buffer.
PICTURE = (640, 480)

# Maximum number of geom pairs to compare for contact masks, which takes a few seconds.
MAX_PAIRS = 2_000_000

# Maximum number of pairs of bodies that contact masks may add to a document, which may list at most 1000.
MAX_EXCLUDED = 500


def add_elements(source: MjcfSource, native: NativeReader | None) -> None:
    """Add all elements other than bodies to the draft, and record the unsupported ones.

    ``native`` keeps what documents cannot express, unless the file was compiled by SimFoundry.
    """
    _add_mimics(source)
    if native is None:
        _add_drives(source)
    _add_springs(source)
    _add_exclusions(source, native)
    _add_cameras(source)
    _add_lights(source)
    if native is not None:
        _note_left_out(source)
    else:
        NativeReader(source, []).read_attachments()


def _add_mimics(source: MjcfSource) -> None:
    """Add mimic joints. All other equality constraints are kept as native data."""
    mujoco, model, joints = source.mujoco, source.model, source.joints
    for k in range(model.neq):
        one, two = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if model.eq_type[k] != mujoco.mjtEq.mjEQ_JOINT or one not in joints or two not in joints:
            continue
        (body, follower), (other, leader) = joints[one], joints[two]
        constant, ratio, *higher = model.eq_data[k][:5].tolist()
        if body is not other or any(higher) or not bool(model.eq_active0[k]) or follower.mimic is not None:
            continue
        zero_one, zero_two = (float(model.jnt(joint).qpos0[0]) for joint in (one, two))
        mimic = Mimic(leader.name, ratio, zero_one + constant - ratio * zero_two)
        low, high = follower.limits or (-math.inf, math.inf)
        if source.is_own or low <= mimic.position(leader.position) <= high:
            follower.mimic = mimic
            source.mimics.add(k)


def _add_drives(source: MjcfSource) -> None:
    """Add the actuators of a compiled file that are drives, and record those that a hand changed as dropped."""
    mujoco, model, draft, joints = source.mujoco, source.model, source.draft, source.joints
    for k in range(model.nu):
        if not source.is_drive(k):
            continue
        what, joint = f"actuator {source.label('actuator', k)}", int(model.actuator_trnid[k, 0])
        kinds = (model.actuator_trntype[k], model.actuator_gaintype[k], model.actuator_biastype[k])
        is_servo = kinds == (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE)
        gain = float(model.actuator_gainprm[k][0])
        bias, stiffness, damping = (-model.actuator_biasprm[k][:3]).tolist()
        is_servo = is_servo and bias == 0 and min(stiffness, damping) >= 0 and stiffness + damping > 0
        is_servo = is_servo and gain in ((stiffness,) if stiffness else (damping, 0.0))
        if not is_servo or joint not in joints or joints[joint][1].type == "ball":
            draft.dropped(what, "only position and velocity servos on joints can be expressed")
            continue
        driven = joints[joint][1]
        if driven.drive is not None:
            draft.dropped(what, "the joint already has a drive")
            continue
        gear = float(model.actuator_gear[k, 0])
        limit = float(np.abs(model.actuator_forcerange[k]).max()) * abs(gear) if model.actuator_forcelimited[k] else 0
        target = float(source.data.ctrl[k]) / gear if stiffness > 0 and model.nkey and gear else None
        stiffness, damping = stiffness * gear**2, damping * gear**2
        driven.drive = DriveSpec(stiffness=stiffness, damping=damping, target=target, force_limit=limit or None)


def _add_springs(source: MjcfSource) -> None:
    """Add joint springs as drives, or as native data where a drive cannot have the same target."""
    for joint, (_, driven) in source.joints.items():
        stiffness = float(np.ravel(source.model.jnt_stiffness[joint])[0])
        if not stiffness or driven.type == "ball" or driven.drive is not None:
            continue
        target = float(source.model.jnt(joint).qpos_spring[0])
        low, high = driven.limits or (-math.inf, math.inf)
        if stiffness > 0 and low <= target <= high:
            driven.drive = DriveSpec(stiffness=stiffness, target=target)
            driven.native["drive"] = "spring"
        else:
            driven.native |= {"stiffness": stiffness, "springref": target}
            why = "a drive needs a positive stiffness and a target within the joint limits; the spring is kept for MJCF"
            source.draft.changed(f"spring of joint `{driven.name}`", why)


def _add_exclusions(source: MjcfSource, native: NativeReader | None) -> None:
    """Add the pairs of bodies excluded by masks or by `<exclude>` elements, except those of compiled proxy geoms."""
    for k, signature in enumerate(source.model.exclude_signature.tolist()):
        one, two = signature >> 16, signature & 0xFFFF
        if native is not None and not _is_expressible(source, one, two):
            native.exclude(one, two)
        elif native is not None or (one in source.owners and two in source.owners):
            _exclude(source, one, two, f"exclusion {source.label('exclude', k)}")
    if not source.is_own:  # in compiled files, pairs and masks are derived from contact parameters
        _add_masks(source)


def _add_masks(source: MjcfSource) -> None:
    """Add the pairs of bodies excluded by contact masks, and record masks that differ within a body as dropped."""
    model, draft, owners = source.model, source.draft, source.owners
    types, affinities = model.geom_contype, model.geom_conaffinity
    colliders = np.flatnonzero(types | affinities).tolist()
    masks = {(int(types[g]), int(affinities[g])) for g in colliders}
    if all(a[0] & b[1] or b[0] & a[1] for a in masks for b in masks):
        return
    if len(colliders) ** 2 > MAX_PAIRS:
        draft.dropped("contact masks", "there are too many geoms to compare")
        return
    by_body: dict[int, list[int]] = {}
    for geom in colliders:
        by_body.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    divided, count = 0, 0
    for one, two in combinations(sorted(by_body), 2):
        a, b = np.array(by_body[one])[:, None], np.array(by_body[two])
        meets = ((types[a] & affinities[b]) | (types[b] & affinities[a])).astype(bool)
        if meets.all() or two == int(model.body_parentid[one]) or one == int(model.body_parentid[two]):
            continue
        same = one in owners and two in owners and owners[one][0] is owners[two][0]
        count += 1
        if meets.any() or not same:
            divided += 1
        elif count <= MAX_EXCLUDED:
            _exclude(source, one, two, "contact masks")
    if divided:
        why = "contact can be excluded only between entire links"
        draft.dropped("contact masks", why, f"{divided} pairs of bodies")


def _is_expressible(source: MjcfSource, one: int, two: int) -> bool:
    """Return True if a document can exclude a pair of bodies that MuJoCo does not exclude itself."""
    owners = source.owners
    if one not in owners or two not in owners:
        return False
    same = owners[one][0] is owners[two][0]
    return not (same and any({j.parent, j.child} == {owners[one][1], owners[two][1]} for j in owners[one][0].joints))


def _exclude(source: MjcfSource, one: int, two: int, what: str) -> None:
    owners = source.owners
    if one not in owners or two not in owners:
        source.draft.dropped(what, "contact can be excluded only between links of objects, not with the world")
        return
    body, pair = owners[one][0], (owners[one][1], owners[two][1])
    if body is not owners[two][0]:
        source.draft.no_contact.append(((body.name, pair[0]), (owners[two][0].name, pair[1])))
        return
    joined = any({j.parent, j.child} == set(pair) for j in body.joints)
    if not joined and pair not in body.no_contact and pair[::-1] not in body.no_contact:
        body.no_contact.append(pair)


def _add_cameras(source: MjcfSource) -> None:
    """Add the cameras that are fixed to the world or to a body."""
    for k, body in enumerate(source.model.cam_bodyid.tolist()):
        if (camera := read_camera(source, k)) is None:
            continue
        if body != 0:
            owner, link, X_BL = source.owners[body]
            camera.X_WC = X_BL.inverse() @ camera.X_WC
            camera.mount = (owner.name, link)
        source.draft.cameras.append(camera)


def read_camera(source: MjcfSource, k: int) -> CameraDraft | None:
    """Return camera ``k`` with its pose in the body frame.

    A camera that is not a pinhole camera is recorded as dropped, and None is returned.
    """
    mujoco, model, draft = source.mujoco, source.model, source.draft
    name = source.name("camera", k) or f"camera_{k}"
    if model.cam_mode[k] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
        draft.changed(
            f"camera `{name}`", "the camera tracks a target in MuJoCo, but the imported camera is fixed to its body"
        )
    # MuJoCo 3.5 replaced the flag with an enum of projections, in which 1 is orthographic.
    projections: Any = model.cam_projection if hasattr(model, "cam_projection") else model.cam_orthographic
    if projections[k] == 1:
        draft.dropped(f"camera `{name}`", "the camera is orthographic, but only pinhole cameras are supported")
        return None
    X_BC = Pose.of(model.cam_pos[k], model.cam_quat[k]) @ Pose.of(q=(0.0, 1.0, 0.0, 0.0))
    width, height = model.cam_resolution[k].tolist()
    if width <= 1 or height <= 1:
        width, height = PICTURE
        draft.assumed(f"image size of camera `{name}`", f"the file specifies no size; {width} x {height} px is assumed")
    fy = height / 2 / math.tan(math.radians(float(model.cam_fovy[k])) / 2)
    camera = CameraDraft(name, (width, height), fy, fy, X_BC)
    across, up = model.cam_sensorsize[k].tolist()
    if across > 0 and up > 0:
        fx, fy, cx, cy = model.cam_intrinsic[k].tolist()
        camera.fx, camera.fy = fx / across * width, fy / up * height
        camera.cx = (width - 1) / 2 - cx / across * width
        camera.cy = (height - 1) / 2 - cy / up * height
    return camera


def _add_lights(source: MjcfSource) -> None:
    """Add the lights that are fixed to the world."""
    mujoco, model, draft = source.mujoco, source.model, source.draft
    for k in range(model.nlight):
        light, name = model.light(k), source.name("light", k) or f"light_{k + 1}"
        if model.light_bodyid[k] != 0:
            draft.dropped(f"light `{name}`", "the light is attached to a body, but only static lights are supported")
            continue
        if not model.light_active[k]:
            continue
        kind = "distant" if model.light_type[k] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL else "point"
        if kind == "point" and model.light_cutoff[k] < 90:
            draft.changed(f"spotlight `{name}`", "the light became a point light, which shines in all directions")
        direction, xyz = tuple(light.dir.tolist()), tuple(light.pos.tolist())
        draft.lights.append(LightDraft(name, kind, *split_color(light.diffuse.tolist()), direction, xyz))


def split_color(values: Sequence[float]) -> tuple[float, tuple[float, float, float]]:
    """Split an RGB value into a light intensity and a color whose largest channel is 1."""
    rgb = [max(0.0, v) for v in values]
    strength = max(*rgb, 1e-9)  # a black light has no color
    return max(rgb), (rgb[0] / strength, rgb[1] / strength, rgb[2] / strength)


def _note_left_out(source: MjcfSource) -> None:
    """Record the kind and the name of every element that is not imported."""
    model, draft = source.model, source.draft
    for kind in ("flex", "skin", "text", "tuple"):
        for k in range(int(getattr(model, f"n{kind}", 0))):
            draft.inexpressible(f"{kind} {source.label(kind, k)}")
