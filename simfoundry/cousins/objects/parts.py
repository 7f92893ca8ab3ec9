"""Edit the parts of an asset document, and identify its functional components.

Each edit returns a new document. Components (body, handles, lid, drawers) are identified by names, joints and geometry.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simfoundry.cousins.objects.profiles import Profile
from simfoundry.cousins.recipe.candidate import free_name
from simfoundry.geometry.frames import Array
from simfoundry.scene.state import pose
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.base import (
    BoxShape,
    CapsuleShape,
    CylinderShape,
    LatheShape,
    PoseSpec,
    PrismShape,
    Round,
    Shape,
    SphereShape,
)

# Identifier of a part: the name of its link and the name of the part.
Key = tuple[str, str]

Parts = Mapping[Key, PartSpec]

UP = np.array([0.0, 0.0, 1.0])


def parts_of(spec: AssetSpec) -> dict[Key, PartSpec]:
    """Return the parts of all links by key."""
    return {(link, name): part for link, body in spec.links.items() for name, part in body.parts.items()}


def with_parts(spec: AssetSpec, parts: Parts) -> AssetSpec:
    """Return the spec with its parts replaced by the given parts, in the given order."""
    links = {
        name: link.model_copy(update={"parts": {p: part for (owner, p), part in parts.items() if owner == name}})
        for name, link in spec.links.items()
    }
    return spec.model_copy(update={"links": links})


def each(spec: AssetSpec, change: Callable[[Key, PartSpec], PartSpec]) -> AssetSpec:
    """Return the spec with ``change`` applied to every part."""
    return with_parts(spec, {key: change(key, part) for key, part in parts_of(spec).items()})


def with_added(spec: AssetSpec, link: str, added: Mapping[str, PartSpec], but: Iterable[Key] = ()) -> AssetSpec:
    """Return the spec with parts added to a link and the parts ``but`` removed.

    Added parts whose names are taken get numbered names.
    """
    parts = {key: part for key, part in parts_of(spec).items() if key not in but}
    names = [name for owner, name in parts if owner == link]
    return with_parts(spec, parts | {(link, free_name(name, names)): part for name, part in added.items()})


def moved(part: PartSpec, xyz: Array) -> PartSpec:
    """Return the part with its frame at ``xyz`` [m] and its rotation unchanged."""
    return part.model_copy(update={"pose": part.pose.model_copy(update={"xyz": _vector(xyz)})})


def shaped(part: PartSpec, shape: Shape) -> PartSpec:
    """Return the part with its shape replaced."""
    return part.model_copy(update={"shape": shape})


def at(part: PartSpec) -> Array:
    """Return the position of the part's frame in the link [m], shape (3,)."""
    return np.array(part.pose.xyz)


def aimed(xyz: Array, direction: Array) -> PoseSpec:
    """Return a pose at ``xyz`` [m] whose z axis points along ``direction``."""
    x, y, z = (float(v) for v in direction)
    pitch, yaw = math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x))
    if abs(pitch) < 1e-9:
        return PoseSpec(xyz=_vector(xyz))
    return PoseSpec(xyz=_vector(xyz), rpy_deg=(0.0, round(pitch, 4), round(yaw, 4)))


def axis_of(part: PartSpec) -> Array:
    """Return the part's z axis as a unit vector in the link frame, shape (3,)."""
    return pose(part.pose).rotation[:, 2]


def is_level(direction: Array) -> bool:
    """Return whether a direction is horizontal, that is, in the x-y plane."""
    return abs(float(direction[2])) < 1e-3


def rod(part: PartSpec) -> tuple[float, float] | None:
    """Return the radius and length [m] of a cylinder or capsule, excluding caps, or None for any other part."""
    match part.shape:
        case CylinderShape(cylinder=size) | CapsuleShape(capsule=size):
            return size.radius, size.height
    return None


def cylinder(radius: float, height: float) -> CylinderShape:
    """Return a cylinder with the given radius and height [m]."""
    return CylinderShape(cylinder=Round(radius=float(radius), height=float(height)))


def capsule(radius: float, height: float) -> CapsuleShape:
    """Return a capsule with the given radius and height [m]; the height excludes the caps."""
    return CapsuleShape(capsule=Round(radius=float(radius), height=float(height)))


def with_rod(part: PartSpec, radius: float, height: float) -> PartSpec:
    """Return a cylinder or capsule part with different dimensions [m]."""
    return shaped(part, (cylinder if isinstance(part.shape, CylinderShape) else capsule)(radius, height))


def corners(part: PartSpec) -> Array:
    """Return points on the part's surface in the link frame [m], shape (k, 3).

    The bounds of the points equal or approximate the part's bounds. A mesh is represented only by its origin, because
    its file is not read.
    """
    return pose(part.pose).apply(_own_corners(part.shape))


def _own_corners(shape: Shape | None) -> Array:
    match shape:
        case BoxShape():
            return _box(np.array(shape.box) / 2)
        case SphereShape():
            return _box(np.full(3, shape.sphere))
        case CylinderShape():
            c = shape.cylinder
            return _ring([(c.radius, -c.height / 2), (c.radius, c.height / 2)])
        case CapsuleShape():
            c, half = shape.capsule, shape.capsule.height / 2
            return _ring([(0.0, -half - c.radius), (c.radius, -half), (c.radius, half), (0.0, half + c.radius)])
        case PrismShape():
            half = shape.prism.height / 2
            return np.array([(x, y, z) for z in (-half, half) for x, y in shape.prism.outline])
        case LatheShape():
            return _ring(list(shape.lathe.profile))
    return np.zeros((1, 3))


def _box(half: Array) -> Array:
    return np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * half


def _ring(profile: list[tuple[float, float]]) -> Array:
    turns = np.arange(16) * (math.pi / 8)
    return np.array([(r * math.cos(a), r * math.sin(a), z) for r, z in profile for a in turns])


def bounds(parts: Iterable[PartSpec]) -> tuple[Array, Array]:
    """Return the minimum and maximum corners [m] of the bounding box of parts in one link, shape (3,) each."""
    points = np.concatenate([corners(part) for part in parts])
    return points.min(axis=0), points.max(axis=0)


def _vector(xyz: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) + 0.0 for v in xyz)
    return x, y, z


# -- components --------------------------------------------------------------------------------------------------------

# Maximum radius [m] of a protruding rod that can be part of a handle.
SLIM = 0.012

# Maximum distance [m] between the bounding boxes of parts that belong to the same handle.
TOUCH = 0.003

# Minimum number of balls in a bunch.
MANY = 5


class Kind(StrEnum):
    """The function of a component."""

    VESSEL = "vessel"  # solid of revolution with a cavity
    TURNED = "turned"  # solid of revolution without a cavity
    CRATE = "crate"  # a floor with walls made of boards
    STACK = "stack"  # disks stacked on each other
    BUNCH = "bunch"  # many equal balls
    BODY = "body"  # any other body
    LID = "lid"
    DRAWER = "drawer"
    HANDLE = "handle"
    KNOB = "knob"
    DIVIDER = "divider"
    BAND = "band"
    STEM = "stem"
    CAP = "cap"
    BASE = "base"
    PLATE = "plate"  # a surface to put objects on, such as a stove's burners


# Kinds of component that a body can be.
MAIN = (Kind.VESSEL, Kind.TURNED, Kind.CRATE, Kind.STACK, Kind.BUNCH, Kind.BODY)

# Words in part names that identify a kind.
WORDS = {
    Kind.HANDLE: ("handle", "grip", "post", "bail", "lug", "tab"),
    Kind.KNOB: ("knob", "dial"),
    Kind.DIVIDER: ("divider", "partition"),
    Kind.BAND: ("label", "ring", "band", "stripe"),
    Kind.STEM: ("stem", "stalk", "tip", "leaf"),
    Kind.CAP: ("cap", "stopper"),
    Kind.BASE: ("foot", "feet", "base"),
    Kind.PLATE: ("burner", "hob"),
}

BOARDS = {"floor", "bottom", "front", "back", "left", "right", "side", "wall"}


@dataclass(frozen=True)
class Component:
    """A component and its parts, all of which belong to the same link."""

    name: str
    kind: Kind
    parts: tuple[Key, ...]

    @property
    def link(self) -> str:
        """Name of the link that the parts belong to."""
        return self.parts[0][0]


def parts_in(spec: AssetSpec, component: Component) -> list[PartSpec]:
    """Return the parts of a component."""
    return [spec.links[link].parts[name] for link, name in component.parts]


def lathe_of(spec: AssetSpec, component: Component) -> tuple[Key, Profile] | None:
    """Return the key and profile of the component's tallest solid of revolution, or None if there is none."""
    lathes = [
        (key, Profile.of(part.shape))
        for key, part in zip(component.parts, parts_in(spec, component), strict=True)
        if isinstance(part.shape, LatheShape)
    ]
    return max(lathes, key=lambda pair: (pair[1].height, pair[0]), default=None)


def outward(spec: AssetSpec, component: Component) -> Array | None:
    """Return the signed coordinate axis along which a component protrudes from the rest of its link, shape (3,).

    The result is None if the component does not protrude.
    """
    body = [p for n, p in spec.links[component.link].parts.items() if (component.link, n) not in component.parts]
    if not body:
        return None
    low, high = bounds(body)
    own_low, own_high = bounds(parts_in(spec, component))
    over = np.concatenate([own_high - high, low - own_low])
    k = int(over.argmax())
    if over[k] <= 0:
        return None
    axis = np.zeros(3)
    axis[k % 3] = 1.0 if k < 3 else -1.0
    return axis


def components(spec: AssetSpec) -> tuple[Component, ...]:
    """Find the components of an asset: the body of each link, followed by the components attached to it.

    The names are unique, for example ``body``, ``drawer``, ``drawer_handle`` and ``handle_2``.
    """
    found: list[Component] = []
    taken: dict[str, int] = {}

    def add(name: str, kind: Kind, keys: list[Key]) -> None:
        taken[name] = taken.get(name, 0) + 1
        found.append(Component(name if taken[name] == 1 else f"{name}_{taken[name]}", kind, tuple(keys)))

    root = next(iter(spec.links))
    every = parts_of(spec)
    for link in spec.links:
        own = {key: part for key, part in every.items() if key[0] == link}
        kinds = {key: _attached(key, part, own) for key, part in own.items()}
        main = [key for key, kind in kinds.items() if kind is None]
        if main:
            moving = _moving(spec, link)
            add("body" if link == root else link, moving or _main_kind([own[k] for k in main], main), main)
        prefix = "" if link == root else f"{link}_"
        for kind in WORDS:
            for group in _groups(own, [key for key, its in kinds.items() if its is kind], kind):
                add(f"{prefix}{kind.value}", kind, group)
    return tuple(found)


def _attached(key: Key, part: PartSpec, own: dict[Key, PartSpec]) -> Kind | None:
    """Return the kind of a part that is attached to the body, or None if the part belongs to the body."""
    words = set(re.split(r"[_\d]+", key[1])) - {""}
    if len(own) == 1:
        return None
    # `stem_side` denotes a side, not a stem.
    named = next((k for k, names in WORDS.items() if (words <= {*names} if k is Kind.STEM else words & {*names})), None)
    if named is not None:
        return named
    body = [other for other in own.values() if not _is_slim(other)]
    if not body or not _is_slim(part):
        return None
    low, high = bounds(body)
    off = np.hypot(*(at(part) - (low + high) / 2)[:2])
    return Kind.HANDLE if off > 0.4 * float((high - low)[:2].max()) else None


def _is_slim(part: PartSpec) -> bool:
    size = rod(part)
    return size is not None and size[0] <= SLIM


def _moving(spec: AssetSpec, link: str) -> Kind | None:
    """Return the kind of a link that a joint moves, or None if the link is not moved by a joint."""
    joint = next((j for j in spec.joints.values() if j.child == link), None)
    if joint is None:
        return None
    return Kind.DRAWER if joint.type == "prismatic" else Kind.LID


def _main_kind(parts: list[PartSpec], keys: list[Key]) -> Kind:
    lathes = [Profile.of(p.shape) for p in parts if isinstance(p.shape, LatheShape)]
    if len(lathes) == 1 and lathes[0].is_hollow:
        return Kind.VESSEL
    if len(parts) == 1 and lathes:
        return Kind.TURNED
    balls = [p for p in parts if isinstance(p.shape, SphereShape)]
    if len(balls) >= MANY and len(balls) == len(parts):
        return Kind.BUNCH
    boards = [k for k, p in zip(keys, parts, strict=True) if isinstance(p.shape, BoxShape)]
    if len(boards) == len(parts) >= 4 and len({w for k in boards for w in k[1].split("_")} & BOARDS) >= 3:
        return Kind.CRATE
    coaxial = all(np.hypot(*at(p)[:2]) < 1e-3 and abs(axis_of(p)[2]) > 0.999 for p in parts)
    return Kind.STACK if len(parts) >= 3 and coaxial else Kind.BODY


def _groups(own: dict[Key, PartSpec], keys: list[Key], kind: Kind) -> list[list[Key]]:
    """Group parts into components. Parts of a handle are grouped if they touch; other parts are not grouped."""
    if kind is not Kind.HANDLE:
        return [[key] for key in keys]
    boxes = {key: bounds([own[key]]) for key in keys}
    groups: list[list[Key]] = []
    for key in keys:
        low, high = boxes[key]
        near = [g for g in groups if any(_meet(low, high, *boxes[k]) for k in g)]
        joined = [k for g in near for k in g] + [key]
        groups = [g for g in groups if g not in near] + [joined]
    return groups


def _meet(low: Array, high: Array, other_low: Array, other_high: Array) -> bool:
    return bool((low <= other_high + TOUCH).all() and (other_low <= high + TOUCH).all())
