"""Merge the members of mappings: renames, groups of keys that are merged as a unit, and the order of members."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

from simfoundry.spec.change.diff.changes import Rename, find_renames, renamed
from simfoundry.spec.change.merge.conflict import MergeConflict, Path_
from simfoundry.spec.change.merge.equality import same
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import EXCLUSIVE, RIVALS, models_at
from simfoundry.spec.yaml.tree import YamlTree


@dataclass(frozen=True)
class SameNames:
    """Three documents in which every member has its new name.

    Attributes:
        base: The original document.
        ours: Our document.
        theirs: Their document.
        edited: The paths of members that one side renamed and the other side removed.
        conflicts: The members that both sides renamed.
    """

    base: YamlTree
    ours: YamlTree
    theirs: YamlTree
    edited: frozenset[Path_] = frozenset()
    conflicts: tuple[MergeConflict, ...] = ()


def same_names(base: YamlTree, ours: YamlTree, theirs: YamlTree) -> SameNames:
    """Apply the renames from each side to the other side. If both sides renamed a member, our name wins."""
    if not (_comes_and_goes(base, ours) or _comes_and_goes(base, theirs)):
        return SameNames(base, ours, theirs)
    data, datas = base.data, (ours.data, theirs.data)
    found = [{(r.section, r.old): r for r in find_renames(data, side)} for side in datas]
    if not any(found):
        return SameNames(base, ours, theirs)
    for_base = list[Rename]()
    for_side: tuple[list[Rename], list[Rename]] = ([], [])
    edited, conflicts = set[Path_](), list[MergeConflict]()
    for here, there in ((0, 1), (1, 0)):
        others = found[there]
        taken = {(r.section, r.new): r.old for r in others.values()}
        for key, rename in found[here].items():
            twin = others.get(key)
            if twin is not None:
                if here == 0:
                    for_base.append(rename)
                    if twin.new != rename.new:
                        for_side[1].append(Rename(rename.section, twin.new, rename.new))
                        conflicts.append(MergeConflict((*key[0], key[1]), key[1], rename.new, twin.new))
                continue
            members = _members(datas[there], rename.section)
            if rename.new in members or taken.get((rename.section, rename.new), rename.old) != rename.old:
                continue  # the name refers to a different member there
            for_base.append(rename)
            for_side[there].append(rename)
            if rename.old not in members and len(rename.section) == 1:
                edited.add((*rename.section, rename.new))
    base, ours, theirs = (
        _with_names(tree, renamed(tree.data, renames)) if renames else tree
        for tree, renames in ((base, for_base), (ours, for_side[0]), (theirs, for_side[1]))
    )
    return SameNames(base, ours, theirs, frozenset(edited), tuple(conflicts))


def _comes_and_goes(a: YamlTree, b: YamlTree) -> bool:
    """Return True if at least one mapping has lost a key and gained another, so that a member may have been renamed."""
    if not (isinstance(a.value, dict) and isinstance(b.value, dict)):
        return False
    if a.value.keys() - b.value.keys() and b.value.keys() - a.value.keys():
        return True
    return any(_comes_and_goes(child, b.value[key]) for key, child in a.value.items() if key in b.value)


def _with_names(tree: YamlTree, data: Any) -> YamlTree:
    """Return the tree with its keys and values replaced by those in ``data``, the tree's data after renaming."""
    if isinstance(data, dict):
        pairs = zip(tree.value.values(), data.items(), strict=True)
        return replace(tree, value={key: _with_names(child, item) for child, (key, item) in pairs})
    if isinstance(data, tuple):
        return replace(tree, value=tuple([_with_names(a, b) for a, b in zip(tree.value, data, strict=True)]))
    return replace(tree, value=data)


def _members(data: Any, section: Path_) -> dict[str, Any]:
    for key in section:
        data = data.get(key) if isinstance(data, dict) else None
    return data if isinstance(data, dict) else {}


Members = Mapping[str, YamlTree]
Sides = tuple[Members, Members]

# Leading keys, each with the keys that depend on its value.
LED = (("type", ("limits", "limits_deg")),)


def at_odds(model: type[Model] | None, path: Path_, sides: Sides, merged: Members) -> set[str]:
    """Return the mutually exclusive keys at ``path`` that occur together only because both sides were combined."""
    rivals = RIVALS.keys() & merged.keys()
    groups = [group for group in EXCLUSIVE if _several(group, rivals)] if len(rivals) > 1 else []
    combined = [group for group in groups if not any(_several(group, side) for side in sides)]
    return set(chain(*combined)) if combined and _holds_fields(model, path) else set()


def torn(model: type[Model] | None, path: Path_, base: Members, sides: Sides) -> set[str]:
    """Return the keys at ``path`` that must stay together but were changed on different sides.

    This is the case if one side changed a leading key and the other side changed a key that depends on it.
    """
    found = set[str]()
    for lead, led in LED:
        keys = (lead, *led)
        if not any(lead in side for side in sides) or not any(k in side for k in led for side in (base, *sides)):
            continue
        a, b = ({k for k in keys if not same(base.get(k), side.get(k))} for side in sides)
        differ = any(not same(sides[0].get(k), sides[1].get(k)) for k in keys)
        crossed = (lead in a and b - {lead}) or (lead in b and a - {lead})
        fields = {name for owner in models_at(model, path) for name in owner.model_fields} if crossed else set()
        if crossed and differ and fields.issuperset(keys):
            found |= set(keys)
    return found


def rivals_at(model: type[Model] | None, path: Path_) -> set[Path_]:
    """Return the paths of the keys that must be resolved together with the last key of ``path``."""
    groups = [*EXCLUSIVE, *((lead, *led) for lead, led in LED)]
    found = {(*path[:-1], key) for group in groups if path[-1:] and path[-1] in group for key in group} - {path}
    return found if found and _holds_fields(model, path[:-1]) else set()


def named_twice(model: type[Model] | None, path: Path_, merged: Members) -> list[str]:
    """Return the objects to which a task's `start` assigns both a pose and a place, although only one is allowed."""
    place, pose = (merged[key].value if key in merged else None for key in ("place", "pose"))
    if isinstance(place, dict) and isinstance(pose, dict) and _is_start(model, path):
        return [name for name in place if name in pose]
    return []


def _several(group: tuple[str, ...], keys: Container[str]) -> bool:
    return sum(key in keys for key in group) > 1


def _holds_fields(model: type[Model] | None, path: Path_) -> bool:
    """Return True if the keys of a mapping are fields rather than names."""
    return bool(models_at(model, path)) and not _is_start(model, path)


def _is_start(model: type[Model] | None, path: Path_) -> bool:
    from simfoundry.spec.models.task import Start

    return path[-1:] == ("start",) and Start in models_at(model, path)


def merged_order(
    base: Collection[str], ours: Collection[str], theirs: Collection[str], kept: Collection[str], ours_first: bool
) -> tuple[list[str], bool]:
    """Merge the order of the ``kept`` keys, each of which exists on at least one side.

    If one side reorders keys that it shares with the base, its order wins. A key that exists on only one side follows
    its predecessor on that side. If both sides added keys at the same position, or both reordered keys, the keys are
    sorted by name, so that swapping the sides does not change the result. With ``ours_first``, our order wins if both
    sides reordered the keys.

    Returns:
        The keys in their merged order, and a flag that is True if the two sides reordered the base differently.
    """
    core = [key for key in ours if key in theirs and key in kept]
    core_theirs = [key for key in theirs if key in ours and key in kept]
    shared, shared_theirs = ([k for k in keys if k in base] for keys in (core, core_theirs))
    inside = set(shared)
    before = [key for key in base if key in inside]
    clash = shared != before and shared_theirs != before and shared != shared_theirs
    if shared != before and (shared_theirs == before or (clash and ours_first)):
        chosen = core
    elif shared == before and shared_theirs != before:
        chosen = core_theirs
    else:
        chosen = min(core, core_theirs)
    runs = [_runs(keys, core, kept) for keys in (ours, theirs)]
    out = list[str]()
    for anchor in (None, *chosen):
        if anchor is not None:
            out.append(anchor)
        for run in sorted(found[anchor] for found in runs if anchor in found):
            out += run
    return out, clash


def reordered(keys: Iterable[str], wanted: Sequence[str]) -> list[str]:
    """Return the keys in the order of ``wanted``. Keys that are not in ``wanted`` stay after their predecessor."""
    keys = list(keys)
    core = [key for key in wanted if key in keys]
    runs = _runs(keys, core, keys)
    return [*runs.get(None, []), *(key for anchor in core for key in (anchor, *runs.get(anchor, [])))]


def _runs(keys: Iterable[str], core: Sequence[str], kept: Collection[str]) -> dict[str | None, list[str]]:
    """Return the keys in ``kept`` that are not in ``core``, grouped by the core key that precedes them."""
    inside, runs, anchor = set(core), dict[str | None, list[str]](), None
    for key in keys:
        if key in inside:
            anchor = key
        elif key in kept:
            runs.setdefault(anchor, []).append(key)
    return runs
