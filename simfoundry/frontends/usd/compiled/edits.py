"""Convert edits of a stage member to document data; everything else stays as it was written."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.frontends.usd.compiled.joints import edited_joints
from simfoundry.frontends.usd.compiled.stage import StageMember, fallback, links_of
from simfoundry.frontends.usd.compiled.values import StageNote, short, srgb
from simfoundry.frontends.usd.compiled.variants import edited_variants
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import UPRIGHT_DEG, pose_spec
from simfoundry.spec.files import is_document
from simfoundry.spec.yaml.write import to_data

MOVED_M = 1e-4
"""Smallest translation [m] that counts as an edit; smaller ones are unintended movements in a viewer."""

SINGLE = 3.4e38
"""Largest number in single precision."""

ROUNDED = 2e-6
"""Relative tolerance for a round trip through single precision: a few units in the last place."""

_PIECES = ("Colliders", "Visuals")

_REPORTED_PREFIXES = ("physics:", "physx", "newton:", "drive:", "state:", "simfoundry:", "inputs:")
"""Prefixes of attributes that are reported when added, unless they have the fallback value."""


@dataclass(frozen=True)
class Edited:
    """Data of a member according to the stage, with notes on unsupported edits."""

    data: dict[str, Any]
    notes: tuple[StageNote, ...]


def edited_object(part: StageMember) -> Edited:
    """Return an edited object, including its variants: pose, size, mass, surface, joints, and whether it is fixed."""
    if part.variant:
        return Edited(*edited_variants(part, _edited_one))
    return Edited(*_edited_one(part))


def _edited_one(part: StageMember) -> tuple[dict[str, Any], tuple[StageNote, ...]]:
    """Return the data of an object without variants, or of one variant, and notes."""
    data = dict(part.spec)
    handled: set[tuple[str, str]] = set()
    handled |= {(link, "at") for link in links_of(part.built)[:1]}
    _pose(part, data)
    notes = [*_size(part, data, handled)]
    articulated = is_document(str(data.get("asset", "")))
    if articulated:
        notes += edited_joints(part, data, handled)
    else:
        _fixed(part, data, handled)
        notes += [*_mass(part, data, handled), *_surface(part, data, handled)]
    hint = f"it belongs to {data['asset']}; change it there" if articulated else ""
    return data, (*notes, *rest(part, handled, hint))


def edited_robot(part: StageMember) -> Edited:
    """Return an edited robot; only its base can be moved."""
    data = dict(part.spec)
    _pose(part, data)
    notes = []
    for path, values in part.built.items():
        now = part.now.get(path, {})
        for name in (n for n in values if n.startswith("state:") and differs(values[n], now.get(n))):
            message = f"`{name}` was {shown(values[name])} and is {shown(now.get(name))}"
            notes.append(StageNote(f"{part.path}/{path}", message, "write the posture of a robot into its `joints`"))
    return Edited(data, tuple(notes))


def has_moved(part: StageMember) -> bool:
    """Return True if the pose of a member differs from the written one."""
    return _shifted(part.X_WP_built, part.X_WP) or _turned(part.X_WP_built, part.X_WP)


def _shifted(old: Pose, new: Pose) -> bool:
    far = max(float(np.abs(old.p).max()), float(np.abs(new.p).max()))  # stages have nine digits
    return bool(np.abs(new.p - old.p).max() > MOVED_M + 1e-8 * far)


def _turned(old: Pose, new: Pose) -> bool:
    return math.degrees(old.angle_to(new)) > UPRIGHT_DEG


def pose_data(pose: Pose, before: Any, built: Pose) -> dict[str, Any]:
    """Return a pose as readable document data; parts of ``before`` that are still valid stay as written."""
    new = to_data(pose_spec(pose))
    if not isinstance(before, dict):
        return new
    rotation = new if _turned(built, pose) else before
    place = new if _shifted(built, pose) else before
    out = {"xyz": place["xyz"]} if "xyz" in place else {}
    return out | {key: value for key, value in rotation.items() if key != "xyz"}


def differs(a: Any, b: Any) -> bool:
    """Return True if two values differ by more than single precision and rounding."""
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        return len(a) != len(b) or any(differs(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, bool) or isinstance(b, bool) or not isinstance(a, int | float) or not isinstance(b, int | float):
        return bool(a != b)
    a, b = (max(-SINGLE, min(SINGLE, v)) for v in (a, b))  # larger values are infinite in a stage
    return not math.isclose(a, b, rel_tol=ROUNDED, abs_tol=1e-10) and not (math.isnan(a) and math.isnan(b))


def rest(part: StageMember, handled: set[tuple[str, str]], hint: str = "") -> Iterator[StageNote]:
    """Yield a note for each remaining difference from the written values, which is not imported."""
    for relative, values in part.built.items():
        path = f"{part.path}/{relative}" if relative else part.path
        if relative not in part.now:
            yield StageNote(path, "it was deleted, and an object keeps all its pieces")
            continue
        now = part.now[relative]
        for name, value in values.items():
            if name != "at" and (relative, name) not in handled and differs(value, now.get(name)):
                yield StageNote(path, f"`{name}` was {shown(value)} and is {shown(now.get(name))}", hint)
        if relative and (relative, "at") not in handled and _displaced(values, now):
            yield StageNote(path, "it was moved within its object", hint or "move the object itself")
    for relative, now in part.now.items():
        prim = part.prim.GetPrimAtPath(relative) if relative else part.prim
        built = part.built.get(relative)
        if built is None and relative and _counts(prim):
            yield StageNote(str(prim.GetPath()), "it was added inside an object", "put it beside the object")
            continue
        for name, value in now.items():
            if name in (built or {}) or name in ("at", "look", "contact") or (relative, name) in handled:
                continue
            if name.startswith(_REPORTED_PREFIXES) and differs(value, fallback(prim, name)):
                yield StageNote(str(prim.GetPath()), f"`{name}` was added, {shown(value)}", hint)


def shown(value: Any) -> str:
    """Return a value formatted for messages."""
    if isinstance(value, tuple | list):
        return f"({', '.join(shown(v) for v in value)})"
    return f"{value:.4g}" if isinstance(value, float) else "absent" if value is None else str(value)


def _displaced(values: dict[str, Any], now: dict[str, Any]) -> bool:
    old = np.array(values.get("at", (0, 0, 0, 1, 0, 0, 0, 1, 1, 1)), dtype=np.float64)
    new = np.array(now.get("at", (0, 0, 0, 1, 0, 0, 0, 1, 1, 1)), dtype=np.float64)
    if new[3:7] @ old[3:7] < 0:
        new[3:7] = -new[3:7]
    bound = np.full(len(old), MOVED_M)
    bound[7:] = np.maximum(MOVED_M, ROUNDED * np.abs(old[7:]))  # scales are written in single precision
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
    """Apply the scaling of an object or the resizing of a primitive; colliders take precedence over visuals."""
    factors = part.scale
    links = links_of(part.built)
    if links and "shape" in data:
        pieces = {f"{links[0]}/{place}/shape": _resized(part, f"{links[0]}/{place}/shape") for place in _PIECES}
        own = next((factor for factor in pieces.values() if factor is not None), np.ones(3))
        for relative, factor in pieces.items():
            if factor is not None and (np.abs(own - 1.0) > 1e-6).any() and not differs(factor.tolist(), own.tolist()):
                handled |= {(relative, name) for name in ("size", "radius", "height", "at")}
        factors = factors * own
    if (np.abs(factors - 1.0) <= 1e-6).all():
        return
    changed, problem = scaled(data, factors)
    if problem:
        yield StageNote(part.path, problem)
    else:
        data.update(changed)


def _resized(part: StageMember, relative: str) -> Any:
    """Return the factors of a resized primitive along its axes, shape (3,); None if there is no such prim."""
    if relative not in part.built or relative not in part.now:
        return None
    built, now = part.built[relative], part.now[relative]
    old, new = (np.array(v.get("at", (0, 0, 0, 1, 0, 0, 0, 1, 1, 1))[7:], dtype=np.float64) for v in (built, now))
    factors = new / old
    for name, axes in (("size", (0, 1, 2)), ("radius", (0, 1)), ("height", (2,))):
        if name in built and isinstance(now.get(name), float) and built[name]:
            factors[list(axes)] *= now[name] / built[name]
    if "radius" in built and "height" not in built:  # a sphere
        factors[2] = factors[0]
    return np.asarray(factors, dtype=np.float64)


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
            yield StageNote(f"{part.path}/{link}", "it has no mass any more", "give it one, or a density")


def _surface(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> Iterator[StageNote]:
    """Apply color, friction and restitution; if there are several parts, those of the first that changed."""
    for relative, values in part.built.items():
        now = part.now.get(relative)
        if now is None:
            continue
        if values.get("look") is not None:
            handled.add((relative, "look"))
            if now.get("look") is None:
                yield StageNote(f"{part.path}/{relative}", "its new material is none that has a plain color")
            elif differs(values["look"], now["look"]):
                rgb, opacity = srgb(now["look"][:3]), short(now["look"][3])
                data["color"] = (*rgb, opacity) if opacity != 1.0 or len(data.get("color", ())) == 4 else rgb
        if values.get("contact") is not None:
            handled.add((relative, "contact"))
            if now.get("contact") is None:
                yield StageNote(f"{part.path}/{relative}", "it has no contact material any more")
                continue
            for k, name in ((0, "friction"), (2, "restitution")):
                own = _own(values["contact"][k : k + 2], now["contact"][k : k + 2])
                if own is not None:
                    data[name] = own


def _own(built: tuple[float, float], now: tuple[float, float]) -> float | None:
    """Return a changed coefficient, either our own copy or the square root that simulators read; None if unchanged."""
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


_EVEN = 1e-6
"""Relative tolerance for equal factors: stages store them in single precision."""


def scaled(data: dict[str, Any], factors: Array) -> tuple[dict[str, Any], str]:
    """Return the changed data of an object that is scaled by ``factors`` along its axes, shape (3,).

    The second value is the reason if no shape can represent the result.
    """
    x, y, z = (float(f) for f in factors)
    if min(x, y, z) <= 0:
        return {}, "it is mirrored or flat, which no shape of a scene is"
    even, round_ = max(x, y, z) - min(x, y, z) <= _EVEN * x, abs(x - y) <= _EVEN * x
    shape = data.get("shape")
    if not isinstance(shape, dict):
        if str(data.get("asset", "")).endswith(".yaml"):
            return {}, "it was scaled, and an asset document has its own size"
        return ({"scale": short(data.get("scale", 1.0) * x)}, "") if even else ({}, "a mesh scales alike in all axes")
    kind, value = next(iter(shape.items()))
    if (kind in ("sphere", "capsule") and not even) or (kind in ("cylinder", "lathe") and not round_):
        return {}, f"stretched by {x:.4g}, {y:.4g}, {z:.4g} it is no {kind} any more"
    match kind:
        case "box":
            new: Any = tuple(short(v * f) for v, f in zip(value, (x, y, z), strict=True))
        case "sphere":
            new = short(value * x)
        case "cylinder" | "capsule":
            new = {"radius": short(value["radius"] * x), "height": short(value["height"] * z)}
        case "lathe":
            new = {"profile": tuple((short(r * x), short(h * z)) for r, h in value["profile"])}
        case _:
            outline = tuple((short(a * x), short(b * y)) for a, b in value["outline"])
            new = {"outline": outline, "height": short(value["height"] * z)}
    return {"shape": {kind: new}}, ""
