"""Geometric edits, such as stretching an object along its axes.

The edits keep parts, link frames and joint travel consistent. Stretching by different factors requires that all links
have the same orientation at rest, so that no joint rotates its child's frame, as is common for furniture. Other objects
are scaled uniformly.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simfoundry.cousins.objects.components import MAIN, Component, Key, Kind, components, each, parts_of, with_parts
from simfoundry.cousins.objects.parts import aimed, at, bounds, is_radial, moved, rod, scaled, shaped, with_rod
from simfoundry.cousins.objects.profiles import Profile, Rng, flared, forms_of, outside, swelled, thickened, walled
from simfoundry.geometry.frames import Array
from simfoundry.scene.state import pose
from simfoundry.spec.models.asset import AssetSpec, AxisSpec, JointSpec, PartSpec
from simfoundry.spec.models.shapes import ConeShape, LatheShape, SphereShape

# Tolerance for recognizing rotation matrices that map coordinate axes onto coordinate axes.
SQUARE = 1e-6


def stretched(spec: AssetSpec, factor: Array) -> AssetSpec:
    """Return the asset scaled along x, y and z by ``factor``, an array of shape (3,).

    If the shapes do not allow this factor, the nearest allowed factor is used. Parts that are round about z remain
    round, and spheres remain spheres. The wall thickness is also scaled.
    """
    f = allowed(spec, factor)
    out = each(spec, lambda _, part: stretched_part(part, f))
    joints = {name: _joint(joint, f) for name, joint in spec.joints.items()}
    return out.model_copy(update={"joints": joints})


def allowed(spec: AssetSpec, factor: Array) -> Array:
    """Return the scale factor nearest to ``factor`` that the shapes in an asset allow.

    Both factors are arrays of shape (3,).
    """
    f = np.array(factor, dtype=np.float64)
    turns = [pose(joint.pose).rotation for joint in spec.joints.values()]
    turned = any(not _is_square(turn) or turn.trace() < 3 - SQUARE for turn in turns)
    if turned or is_ball(spec) or any(p.mesh is not None for p in parts_of(spec).values()):
        return np.full(3, float(np.cbrt(f.prod())))
    if any(_round_about_z(part) for part in parts_of(spec).values()):
        f[:2] = np.sqrt(f[0] * f[1])
    return f


def stretched_part(part: PartSpec, f: Array) -> PartSpec:
    """Return a part scaled along the axes of its link by ``f``, an array of shape (3,)."""
    there = moved(part, at(part) * f)
    if part.mesh is not None:
        even = float(np.cbrt(f.prod()))
        scale = tuple(v * even for v in part.scale) if isinstance(part.scale, tuple) else part.scale * even
        return there.model_copy(update={"scale": scale})
    assert part.shape is not None
    turn = pose(part.pose).rotation
    local = np.abs(turn.T) @ f
    if not _is_square(turn):
        size = rod(part)
        if size is not None:
            return _leaning_rod(there, size, turn[:, 2], f)
        upright = abs(turn[2, 2]) > 1 - SQUARE and abs(f[0] - f[1]) < SQUARE
        local = np.array(f) if upright else np.full(3, float(np.cbrt(f.prod())))
    return shaped(there, scaled(part.shape, local))


def _leaning_rod(part: PartSpec, size: tuple[float, float], axis: Array, f: Array) -> PartSpec:
    """Scale a cylinder or capsule that is not aligned with the axes by moving its end points."""
    along = axis * f
    length = float(np.linalg.norm(along))
    thick = float(np.sqrt(f.prod() / length))
    there = with_rod(part, size[0] * thick, size[1] * length)
    return there.model_copy(update={"pose": aimed(at(there), along / length)})


def _joint(joint: JointSpec, f: Array) -> JointSpec:
    way = joint.pose.model_copy(update={"xyz": tuple(float(v) for v in np.array(joint.pose.xyz) * f)})
    axes = {name: axis.model_copy(update=_stretched_limits(axis, f)) for name, axis in joint.axes.items()}
    return joint.model_copy(update={"pose": way, "axes": axes} | _stretched_limits(joint, f))


def _stretched_limits(motion: JointSpec | AxisSpec, f: Array) -> dict[str, object]:
    """Return the scaled limits of a sliding joint or axis as an update of its fields."""
    if motion.limits is None:
        return {}
    axis = np.abs(np.array(motion.axis)) / np.linalg.norm(motion.axis)
    low, high = (float(v * (axis @ f)) for v in motion.limits)
    return {"limits": (low, high)}


def is_ball(spec: AssetSpec) -> bool:
    """Return True if an asset consists of a single sphere."""
    return [type(part.shape) for part in parts_of(spec).values()] == [SphereShape]


def _round_about_z(part: PartSpec) -> bool:
    """Return True if x and y must be scaled equally to preserve a part's shape."""
    turn = pose(part.pose).rotation
    if not _is_square(turn):
        return rod(part) is None
    upright = abs(turn[2, 2]) > 1 - SQUARE
    return (isinstance(part.shape, LatheShape | ConeShape) or rod(part) is not None) and upright


def _is_square(rotation: Array) -> bool:
    """Return True if a rotation maps each coordinate axis onto a coordinate axis."""
    return bool((np.abs(np.abs(rotation).max(axis=0) - 1) < SQUARE).all())


# The changed asset and a description of the change.
Edit = tuple[AssetSpec, str]

# Range of the stretch factor along each axis. Variants with an implausible size or mass are rejected later.
LEAST, MOST = 0.74, 1.36

# Minimum distance of a part from the axis, as a fraction of the body's radius, to be attached to the body's wall.
ATTACHED = 0.6


def stretch(spec: AssetSpec, _component: Component, rng: Rng) -> Edit | None:
    """Stretch the entire object, including separate links such as lids, so that everything still fits."""
    if is_ball(spec):  # balls for the same sport differ little in size
        factor = np.full(3, rng.uniform(0.94, 1.06))
    else:
        factor = allowed(spec, np.exp(rng.uniform(np.log(LEAST), np.log(MOST), 3)))
    sizes = ", ".join(f"{axis} {f:.2f}" for axis, f in zip("xyz", factor, strict=True))
    return stretched(spec, factor), f"stretched: {sizes}"


# Ranges of the factors on the twin's height, rim radius and wall thickness, similar to the variety of cups in stores.
HEIGHTS, RIMS, WALLS = (0.74, 1.34), (0.84, 1.2), (0.85, 1.35)

# Minimum foot radius as a fraction of the rim radius. Vessels with smaller feet topple when pushed.
SMALLEST_FOOT = 0.35


def reshape(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Replace the silhouette of a vessel.

    The height, the width, the wall, the floor and the foot also change.
    """
    lathe = component.lathe(spec)
    if lathe is None or len(spec.links) > 1:  # another link, such as a lid, must fit the existing rim
        return None
    key, old = lathe
    if not old.is_hollow:
        return None
    widest = float(old.outer[:, 0].max())
    was = np.array([old.height, widest, old.thinnest])
    factors = [float(np.exp(rng.uniform(*np.log(between)))) for between in (HEIGHTS, RIMS, WALLS)]
    height, rim, wall = (float(v) for v in was * factors)
    forms = forms_of(old.height / widest)
    name = list(forms)[int(rng.integers(len(forms)))]
    share, form = forms[name]
    foot = rim * float(np.clip(rng.uniform(*share), SMALLEST_FOOT, 1.0))
    floor = max((old.height - old.depth) * float(rng.uniform(0.85, 1.2)), wall)
    made = walled(outside(form, foot, rim, height, rng), wall, floor)
    if made is None:
        return None
    return with_profile(spec, key, old, made), f"{name}, {height * 1000:.0f} mm high, {2 * rim * 1000:.0f} mm wide"


def taper(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Change the slope of a wall. The rim stays unchanged if another link, such as a lid, must fit onto it."""
    foot, rim = rng.uniform(0.74, 1.12), rng.uniform(0.9, 1.14)
    grow = np.array([foot, 1.0 if len(spec.links) > 1 else rim])
    return _reprofiled(spec, component, lambda p: swelled(p, grow), f"tapered: foot x {foot:.2f}, rim x {grow[1]:.2f}")


def belly(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Make a wall bulge outward or inward between the foot and the rim."""
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
    """Change the dimensions of a handle, knob, cap or stem without moving its attachment point."""
    reach, span, thick = rng.uniform(0.85, 1.2), rng.uniform(0.8, 1.25), rng.uniform(0.85, 1.25)
    out = component.outward(spec)
    if out is None:
        return None
    # Scale by the reach along `out`, the direction in which the component protrudes, and by the span across it.
    factor = np.where(np.abs(out) > 0.5, reach, 1.0 if component.kind is Kind.CAP else span)
    # The attachment point is at the end opposite to `out`, centered across it.
    low, high = bounds(component.parts_in(spec))
    anchor = np.where(out > 0, low, np.where(out < 0, high, (low + high) / 2))
    parts = parts_of(spec)
    for key in component.parts:
        was = parts[key]
        part = stretched_part(moved(was, at(was) - anchor), factor)
        if (size := rod(part)) is not None and (old := rod(was)) is not None:
            part = with_rod(part, old[0] * thick, size[1])
        parts[key] = moved(part, at(part) + anchor)
    return with_parts(spec, parts), f"{component.name}: reach x {reach:.2f}, span x {span:.2f}, rods x {thick:.2f}"


def _reprofiled(spec: AssetSpec, component: Component, change: Callable[[Profile], Profile], words: str) -> Edit | None:
    """Return the asset with the profile of a component changed.

    Attached parts are moved accordingly. The result is None if the component is not a solid of revolution.
    """
    lathe = component.lathe(spec)
    return (with_profile(spec, *lathe, change(lathe[1])), words) if lathe is not None else None


def with_profile(spec: AssetSpec, key: Key, old: Profile, new: Profile) -> AssetSpec:
    """Return the asset with the profile of a part replaced.

    Parts that are attached to its wall or located on top of it are moved accordingly.
    """
    parts = parts_of(spec)
    base = at(parts[key])[2]
    changed = parts | {key: shaped(parts[key], new.shape)}
    for other in components(spec):
        if other.link == key[0]:
            changed |= _follow({k: parts[k] for k in other.parts if k != key}, old, new, base)
    return with_parts(spec, changed)


def _follow(parts: dict[Key, PartSpec], old: Profile, new: Profile, base: float) -> dict[Key, PartSpec]:
    """Move the parts of a component with the wall to which they are attached.

    Args:
        parts: The parts of the component.
        old: Old profile of the wall.
        new: New profile of the wall.
        base: Height of the profile's frame in the link [m].
    """
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
            if is_radial(part) and size is not None:  # stretch the post from the moved wall to the grip
                part = with_rod(part, size[0], max(size[1] + together - own, 0.002))
                out[key] = moved(part, p + way * (own + together) / 2 + rise)
            else:
                out[key] = moved(part, p + way * together + rise)
        else:
            out[key] = moved(part, p + rise)
    return out


# Edits, and the kinds of components that they apply to.
GEOMETRY = (
    (reshape, (Kind.VESSEL,)),
    (stretch, MAIN),
    (taper, (Kind.VESSEL, Kind.TURNED)),
    (belly, (Kind.VESSEL, Kind.TURNED)),
    (lip, (Kind.VESSEL,)),
    (thicken, (Kind.VESSEL,)),
    (resize, (Kind.HANDLE, Kind.KNOB, Kind.STEM, Kind.CAP)),
)
