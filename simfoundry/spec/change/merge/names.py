"""Apply the renames of both sides to all three documents of a merge."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from simfoundry.spec.change.diff.renames import Rename, find_renames, renamed
from simfoundry.spec.change.merge.conflict import MergeConflict, Path_
from simfoundry.spec.yaml.tree import YamlTree


@dataclass(frozen=True)
class SameNames:
    """Three documents with every member under its new name.

    ``edited`` contains the paths of members that one side renamed and the other removed; a rename counts as an edit.
    """

    base: YamlTree
    ours: YamlTree
    theirs: YamlTree
    edited: frozenset[Path_] = frozenset()
    conflicts: tuple[MergeConflict, ...] = ()


def same_names(base: YamlTree, ours: YamlTree, theirs: YamlTree) -> SameNames:
    """Apply each side's renames to the other; if both renamed a member, ours wins."""
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
    trees = (_renamed(base, for_base), _renamed(ours, for_side[0]), _renamed(theirs, for_side[1]))
    return SameNames(*trees, frozenset(edited), tuple(conflicts))


def _comes_and_goes(a: YamlTree, b: YamlTree) -> bool:
    """Return True if some mapping lost a key and gained another; otherwise there is no rename."""
    if not (isinstance(a.value, dict) and isinstance(b.value, dict)):
        return False
    if a.value.keys() - b.value.keys() and b.value.keys() - a.value.keys():
        return True
    return any(_comes_and_goes(child, b.value[key]) for key, child in a.value.items() if key in b.value)


def _renamed(tree: YamlTree, renames: list[Rename]) -> YamlTree:
    return _with_names(tree, renamed(tree.data, renames)) if renames else tree


def _with_names(tree: YamlTree, data: Any) -> YamlTree:
    """Return the tree with the keys and values of ``data``, its renamed data in the same order."""
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
