"""Variants by rules: of each functional component its geometry, its parts, its looks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.objects.appearance import APPEARANCE, recolor
from simfoundry.cousins.objects.components import MAIN, Component, Kind, components
from simfoundry.cousins.objects.geometry import GEOMETRY, Edit, Rng, stretch
from simfoundry.cousins.objects.handles import swept
from simfoundry.cousins.objects.item import Item
from simfoundry.cousins.objects.meshes import deformed
from simfoundry.cousins.objects.parts import parts_of
from simfoundry.cousins.objects.silhouettes import reshape
from simfoundry.cousins.objects.skins import skinned
from simfoundry.cousins.objects.topology import TOPOLOGY
from simfoundry.spec.models.asset import AssetSpec

Rule = Callable[[AssetSpec, Component, Rng], Edit | None]

RULES: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": ((reshape, (Kind.VESSEL,)), *GEOMETRY), "topology": TOPOLOGY, "appearance": APPEARANCE}
)

TOGETHER: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": ((stretch, MAIN),), "topology": (), "appearance": ((recolor, MAIN),)}
)
"""Rules that change meshes and shapes alike, for things whose shapes collide for the meshes that are seen."""

SHARES = MappingProxyType({"geometry": 1.0, "topology": 0.5, "appearance": 0.8})
"""How often a variant differs in each way that is allowed: in shape always, or it would be a recoloured copy."""

WEIGHTS: Mapping[Rule, float] = MappingProxyType({reshape: 16.0})
"""How often a rule is drawn beside the others, which count 1: three vessels of four have another silhouette."""

SKINNED = 0.7
"""Share of the variants whose looks may differ that carry a pattern; shops sell plain things too."""

ALIKE = (Kind.HANDLE, Kind.KNOB, Kind.DRAWER)
"""Of these a thing has several that are the same, and stay so: what is done to one is done to all."""

TRIES = 8
"""Rules that do not apply to a thing are passed over so often."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A candidate: a spec not yet weighed nor named, the new ``files`` that it names, those that it keeps of the twin,
    and what was ``changed``, for people.
    """

    spec: AssetSpec
    changed: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=lambda: MappingProxyType({}))
    kept: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))


def draft(item: Item, changes: Sequence[str], only: Sequence[str], rng: Rng) -> Draft:
    """A candidate that differs in some of ``changes``, in the components named in ``only``, by default in any.

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
    """Whether some parts are meshes and others shapes: mostly what is seen, and what collides for it."""
    return len({part.mesh is None for part in parts_of(spec).values()}) == 2


def _finished(
    spec: AssetSpec, changes: Sequence[str], only: Sequence[str], rng: Rng
) -> tuple[AssetSpec, dict[str, bytes], list[str]]:
    """The asset with what no rule can change afterwards: handles as tubes, and patterns; the new files, and words."""
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
    """One rule applied to one component, both drawn, and to those that are like it; None where none drawn applies."""
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
    """The generator of candidate ``k`` of the thing called ``name``."""
    return np.random.default_rng([seed, k, *name.encode()])
