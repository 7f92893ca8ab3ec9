"""Merge the comments around a value; comments of both sides are kept and never cause a conflict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from simfoundry.spec.yaml.tree import YamlTree

_NONE = YamlTree(None)


def commented(tree: YamlTree, base: YamlTree | None, ours: YamlTree, theirs: YamlTree) -> YamlTree:
    """Return ``tree`` with the top-level comments of ``ours`` and ``theirs``; the side that changed a comment wins."""
    base = base or _NONE
    above = _lines(base.above, ours.above, theirs.above)
    end = _lines(base.end, ours.end, theirs.end)
    beside = _changed(base.beside, ours.beside, theirs.beside)
    if beside is None:
        beside, late = ours.beside or theirs.beside, theirs.beside
        if late and late != beside and late not in above:
            above = (*above, late)
    return replace(tree, above=above, beside=beside, end=end)


def united(base: YamlTree | None, ours: YamlTree, theirs: YamlTree) -> YamlTree:
    """Return ``ours``, whose data equals ``theirs``, with the comments of both at every level."""
    value = ours.value
    if isinstance(value, dict):
        value = {key: _united(base, child, theirs, key) for key, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple([_united(base, child, theirs, k) for k, child in enumerate(value)])
    return commented(replace(ours, value=value), base, ours, theirs)


def _united(base: YamlTree | None, ours: YamlTree, theirs: YamlTree, part: str | int) -> YamlTree:
    other = _inside(theirs, part)
    return united(_inside(base, part), ours, other) if other is not None else ours


def rescued(tree: YamlTree, base: YamlTree | None, other: YamlTree) -> YamlTree:
    """Return ``tree`` plus the comments inside ``other`` that would otherwise be lost when ``tree`` replaces it."""
    known = {text for t in (tree, base) if t is not None for _, text in t.comments()}
    new = tuple(text for child in _children(other) for _, text in child.comments() if text not in known)
    return replace(tree, above=(*tree.above, *new)) if new else tree


def _changed(base: str, ours: str, theirs: str) -> str | None:
    """Return the comment of the side that changed it; None if both changed it differently."""
    if ours == theirs or theirs == base:
        return ours
    return theirs if ours == base else None


def _lines(base: tuple[str, ...], ours: tuple[str, ...], theirs: tuple[str, ...]) -> tuple[str, ...]:
    if ours == theirs or theirs == base:
        return ours
    if ours == base:
        return theirs
    return (*ours, *(text for text in theirs if text not in ours and text not in base))


def _inside(tree: YamlTree | None, part: str | int) -> YamlTree | None:
    value = tree.value if tree is not None else None
    if isinstance(value, dict):
        return value.get(part)
    if isinstance(value, tuple) and isinstance(part, int) and part < len(value):
        found: YamlTree = value[part]
        return found
    return None


def _children(tree: YamlTree) -> Iterator[YamlTree]:
    if isinstance(tree.value, dict):
        yield from tree.value.values()
    elif isinstance(tree.value, tuple):
        yield from tree.value
