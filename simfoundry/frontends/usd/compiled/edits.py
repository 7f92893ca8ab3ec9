"""Convert edits to a stage member to document data. Values that were not edited stay as they were written."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from simfoundry.assets.mesh import srgb_of_linear
from simfoundry.frontends.names import free_name
from simfoundry.frontends.usd.compiled.scaling import scale_object, short
from simfoundry.frontends.usd.compiled.stage import (
    Edited,
    StageMember,
    StageNote,
    fallback,
    links_of,
    local_pose,
    transform,
)
from simfoundry.frontends.usd.compiled.variants import edited_variants
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import STILL, UPRIGHT_DEG, pose_spec
from simfoundry.spec.files import is_document
from simfoundry.spec.yaml.write import to_data


def srgb(linear: Iterable[float]) -> tuple[float, ...]:
    """Convert a scene-linear RGB color to a display color with three digits per channel."""
    return tuple(round(srgb_of_linear(min(max(float(v), 0.0), 1.0)), 3) for v in linear)


def as_name(text: str, taken: Iterable[str]) -> str:
    """Convert a prim name to a valid document name that is not in ``taken``."""
    word = "".join(c if c.isascii() and c.isalnum() else "_" for c in text.lower()).strip("_")
    word = word[:60] if word[:1].isalpha() else f"thing_{word}"[:60].rstrip("_")
    return free_name(word, set(taken))


# Maximum deviation [m, rad] of a moved link from its joint's axis of motion; manual moves are inexact.
_OFF_M, _OFF_RAD = 1e-3, 1e-2


def edited_joints(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> Iterator[StageNote]:
    """Write changed joint positions to ``data`` and yield notes on unsupported edits.

    If a joint attribute and a link pose were both changed, the joint attribute takes precedence. Processed attributes
    are added to ``handled``.
    """
    joints = dict(data.get("joints", {}))
    for relative, values in part.built.items():
        found = next((name for name in values if name.startswith("state:") and name.endswith(":position")), "")
        kind = found.split(":")[1] if found else ""
        if kind not in ("linear", "angular") or relative not in part.now:
            continue
        handled |= {(relative, found), (relative, f"newton:{kind}:position")}
        unit = 1.0 if kind == "linear" else math.degrees(1.0)
        old = values[found] / unit
        positions = [part.now[relative].get(name) for name in (found, f"newton:{kind}:position")]
        stated = [v / unit for v in positions if v is not None and abs(v / unit - old) > STILL]
        child, moved, off = _moved(part, relative, kind)
        handled.add((child, "at"))
        new = stated[0] if stated else old + moved
        if not stated and off:
            message = (
                "the link was moved in a way that its joint does not allow; only the motion along the joint is kept"
            )
            yield StageNote(f"{part.path}/{child}", message)
        name = relative.rpartition("/")[2]
        if abs(new - old) > STILL:
            in_degrees = isinstance(joints.get(name), dict)
            joints[name] = {"deg": round(math.degrees(new), 2) + 0.0} if in_degrees else round(new, 4) + 0.0
    if joints != data.get("joints", {}):
        data["joints"] = joints


def _moved(part: StageMember, relative: str, kind: str) -> tuple[str, float, bool]:
    """Determine the motion of a joint.

    Returns:
        The joint's child link, its motion along the joint [m or rad], and True if it also moved in any other way.
    """
    prim = part.prim.GetPrimAtPath(relative)
    targets = (prim.GetRelationship(name).GetTargets() for name in ("physics:body0", "physics:body1"))
    parent, child = (str(t[0].MakeRelativePath(part.prim.GetPath())) if t else "" for t in targets)
    X_PC_old, X_PC_new = (local_pose(v, parent).inverse() @ local_pose(v, child) for v in (part.built, part.now))
    step = X_PC_old.inverse() @ X_PC_new  # motion in the child frame, in which the axis is constant
    values = part.built[relative]
    X_CJ = Pose.of(q=values.get("physics:localRot1", (1.0, 0.0, 0.0, 0.0)))
    axis = X_CJ.rotation[:, "XYZ".index(values.get("physics:axis", "X"))]
    angle = step.angle_about(axis)
    along = float(step.p @ axis)
    if kind == "linear":
        off = np.linalg.norm(step.p - along * axis) > _OFF_M or step.angle_to(Pose.of()) > _OFF_RAD
        return child, along, bool(off)
    return child, angle, bool(np.linalg.norm(step.p) > _OFF_M or Pose.about(axis, angle).angle_to(step) > _OFF_RAD)


# Minimum translation [m] that counts as an edit; smaller ones are accidental movements in a viewer.
MOVED_M = 1e-4

# Largest finite number in single precision.
SINGLE = 3.4e38

# Relative tolerance for a round trip through single precision, which is a few units in the last place.
ROUNDED = 2e-6

_PIECES = ("Colliders", "Visuals")

# Prefixes of attributes to report if a user added them with a value other than the fallback.
_REPORTED_PREFIXES = ("physics:", "physx", "newton:", "drive:", "state:", "simfoundry:", "inputs:")


def edited_object(part: StageMember) -> Edited:
    """Return the data of an edited object, including its variants.

    Supported edits are changes to the pose, size, mass, surface properties, joint positions, and ``fixed`` flag.
    """
    return edited_variants(part, _edited_one) if part.variant else _edited_one(part)


def _edited_one(part: StageMember) -> Edited:
    """Return the data of an object without variants, or of a single variant, and notes on unsupported edits."""
    data = dict(part.spec)
    handled = {(link, "at") for link in links_of(part.built)[:1]}
    _pose(part, data)
    notes = [*_size(part, data, handled)]
    articulated = is_document(str(data.get("asset", "")))
    if articulated:
        notes += edited_joints(part, data, handled)
    else:
        _fixed(part, data, handled)
        notes += [*_mass(part, data, handled), *_surface(part, data, handled)]
    hint = f"the value is defined in {data['asset']}; change it there" if articulated else ""
    return Edited(data, (*notes, *rest(part, handled, hint)))


def edited_robot(part: StageMember) -> Edited:
    """Return the data of an edited robot, of which only the base can be moved."""
    data = dict(part.spec)
    _pose(part, data)
    notes = []
    for path, values in part.built.items():
        now = part.now.get(path, {})
        for name in (n for n in values if n.startswith("state:") and differs(values[n], now.get(n))):
            message = f"`{name}` changed from {shown(values[name])} to {shown(now.get(name))}"
            notes.append(StageNote(f"{part.path}/{path}", message, "set a robot's posture with its `joints` key"))
    return Edited(data, tuple(notes))


def has_moved(part: StageMember) -> bool:
    """Return True if a member's pose differs from the pose that was written."""
    return _shifted(part.X_WP_built, part.X_WP) or _turned(part.X_WP_built, part.X_WP)


def _shifted(old: Pose, new: Pose) -> bool:
    far = max(float(np.abs(old.p).max()), float(np.abs(new.p).max()))  # stages store nine digits
    return bool(np.abs(new.p - old.p).max() > MOVED_M + 1e-8 * far)


def _turned(old: Pose, new: Pose) -> bool:
    return math.degrees(old.angle_to(new)) > UPRIGHT_DEG


def pose_data(pose: Pose, before: Any, built: Pose) -> dict[str, Any]:
    """Return a pose as readable document data. A pose in a frame becomes a pose in the world.

    Args:
        pose: New pose.
        before: Pose data in the document before the edit; values that still apply are kept.
        built: Pose that the stage had when it was compiled.
    """
    new = to_data(pose_spec(pose))
    if not isinstance(before, dict) or "frame" in before:
        return new
    rotation = new if _turned(built, pose) else before
    place = new if _shifted(built, pose) else before
    out = {"xyz": place["xyz"]} if "xyz" in place else {}
    return out | {key: value for key, value in rotation.items() if key != "xyz"}


def differs(a: Any, b: Any) -> bool:
    """Return True if two values differ by more than single-precision rounding."""
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        return len(a) != len(b) or any(differs(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, bool) or isinstance(b, bool) or not isinstance(a, int | float) or not isinstance(b, int | float):
        return bool(a != b)
    a, b = (max(-SINGLE, min(SINGLE, v)) for v in (a, b))  # stages treat larger values as infinite
    return not math.isclose(a, b, rel_tol=ROUNDED, abs_tol=1e-10) and not (math.isnan(a) and math.isnan(b))


def rest(part: StageMember, handled: set[tuple[str, str]], hint: str = "") -> Iterator[StageNote]:
    """Yield a note for each remaining difference from the written values, which will not be imported.

    Values in ``handled`` are skipped, and ``hint`` is added to the notes.
    """
    for relative, values in part.built.items():
        path = f"{part.path}/{relative}" if relative else part.path
        if relative not in part.now:
            yield StageNote(path, "the prim was deleted, but pieces of an object cannot be deleted individually")
            continue
        now = part.now[relative]
        for name, value in values.items():
            if name != "at" and (relative, name) not in handled and differs(value, now.get(name)):
                yield StageNote(path, f"`{name}` changed from {shown(value)} to {shown(now.get(name))}", hint)
        if relative and (relative, "at") not in handled and _displaced(part, relative):
            yield StageNote(path, "the prim was moved within its object", hint or "move the entire object")
    for relative, now in part.now.items():
        prim = part.prim.GetPrimAtPath(relative) if relative else part.prim
        built = part.built.get(relative)
        if built is None and relative and _counts(prim):
            yield StageNote(str(prim.GetPath()), "the prim was added inside an object", "move it outside the object")
            continue
        for name, value in now.items():
            if name in (built or {}) or name in ("at", "look", "contact") or (relative, name) in handled:
                continue
            if name.startswith(_REPORTED_PREFIXES) and differs(value, fallback(prim, name)):
                yield StageNote(str(prim.GetPath()), f"`{name}` was added with the value {shown(value)}", hint)


def shown(value: Any) -> str:
    """Format a value for messages."""
    if isinstance(value, tuple | list):
        return f"({', '.join(shown(v) for v in value)})"
    return f"{value:.4g}" if isinstance(value, float) else "absent" if value is None else str(value)


def _displaced(part: StageMember, relative: str) -> bool:
    old, new = (transform(values, relative) for values in (part.built, part.now))
    if new[3:7] @ old[3:7] < 0:
        new[3:7] = -new[3:7]
    bound = np.full(len(old), MOVED_M)
    bound[:3] += 1e-8 * np.abs(old[:3]).max()  # stages store nine digits
    bound[7:] = np.maximum(MOVED_M, ROUNDED * np.abs(old[7:]))  # scales are stored in single precision
    return bool((np.abs(old - new) > bound).any())


def _counts(prim: Any) -> bool:
    """Return True if a prim is a shape, a joint or a body."""
    from pxr import UsdGeom, UsdPhysics

    return bool(prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdPhysics.Joint) or prim.HasAPI(UsdPhysics.RigidBodyAPI))


def _pose(part: StageMember, data: dict[str, Any]) -> None:
    if has_moved(part):
        pose = pose_data(part.X_WP, None if "place" in data else data.get("pose", {}), part.X_WP_built)
        data.pop("place", None)
        data.pop("pose", None)
        if pose:
            data["pose"] = pose


def _size(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> Iterator[StageNote]:
    """Apply the scale of an object, or the new size of a primitive if its collider or visual was resized.

    Colliders take precedence over visuals.
    """
    factors, links = part.scale, links_of(part.built)
    if links and "shape" in data:
        paths = [f"{links[0]}/{place}/shape" for place in _PIECES]
        pieces = {path: _resized(part, path) for path in paths if path in part.built and path in part.now}
        own = next(iter(pieces.values()), np.ones(3))
        for relative, factor in pieces.items():
            if (np.abs(own - 1.0) > 1e-6).any() and not differs(factor.tolist(), own.tolist()):
                handled |= {(relative, name) for name in ("size", "radius", "height", "at")}
        factors = factors * own
    if (np.abs(factors - 1.0) <= 1e-6).all():
        return
    changed, problem = scale_object(data, factors)
    if problem:
        yield StageNote(part.path, problem)
    else:
        data.update(changed)


def _resized(part: StageMember, relative: str) -> Array:
    """Return the scale factors of a primitive along its three axes."""
    built, now = part.built[relative], part.now[relative]
    factors = transform(part.now, relative)[7:] / transform(part.built, relative)[7:]
    around = (0, 1) if "height" in built else (0, 1, 2)  # the radius of a sphere also applies along z
    for name, axes in (("size", (0, 1, 2)), ("radius", around), ("height", (2,))):
        if name in built and isinstance(now.get(name), float) and built[name]:
            factors[list(axes)] *= now[name] / built[name]
    return factors


def _mass(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> Iterator[StageNote]:
    for link in links_of(part.built)[:1]:
        handled |= {(link, "physics:mass"), (link, "physics:density")}
        old, now = part.built[link]["physics:mass"], part.now.get(link, {})
        mass, density = now.get("physics:mass", 0.0), now.get("physics:density", 0.0)
        if differs(old, mass) and mass > 0:
            data.pop("density", None)
            data["mass"] = short(mass)
        elif mass <= 0 and density > 0:
            data.pop("mass", None)
            data["density"] = short(density)
        elif mass <= 0:
            yield StageNote(f"{part.path}/{link}", "the mass was removed", "set a mass or a density")


def _surface(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> Iterator[StageNote]:
    """Apply changes in color, friction and restitution.

    If several parts changed, the first of them is used.
    """
    for relative, values in part.built.items():
        if (now := part.now.get(relative)) is None:
            continue
        if values.get("look") is not None:
            handled.add((relative, "look"))
            if now.get("look") is None:
                yield StageNote(f"{part.path}/{relative}", "the new material does not have a uniform color")
            elif differs(values["look"], now["look"]):
                rgb, opacity = srgb(now["look"][:3]), short(now["look"][3])
                owner = _part_of_compound(data, relative.rpartition("/")[2])
                owner["color"] = (*rgb, opacity) if opacity != 1.0 or len(owner.get("color", ())) == 4 else rgb
        if values.get("contact") is not None:
            handled.add((relative, "contact"))
            if now.get("contact") is None:
                yield StageNote(f"{part.path}/{relative}", "the contact material was removed")
                continue
            for k, name in ((0, "friction"), (2, "restitution")):
                own = _own(values["contact"][k : k + 2], now["contact"][k : k + 2])
                if own is not None and "compound" in data.get("shape", {}):
                    message = f"the {name} of a part of a compound was changed"
                    yield StageNote(f"{part.path}/{relative}", message, "change the material of the part")
                elif own is not None:
                    data[name] = own


def _part_of_compound(data: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a new copy of the compound's part that a visual shows, or the object if it is not a compound.

    The copy is stored in ``data``.
    """
    parts = data["shape"].get("compound", {}) if "shape" in data else {}
    owner = next((key for key in sorted(parts, key=len, reverse=True) if name == key or name.startswith(f"{key}_")), "")
    if not owner:
        return data
    copy = dict(parts[owner])
    data["shape"] = {"compound": {**parts, owner: copy}}
    return copy


def _own(built: tuple[float, float], now: tuple[float, float]) -> float | None:
    """Return a contact coefficient if it was changed, or None if it is unchanged.

    Each argument contains SimFoundry's own copy of the coefficient and the square root that simulators read, either of
    which may have been edited.
    """
    if differs(built[1], now[1]):
        return float(short(now[1]))
    return float(short(now[0] ** 2)) if differs(built[0], now[0]) else None


def _fixed(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> None:
    from pxr import UsdPhysics

    for link in links_of(part.built)[:1]:
        prim = part.prim.GetChild(link)
        enabled, kinematic = "physics:rigidBodyEnabled", "physics:kinematicEnabled"
        handled |= {(link, enabled), (link, kinematic)}
        now = part.now.get(link, {})
        free = prim and prim.HasAPI(UsdPhysics.RigidBodyAPI) and now.get(enabled, True) and not now.get(kinematic)
        if not free and not data.get("fixed", False):
            data["fixed"] = True
        elif free:
            data.pop("fixed", None)
