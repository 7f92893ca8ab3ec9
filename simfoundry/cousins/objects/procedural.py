"""Generate procedural variants by applying rules to random components of an object."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.objects.appearance import APPEARANCE, recolor
from simfoundry.cousins.objects.components import MAIN, Component, Kind, components, parts_of
from simfoundry.cousins.objects.geometry import GEOMETRY, Edit, reshape, stretch
from simfoundry.cousins.objects.item import ObjectAsset
from simfoundry.cousins.objects.meshes import deformed, swept
from simfoundry.cousins.objects.profiles import Rng
from simfoundry.cousins.objects.skins import skinned
from simfoundry.cousins.objects.topology import TOPOLOGY
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.origin import ModelUse

Rule = Callable[[AssetSpec, Component, Rng], Edit | None]

RULES: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": GEOMETRY, "topology": TOPOLOGY, "appearance": APPEARANCE}
)

# Rules for objects whose visual geometry is a mesh and whose collision geometry consists of shapes. These rules keep
# the mesh and the shapes consistent.
TOGETHER: Mapping[str, Sequence[tuple[Rule, tuple[Kind, ...]]]] = MappingProxyType(
    {"geometry": ((stretch, MAIN),), "topology": (), "appearance": ((recolor, MAIN),)}
)

# Probability that a variant differs in each allowed dimension. The geometry always varies if it is allowed to, because
# the variant could otherwise be a copy with different colors.
SHARES = MappingProxyType({"geometry": 1.0, "topology": 0.5, "appearance": 0.8})

# Weights of rules relative to the default of 1. With these, three of four vessels get a different silhouette.
WEIGHTS: Mapping[Rule, float] = MappingProxyType({reshape: 16.0})

# Probability that a variant whose appearance may change gets a pattern; many real objects are plain.
SKINNED = 0.7

# Kinds of components that usually look the same on an object. An edit of one of them is applied to all of them.
ALIKE = (Kind.HANDLE, Kind.KNOB, Kind.DRAWER)

# Maximum number of rules to try until a rule applies.
TRIES = 8


@dataclass(frozen=True, eq=False)
class Draft:
    """A candidate variant without final masses and without a final name.

    Attributes:
        spec: The asset document.
        changed: Human-readable list of changes.
        files: Contents of new files, keyed by the names used in the document.
        kept: Paths of the twin's files that the document still uses.
        models: Foundation models that contributed.
    """

    spec: AssetSpec
    changed: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=lambda: MappingProxyType({}))
    kept: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))
    models: tuple[ModelUse, ...] = ()


def draft(item: ObjectAsset, changes: Sequence[str], only: Sequence[str], rng: Rng) -> Draft:
    """Generate a candidate. The same state of the random generator always produces the same draft.

    Args:
        item: The twin's object.
        changes: Dimensions in which the candidate may differ.
        only: Names of the components that may change. If it is empty, all components may change.
        rng: Random generator.
    """
    spec, said = item.spec, list[str]()
    files, kept = dict[str, bytes](), dict(item.files)
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
    """Return True if an asset contains both meshes (usually visual) and shapes (usually collision geometry)."""
    return len({part.mesh is None for part in parts_of(spec).values()}) == 2


def _finished(
    spec: AssetSpec, changes: Sequence[str], only: Sequence[str], rng: Rng
) -> tuple[AssetSpec, dict[str, bytes], list[str]]:
    """Apply tubular handles and patterns as the last edits. Rules cannot be applied after that.

    Returns:
        The asset, the new files by name, and descriptions of the changes.
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
    """Apply a random rule to a random component and to all components that resemble it.

    Returns:
        The asset, a description of the change, and the rule, or None if none of the attempted rules was applicable.
    """
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
    """Return the random generator for candidate ``k`` of the object called ``name``."""
    return np.random.default_rng([seed, k, *name.encode()])
