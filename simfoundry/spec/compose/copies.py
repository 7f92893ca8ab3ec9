"""Copies of repeated objects: their names, their poses, and the references among them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from pydantic import ValidationError

from simfoundry.spec.change.diff.changes import renamed_reference
from simfoundry.spec.models.reuse import RepeatSpec
from simfoundry.spec.yaml.nodes import Node

Vector = tuple[float, float, float]

# Keys of a place that define a position relative to another object. Copies are counted from this position.
_ANCHORED = ("left_of", "right_of", "in_front_of", "behind")


@dataclass(frozen=True)
class Copy:
    """One copy of a repeated object: its name and its indices, counted from 1."""

    name: str
    index: tuple[int, ...]
    offset: Vector


@dataclass(frozen=True)
class Group:
    """The copies of a repeated object.

    Attributes:
        root: Name of the object that defines the copies; the same for all objects that repeat with it.
        repeat: The copies in a row, a grid or a stack.
        copies: The copies in order.
    """

    root: str
    repeat: RepeatSpec
    copies: tuple[Copy, ...]

    def named(self, index: tuple[int, ...]) -> str | None:
        """Return the name of the copy with the given indices, or None if it was removed."""
        return self._names.get(index)

    @cached_property
    def _names(self) -> dict[tuple[int, ...], str]:
        return {copy.index: copy.name for copy in self.copies}

    def has(self, name: str) -> bool:
        """Return True if an object is one of the copies."""
        return name in self._members

    @cached_property
    def _members(self) -> frozenset[str]:
        return frozenset(copy.name for copy in self.copies)

    def without(self, removed: Collection[tuple[int, ...]]) -> Group:
        """Return the group without the copies that have the given indices."""
        return replace(self, copies=tuple(copy for copy in self.copies if copy.index not in removed))

    def renamed(self, prefix: str) -> Group:
        """Return the group with a prefix before each name."""
        copies = tuple(replace(copy, name=f"{prefix}_{copy.name}") for copy in self.copies)
        return Group(f"{prefix}_{self.root}", self.repeat, copies)


def repeat_of(node: Node) -> RepeatSpec | None:
    """Return the repetition that a node describes, or None if it is invalid, which the type check reports."""
    try:
        return RepeatSpec.model_validate(node.value)
    except ValidationError:
        return None


def group(name: str, root: str, repeat: RepeatSpec, centered: bool) -> Group:
    """Return the copies of an object."""
    found = (Copy(f"{name}_{'_'.join(map(str, index))}", index, at) for index, at in repeat.offsets(centered))
    return Group(root, repeat, tuple(found))


def states_position(entry: Node | None) -> bool:
    """Return True if an entry for a copy defines the horizontal position of its place."""
    place = child(entry, "place") if entry is not None else None
    keys = place.children if place is not None and isinstance(place.children, dict) else {}
    return not keys.keys().isdisjoint(("xy", "local_xy", *_ANCHORED))


def is_centered(item: Node) -> bool:
    """Return True if the copies of an object are arranged around the center of its support."""
    place = child(item, "place")
    if place is None or not isinstance(place.children, dict):
        return False
    return not {"xy", "local_xy", *_ANCHORED} & place.children.keys()


def child(node: Node, key: str) -> Node | None:
    """Return the value of a key, or None if the node is not a mapping with this key."""
    return node.children.get(key) if isinstance(node.children, dict) else None


def copied_object(item: Node, copy: Copy, below: str | None, names: Mapping[str, str]) -> Node:
    """Return the node of a copy.

    Args:
        item: The repeated object, without `repeat`.
        copy: The copy.
        below: Name of the copy on which this copy is stacked, or None.
        names: Names of the copies that references to other repeated objects stand for, by object name.
    """
    if names:
        item = with_references(item, {"objects": names})
    if below is not None:
        return _stacked(item, below)
    return _shifted(item, copy.offset) if any(copy.offset) else item


def with_references(node: Node, spaces: Mapping[str, Mapping[str, str]], key: str = "") -> Node:
    """Return a node in which the names of members are replaced, given by section and old name."""
    if isinstance(node.children, dict):
        children = {name: with_references(inner, spaces, name) for name, inner in node.children.items()}
        same = all(children[name] is inner for name, inner in node.children.items())
        return node if same else node.with_members(children)
    if isinstance(node.children, list):
        items = [with_references(inner, spaces, key) for inner in node.children]
        same = all(a is b for a, b in zip(items, node.children, strict=True))
        return node if same else node.with_members(items)
    value = renamed_reference(key, node.value, spaces) if isinstance(node.value, str) else node.value
    return node if value == node.value else scalar_at(value, node)


def _stacked(item: Node, below: str) -> Node:
    """Return an object that is placed on another one, with the rotation that it had."""
    assert isinstance(item.children, dict)
    members = {key: node for key, node in item.children.items() if key != "pose"}
    where = child(item, "place") or child(item, "pose")
    kept = where.children if where is not None and isinstance(where.children, dict) else {}
    turns = {key: node for key, node in kept.items() if key in ("yaw_deg", "rpy_deg", "frame")}
    at = where if where is not None else item
    place = at.with_members({"on": scalar_at(below, at), **turns})
    return item.with_members({**members, "place": place})


def _shifted(item: Node, offset: Vector) -> Node:
    """Return an object whose position is moved by an offset [m]."""
    place = child(item, "place")
    if place is None:
        pose = child(item, "pose")
        moved = _moved(pose if pose is not None else item.with_members({}), "xyz", offset)
        return _with(item, "pose", moved)
    keys = place.children if isinstance(place.children, dict) else {}
    key = next((key for key in ("xy", "local_xy") if key in keys), "offset")
    return _with(item, "place", _moved(place, key, offset[:2]))


def _moved(node: Node, key: str, offset: Sequence[float]) -> Node:
    """Return a mapping whose position at ``key`` is moved. A position of another form is left to the type check."""
    if not isinstance(node.children, dict):
        return node
    old = node.children.get(key)
    if old is None:
        items = [scalar_at(value, node) for value in offset]
        return _with(node, key, node.with_members(items))
    numbers = old.children if isinstance(old.children, list) else []
    if len(numbers) != len(offset) or not all(is_number(number.value) for number in numbers):
        return node
    # Rounded to hide binary rounding: 0.1 + 0.2 is 0.3.
    items = [scalar_at(round(n.value + d, 12), n) for n, d in zip(numbers, offset, strict=True)]
    return _with(node, key, old.with_members(items))


def _with(node: Node, key: str, value: Node) -> Node:
    """Return a mapping with another value for one key."""
    assert isinstance(node.children, dict)
    return node.with_members({**node.children, key: value}, {key: value.place} | node.keys)


def is_number(value: Any) -> bool:
    """Return True if a value is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def scalar_at(value: Any, at: Node) -> Node:
    """Return a scalar at the position of another node."""
    return Node(value, at.line, at.column, file=at.file)
