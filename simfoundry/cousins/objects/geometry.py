"""Geometric edits: stretch an object along its axes, with its parts, link frames and joint travel kept consistent.

All links must have the same orientation at rest (no joint rotates its child's frame), as in furniture; otherwise only a
uniform factor keeps them together.
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
from simfoundry.scene.state import pose
from simfoundry.spec.models.asset import AssetSpec, JointSpec, PartSpec
from simfoundry.spec.models.base import BoxShape, LatheShape, PrismShape, Shape, SphereShape

SQUARE = 1e-6
"""Tolerance between a rotation matrix and a permutation for a rotation that maps boxes onto the axes."""


def stretched(spec: AssetSpec, factor: Array) -> AssetSpec:
    """Return the asset with its x, y and z scaled by ``factor``, shape (3,), or by the nearest factor its shapes allow.

    Parts round about z keep x and y equal and balls stay balls; wall thickness scales with the rest.
    """
    f = allowed(spec, factor)
    out = each(spec, lambda _, part: stretched_part(part, f))
    joints = {name: _joint(joint, f) for name, joint in spec.joints.items()}
    return out.model_copy(update={"joints": joints})


def allowed(spec: AssetSpec, factor: Array) -> Array:
    """Nearest factor to ``factor`` that the shapes of an asset allow, shape (3,)."""
    f = np.array(factor, dtype=np.float64)
    turned = any(not pose(joint.pose).is_identity and _turns(joint) for joint in spec.joints.values())
    if turned or is_ball(spec) or any(p.mesh is not None for p in parts_of(spec).values()):
        return np.full(3, float(np.cbrt(f.prod())))
    if any(_round_about_z(part) for part in parts_of(spec).values()):
        f[:2] = np.sqrt(f[0] * f[1])
    return f


def stretched_part(part: PartSpec, f: Array) -> PartSpec:
    """Return a part with the axes of its link scaled by ``f``, shape (3,)."""
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
    """Return a shape with its own axes scaled by ``f``, shape (3,)."""
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
    """Scale a cylinder or capsule that is not aligned with the axes by moving its end points."""
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
    """Return whether an asset consists of a single ball."""
    every = list(parts_of(spec).values())
    return len(every) == 1 and isinstance(every[0].shape, SphereShape)


def _round_about_z(part: PartSpec) -> bool:
    """Return whether a part would lose its shape if x and y were scaled differently."""
    turn = pose(part.pose).rotation
    if not _is_square(turn):
        return rod(part) is None
    upright = abs(turn[2, 2]) > 1 - SQUARE
    return (isinstance(part.shape, LatheShape) or rod(part) is not None) and upright


def _is_square(rotation: Array) -> bool:
    """Return whether a rotation maps axes onto axes."""
    return bool((np.abs(np.abs(rotation).max(axis=0) - 1) < SQUARE).all())


Edit = tuple[AssetSpec, str]
"""The changed asset, and a description of the change."""

Rng = np.random.Generator

LEAST, MOST = 0.74, 1.36
"""Range of the stretch factor along each axis; results outside their category are rejected by size and mass."""

ATTACHED = 0.6
"""Parts farther from the axis than this share of the body's radius are attached to its wall."""


def stretch(spec: AssetSpec, _component: Component, rng: Rng) -> Edit | None:
    """Stretch the whole object in length, width and height, including loose links so that they fit."""
    parts = list(parts_of(spec).values())
    if len(parts) == 1 and isinstance(parts[0].shape, SphereShape):  # balls of one game differ little
        factor = np.full(3, rng.uniform(0.94, 1.06))
    else:
        factor = allowed(spec, np.exp(rng.uniform(np.log(LEAST), np.log(MOST), 3)))
    sizes = ", ".join(f"{axis} {f:.2f}" for axis, f in zip("xyz", factor, strict=True))
    return stretched(spec, factor), f"stretched: {sizes}"


def taper(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Change the slope of a wall; the rim is unchanged if a lid or another part must fit it."""
    foot, rim = rng.uniform(0.74, 1.12), rng.uniform(0.9, 1.14)
    grow = np.array([foot, 1.0 if len(spec.links) > 1 else rim])
    return _reprofiled(spec, component, lambda p: swelled(p, grow), f"tapered: foot x {foot:.2f}, rim x {grow[1]:.2f}")


def belly(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Bulge or waist a wall between foot and rim."""
    by = rng.choice([-1.0, 1.0]) * rng.uniform(0.06, 0.2)
    curve = 1.0 + by * np.sin(np.linspace(0.0, np.pi, 7))
    words = f"{'swelled' if by > 0 else 'waisted'} by {abs(by):.0%}"
    return _reprofiled(spec, component, lambda p: swelled(p, curve), words)


def lip(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Bend the rim outward."""
    if len(spec.links) > 1:
        return None
    out = rng.uniform(0.0025, 0.006)
    return _reprofiled(spec, component, lambda p: flared(p, out, 0.2 * p.height), f"lip of {out * 1000:.1f} mm")


def thicken(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Change the thickness of the wall and floor."""
    more = rng.uniform(-0.35, 0.6)
    return _reprofiled(
        spec, component, lambda p: thickened(p, more * p.thinnest), f"wall {'+' if more > 0 else ''}{more:.0%}"
    )


def resize(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Change the sizes of a handle, knob, cap or stem; its attachment point stays in place."""
    reach, span, thick = rng.uniform(0.85, 1.2), rng.uniform(0.8, 1.25), rng.uniform(0.85, 1.25)
    parts = parts_of(spec)
    body = [p for key, p in parts.items() if key[0] == component.link and key not in component.parts]
    out = outward(body, [parts[k] for k in component.parts])
    if out is None:
        return None
    # The handle extends from the body: scaled along `out` by the reach and across it by the span.
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
    """Signed axis along which a component protrudes from the rest of its link, shape (3,)."""
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
    """Attachment point of a component: its end opposite to ``out``, centered across [m]."""
    low, high = bounds(handle)
    k = int(np.abs(out).argmax())
    anchor = (low + high) / 2
    anchor[k] = low[k] if out[k] > 0 else high[k]
    return np.asarray(anchor)


def _reprofiled(spec: AssetSpec, component: Component, change: object, words: str) -> Edit | None:
    """Return the asset with the profile of a component's lathe changed, and all attached parts moved along."""
    assert callable(change)
    key = lathe_of(spec, component)
    if key is None:
        return None
    shape = parts_of(spec)[key].shape
    assert isinstance(shape, LatheShape)
    old = Profile.of(shape)
    return with_profile(spec, key, old, change(old)), words


def lathe_of(spec: AssetSpec, component: Component) -> Key | None:
    """Key of the component's solid of revolution, the highest if there are several."""
    parts = parts_of(spec)
    lathes = [(Profile.of(shape).height, k) for k in component.parts if isinstance(shape := parts[k].shape, LatheShape)]
    return max(lathes)[1] if lathes else None


def with_profile(spec: AssetSpec, key: Key, old: Profile, new: Profile) -> AssetSpec:
    """Return the asset with another profile for one lathe; parts attached to its wall or standing on it are moved
    along.
    """
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
    """Move the parts of one component with the wall that they are attached to."""
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
            if is_radial(part) and size is not None:  # it extends from the wall, which moved by `own`, to the grip
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
"""Edits and the kinds of components that they apply to."""
