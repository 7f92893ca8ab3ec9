"""Topology edits, which add, remove or replace parts.

They produce only kinds of objects that really exist.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from simfoundry.cousins.objects.components import Component, Kind, components, each, parts_of, with_added, with_parts
from simfoundry.cousins.objects.geometry import Edit, with_profile
from simfoundry.cousins.objects.parts import UP, aimed, at, bounds, capsule, cylinder, moved, rod
from simfoundry.cousins.objects.profiles import Profile, Rng, raised_foot
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.shapes import BoxShape, SphereShape

FORWARD = np.array([1.0, 0.0, 0.0])

# Minimum ratio of height to width for a loop handle. Bowls and plates get lugs or a foot instead.
SHALLOW = 0.6


def remove(spec: AssetSpec, component: Component, _rng: Rng) -> Edit | None:
    """Remove a divider, band or stem.

    Handles are not removed. A mug without a handle, for example, would be a cup.
    """
    return with_added(spec, component.link, {}, component.parts), f"without its {component.name}"


def mirror(spec: AssetSpec, component: Component, _rng: Rng) -> Edit | None:
    """Duplicate the handle on the other side of a solid of revolution."""
    kinds = [c.kind for c in components(spec) if c.link == component.link]
    if Kind.VESSEL not in kinds or kinds.count(Kind.HANDLE) > 1:
        return None
    added = {}
    for (_, name), part in zip(component.parts, component.parts_in(spec), strict=True):
        roll, pitch, yaw = part.pose.rpy_deg or (0.0, 0.0, part.pose.yaw_deg or 0.0)
        turned = part.pose.model_copy(update={"rpy_deg": (roll, pitch, yaw + 180.0), "yaw_deg": None})
        opposite = at(part) * np.array([-1.0, -1.0, 1.0])
        added[f"{name}_other"] = moved(part.model_copy(update={"pose": turned}), opposite)
    return with_added(spec, component.link, added), f"a second {component.name}"


def loop_handle(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a loop handle, as on a mug, to a vessel without a handle."""
    vessel = _vessel(spec, component)
    if vessel is None or _is_shallow(vessel[0]):
        return None
    profile, base = vessel
    high, low = (profile.foot + profile.height * share for share in (rng.uniform(0.74, 0.84), rng.uniform(0.22, 0.34)))
    reach, thick = rng.uniform(0.022, 0.032), rng.uniform(0.0035, 0.0055)
    walls = [float(profile.radius(z)) for z in (low, high)]
    far = max(walls) + reach
    added = {}
    for name, z, wall in (("lower", low, walls[0]), ("upper", high, walls[1])):
        start = wall + thick - 0.6 * min(profile.wall, thick)  # the cap of the capsule ends inside the wall
        pose = aimed(np.array([(start + far) / 2, 0.0, z + base[2]]), FORWARD)
        added[f"handle_{name}"] = PartSpec(shape=capsule(thick, far - start), pose=pose)
    middle = np.array([far, 0.0, (low + high) / 2 + base[2]])
    added["handle_grip"] = PartSpec(shape=capsule(thick, high - low), pose=aimed(middle, UP))
    return with_added(spec, component.link, added), f"a loop handle that protrudes {far - max(walls):.3f} m"


def lugs(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add two short lugs below the rim of a shallow vessel."""
    vessel = _vessel(spec, component)
    if vessel is None or not _is_shallow(vessel[0]) or vessel[0].height < 0.03:  # a plate has no space below its rim
        return None
    profile, base = vessel
    thick, long = rng.uniform(0.004, 0.006), rng.uniform(0.024, 0.036)
    z = profile.rim - rng.uniform(1.2, 1.8) * thick
    off = float(profile.radius(z)) + 0.5 * thick
    added = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        pose = aimed(np.array([0.0, sign * off, z]) + base, FORWARD)
        added[f"lug_{side}"] = PartSpec(shape=capsule(thick, long), pose=pose)
    return with_added(spec, component.link, added), f"two lugs of {long * 1000:.0f} mm"


def foot_ring(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a ring foot under a vessel."""
    lathe = component.lathe(spec) if _vessel(spec, component) is not None else None
    if lathe is None:
        return None
    key, profile = lathe
    up, inset = rng.uniform(0.003, 0.008), rng.uniform(0.04, 0.2) * float(profile.outer[1, 0])
    return with_profile(spec, key, profile, raised_foot(profile, up, inset)), f"a foot of {up * 1000:.0f} mm"


def knobs(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Replace a drawer's bar handle with one or two round knobs."""
    out = component.outward(spec)
    drawers = {joint.child for joint in spec.single_joints.values() if joint.type == "prismatic"}
    if out is None or component.link not in drawers or abs(out[2]) > 0.5:
        return None
    old = component.parts_in(spec)
    low, high = bounds(old)
    wide, middle = high - low, (low + high) / 2
    along = np.array([abs(out[1]), abs(out[0]), 0.0])
    length = float(wide[int(np.abs(out).argmax())])
    count = int(rng.integers(1, 3))
    radius = float(np.clip(rng.uniform(0.011, 0.016), 0.0, wide[2]))
    spread = 0.0 if count == 1 else 0.35 * float(wide @ along)
    added = {}
    for n, sign in enumerate((0.0,) if count == 1 else (-1.0, 1.0)):
        spot = middle + sign * spread * along
        head = spot + out * (length / 2 - 0.3 * radius)
        shapes = {f"knob_neck_{n}": (cylinder(0.45 * radius, length), spot)}
        shapes[f"knob_{n}"] = (cylinder(radius, 0.8 * radius), head)
        for name, (shape, where) in shapes.items():
            added[name] = PartSpec(shape=shape, pose=aimed(where, out), material=old[0].material)
    words = f"{count} knob{'s' * (count > 1)} in place of its {component.name}"
    return with_added(spec, component.link, added, component.parts), words


def another_knob(spec: AssetSpec, component: Component, _rng: Rng) -> Edit | None:
    """Add a third knob halfway between two knobs."""
    peers = [c for c in components(spec) if c.kind is Kind.KNOB and c.link == component.link]
    if len(peers) != 2:
        return None
    a, b = (c.parts_in(spec)[0] for c in peers)
    if float(np.linalg.norm(at(a) - at(b))) < 4 * (rod(a) or (0.02,))[0]:
        return None
    return with_added(spec, component.link, {"knob_middle": moved(a, (at(a) + at(b)) / 2)}), "a third knob"


def lid_knob(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a knob to the top of a lid."""
    if any(name.startswith("top_knob") for _, name in parts_of(spec)):
        return None
    low, high = bounds(component.parts_in(spec))
    radius, height = rng.uniform(0.01, 0.016), rng.uniform(0.014, 0.022)
    lathe = component.lathe(spec)
    middle = at(parts_of(spec)[lathe[0]]) if lathe is not None else (low + high) / 2
    spot = np.array([*middle[:2], high[2] + height / 2 - 0.001])
    knob = PartSpec(shape=cylinder(radius, height), pose=aimed(spot, UP))
    return with_added(spec, component.link, {"top_knob": knob}), "a knob on the lid"


def another_divider(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a divider beside an existing one."""
    part = component.parts_in(spec)[0]
    if not isinstance(part.shape, BoxShape) or part.pose.rpy_deg or part.pose.yaw_deg:
        return None
    low, high = bounds(spec.links[component.link].parts.values())
    across = int(np.argmin(part.shape.box))
    if across == 2:
        return None
    spot = at(part)
    room = (low[across] - spot[across], high[across] - spot[across])
    spot[across] += rng.uniform(0.4, 0.6) * max(room, key=abs)
    return with_added(spec, component.link, {"divider_more": moved(part, spot)}), "an additional divider"


def crate_divider(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a low divider across an open box."""
    if any(c.kind is Kind.DIVIDER or c.kind is Kind.DRAWER for c in components(spec)):
        return None
    boards = component.parts_in(spec)
    low, high = bounds(boards)
    thick = min(min(board.shape.box) for board in boards if isinstance(board.shape, BoxShape))
    size = high - low
    k = int(size[:2].argmax())
    box = size * np.array([1.0, 1.0, rng.uniform(0.3, 0.6)])
    box[k], box[1 - k] = thick, size[1 - k] - 1.5 * thick
    spot = (low + high) / 2
    spot[k] += rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.3) * size[k]
    spot[2] = low[2] + 0.5 * thick + box[2] / 2
    x, y, z = (float(v) for v in box)
    board = PartSpec(shape=BoxShape(box=(x, y, z)), pose=aimed(spot, UP))
    return with_added(spec, component.link, {"divider": board}), "a board across"


def feet(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add four round feet, and raise all other parts."""
    if any(c.kind is Kind.BASE for c in components(spec)):
        return None
    low, high = bounds(component.parts_in(spec))
    size = high - low
    if min(size[:2]) < 0.08 or low[2] < -1e-6:
        return None
    up, radius = float(rng.uniform(0.006, 0.014)), 0.05 * float(min(size[:2])) + 0.003
    own = component.link
    lifted = each(spec, lambda key, part: moved(part, at(part) + up * UP) if key[0] == own else part)
    inset = 1.4 * radius
    corners = product((low[0] + inset, high[0] - inset), (low[1] + inset, high[1] - inset))
    added = {
        f"foot_{n}": PartSpec(shape=cylinder(radius, up), pose=aimed(np.array([x, y, low[2] + up / 2]), UP))
        for n, (x, y) in enumerate(corners)
    }
    joints = {
        name: joint.model_copy(update={"pose": _raised(joint.pose, up)}) if joint.parent == own else joint
        for name, joint in spec.joints.items()
    }
    footed = with_added(lifted, own, added).model_copy(update={"joints": joints})
    return footed, f"on four feet of {up * 1000:.0f} mm"


def layer(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Duplicate or remove a layer of a stack.

    The lowest and highest layers stay unchanged.
    """
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
    added = {f"{chosen[1]}_more": moved(parts[chosen], at(parts[chosen]) + thick * UP)} if more else {}
    words = f"{'a second' if more else 'without'} {chosen[1]}"
    return with_added(with_parts(spec, changed), component.link, added), words


def berry(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Remove a random berry from a bunch, or add a berry next to the highest one.

    Berries in the lowest layer are not removed.
    """
    parts = parts_of(spec)
    order = sorted(component.parts, key=lambda k: (at(parts[k])[2], k))
    top = [k for k in order if at(parts[k])[2] > at(parts[order[0]])[2] + 1e-6]
    if rng.integers(0, 2) and len(top) > 2:
        gone = top[int(rng.integers(0, len(top)))]
        return with_added(spec, component.link, {}, (gone,)), "one berry removed"
    chosen = parts[order[-1]]
    assert isinstance(chosen.shape, SphereShape)
    angle = rng.uniform(0.0, 2 * math.pi)
    step = chosen.shape.sphere * 1.3 * np.array([math.cos(angle), math.sin(angle), 0.5])
    return with_added(spec, component.link, {"berry": moved(chosen, at(chosen) + step)}), "one berry added"


def leaf(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a leaf to the stem of a round fruit."""
    if not any(c.kind is Kind.TURNED for c in components(spec)):
        return None
    stem = component.parts_in(spec)[0]
    if any(name == "leaf" for _, name in parts_of(spec)) or rod(stem) is None:
        return None
    spot = at(stem) + np.array([0.009, 0.0, 0.003])
    size = (round(rng.uniform(0.014, 0.02), 4), round(rng.uniform(0.008, 0.011), 4), 0.001)
    pose = PoseSpec(xyz=tuple(float(v) for v in spot), yaw_deg=round(float(rng.uniform(-30, 30)), 1))  # type: ignore[arg-type]
    green = (0.3, 0.52, 0.18)
    part = PartSpec(shape=BoxShape(box=size), pose=pose, color=green, material=stem.material)
    return with_added(spec, component.link, {"leaf": part}), "a leaf at its stem"


def clip(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Add a clip to a horizontal cap, as on a pen."""
    cap = component.parts_in(spec)[0]
    low, high = bounds([cap])
    size = high - low
    if size[0] < 2 * size[2] or any(name == "clip" for _, name in parts_of(spec)):
        return None
    long = float(rng.uniform(0.55, 0.8) * size[0])
    spot = np.array([(low[0] + high[0]) / 2, 0.0, high[2] + 0.0008])
    part = cap.model_copy(update={"shape": BoxShape(box=(long, 0.0035, 0.002)), "pose": aimed(spot, UP)})
    return with_added(spec, component.link, {"clip": part}), "a clip on its cap"


# Edits, and the kinds of components that they apply to.
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


def _vessel(spec: AssetSpec, component: Component) -> tuple[Profile, Array] | None:
    """Return the profile of a vessel and its position in the link [m].

    The position has shape (3,). The result is None if the component is not a vessel, already has a handle, or belongs
    to an object with several links.
    """
    lathe = component.lathe(spec)
    if lathe is None or len(spec.links) > 1 or any(c.kind is Kind.HANDLE for c in components(spec)):
        return None
    return lathe[1], at(parts_of(spec)[lathe[0]])


def _is_shallow(profile: Profile) -> bool:
    return profile.height < SHALLOW * 2 * float(profile.outer[:, 0].max())


def _raised(pose: PoseSpec, up: float) -> PoseSpec:
    x, y, z = pose.xyz
    return pose.model_copy(update={"xyz": (x, y, z + up)})
