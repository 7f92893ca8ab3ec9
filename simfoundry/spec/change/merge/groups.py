"""Groups of keys that must be merged as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain

from simfoundry.spec.change.merge.conflict import Path_
from simfoundry.spec.change.merge.equality import same
from simfoundry.spec.compose import EXCLUSIVE
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import models_at
from simfoundry.spec.yaml.tree import YamlTree

Members = Mapping[str, YamlTree]
Sides = tuple[Members, Members]

LED = (("type", ("limits", "limits_deg")),)
"""Leading keys and the keys that depend on their value."""

_RIVALS = frozenset(chain.from_iterable(EXCLUSIVE))


def at_odds(model: type[Model] | None, path: Path_, sides: tuple[Members, Members], merged: Members) -> set[str]:
    """Return the mutually exclusive keys at ``path`` that are present only because both sides were combined."""
    rivals = _RIVALS & merged.keys()
    found = set[str]()
    for group in EXCLUSIVE if len(rivals) > 1 else ():
        if _several(group, rivals) and not any(_several(group, side) for side in sides):
            found |= set(group)
    return found if found and model is not None and _holds_fields(model, path) else set()


def torn(model: type[Model] | None, path: Path_, base: Members, sides: Sides) -> set[str]:
    """Return the keys at ``path`` for which one side changed a leading key and the other a dependent key."""
    found = set[str]()
    for lead, led in LED:
        keys = (lead, *led)
        if not any(lead in side for side in sides) or not any(k in side for k in led for side in (base, *sides)):
            continue
        a, b = ({k for k in keys if not same(base.get(k), side.get(k))} for side in sides)
        differ = any(not same(sides[0].get(k), sides[1].get(k)) for k in keys)
        crossed = (lead in a and b - {lead}) or (lead in b and a - {lead})
        if crossed and differ and model is not None and set(keys) <= _fields(model, path):
            found |= set(keys)
    return found


def rivals_at(model: type[Model] | None, path: Path_) -> set[str]:
    """Return the keys that must be resolved together with the last key of ``path``."""
    groups = [*EXCLUSIVE, *((lead, *led) for lead, led in LED)]
    found = set(chain.from_iterable(group for group in groups if path[-1] in group)) - {path[-1]}
    return found if found and model is not None and _holds_fields(model, path[:-1]) else set()


def named_twice(model: type[Model] | None, path: Path_, merged: Members) -> Iterator[str]:
    """Yield the names that a start lists under both `pose` and `place`, which are mutually exclusive."""
    place, pose = (merged[key].value if key in merged else None for key in ("place", "pose"))
    if model is not None and isinstance(place, dict) and isinstance(pose, dict) and _is_start(model, path):
        yield from (name for name in place if name in pose)


def _several(group: tuple[str, ...], keys: Mapping[str, YamlTree] | frozenset[str]) -> bool:
    return sum(key in keys for key in group) > 1


def _holds_fields(model: type[Model], path: Path_) -> bool:
    """Return True if the keys of a mapping are fields rather than names."""
    return bool(models_at(model, path)) and not _is_start(model, path)


def _fields(model: type[Model], path: Path_) -> set[str]:
    return {name for owner in models_at(model, path) for name in owner.model_fields}


def _is_start(model: type[Model], path: Path_) -> bool:
    from simfoundry.spec.models.task import Start

    return path[-1:] == ("start",) and Start in models_at(model, path)
