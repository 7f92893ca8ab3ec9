"""Identify the functional components of an asset document, and add, replace or remove its parts.

Components (body, handles, lid, drawers) are identified by names, joints and geometry. Each edit returns a new document.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simfoundry.cousins.objects.parts import at, axis_of, bounds, rod
from simfoundry.cousins.objects.profiles import Profile
from simfoundry.cousins.recipe.candidate import free_name
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.shapes import BoxShape, LatheShape, SphereShape

# Identifier of a part: the name of its link and the name of the part.
Key = tuple[str, str]

Parts = Mapping[Key, PartSpec]


def parts_of(spec: AssetSpec) -> dict[Key, PartSpec]:
    """Return the parts of all links, keyed by link name and part name."""
    return {(link, name): part for link, body in spec.links.items() for name, part in body.parts.items()}


def with_parts(spec: AssetSpec, parts: Parts) -> AssetSpec:
    """Return the spec with its parts replaced by the given parts, in the given order."""
    own = {name: {part: parts[link, part] for link, part in parts if link == name} for name in spec.links}
    links = {name: link.model_copy(update={"parts": own[name]}) for name, link in spec.links.items()}
    return spec.model_copy(update={"links": links})


def each(spec: AssetSpec, change: Callable[[Key, PartSpec], PartSpec]) -> AssetSpec:
    """Return the spec with ``change`` applied to every part."""
    return with_parts(spec, {key: change(key, part) for key, part in parts_of(spec).items()})


def with_added(spec: AssetSpec, link: str, added: Mapping[str, PartSpec], but: Iterable[Key] = ()) -> AssetSpec:
    """Return the spec with the parts in ``but`` removed and new parts added to a link.

    If the name of a new part is already in use, a number is appended to the name.
    """
    parts = {key: part for key, part in parts_of(spec).items() if key not in but}
    names = [name for owner, name in parts if owner == link]
    return with_parts(spec, parts | {(link, free_name(name, names)): part for name, part in added.items()})


# Maximum radius [m] of a rod that can be part of a handle.
SLIM = 0.012

# Maximum distance [m] between the bounding boxes of parts that belong to the same handle.
TOUCH = 0.003

# Minimum number of balls in a bunch.
MANY = 5


class Kind(StrEnum):
    """The functional kind of a component, such as a vessel or a handle."""

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


# Kinds of components that can be the body of a link.
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
        """Name of the link to which the component's parts belong."""
        return self.parts[0][0]

    def parts_in(self, spec: AssetSpec) -> list[PartSpec]:
        """Return the parts of the component."""
        return [spec.links[link].parts[name] for link, name in self.parts]

    def lathe(self, spec: AssetSpec) -> tuple[Key, Profile] | None:
        """Return the key and profile of the tallest solid of revolution in the component.

        The result is None if there is no solid of revolution.
        """
        parts = zip(self.parts, self.parts_in(spec), strict=True)
        lathes = [(key, Profile.of(part.shape)) for key, part in parts if isinstance(part.shape, LatheShape)]
        return max(lathes, key=lambda pair: (pair[1].height, pair[0]), default=None)

    def outward(self, spec: AssetSpec) -> Array | None:
        """Return the coordinate axis along which the component protrudes from the rest of its link.

        Returns:
            A signed unit vector of shape (3,), or None if the component does not protrude.
        """
        body = [part for name, part in spec.links[self.link].parts.items() if (self.link, name) not in self.parts]
        if not body:
            return None
        low, high = bounds(body)
        own_low, own_high = bounds(self.parts_in(spec))
        over = np.concatenate([own_high - high, low - own_low])
        k = int(over.argmax())
        return np.concatenate([np.eye(3), -np.eye(3)])[k] + 0.0 if over[k] > 0 else None


def components(spec: AssetSpec) -> tuple[Component, ...]:
    """Find the components of an asset.

    For each link, these are the body and the components attached to it. The names are unique, for example ``body``,
    ``drawer``, ``drawer_handle`` and ``handle_2``.
    """
    found: list[Component] = []
    taken = Counter[str]()

    def add(name: str, kind: Kind, keys: list[Key]) -> None:
        taken[name] += 1
        found.append(Component(name if taken[name] == 1 else f"{name}_{taken[name]}", kind, tuple(keys)))

    root = next(iter(spec.links))
    every = parts_of(spec)
    for link in spec.links:
        own = {key: part for key, part in every.items() if key[0] == link}
        kinds = {key: _attached(key, part, own) for key, part in own.items()}
        main = [key for key, kind in kinds.items() if kind is None]
        if main:
            joint = next((j for j in spec.joints.values() if j.child == link), None)
            moving = None if joint is None else Kind.DRAWER if joint.type == "prismatic" else Kind.LID
            add("body" if link == root else link, moving or _main_kind({k: own[k] for k in main}), main)
        prefix = "" if link == root else f"{link}_"
        for kind in WORDS:
            for group in _groups(own, [key for key, its in kinds.items() if its is kind], kind):
                add(f"{prefix}{kind.value}", kind, group)
    return tuple(found)


def _attached(key: Key, part: PartSpec, own: dict[Key, PartSpec]) -> Kind | None:
    """Return the kind of a part that is attached to a body, or None if the part belongs to the body."""
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


def _main_kind(parts: Parts) -> Kind:
    """Return the kind of a body that consists of the given parts."""
    lathes = [Profile.of(p.shape) for p in parts.values() if isinstance(p.shape, LatheShape)]
    if len(lathes) == 1 and lathes[0].is_hollow:
        return Kind.VESSEL
    if len(parts) == 1 and lathes:
        return Kind.TURNED
    kinds = {type(p.shape) for p in parts.values()}
    if len(parts) >= MANY and kinds == {SphereShape}:
        return Kind.BUNCH
    words = {word for _, name in parts for word in name.split("_")}
    if len(parts) >= 4 and kinds == {BoxShape} and len(words & BOARDS) >= 3:
        return Kind.CRATE
    coaxial = all(np.hypot(*at(p)[:2]) < 1e-3 and abs(axis_of(p)[2]) > 0.999 for p in parts.values())
    return Kind.STACK if len(parts) >= 3 and coaxial else Kind.BODY


def _groups(own: dict[Key, PartSpec], keys: list[Key], kind: Kind) -> list[list[Key]]:
    """Group parts into components.

    Handle parts that touch each other form one component. Each of the remaining parts is a separate component.
    """
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
