"""Semantic three-way merge of document trees.

Mappings are merged key by key. ``relations``, ``no_contact`` and lists of goals are merged as sets. All other values
are merged as a unit. Edits to different values never conflict, and identical edits are merged into one. Incompatible
edits result in a :class:`MergeConflict`: the document keeps our value (or the changed value, if one side removed the
value) and records all three values under ``conflicts``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from simfoundry.spec.change.merge.conflict import ABSENT, CONFLICTS, MergeConflict, Path_, dotted, numbered
from simfoundry.spec.change.merge.equality import identical, is_list_of_conditions, matched, same, spelled
from simfoundry.spec.change.merge.members import Members, Sides, at_odds, merged_order, named_twice, same_names, torn
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import models_at
from simfoundry.spec.yaml.tree import YamlTree, plain_tree

# A value in one version of a document, or None if the version does not contain it.
Tree = YamlTree | None

# Named mappings whose order is significant.
ORDERED = (("subtasks",), ("links",), ("frames",))


@dataclass(frozen=True)
class Merged:
    """A merged document that records its conflicts. ``conflicts`` contains the conflicts that this merge added."""

    tree: YamlTree
    conflicts: tuple[MergeConflict, ...]

    @property
    def data(self) -> Any:
        """Return the document as plain data."""
        return self.tree.data


def merge_trees(base: YamlTree, ours: YamlTree, theirs: YamlTree) -> Merged:
    """Merge three documents with their comments."""
    named = same_names(base, ours, theirs)
    overlay = any("extends" in _mapping(tree) for tree in (base, ours, theirs))
    merging = _Merging(model_in(ours), named.edited, overlay, list(named.conflicts))
    tree = merging.value(named.base, named.ours, named.theirs, ())
    assert tree is not None
    return Merged(_recorded(tree, merging.conflicts), tuple(merging.conflicts))


def model_in(document: YamlTree) -> type[Model] | None:
    """Return the model for a document's kind, or None if the kind is missing or unknown."""
    kind = document.value.get("simfoundry") if isinstance(document.value, dict) else None
    return model_of(kind.value) if kind is not None and kind.value in KINDS else None


def _recorded(tree: YamlTree, conflicts: list[MergeConflict]) -> YamlTree:
    """Return the document with one entry in ``conflicts`` for each conflict."""
    if not conflicts or not isinstance(tree.value, dict):
        return tree
    section = tree.value.get(CONFLICTS) or YamlTree({})
    entries: dict[str, YamlTree] = dict(section.value) if isinstance(section.value, dict) else {}
    for conflict in conflicts:
        record, path = conflict.record(), dotted(conflict.path)
        if path in entries and entries[path].data == record:
            continue
        entries[numbered(path, entries)] = replace(plain_tree(record), beside=conflict.comment)
    return replace(tree, value={**tree.value, CONFLICTS: replace(section, value=entries)})


@dataclass
class _Merging:
    """The state of one merge.

    Attributes:
        model: The model of the documents.
        edited: The paths of members that one side renamed and the other side removed.
        overlay: True if a document extends another document, from which it inherits missing lists.
        conflicts: The conflicts found so far.
    """

    model: type[Model] | None
    edited: frozenset[Path_]
    overlay: bool
    conflicts: list[MergeConflict]

    def value(self, base: Tree, ours: Tree, theirs: Tree, path: Path_) -> Tree:
        """Merge one value, or return None if the value was removed."""
        if ours is None or theirs is None:
            return self.one_sided(base, ours, theirs, path)
        if base is not None and not self.edited and identical(base, theirs):
            return ours
        if base is not None and not self.edited and identical(base, ours):
            return theirs
        old = base.value if base is not None else None
        if isinstance(ours.value, dict) and isinstance(theirs.value, dict) and not _is_whole(path, ours, theirs):
            tree = self.mapping(base, ours, theirs, path)
        elif is_list_of_conditions(path, ours.value, theirs.value, old if old is not None else ()):
            tree = self.conditions(base, ours, theirs, path)
        else:
            return self.whole(base, ours, theirs, path)
        return commented(tree, base, ours, theirs)

    def one_sided(self, base: Tree, ours: Tree, theirs: Tree, path: Path_) -> Tree:
        """Merge a value that is missing on one side."""
        there = theirs if ours is None else ours
        if there is None or base is None:
            return there
        if self.is_empty_where_absent(base, there, path):
            nothing = YamlTree(type(there.value)())
            tree = self.value(base, ours or nothing, theirs or nothing, path)
            return tree if tree is not None and tree.value else None
        if path not in self.edited and same(base, there, path):
            return None
        if path[:1] != (CONFLICTS,):
            self.clash(path, base, ours, theirs)
        return there

    def is_empty_where_absent(self, base: YamlTree, there: YamlTree, path: Path_) -> bool:
        """Return True for mappings and lists that documents omit when they are empty."""
        if isinstance(base.value, dict) and isinstance(there.value, dict) and path and self.model is not None:
            return not models_at(self.model, path)
        is_set = path in (("relations",), ("no_contact",))
        return is_set and not self.overlay and is_list_of_conditions(path, base.value, there.value)

    def whole(self, base: Tree, ours: YamlTree, theirs: YamlTree, path: Path_) -> YamlTree:
        """Take the entire value from one side instead of merging its members."""
        if same(ours, theirs, path):
            return united(base, ours, theirs)
        taken, other = ours, theirs
        if base is not None and same(base, ours, path):
            taken, other = theirs, ours
        elif base is None or not same(base, theirs, path):
            known = (ours.beside, base.beside if base is not None else "")
            self.clash(path, base, ours, theirs, theirs.beside if theirs.beside not in known else "")
            theirs = replace(theirs, beside=ours.beside)
        return rescued(commented(taken, base, ours, theirs), base, other)

    def mapping(self, base: Tree, ours: YamlTree, theirs: YamlTree, path: Path_) -> YamlTree:
        """Merge a mapping key by key."""
        before = _mapping(base)
        sides = (ours.value, theirs.value)
        merged = dict[str, YamlTree]()
        for key in dict.fromkeys([*ours.value, *theirs.value]):
            tree = self.value(before.get(key), ours.value.get(key), theirs.value.get(key), (*path, key))
            if tree is not None:
                merged[key] = tree
        if odd := torn(self.model, path, before, sides):
            self.keep_ours(odd, before, sides, merged, path)
        while odd := at_odds(self.model, path, sides, merged):
            self.keep_ours(odd, before, sides, merged, path)
        self.keep_ours_of_start(before, sides, merged, path)
        if path == (CONFLICTS,):
            self.keep_both(before, sides, merged)
        order, clash = merged_order(before, *sides, merged, path in ORDERED)
        if clash and path in ORDERED:
            self.conflicts.append(MergeConflict(path, tuple(before), tuple(sides[0]), tuple(sides[1])))
        return replace(ours, value={key: merged[key] for key in dict.fromkeys((*order, *merged))})

    def conditions(self, base: Tree, ours: YamlTree, theirs: YamlTree, path: Path_) -> YamlTree:
        """Merge a list of conditions as a set. If two edits of a condition conflict, the whole list conflicts."""
        before = matched(base.value) if base is not None and isinstance(base.value, tuple) else {}
        sides = (matched(ours.value, before), matched(theirs.value, before))
        found, merged = len(self.conflicts), dict[str, YamlTree]()
        for name in dict.fromkeys([*sides[0], *sides[1]]):
            tree = self.condition(before.get(name), sides[0].get(name), sides[1].get(name), (*path, name))
            if tree is not None:
                merged[name] = tree
        if len(self.conflicts) > found:
            del self.conflicts[found:]
            self.clash(path, base, ours, theirs)
            return ours
        order, _ = merged_order(before, *sides, merged, ours_first=False)
        return replace(ours, value=tuple([merged[name] for name in order]))

    def condition(self, base: Tree, ours: Tree, theirs: Tree, path: Path_) -> Tree:
        """Merge one condition in a list, ignoring differences in spacing."""
        given = [spelled(tree.data) for tree in (base, ours, theirs) if tree is not None]
        if len(set(given)) > 1:
            return self.value(base, ours, theirs, path)
        if ours is None or theirs is None:
            return None if base is not None else ours or theirs
        taken = min((ours, theirs), key=lambda tree: repr(tree.data))  # independent of which side is which
        return commented(taken, base, ours, theirs)

    # -- conflicts --------------------------------------------------------------------------------------------------

    def clash(self, path: Path_, base: Tree, ours: Tree, theirs: Tree, comment: str = "") -> None:
        """Record a conflict."""
        was, here, there = (tree.data if tree is not None else ABSENT for tree in (base, ours, theirs))
        self.conflicts.append(MergeConflict(path, was, here, there, comment))

    def keep_ours(self, keys: set[str], base: Members, sides: Sides, merged: dict[str, YamlTree], path: Path_) -> None:
        """Keep our values of the ``keys``, and record a conflict for each value that differs."""
        ours, theirs = sides
        inside = {(*path, key) for key in keys}
        self.conflicts = [c for c in self.conflicts if c.path[: len(path) + 1] not in inside]
        for key in sorted(keys):
            if key in ours:
                merged[key] = ours[key]
            else:
                merged.pop(key, None)
            if not same(ours.get(key), theirs.get(key), (*path, key)):
                self.clash((*path, key), base.get(key), ours.get(key), theirs.get(key))

    def keep_ours_of_start(self, base: Members, sides: Sides, merged: dict[str, YamlTree], path: Path_) -> None:
        """Keep our value if a task's ``start`` assigns a pose to an object on one side and a place on the other."""
        for name in named_twice(self.model, path, merged):
            for key in ("place", "pose"):
                inner = dict(merged[key].value)
                of = [_mapping(members.get(key)) for members in (base, *sides)]
                self.keep_ours({name}, of[0], (of[1], of[2]), inner, (*path, key))
                merged[key] = replace(merged[key], value=inner)

    def keep_both(self, base: Members, sides: Sides, merged: dict[str, YamlTree]) -> None:
        """Keep the versions of both sides if they changed the same entry in ``conflicts``."""
        theirs = sides[1]
        for conflict in [c for c in self.conflicts if c.path[:1] == (CONFLICTS,)]:
            self.conflicts.remove(conflict)
            path = conflict.path[1]
            merged[numbered(path, {**merged, **theirs})] = theirs[path]


def _is_whole(path: Path_, ours: YamlTree, theirs: YamlTree) -> bool:
    """Return True for mappings that represent a single value: an estimate, or an entry of ``conflicts``."""
    estimate = path[-1:] in (("mass",), ("density",)) and ("value" in ours.value or "value" in theirs.value)
    return estimate or (path[:1] == (CONFLICTS,) and len(path) == 2)


def _mapping(tree: Tree) -> Members:
    return tree.value if tree is not None and isinstance(tree.value, dict) else {}


_NONE = YamlTree(None)


def commented(tree: YamlTree, base: Tree, ours: YamlTree, theirs: YamlTree) -> YamlTree:
    """Return ``tree`` with the top-level comments and layout of ``ours`` and ``theirs``.

    If one side changed a comment or the layout, its version is used.
    """
    base = base or _NONE
    above = _lines(base.above, ours.above, theirs.above)
    end = _lines(base.end, ours.end, theirs.end)
    beside = _changed(base.beside, ours.beside, theirs.beside)
    if beside is None:
        beside, late = ours.beside or theirs.beside, theirs.beside
        if late and late != beside and late not in above:
            above = (*above, late)
    layout = _changed(base.layout, ours.layout, theirs.layout) or tree.layout
    return replace(tree, above=above, beside=beside, end=end, layout=layout)


def united(base: Tree, ours: YamlTree, theirs: Tree) -> YamlTree:
    """Return ``ours`` with the comments of both sides at every level. The data of both sides must be equal."""
    if theirs is None:
        return ours
    value = ours.value
    if isinstance(value, dict):
        value = {key: united(_inside(base, key), child, _inside(theirs, key)) for key, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple([united(_inside(base, k), child, _inside(theirs, k)) for k, child in enumerate(value)])
    return commented(replace(ours, value=value), base, ours, theirs)


def _inside(tree: Tree, part: str | int) -> Tree:
    """Return a member of a mapping or an item of a list, or None if it does not exist."""
    value = tree.value if tree is not None else None
    if isinstance(value, tuple) and isinstance(part, int):
        value = dict(enumerate(value[part : part + 1], part))
    return value.get(part) if isinstance(value, dict) else None


def rescued(tree: YamlTree, base: Tree, other: YamlTree) -> YamlTree:
    """Return ``tree`` with the comments inside ``other`` added.

    These comments would otherwise be lost when ``tree`` replaces ``other``.
    """
    known = {text for t in (tree, base) if t is not None for _, text in t.comments()}
    new = tuple(text for path, text in other.comments() if path and text not in known)
    return replace(tree, above=(*tree.above, *new)) if new else tree


def _changed(base: Any, ours: Any, theirs: Any) -> Any:
    """Return the value from the side that changed it, or None if the two sides changed it differently."""
    if ours == theirs or theirs == base:
        return ours
    return theirs if ours == base else None


def _lines(base: tuple[str, ...], ours: tuple[str, ...], theirs: tuple[str, ...]) -> tuple[str, ...]:
    both = (*ours, *(text for text in theirs if text not in ours and text not in base))
    changed = _changed(base, ours, theirs)
    return both if changed is None else tuple(changed)
