"""A thing stretched along its axes: parts, frames of links and ways of joints together, so that all still fit.

All links must be turned alike at rest (no joint turns its child's frame), as in furniture; otherwise only a factor that
is the same along all three axes keeps them together.
"""

from __future__ import annotations

import numpy as np

from simfoundry.cousins.objects.components import Component, Kind, components
from simfoundry.cousins.objects.parts import (
    Key,
    Profile,
    aimed,
    at,
    axis_of,
    bounds,
    each,
    flared,
    is_level,
    moved,
    parts_of,
    rod,
    shaped,
    swelled,
    thickened,
    with_parts,
    with_rod,
)
from simfoundry.geometry.frames import Array
from simfoundry.scene.poses import pose
from simfoundry.spec.models.asset import AssetSpec, JointSpec, PartSpec
from simfoundry.spec.models.base import BoxShape, LatheShape, PrismShape, Shape, SphereShape

SQUARE = 1e-6
"""A rotation whose matrix is this near to a permutation turns boxes onto the axes."""


def stretched(spec: AssetSpec, factor: Array) -> AssetSpec:
    """The asset with its x, y and z multiplied by ``factor``, shape (3,), the nearest that its shapes allow.

    What is round about z keeps x and y alike, a ball stays a ball; walls grow with the rest.
    """
    f = allowed(spec, factor)
    out = each(spec, lambda _, part: stretched_part(part, f))
    joints = {name: _joint(joint, f) for name, joint in spec.joints.items()}
    return out.model_copy(update={"joints": joints})


def allowed(spec: AssetSpec, factor: Array) -> Array:
    """The factor that the shapes of an asset allow, shape (3,)."""
    f = np.array(factor, dtype=np.float64)
    turned = any(not pose(joint.pose).is_identity and _turns(joint) for joint in spec.joints.values())
    if turned or is_ball(spec) or any(p.mesh is not None for p in parts_of(spec).values()):
        return np.full(3, float(np.cbrt(f.prod())))
    if any(_round_about_z(part) for part in parts_of(spec).values()):
        f[:2] = np.sqrt(f[0] * f[1])
    return f


def stretched_part(part: PartSpec, f: Array) -> PartSpec:
    """One part with the axes of its link multiplied by ``f``, shape (3,)."""
    there = moved(part, at(part) * f)
    if part.mesh is not None:
        return there.model_copy(update={"scale": part.scale * float(np.cbrt(f.prod()))})
    assert part.shape is not None
    turn = pose(part.pose).rotation
    local = np.abs(turn.T) @ f
    if not _is_square(turn):
        size = rod(part)
        if size is not None:
            return _leaning_rod(there, size, turn[:, 2], f)
        upright = abs(turn[2, 2]) > 1 - SQUARE and abs(f[0] - f[1]) < SQUARE
        local = np.array([f[0], f[1], f[2]]) if upright else np.full(3, float(np.cbrt(f.prod())))
    return shaped(there, _scaled(there.shape, local))


def _scaled(shape: Shape | None, f: Array) -> Shape:
    """A shape with its own axes multiplied by ``f``, shape (3,)."""
    x, y, z = (float(v) for v in f)
    across = float(np.sqrt(x * y))
    match shape:
        case BoxShape():
            a, b, c = shape.box
            return BoxShape(box=(a * x, b * y, c * z))
        case SphereShape():
            return SphereShape(sphere=shape.sphere * float(np.cbrt(x * y * z)))
        case LatheShape():
            rings = tuple((r * across, h * z) for r, h in shape.lathe.profile)
            return LatheShape.model_validate({"lathe": {"profile": rings}})
        case PrismShape():
            outline = tuple((u * x, v * y) for u, v in shape.prism.outline)
            return PrismShape.model_validate({"prism": {"outline": outline, "height": shape.prism.height * z}})
    part = PartSpec(shape=shape)
    size = rod(part)
    assert size is not None
    scaled = with_rod(part, size[0] * across, size[1] * z).shape
    assert scaled is not None
    return scaled


def _leaning_rod(part: PartSpec, size: tuple[float, float], axis: Array, f: Array) -> PartSpec:
    """A cylinder or capsule that lies across the axes: its ends go where the stretch takes them."""
    along = axis * f
    length = float(np.linalg.norm(along))
    thick = float(np.sqrt(f.prod() / length))
    there = with_rod(part, size[0] * thick, size[1] * length)
    return there.model_copy(update={"pose": aimed(at(there), along / length)})


def _joint(joint: JointSpec, f: Array) -> JointSpec:
    way = joint.pose.model_copy(update={"xyz": tuple(float(v) for v in np.array(joint.pose.xyz) * f)})
    changes: dict[str, object] = {"pose": way}
    if joint.limits is not None:
        axis = np.abs(np.array(joint.axis)) / np.linalg.norm(joint.axis)
        low, high = (float(v * (axis @ f)) for v in joint.limits)
        changes["limits"] = (low, high)
    return joint.model_copy(update=changes)


def _turns(joint: JointSpec) -> bool:
    return not _is_square(pose(joint.pose).rotation) or pose(joint.pose).rotation.trace() < 3 - SQUARE


def is_ball(spec: AssetSpec) -> bool:
    """Return whether an asset is nothing but one ball."""
    every = list(parts_of(spec).values())
    return len(every) == 1 and isinstance(every[0].shape, SphereShape)


def _round_about_z(part: PartSpec) -> bool:
    """Return whether it would no longer be what it is with another factor in x than in y."""
    turn = pose(part.pose).rotation
    if not _is_square(turn):
        return rod(part) is None
    upright = abs(turn[2, 2]) > 1 - SQUARE
    return (isinstance(part.shape, LatheShape) or rod(part) is not None) and upright


def _is_square(rotation: Array) -> bool:
    """Return whether a rotation maps axes onto axes."""
    return bool((np.abs(np.abs(rotation).max(axis=0) - 1) < SQUARE).all())


Edit = tuple[AssetSpec, str]
"""The changed asset, and what was changed, for people."""

Rng = np.random.Generator

LEAST, MOST = 0.74, 1.36
"""Factors of a stretch along each axis; what then is no longer of its kind is refused by its size and mass."""

ATTACHED = 0.6
"""What is farther from the axis than this share of the body's radius hangs on its wall."""


def stretch(spec: AssetSpec, _component: Component, rng: Rng) -> Edit | None:
    """The whole thing longer, wider, higher; of the loose links too, so that they fit."""
    parts = list(parts_of(spec).values())
    if len(parts) == 1 and isinstance(parts[0].shape, SphereShape):  # balls for one game differ little
        factor = np.full(3, rng.uniform(0.94, 1.06))
    else:
        factor = allowed(spec, np.exp(rng.uniform(np.log(LEAST), np.log(MOST), 3)))
    sizes = ", ".join(f"{axis} {f:.2f}" for axis, f in zip("xyz", factor, strict=True))
    return stretched(spec, factor), f"stretched: {sizes}"


def taper(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """A wall that leans more or less; where a lid or a part must fit the rim, the rim stays."""
    foot, rim = rng.uniform(0.74, 1.12), rng.uniform(0.9, 1.14)
    grow = np.array([foot, 1.0 if len(spec.links) > 1 else rim])
    return _reprofiled(spec, component, lambda p: swelled(p, grow), f"tapered: foot x {foot:.2f}, rim x {grow[1]:.2f}")


def belly(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """A wall that swells or is waisted between foot and rim."""
    by = rng.choice([-1.0, 1.0]) * rng.uniform(0.06, 0.2)
    curve = 1.0 + by * np.sin(np.linspace(0.0, np.pi, 7))
    words = f"{'swelled' if by > 0 else 'waisted'} by {abs(by):.0%}"
    return _reprofiled(spec, component, lambda p: swelled(p, curve), words)


def lip(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """A rim that bends outwards."""
    if len(spec.links) > 1:
        return None
    out = rng.uniform(0.0025, 0.006)
    return _reprofiled(spec, component, lambda p: flared(p, out, 0.2 * p.height), f"lip of {out * 1000:.1f} mm")


def thicken(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """A thicker or thinner wall and floor."""
    more = rng.uniform(-0.35, 0.6)
    return _reprofiled(
        spec, component, lambda p: thickened(p, more * p.thinnest), f"wall {'+' if more > 0 else ''}{more:.0%}"
    )


def resize(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """A handle, knob, cap or stem with other sizes; what holds it on stays where it is."""
    reach, span, thick = rng.uniform(0.85, 1.2), rng.uniform(0.8, 1.25), rng.uniform(0.85, 1.25)
    parts = parts_of(spec)
    body = [p for key, p in parts.items() if key[0] == component.link and key not in component.parts]
    out = outward(body, [parts[k] for k in component.parts])
    if out is None:
        return None
    # The handle grows away from the body: along `out` by the reach, across it by the span.
    factor = np.where(np.abs(out) > 0.5, reach, 1.0 if component.kind is Kind.CAP else span)
    anchor = _anchor([parts[k] for k in component.parts], out)
    changed = dict(parts)
    for key in component.parts:
        part = moved(parts[key], at(parts[key]) - anchor)
        part = stretched_part(part, factor)
        if (size := rod(part)) is not None and (was := rod(parts[key])) is not None:
            part = with_rod(part, was[0] * thick, size[1])
        changed[key] = moved(part, at(part) + anchor)
    return with_parts(spec, changed), f"{component.name}: reach x {reach:.2f}, span x {span:.2f}, rods x {thick:.2f}"


def outward(body: list[PartSpec], handle: list[PartSpec]) -> Array | None:
    """The axis, with its sign, along which a component stands off from the rest of its link, shape (3,)."""
    if not body:
        return None
    low, high = bounds(body)
    mine_low, mine_high = bounds(handle)
    over = np.concatenate([mine_high - high, low - mine_low])
    k = int(over.argmax())
    if over[k] <= 0:
        return None
    axis = np.zeros(3)
    axis[k % 3] = 1.0 if k < 3 else -1.0
    return axis


def _anchor(handle: list[PartSpec], out: Array) -> Array:
    """The point of a component where it meets the body: its end against ``out``, in its middle across [m]."""
    low, high = bounds(handle)
    k = int(np.abs(out).argmax())
    anchor = (low + high) / 2
    anchor[k] = low[k] if out[k] > 0 else high[k]
    return np.asarray(anchor)


def _reprofiled(spec: AssetSpec, component: Component, change: object, words: str) -> Edit | None:
    """The asset with the profile of a component's lathe changed, and all that hangs on it moved along."""
    assert callable(change)
    key = lathe_of(spec, component)
    if key is None:
        return None
    shape = parts_of(spec)[key].shape
    assert isinstance(shape, LatheShape)
    old = Profile.of(shape)
    return with_profile(spec, key, old, change(old)), words


def lathe_of(spec: AssetSpec, component: Component) -> Key | None:
    """The turned part of a component, the highest of several."""
    parts = parts_of(spec)
    lathes = [(Profile.of(shape).height, k) for k in component.parts if isinstance(shape := parts[k].shape, LatheShape)]
    return max(lathes)[1] if lathes else None


def with_profile(spec: AssetSpec, key: Key, old: Profile, new: Profile) -> AssetSpec:
    """The asset with another profile for one lathe; what hangs on its wall or stands on it goes along."""
    parts = parts_of(spec)
    base = at(parts[key])[2]
    changed = dict(parts)
    changed[key] = shaped(parts[key], new.shape)
    for other in components(spec):
        if other.link == key[0] and key not in other.parts:
            changed |= _follow({k: parts[k] for k in other.parts}, old, new, base)
    rest = [k for c in components(spec) if key in c.parts for k in c.parts if k != key]
    changed |= _follow({k: parts[k] for k in rest}, old, new, base)
    return with_parts(spec, changed)


def _follow(parts: dict[Key, PartSpec], old: Profile, new: Profile, base: float) -> dict[Key, PartSpec]:
    """Parts of one component where the wall that they hang on has moved."""
    if not parts:
        return {}
    low, _ = bounds(list(parts.values()))
    if low[2] - base >= old.rim - 0.003:
        rise = np.array([0.0, 0.0, new.rim - old.rim])
        return {key: moved(part, at(part) + rise) for key, part in parts.items()}
    scale = new.height / old.height

    def delta(part: PartSpec) -> float:
        z = float(at(part)[2]) - base
        return float(new.radius(new.foot + (z - old.foot) * scale) - old.radius(z))

    together = max((delta(p) for p in parts.values() if not is_radial(p)), default=0.0)
    out: dict[Key, PartSpec] = {}
    for key, part in parts.items():
        p = at(part)
        off = float(np.hypot(*p[:2]))
        rise = np.array([0.0, 0.0, new.foot + (p[2] - base - old.foot) * scale + base - p[2]])
        size = rod(part)
        if off < 1e-3 and size is not None:
            out[key] = moved(with_rod(part, size[0] + max(delta(part), 0.0), size[1]), p + rise)
        elif off > ATTACHED * float(old.radius(p[2] - base)):
            way = np.array([p[0], p[1], 0.0]) / off
            own = delta(part)
            if is_radial(part) and size is not None:  # it reaches from the wall, which moved by `own`, to the grip
                part = with_rod(part, size[0], max(size[1] + together - own, 0.002))
                out[key] = moved(part, p + way * (own + together) / 2 + rise)
            else:
                out[key] = moved(part, p + way * together + rise)
        else:
            out[key] = moved(part, p + rise)
    return out


def is_radial(part: PartSpec) -> bool:
    """Return whether a rod points away from the z axis of its link."""
    p, axis = at(part), axis_of(part)
    off = float(np.hypot(*p[:2]))
    return rod(part) is not None and off > 1e-3 and is_level(axis) and abs(float(axis[:2] @ p[:2])) / off > 0.9


GEOMETRY = (
    (stretch, (Kind.VESSEL, Kind.TURNED, Kind.CRATE, Kind.STACK, Kind.BUNCH, Kind.BODY)),
    (taper, (Kind.VESSEL, Kind.TURNED)),
    (belly, (Kind.VESSEL, Kind.TURNED)),
    (lip, (Kind.VESSEL,)),
    (thicken, (Kind.VESSEL,)),
    (resize, (Kind.HANDLE, Kind.KNOB, Kind.STEM, Kind.CAP)),
)
"""What can be done to which components."""
