"""Changes between two documents as data: the edits that turn one into the other.

Documents are plain data: mappings with string keys, tuples, and scalars. Members of named mappings are matched by
name. If one member disappears and a nearly equal one appears, the pair is treated as a rename
(:mod:`simfoundry.spec.change.diff.renames`). Lists are replaced as a whole, except lists of expressions (``relations``,
``all``, ``any``) and of pairs (``no_contact``), which are compared as sets: each expression or pair is a member whose
name is its text. ``1`` and ``1.0`` are the same number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from simfoundry.spec.change.diff.renames import Path_, Rename, find_renames, renamed, same

EXPRESSION_LISTS = ("relations", "all", "any")
"""Keys of lists of expressions, which are unordered."""

PAIR_LISTS = ("no_contact",)
"""Keys of lists of pairs; both the lists and the pairs are unordered."""


@dataclass(frozen=True)
class Set:
    """Change of the value at ``path`` to ``new``."""

    path: Path_
    old: Any
    new: Any


@dataclass(frozen=True)
class Add:
    """Addition of the member ``value`` at ``path``, at index ``position`` of its mapping (from 0)."""

    path: Path_
    value: Any
    position: int


@dataclass(frozen=True)
class Remove:
    """Removal of the member at ``path``."""

    path: Path_
    old: Any


@dataclass(frozen=True)
class Reorder:
    """New order of the members of the mapping at ``section``."""

    section: Path_
    order: tuple[str, ...]


Change = Set | Add | Remove | Rename | Reorder


def diff(a: Any, b: Any) -> tuple[Change, ...]:
    """Return the changes that turn ``a`` into ``b``, including changes of key order.

    Renames come first; all other changes use paths and old values as they are after the renames.
    """
    renames = find_renames(a, b)
    return (*renames, *_value(renamed(a, renames), b, ()))


def to_json(change: Change) -> dict[str, Any]:
    """Return a plain mapping with the ``kind`` of the change."""
    return {"kind": type(change).__name__.lower(), **asdict(change)}


def members(value: Any, path: Path_) -> dict[str, Any] | None:
    """Return the members of a mapping by name, or of a list of expressions by text; None for other values."""
    if isinstance(value, dict):
        return value
    if path and path[-1] in (*EXPRESSION_LISTS, *PAIR_LISTS) and isinstance(value, tuple | list):
        keyed = {expression(item): item for item in value}
        return keyed if len(keyed) == len(value) else None
    return None


def expression(item: Any) -> str:
    """Format a goal or a pair as one string: ``any(OnTop(cup, plate), not Open(box))``, ``cup and plate``."""
    match item:
        case str():
            return item
        case (str(), str()):
            return " and ".join(sorted(item))
        case {"not": inner}:
            return f"not {expression(inner)}"
        case dict() if len(item) == 1:
            key, inner = next(iter(item.items()))
            parts = inner if isinstance(inner, tuple | list) else (inner,)
            return f"{key}({', '.join(map(expression, parts))})"
    return repr(item)


def _value(a: Any, b: Any, path: Path_) -> Iterator[Change]:
    before, after = members(a, path), members(b, path)
    together = isinstance(a, dict) == isinstance(b, dict) and not (path and path[-1] == "shape" and _other_kind(a, b))
    if before is None or after is None or not together:
        if not same(a, b):
            yield Set(path, a, b)
        return
    for key, old in before.items():
        if key not in after:
            yield Remove((*path, key), old)
        else:
            yield from _value(old, after[key], (*path, key))
    order = [key for key in before if key in after]
    for position, (key, new) in enumerate(after.items()):
        if key not in before:
            yield Add((*path, key), new, position)
            order.insert(position, key)
    if order != list(after):
        yield Reorder(path, tuple(after))


def _other_kind(a: Any, b: Any) -> bool:
    """Return True if two shapes are of different kinds and therefore have no key in common."""
    return isinstance(a, dict) and isinstance(b, dict) and not a.keys() & b.keys()
