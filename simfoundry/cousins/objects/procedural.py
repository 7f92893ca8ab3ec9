"""Procedural variants by rules, and new silhouettes for vessels (cups, bowls, plates) with walls of even thickness."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.objects.appearance import APPEARANCE, recolor
from simfoundry.cousins.objects.components import MAIN, Component, Kind, components
from simfoundry.cousins.objects.geometry import GEOMETRY, Edit, Rng, lathe_of, stretch, with_profile
from simfoundry.cousins.objects.item import ObjectAsset
from simfoundry.cousins.objects.meshes import deformed, swept
from simfoundry.cousins.objects.parts import FLAT, LOW, THINNEST, WIDE, Profile, parts_of
from simfoundry.cousins.objects.skins import skinned
from simfoundry.cousins.objects.topology import TOPOLOGY
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import LatheShape

POINTS = 13
"""Number of rings of a curved wall: a bulge of 10 % of a cup's radius then deviates from its chords by under 0.1 mm."""

HEIGHTS, RIMS, WALLS = (0.74, 1.34), (0.84, 1.2), (0.85, 1.35)
"""Factors on the twin's height, rim radius and wall thickness, similar to the variety of cups in shops."""

SMALLEST_FOOT = 0.35
"""Minimum foot radius as a share of the rim's radius; below it the vessel topples when pushed."""

Form = Callable[[Array, Rng], Array]
"""Normalized profile: outer radius between foot (0) and rim (1) at heights between foot (0) and rim (1), both (k,)."""


def reshape(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Replace the silhouette of a vessel by one of a family that fits its height, with new sizes, wall and foot."""
    key = lathe_of(spec, component)
    if key is None or len(spec.links) > 1:  # a lid fits the existing rim
        return None
    shape = parts_of(spec)[key].shape
    assert isinstance(shape, LatheShape)
    old = Profile.of(shape)
    if not old.is_hollow:
        return None
    widest = float(old.outer[:, 0].max())
    height, rim, wall = (v * _factor(rng, r) for v, r in ((old.height, HEIGHTS), (widest, RIMS), (old.thinnest, WALLS)))
    forms = _forms(old.height / widest)
    name = list(forms)[int(rng.integers(len(forms)))]
    share, form = forms[name]
    foot = rim * float(np.clip(rng.uniform(*share), SMALLEST_FOOT, 1.0))
    floor = max((old.height - old.depth) * float(rng.uniform(0.85, 1.2)), wall)
    made = walled(_outside(form, foot, rim, height, rng), max(wall, THINNEST), floor)
    if made is None:
        return None
    words = f"{name}, {height * 1000:.0f} mm high, {2 * rim * 1000:.0f} mm wide"
    return with_profile(spec, key, old, made), words


def _forms(slender: float) -> dict[str, tuple[tuple[float, float], Form]]:
    """Return the forms for vessels whose height is ``slender`` times their rim radius."""
    if slender < FLAT:
        return DISHES
    if slender < LOW:
        return BOWLS
    return {name: CUPS[name] for name in POTS} if slender < WIDE else CUPS


def _factor(rng: Rng, between: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(between))))


def _outside(form: Form, foot: float, rim: float, height: float, rng: Rng) -> Array:
    """Points (radius, height) [m] of an outer wall from foot to rim, shape (k, 2), evenly spaced along the wall."""
    t = np.linspace(0.0, 1.0, 101)
    wall = np.column_stack([foot + (rim - foot) * form(t, rng), t * height])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(wall, axis=0), axis=1))])
    even = np.linspace(0.0, along[-1], POINTS)
    return np.column_stack([np.interp(even, along, wall[:, k]) for k in range(2)])


def walled(outside: Array, wall: float, floor: float) -> Profile | None:
    """Hollow profile with an outer wall [m], shape (k, 2), from foot to rim, and an inner one offset by ``wall`` [m].

    The rim is rounded, and the inside ends on a level ``floor`` [m]. None if the wall bends more sharply than its
    thickness allows.
    """
    from shapely.geometry import Polygon

    tangent = np.gradient(outside, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    inward = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    inside = outside + wall * inward
    lip = (outside[-1] + inside[-1]) / 2 + 0.4 * wall * tangent[-1]
    above = np.flatnonzero(inside[:, 1] > floor + 0.3 * wall)
    if len(above) < 2 or (np.diff(above) > 1).any():
        return None
    first = inside[above[0]]
    run = tangent[above[0]]
    down = (first[1] - floor) / max(float(run[1]), 0.3)  # follow the wall down to the floor
    corner = np.array([float(first[0] - run[0] * down), floor])
    rings = np.concatenate([[[0.0, 0.0]], outside, [lip], inside[above][::-1], [corner, [0.0, floor]]])
    if (rings[1:-1, 0] <= 5e-4).any() or not Polygon(rings).is_valid:
        return None
    made = Profile.of(LatheShape.model_validate({"lathe": {"profile": tuple(map(tuple, rings.round(6).tolist()))}}))
    return made if made.is_hollow and made.thinnest > 0.6 * wall else None


def _straight(t: Array, _: Rng) -> Array:
    return t


def _rounded(t: Array, rng: Rng) -> Array:
    """Quarter ellipse at the bottom, straight above."""
    bend = rng.uniform(0.3, 0.6)
    return np.asarray(np.sqrt(1 - np.clip(1 - t / bend, 0.0, 1.0) ** 2))


def _flared(t: Array, rng: Rng) -> Array:
    return np.asarray(t ** rng.uniform(2.0, 3.5))


def _barrel(t: Array, rng: Rng) -> Array:
    return np.asarray(t + rng.uniform(0.6, 1.4) * np.sin(np.pi * t))


def _tulip(t: Array, rng: Rng) -> Array:
    """Wide at the bottom, narrower in the middle, and flared at the rim."""
    return np.asarray(t + rng.uniform(0.5, 0.9) * np.sin(2 * np.pi * t**0.85))


def _waisted(t: Array, rng: Rng) -> Array:
    return np.asarray(t - rng.uniform(0.5, 1.0) * np.sin(np.pi * t))


def _shouldered(t: Array, rng: Rng) -> Array:
    """Two straight walls with a smooth step between them."""
    at, soft = rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.1)
    step = 1 / (1 + np.exp(-(t - at) / soft))
    return np.asarray((step - step[0]) / (step[-1] - step[0]))


def _round_bowl(t: Array, rng: Rng) -> Array:
    return np.asarray(np.sqrt(np.clip(1 - (1 - t) ** 2, 0.0, 1.0)) ** rng.uniform(0.8, 1.2))


def _bell(t: Array, rng: Rng) -> Array:
    """Round at the bottom, flared at the rim."""
    return np.asarray(0.72 * np.sqrt(np.clip(1 - (1 - t) ** 2, 0.0, 1.0)) + 0.28 * t ** rng.uniform(3.0, 6.0))


def _coupe(t: Array, rng: Rng) -> Array:
    return np.asarray(t ** rng.uniform(0.45, 0.65))


def _rimmed(t: Array, rng: Rng) -> Array:
    """Well with a wide rim that rises slightly."""
    at = rng.uniform(0.5, 0.7)
    well, rim = np.clip(t / at, 0.0, 1.0), np.clip((t - at) / (1 - at), 0.0, 1.0)
    share = rng.uniform(0.35, 0.5)
    return np.asarray(share * well**0.8 + (1 - share) * rim)


def _edged(t: Array, rng: Rng) -> Array:
    """Nearly flat, with an edge that turns up."""
    return np.asarray(np.clip(t / rng.uniform(0.45, 0.6), 0.0, 1.0) ** 0.9)


CUPS: dict[str, tuple[tuple[float, float], Form]] = {
    "straight": ((0.92, 1.0), _straight),
    "tapered": ((0.6, 0.8), _straight),
    "rounded": ((0.45, 0.7), _rounded),
    "flared": ((0.65, 0.8), _flared),
    "barrel-shaped": ((0.82, 0.9), _barrel),
    "tulip-shaped": ((0.78, 0.88), _tulip),
    "waisted": ((0.84, 0.92), _waisted),
    "shouldered": ((0.68, 0.82), _shouldered),
}
"""Forms of cups and mugs by name: range of the foot radius as a share of the rim's, and the profile between them."""

POTS = ("straight", "tapered", "rounded", "flared", "barrel-shaped")

BOWLS: dict[str, tuple[tuple[float, float], Form]] = {
    "round": ((0.4, 0.6), _round_bowl),
    "conical": ((0.4, 0.6), _straight),
    "upright": ((0.6, 0.8), _rounded),
    "bell-shaped": ((0.42, 0.58), _bell),
    "shouldered": ((0.5, 0.68), _shouldered),
    "steep": ((0.8, 0.95), _straight),
}

DISHES: dict[str, tuple[tuple[float, float], Form]] = {
    "coupe": ((0.5, 0.62), _coupe),
    "rimmed": ((0.5, 0.62), _rimmed),
    "edged": ((0.62, 0.72), _edged),
    "conical": ((0.5, 0.64), _straight),
}


Rule = Callable[[AssetSpec, Component, Rng], Edit | None]

RULES: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": ((reshape, (Kind.VESSEL,)), *GEOMETRY), "topology": TOPOLOGY, "appearance": APPEARANCE}
)

TOGETHER: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": ((stretch, MAIN),), "topology": (), "appearance": ((recolor, MAIN),)}
)
"""Rules that change meshes and shapes consistently, for objects whose visual geometry is a mesh and whose collision
geometry consists of shapes.
"""

SHARES = MappingProxyType({"geometry": 1.0, "topology": 0.5, "appearance": 0.8})
"""Probability that a variant differs in each allowed dimension; always in shape, or it would be a recolored copy."""

WEIGHTS: Mapping[Rule, float] = MappingProxyType({reshape: 16.0})
"""Weight of a rule relative to the others (1): three vessels of four get another silhouette."""

SKINNED = 0.7
"""Probability that a variant whose appearance may change gets a pattern; shops sell plain objects too."""

ALIKE = (Kind.HANDLE, Kind.KNOB, Kind.DRAWER)
"""Components of which an object has several equal ones: an edit of one is applied to all."""

TRIES = 8
"""Maximum number of inapplicable rules tried before giving up."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A candidate whose spec has no estimated masses and no final name yet, with the new ``files`` that it names, those
    kept from the twin, and a human-readable list of what was ``changed``.
    """

    spec: AssetSpec
    changed: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=lambda: MappingProxyType({}))
    kept: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))


def draft(item: ObjectAsset, changes: Sequence[str], only: Sequence[str], rng: Rng) -> Draft:
    """Generate a candidate that differs in some of ``changes``, in the components named in ``only`` (by default any).

    The same generator state gives the same draft.
    """
    spec, said = item.spec, list[str]()
    files: dict[str, bytes] = {}
    kept = dict(item.files)
    wanted = [change for change in changes if rng.random() < SHARES[change]] or [changes[0]]
    rules = TOGETHER if _is_mixed(spec) else RULES
    if "geometry" in wanted and all(part.mesh is not None for part in parts_of(spec).values()):
        spec, files, words = deformed(spec, item.files, rng)
        kept, said = {}, [words]
    for change in wanted:
        done = set[Rule]()
        for _ in range(2 if change != "topology" and rng.random() < 0.5 else 1):
            edit = _edit(spec, [pair for pair in rules[change] if pair[0] not in done], only, rng)
            if edit is not None:
                spec, words, rule = edit
                said.append(words)
                done.add(rule)
    for change in changes if not said else ():
        edit = _edit(spec, rules[change], only, rng)
        if edit is not None:
            spec, words, _ = edit
            said.append(words)
    spec, made, more = _finished(spec, changes, only, rng) if rules is RULES else (spec, {}, [])
    return Draft(spec, (*said, *more), MappingProxyType({**files, **made}), MappingProxyType(kept))


def _is_mixed(spec: AssetSpec) -> bool:
    """Return whether some parts are meshes and others shapes, which usually are visual and collision geometry."""
    return len({part.mesh is None for part in parts_of(spec).values()}) == 2


def _finished(
    spec: AssetSpec, changes: Sequence[str], only: Sequence[str], rng: Rng
) -> tuple[AssetSpec, dict[str, bytes], list[str]]:
    """Apply the final edits, which no rule can follow (tubular handles, patterns); return the asset, files and
    descriptions.
    """
    files: dict[str, bytes] = {}
    said: list[str] = []
    if "geometry" in changes or "topology" in changes:
        spec, made, words = swept(spec, only, rng)
        files, said = files | made, said + [words] * bool(words)
    if "appearance" in changes and rng.random() < SKINNED:
        spec, made, words = skinned(spec, only, rng)
        files, said = files | made, said + [words] * bool(words)
    return spec, files, said


def _edit(
    spec: AssetSpec, rules: Sequence[tuple[Rule, tuple[Kind, ...]]], only: Sequence[str], rng: Rng
) -> tuple[AssetSpec, str, Rule] | None:
    """Apply one random rule to one random component and those equal to it; None if no drawn rule applies."""
    found = [c for c in components(spec) if not only or c.name in only]
    choices = [(rule, c) for rule, kinds in rules for c in found if c.kind in kinds]
    weights = np.array([WEIGHTS.get(rule, 1.0) for rule, _ in choices])
    order = (
        rng.choice(len(choices), min(TRIES, len(choices)), replace=False, p=weights / weights.sum()) if choices else ()
    )
    for k in order:
        rule, component = choices[int(k)]
        seed = int(rng.integers(0, 2**62))
        edit = rule(spec, component, np.random.default_rng(seed))
        if edit is None:
            continue
        made, words = edit
        for other in found:
            if other.kind in ALIKE and other.kind is component.kind and other != component:
                again = rule(made, other, np.random.default_rng(seed))
                made = made if again is None else again[0]
        return made, words, rule
    return None


def rng_of(seed: int, name: str, k: int) -> np.random.Generator:
    """Return the generator for candidate ``k`` of the object ``name``."""
    return np.random.default_rng([seed, k, *name.encode()])
