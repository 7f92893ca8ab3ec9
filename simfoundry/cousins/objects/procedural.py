"""Procedural variants: rules that edit random components of an object."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.objects.appearance import APPEARANCE, recolor
from simfoundry.cousins.objects.geometry import GEOMETRY, Edit, reshape, stretch
from simfoundry.cousins.objects.item import ObjectAsset
from simfoundry.cousins.objects.meshes import deformed, swept
from simfoundry.cousins.objects.parts import MAIN, Component, Kind, components, parts_of
from simfoundry.cousins.objects.profiles import Rng
from simfoundry.cousins.objects.skins import skinned
from simfoundry.cousins.objects.topology import TOPOLOGY
from simfoundry.spec.models.asset import AssetSpec

Rule = Callable[[AssetSpec, Component, Rng], Edit | None]

RULES: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": GEOMETRY, "topology": TOPOLOGY, "appearance": APPEARANCE}
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
