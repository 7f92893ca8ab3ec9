"""Topology edits: add, remove or replace parts where such objects exist in the real world."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.cousins.objects.components import Component, Kind, components
from simfoundry.cousins.objects.geometry import Edit, Rng, lathe_of, outward, with_profile
from simfoundry.cousins.objects.parts import (
    Key,
    Profile,
    aimed,
    at,
    bounds,
    moved,
    parts_of,
    raised_foot,
    rod,
    with_parts,
)
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.base import (
    BoxShape,
    CapsuleShape,
    CylinderShape,
    LatheShape,
    PoseSpec,
    Round,
    SphereShape,
)

SHALLOW = 0.6
"""Minimum ratio of height to width for a loop handle: bowls and plates have lugs or a foot."""


def remove(spec: AssetSpec, component: Component, _rng: Rng) -> Edit | None:
    """Remove a divider, band or stem. A handle stays: a mug without one is a cup."""
    parts = {key: part for key, part in parts_of(spec).items() if key not in component.parts}
    return with_parts(spec, parts), f"without its {component.name}"


def mirror(spec: AssetSpec, component: Component, _rng: Rng) -> Edit | None:
    """Duplicate the handle on the other side of a solid of revolution."""
    body = next((c for c in components(spec) if c.kind is Kind.VESSEL and c.link == component.link), None)
    handles = [c for c in components(spec) if c.kind is Kind.HANDLE and c.link == component.link]
    if body is None or len(handles) > 1:
        return None
    parts = parts_of(spec)
    added = {}
    for key in component.parts:
        part = parts[key]
        p = at(part) * np.array([-1.0, -1.0, 1.0])
        yaw = _yaw(part) + 180.0
        turned = part.pose.model_copy(update={"rpy_deg": _turned(part, yaw), "yaw_deg": None})
        added[_free(parts, key[0], f"{key[1]}_other")] = moved(part.model_copy(update={"pose": turned}), p)
    return with_parts(spec, parts | added), f"a second {component.name}"


def loop_handle(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a mug's loop handle to a vessel that has none."""
    key, profile = _vessel(spec, component)
    if key is None or profile is None or profile.height < SHALLOW * 2 * float(profile.outer[:, 0].max()):
        return None
    high, low = (profile.foot + profile.height * share for share in (rng.uniform(0.74, 0.84), rng.uniform(0.22, 0.34)))
    reach, thick = rng.uniform(0.022, 0.032), rng.uniform(0.0035, 0.0055)
    walls = [float(profile.radius(z)) for z in (low, high)]
    far = max(walls) + reach
    parts = parts_of(spec)
    base = at(parts[key])[2]
    added: dict[Key, PartSpec] = {}
    for name, z, wall in (("lower", low, walls[0]), ("upper", high, walls[1])):
        start = wall + thick - 0.6 * min(profile.wall, thick)  # its cap ends inside the wall
        pose = aimed(np.array([(start + far) / 2, 0.0, z + base]), np.array([1.0, 0.0, 0.0]))
        added[_free(parts, key[0], f"handle_{name}")] = PartSpec(shape=_capsule(thick, far - start), pose=pose)
    grip = PartSpec(shape=_capsule(thick, high - low), pose=aimed(np.array([far, 0.0, (low + high) / 2 + base]), UP))
    added[_free(parts, key[0], "handle_grip")] = grip
    return with_parts(spec, parts | added), f"a loop handle that reaches {far - max(walls):.3f} m out"


def lugs(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add two short lugs below the rim of a shallow vessel."""
    key, profile = _vessel(spec, component)
    if key is None or profile is None or profile.height > SHALLOW * 2 * float(profile.outer[:, 0].max()):
        return None
    if profile.height < 0.03:  # too little space below the rim of a plate
        return None
    thick, long = rng.uniform(0.004, 0.006), rng.uniform(0.024, 0.036)
    z = profile.rim - rng.uniform(1.2, 1.8) * thick
    off = float(profile.radius(z)) + 0.5 * thick
    parts = parts_of(spec)
    added: dict[Key, PartSpec] = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        spot = np.array([0.0, sign * off, z]) + at(parts[key])
        pose = aimed(spot, np.array([1.0, 0.0, 0.0]))
        added[_free(parts, key[0], f"lug_{side}")] = PartSpec(shape=_capsule(thick, long), pose=pose)
    return with_parts(spec, parts | added), f"two lugs of {long * 1000:.0f} mm"


def foot_ring(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a ring foot under a vessel."""
    key, profile = _vessel(spec, component)
    if key is None or profile is None or len(spec.links) > 1:
        return None
    up, inset = rng.uniform(0.003, 0.008), rng.uniform(0.04, 0.2) * float(profile.outer[1, 0])
    return with_profile(spec, key, profile, raised_foot(profile, up, inset)), f"a foot of {up * 1000:.0f} mm"


def knobs(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Replace the bar handle of a drawer by one or two round knobs."""
    parts = parts_of(spec)
    body = [p for key, p in parts.items() if key[0] == component.link and key not in component.parts]
    out = outward(body, [parts[k] for k in component.parts])
    drawers = {joint.child for joint in spec.joints.values() if joint.type == "prismatic"}
    if out is None or component.link not in drawers or abs(out[2]) > 0.5:
        return None
    low, high = bounds([parts[k] for k in component.parts])
    wide = high - low
    along = np.array([abs(out[1]), abs(out[0]), 0.0])
    k = int(np.abs(out).argmax())
    length = float(wide[k])
    count = int(rng.integers(1, 3))
    radius = float(np.clip(rng.uniform(0.011, 0.016), 0.0, wide[2]))
    spread = 0.0 if count == 1 else 0.35 * float(wide @ along)
    middle = (low + high) / 2
    kept = {key: part for key, part in parts.items() if key not in component.parts}
    material = parts[component.parts[0]].material
    added: dict[Key, PartSpec] = {}
    for n, sign in enumerate((0.0,) if count == 1 else (-1.0, 1.0)):
        spot = middle + sign * spread * along
        neck = PartSpec(shape=_cylinder(0.45 * radius, length), pose=aimed(spot, out), material=material)
        head = spot + out * (length / 2 - 0.3 * radius)
        added[_free(kept, component.link, f"knob_neck_{n}")] = neck
        added[_free(kept, component.link, f"knob_{n}")] = PartSpec(
            shape=_cylinder(radius, 0.8 * radius), pose=aimed(head, out), material=material
        )
    return with_parts(spec, kept | added), f"{count} knob{'s' * (count > 1)} in place of its {component.name}"


def another_knob(spec: AssetSpec, component: Component, _rng: Rng) -> Edit | None:
    """Add a third knob in the middle between two."""
    peers = [c for c in components(spec) if c.kind is Kind.KNOB and c.link == component.link]
    if len(peers) != 2:
        return None
    parts = parts_of(spec)
    a, b = (parts[c.parts[0]] for c in peers)
    if float(np.linalg.norm(at(a) - at(b))) < 4 * (rod(a) or (0.02,))[0]:
        return None
    added = {_free(parts, component.link, "knob_middle"): moved(a, (at(a) + at(b)) / 2)}
    return with_parts(spec, parts | added), "a third knob"


def lid_knob(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a knob on top of a lid."""
    parts = parts_of(spec)
    if any(key[1].startswith("top_knob") for key in parts):
        return None
    low, high = bounds([parts[k] for k in component.parts])
    radius, height = rng.uniform(0.01, 0.016), rng.uniform(0.014, 0.022)
    key = lathe_of(spec, component)
    spot = np.array([*(at(parts[key])[:2] if key else (low + high)[:2] / 2), high[2] + height / 2 - 0.001])
    added = {_free(parts, component.link, "top_knob"): PartSpec(shape=_cylinder(radius, height), pose=aimed(spot, UP))}
    return with_parts(spec, parts | added), "a knob on the lid"


def another_divider(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a divider beside the existing one."""
    parts = parts_of(spec)
    part = parts[component.parts[0]]
    if not isinstance(part.shape, BoxShape) or part.pose.rpy_deg or part.pose.yaw_deg:
        return None
    low, high = bounds([p for key, p in parts.items() if key[0] == component.link])
    across = int(np.argmin(part.shape.box))
    if across == 2:
        return None
    spot = at(part)
    room = (low[across] - spot[across], high[across] - spot[across])
    spot[across] += rng.uniform(0.4, 0.6) * max(room, key=abs)
    added = {_free(parts, component.link, "divider_more"): moved(part, spot)}
    return with_parts(spec, parts | added), "an additional divider"


def crate_divider(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a low board across an open box."""
    if any(c.kind is Kind.DIVIDER or c.kind is Kind.DRAWER for c in components(spec)):
        return None
    parts = parts_of(spec)
    low, high = bounds([parts[k] for k in component.parts])
    thick = min(min(_box(parts[k])) for k in component.parts)
    size = high - low
    k = int(size[:2].argmax())
    box = size * np.array([1.0, 1.0, rng.uniform(0.3, 0.6)])
    box[k], box[1 - k] = thick, size[1 - k] - 1.5 * thick
    spot = (low + high) / 2
    spot[k] += rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.3) * size[k]
    spot[2] = low[2] + 0.5 * thick + box[2] / 2
    x, y, z = (float(v) for v in box)
    added = {_free(parts, component.link, "divider"): PartSpec(shape=BoxShape(box=(x, y, z)), pose=_upright(spot))}
    return with_parts(spec, parts | added), "a board across"


def feet(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add four round feet and raise all other parts."""
    if any(c.kind is Kind.BASE for c in components(spec)):
        return None
    parts = parts_of(spec)
    low, high = bounds([parts[k] for k in component.parts])
    size = high - low
    if min(size[:2]) < 0.08 or low[2] < -1e-6:
        return None
    up, radius = float(rng.uniform(0.006, 0.014)), 0.05 * float(min(size[:2])) + 0.003
    lifted = {key: moved(part, at(part) + up * UP) if key[0] == component.link else part for key, part in parts.items()}
    inset = 1.4 * radius
    for n, (x, y) in enumerate(
        (x, y) for x in (low[0] + inset, high[0] - inset) for y in (low[1] + inset, high[1] - inset)
    ):
        pose = _upright(np.array([x, y, low[2] + up / 2]))
        lifted[_free(lifted, component.link, f"foot_{n}")] = PartSpec(shape=_cylinder(radius, up), pose=pose)
    joints = {
        name: joint.model_copy(update={"pose": _raised(joint.pose, up)}) if joint.parent == component.link else joint
        for name, joint in spec.joints.items()
    }
    return with_parts(spec, lifted).model_copy(update={"joints": joints}), f"on four feet of {up * 1000:.0f} mm"


def layer(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Duplicate or remove a layer of a stack, except the lowest and the highest."""
    parts = parts_of(spec)
    order = sorted(component.parts, key=lambda k: at(parts[k])[2] + bounds([parts[k]])[0][2])
    if len(order) < 4:
        return None
    chosen = order[int(rng.integers(1, len(order) - 1))]
    low, high = bounds([parts[chosen]])
    thick = float(high[2] - low[2])
    more = bool(rng.integers(0, 2))
    changed = {}
    for key, part in parts.items():
        above = key in component.parts and bounds([part])[0][2] > low[2] + 1e-6
        if key == chosen and not more:
            continue
        changed[key] = moved(part, at(part) + (thick if more else -thick) * UP) if above else part
    if more:
        changed[_free(parts, chosen[0], f"{chosen[1]}_more")] = moved(parts[chosen], at(parts[chosen]) + thick * UP)
    return with_parts(spec, changed), f"{'a second' if more else 'without'} {chosen[1]}"


def berry(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Remove a berry from the top of a bunch, or add one beside the highest."""
    parts = parts_of(spec)
    order = sorted(component.parts, key=lambda k: (at(parts[k])[2], k))
    top = [k for k in order if at(parts[k])[2] > at(parts[order[0]])[2] + 1e-6]
    if rng.integers(0, 2) and len(top) > 2:
        gone = top[int(rng.integers(0, len(top)))]
        return with_parts(spec, {k: p for k, p in parts.items() if k != gone}), "one berry removed"
    chosen = parts[order[-1]]
    assert isinstance(chosen.shape, SphereShape)
    angle = rng.uniform(0.0, 2 * math.pi)
    step = chosen.shape.sphere * 1.3 * np.array([math.cos(angle), math.sin(angle), 0.5])
    return with_parts(
        spec, parts | {_free(parts, component.link, "berry"): moved(chosen, at(chosen) + step)}
    ), "one berry added"


def leaf(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a leaf at the stem of a round fruit."""
    if not any(c.kind is Kind.TURNED for c in components(spec)):
        return None
    parts = parts_of(spec)
    key = component.parts[0]
    if any(k[1] == "leaf" for k in parts) or rod(parts[key]) is None:
        return None
    spot = at(parts[key]) + np.array([0.009, 0.0, 0.003])
    size = (round(rng.uniform(0.014, 0.02), 4), round(rng.uniform(0.008, 0.011), 4), 0.001)
    pose = PoseSpec(xyz=tuple(float(v) for v in spot), yaw_deg=round(float(rng.uniform(-30, 30)), 1))  # type: ignore[arg-type]
    green = (0.3, 0.52, 0.18)
    part = PartSpec(shape=BoxShape(box=size), pose=pose, color=green, material=parts[key].material)
    return with_parts(spec, parts | {_free(parts, component.link, "leaf"): part}), "a leaf at its stem"


def clip(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a clip along a cap that lies horizontally, as on a pen."""
    parts = parts_of(spec)
    key = component.parts[0]
    low, high = bounds([parts[key]])
    size = high - low
    if size[0] < 2 * size[2] or any(k[1] == "clip" for k in parts):
        return None
    long = float(rng.uniform(0.55, 0.8) * size[0])
    spot = np.array([(low[0] + high[0]) / 2, 0.0, high[2] + 0.0008])
    part = parts[key].model_copy(update={"shape": BoxShape(box=(long, 0.0035, 0.002)), "pose": _upright(spot)})
    return with_parts(spec, parts | {_free(parts, component.link, "clip"): part}), "a clip on its cap"


UP = np.array([0.0, 0.0, 1.0])

TOPOLOGY = (
    (remove, (Kind.DIVIDER, Kind.BAND, Kind.STEM)),
    (mirror, (Kind.HANDLE,)),
    (loop_handle, (Kind.VESSEL,)),
    (lugs, (Kind.VESSEL,)),
    (foot_ring, (Kind.VESSEL,)),
    (knobs, (Kind.HANDLE,)),
    (another_knob, (Kind.KNOB,)),
    (lid_knob, (Kind.LID,)),
    (another_divider, (Kind.DIVIDER,)),
    (crate_divider, (Kind.CRATE,)),
    (feet, (Kind.CRATE, Kind.BODY)),
    (layer, (Kind.STACK,)),
    (berry, (Kind.BUNCH,)),
    (leaf, (Kind.STEM,)),
    (clip, (Kind.CAP,)),
)
"""Edits and the kinds of components that they apply to."""


def _vessel(spec: AssetSpec, component: Component) -> tuple[Key | None, Profile | None]:
    """Lathe of a vessel that has no handle yet, and its profile."""
    key = lathe_of(spec, component)
    if key is None or len(spec.links) > 1 or any(c.kind is Kind.HANDLE for c in components(spec)):
        return None, None
    shape = parts_of(spec)[key].shape
    assert isinstance(shape, LatheShape)
    return key, Profile.of(shape)


def _free(parts: dict[Key, PartSpec], link: str, name: str) -> Key:
    """Return an unused name for a new part of a link."""
    n, key = 1, (link, name)
    while key in parts:
        n, key = n + 1, (link, f"{name}_{n + 1}")
    return key


def _capsule(radius: float, height: float) -> CapsuleShape:
    return CapsuleShape(capsule=Round(radius=float(radius), height=float(height)))


def _cylinder(radius: float, height: float) -> CylinderShape:
    return CylinderShape(cylinder=Round(radius=float(radius), height=float(height)))


def _box(part: PartSpec) -> tuple[float, float, float]:
    assert isinstance(part.shape, BoxShape)
    return part.shape.box


def _upright(xyz: Array) -> PoseSpec:
    x, y, z = (round(float(v), 6) for v in xyz)
    return PoseSpec(xyz=(x, y, z))


def _raised(pose: PoseSpec, up: float) -> PoseSpec:
    x, y, z = pose.xyz
    return pose.model_copy(update={"xyz": (x, y, z + up)})


def _yaw(part: PartSpec) -> float:
    return part.pose.rpy_deg[2] if part.pose.rpy_deg is not None else part.pose.yaw_deg or 0.0


def _turned(part: PartSpec, yaw: float) -> tuple[float, float, float]:
    roll, pitch = part.pose.rpy_deg[:2] if part.pose.rpy_deg is not None else (0.0, 0.0)
    return roll, pitch, yaw
