"""Functional components of an object (body, handles, lid, drawers), found by names, joints and geometry."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simfoundry.cousins.objects.parts import Key, Profile, at, axis_of, bounds, parts_of, rod
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.base import BoxShape, LatheShape, SphereShape

SLIM = 0.012
"""Maximum radius of a rod that protrudes from the body for it to be part of a handle [m]."""

TOUCH = 0.003
"""Maximum distance between the bounding boxes of parts of one handle [m]."""

MANY = 5
"""Minimum number of equal balls that form a bunch."""


class Kind(StrEnum):
    """The purpose of a component."""

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
    PLATE = "plate"  # a surface to put objects on, such as the burners of a stove


MAIN = (Kind.VESSEL, Kind.TURNED, Kind.CRATE, Kind.STACK, Kind.BUNCH, Kind.BODY)
"""Kinds that a body can have."""

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
"""Words in part names that identify a kind."""

BOARDS = {"floor", "bottom", "front", "back", "left", "right", "side", "wall"}


@dataclass(frozen=True)
class Component:
    """A component and its parts, all of which belong to one link."""

    name: str
    kind: Kind
    parts: tuple[Key, ...]

    @property
    def link(self) -> str:
        """Link to which the parts belong."""
        return self.parts[0][0]


def components(spec: AssetSpec) -> tuple[Component, ...]:
    """Find the components of an asset: for each link its body, followed by the attached components.

    Names are unique: ``body``, ``drawer``, ``drawer_handle``, ``handle_2``.
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
    """Kind of a part that is attached to the body, or None if it belongs to the body."""
    words = set(re.split(r"[_\d]+", key[1])) - {""}
    if len(own) == 1:
        return None
    named = next((kind for kind, names in WORDS.items() if _is_called(words, kind, set(names))), None)
    if named is not None:
        return named
    size = rod(part)
    if size is None or size[0] > SLIM:
        return None
    body = [other for other in own.values() if rod(other) is None or (rod(other) or (0.0,))[0] > SLIM]
    if not body:
        return None
    low, high = bounds(body)
    off = np.hypot(*(at(part) - (low + high) / 2)[:2])
    return Kind.HANDLE if off > 0.4 * float((high - low)[:2].max()) else None


def _is_called(words: set[str], kind: Kind, names: set[str]) -> bool:
    """Return whether the words of a part's name denote a kind; `stem_side` denotes a side, not a stem."""
    return words <= names if kind is Kind.STEM else bool(words & names)


def _moving(spec: AssetSpec, link: str) -> Kind | None:
    """Kind of a link according to the joint that moves it."""
    joint = next((j for j in spec.joints.values() if j.child == link), None)
    if joint is None:
        return None
    return Kind.DRAWER if joint.type == "prismatic" else Kind.LID


def _main_kind(parts: list[PartSpec], keys: list[Key]) -> Kind:
    lathes = [Profile.of(p.shape) for p in parts if isinstance(p.shape, LatheShape)]
    if len(parts) == 1 and lathes:
        return Kind.VESSEL if lathes[0].is_hollow else Kind.TURNED
    if len(lathes) == 1 and lathes[0].is_hollow:
        return Kind.VESSEL
    balls = [p for p in parts if isinstance(p.shape, SphereShape)]
    if len(balls) >= MANY and len(balls) == len(parts):
        return Kind.BUNCH
    boards = [k for k, p in zip(keys, parts, strict=True) if isinstance(p.shape, BoxShape)]
    if len(boards) == len(parts) >= 4 and len({w for k in boards for w in k[1].split("_")} & BOARDS) >= 3:
        return Kind.CRATE
    if len(parts) >= 3 and all(_coaxial(p) for p in parts):
        return Kind.STACK
    return Kind.BODY


def _coaxial(part: PartSpec) -> bool:
    return bool(np.hypot(*at(part)[:2]) < 1e-3 and abs(axis_of(part)[2]) > 0.999)


def _groups(own: dict[Key, PartSpec], keys: list[Key], kind: Kind) -> list[list[Key]]:
    """Group the keys of touching parts; only handles consist of several parts."""
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


def _meet(low: np.ndarray, high: np.ndarray, other_low: np.ndarray, other_high: np.ndarray) -> bool:
    return bool((low <= other_high + TOUCH).all() and (other_low <= high + TOUCH).all())
