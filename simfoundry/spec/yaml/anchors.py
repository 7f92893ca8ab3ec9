"""Decide where a document is written with anchors and aliases.

A value stays an alias if the last anchor of its name has the same content. Otherwise, it is written in full. This holds
for any order of keys and after any edit, so a value that was changed in one place does not change in others.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from simfoundry.spec.models.types import KeyOrder
from simfoundry.spec.yaml.tree import TextLayout, YamlTree


@dataclass(frozen=True, slots=True)
class Alias:
    """The value of a tree that is written as an alias."""

    name: str


@dataclass(slots=True)
class _Anchor:
    """An anchor, in the order of the output. ``needed`` is True if a person wrote it or an alias refers to it."""

    content: str
    needed: bool


def with_aliases(tree: YamlTree, order: KeyOrder) -> YamlTree:
    """Return a tree in which repeated values are replaced by :class:`Alias`.

    The first of several equal values gets the anchor, in the order in which ``order`` writes them. Anchors remain in
    the layouts of exactly those values that are written with one.
    """
    if not _has_anchor(tree):
        return tree
    first = _Anchors([])
    first.value(tree, order)
    return _Anchors([anchor.needed for anchor in first.found]).value(tree, order)


def _has_anchor(tree: YamlTree) -> bool:
    return (tree.layout is not None and bool(tree.layout.anchor)) or any(map(_has_anchor, _members(tree)))


def _members(tree: YamlTree) -> Collection[YamlTree]:
    value: Any = tree.value
    return value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ()


class _Anchors:
    """A pass over a tree that marks anchors and aliases.

    ``needed`` tells for each anchor whether it is written; it is known from an earlier pass, which writes all of them.
    """

    def __init__(self, needed: list[bool]) -> None:
        self.needed = needed
        self.found: list[_Anchor] = []
        self.current: dict[str, _Anchor] = {}  # the last anchor of each name
        self.open: set[str] = set()  # names of anchors whose values contain the current value

    def value(self, tree: YamlTree, order: KeyOrder) -> YamlTree:
        """Return a value in which anchors and aliases are marked."""
        layout = tree.layout
        if layout is None or not layout.anchor:
            return self.inside(tree, order)
        name, content = layout.anchor, repr(tree.data)
        known = self.current.get(name)
        if name not in self.open and known is not None and known.content == content and not _has_comments_inside(tree):
            known.needed = True
            return replace(tree, value=Alias(name), end=(), layout=TextLayout())
        if name in self.open or (layout.alias and known is not None):
            return self.inside(replace(tree, layout=TextLayout(layout.one_line)), order)
        anchor = _Anchor(content, not layout.alias)
        written = self.needed[len(self.found)] if self.needed else True
        self.found.append(anchor)
        self.open.add(name)
        tree = self.inside(replace(tree, layout=TextLayout(layout.one_line, name if written else "")), order)
        self.open.remove(name)
        self.current[name] = anchor
        return tree

    def inside(self, tree: YamlTree, order: KeyOrder) -> YamlTree:
        """Return a value in which the anchors and aliases of its members are marked."""
        if isinstance(tree.value, dict):
            members = {key: self.value(tree.value[key], order.member(key)) for key in order.ordered(tree.value)}
            return replace(tree, value=members)
        if isinstance(tree.value, tuple):
            return replace(tree, value=tuple([self.value(item, order.item) for item in tree.value]))
        return tree


def _has_comments_inside(tree: YamlTree) -> bool:
    return any(tree.end) or any(any(child.comments()) for child in _members(tree))
