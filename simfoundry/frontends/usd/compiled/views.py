"""Convert the cameras, the lights and the gravity in a stage to document data."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.backends.usd.surroundings import FULL, HALF_PIXEL, X_CU
from simfoundry.frontends.usd.compiled.edits import differs, has_moved, rest, srgb
from simfoundry.frontends.usd.compiled.scaling import short
from simfoundry.frontends.usd.compiled.stage import Edited, StageMember, StageNote
from simfoundry.frontends.usd.views import LENS, LIGHTS, OFFSETS
from simfoundry.geometry.frames import Array, Pose, look_at
from simfoundry.scene.model import LightType

if TYPE_CHECKING:
    from pxr import Usd

    from simfoundry.frontends.usd.compiled.stage_frame import StageFrame

# Attribute in which SimFoundry stores the image size of a camera.
RESOLUTION = "simfoundry:resolution"

# Maximum roll of a camera that is written with `look_at`, which keeps the image upright.
UPRIGHT_RAD = 1e-3


def edited_camera(part: StageMember) -> Edited:
    """Return the data of an edited camera, with its pose and intrinsics."""
    data, names = dict(part.spec), (*LENS, *OFFSETS, RESOLUTION)
    built, now = part.built.get("", {}), part.now[""]
    if has_moved(part):
        data["pose"] = camera_pose(part.X_WP @ X_CU.inverse(), data.get("pose", {}))
    if any(differs(built[name], now.get(name)) for name in names if name in built):
        edited = lens(now, built)
        data |= {k: v for k, v in edited.items() if differs(v, lens(built, built)[k])}
        if "fov_deg" in data and any(key in data and data[key] != part.spec.get(key) for key in ("size", "fx", "fy")):
            data |= {key: edited[key] for key in ("fx", "fy")}
            del data["fov_deg"]
            if not differs(data["fx"], data["fy"]):
                focal = data.pop("fx"), data.pop("fy")
                data["fov_deg"] = round(math.degrees(2 * math.atan(edited["size"][1] / 2 / focal[1])), 4)
    return Edited(data, tuple(rest(part, {("", name) for name in names})))


def lens(values: dict[str, Any], built: dict[str, Any]) -> dict[str, Any]:
    """Return the image size, focal lengths, and principal point of a camera, rounded to 0.001 px."""
    focal, across, up = (float(values[name]) for name in LENS)
    width, height = (int(v) for v in values.get(RESOLUTION) or built[RESOLUTION])
    right, above = (float(values.get(name, 0.0)) for name in OFFSETS)
    return {
        "size": (width, height),
        "fx": _pixels(focal / across * width),
        "fy": _pixels(focal / up * height),
        "cx": _pixels(width / 2 - right / across * width - HALF_PIXEL),
        "cy": _pixels(height / 2 + above / up * height - HALF_PIXEL),
    }


def camera_pose(X_WC: Pose, before: Any = None) -> dict[str, Any]:
    """Return the pose of a camera (OpenCV axes) as readable data, using `look_at` if the image is upright.

    The target point is at the same distance as in ``before``, or at a distance of one meter if there was no point.
    """
    xyz = _point(X_WC.p, 4)
    old = before if isinstance(before, dict) else {}
    far = math.dist(old["look_at"], old.get("xyz", (0.0, 0.0, 0.0))) if isinstance(old.get("look_at"), tuple) else 1.0
    target = X_WC.apply(np.array([0.0, 0.0, far]))
    upright = look_at(X_WC.p, target)
    if upright.angle_to(X_WC) < UPRIGHT_RAD and "quat_wxyz" not in old:
        return {"xyz": xyz, "look_at": _point(target, 4)}
    return {"xyz": xyz, "quat_wxyz": _point(X_WC.q, 6)}


def edited_light(part: StageMember) -> Edited:
    """Return the data of an edited light, with its intensity, color, and position or direction."""
    data, names = dict(part.spec), ("inputs:intensity", "inputs:exposure", "inputs:color")
    built, now = part.built.get("", {}), part.now[""]
    notes, type_name = tuple(rest(part, {("", name) for name in names})), str(part.prim.GetTypeName())
    if (kind := LIGHTS.get(type_name)) is None:
        return Edited(data, (*notes, StageNote(part.path, f"lights of type {type_name} are not supported")))
    data["type"] = kind.value
    old, new = (v.get(names[0], 1.0) * 2.0 ** v.get(names[1], 0.0) for v in (built, now))
    if differs(old, new):
        data["intensity"] = short(new / FULL[kind])
    if differs(built.get(names[2]), now.get(names[2])):
        data["color"] = srgb(now.get(names[2], (1.0, 1.0, 1.0)))
    if has_moved(part):
        data |= light_place(kind, part.X_WP)
        data.pop("frame", None)  # stages state poses in the world
    return Edited(data, notes)


def light_place(kind: LightType, X_WL: Pose) -> dict[str, Any]:
    """Return a point light's position or a distant light's direction as data, or empty data for a dome light."""
    if kind is LightType.DISTANT:
        return {"direction": _point(X_WL.rotation @ np.array([0.0, 0.0, -1.0]), 4)}
    return {"xyz": _point(X_WL.p, 4)} if kind is LightType.POINT else {}


def edit_gravity(prim: Usd.Prim, data: dict[str, Any], world: StageFrame) -> None:
    """Write gravity into ``data`` if it was edited in the stage.

    ``prim`` contains the document.
    """
    physics = prim.GetChild("Physics")
    if not physics:
        return
    direction, magnitude = (physics.GetAttribute(f"physics:gravity{name}").Get() for name in ("Direction", "Magnitude"))
    if direction is None or magnitude is None or not np.isfinite([*direction, magnitude]).all():
        return
    gravity = np.array(direction, dtype=np.float64) * float(magnitude)
    in_world = world.X_WS[:3, :3] @ gravity
    old = data.get("gravity", (0.0, 0.0, -9.81))
    tolerance = 1e-5 * max(1.0, np.abs(old).max())
    # The written value is in meters, also in a stage with other units.
    if all(np.abs(value - old).max() > tolerance for value in (gravity, in_world)):
        data["gravity"] = short(tuple(in_world.tolist()))


def _point(values: Array, digits: int) -> tuple[float, ...]:
    return tuple(round(float(v), digits) + 0.0 for v in values)


def _pixels(value: float) -> float:
    return round(value, 3) + 0.0
