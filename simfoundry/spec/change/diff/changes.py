"""Changes between two documents as data: what to do to the one to get the other.

Documents are plain data: mappings with text keys, tuples, scalars. Members of named mappings are matched by name, and
where one vanishes while a nearly equal one appears, by a rename (:mod:`simfoundry.spec.change.diff.renames`). Lists are
replaced as a whole, except lists of expressions (``relations``, ``all``, ``any``) and of pairs (``no_contact``), which
are sets: an expression or a pair is a member that is called like its text. ``1`` and ``1.0`` are the same number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.renames import Path_, Rename, copied, find_renames, renamed, same

EXPRESSION_LISTS = ("relations", "all", "any")
"""Keys of lists of expressions; their order means nothing."""

PAIR_LISTS = ("no_contact",)
"""Keys of lists of pairs; their order, and that of each pair, mean nothing."""


@dataclass(frozen=True)
class Set:
    """The value at ``path`` becomes ``new``."""

    path: Path_
    old: Any
    new: Any


@dataclass(frozen=True)
class Add:
    """A member ``value`` appears at ``path``, as the ``position``-th of its mapping (counted from 0)."""

    path: Path_
    value: Any
    position: int


@dataclass(frozen=True)
class Remove:
    """The member at ``path`` goes."""

    path: Path_
    old: Any


@dataclass(frozen=True)
class Reorder:
    """The members of the mapping at ``section`` stand in another order."""

    section: Path_
    order: tuple[str, ...]


Change = Set | Add | Remove | Rename | Reorder

_KINDS: dict[str, type[Change]] = {"set": Set, "add": Add, "remove": Remove, "rename": Rename, "reorder": Reorder}
_NAMES = {kind: name for name, kind in _KINDS.items()}


class ChangeError(SimfoundryError):
    """A change that does not fit the document that it is applied to."""


def diff(a: Any, b: Any) -> tuple[Change, ...]:
    """What turns ``a`` into ``b``: ``apply(diff(a, b), a) == b``, the order of keys included.

    Renames come first; the paths and old values of all other changes are those after the renames.
    """
    renames = find_renames(a, b)
    return (*renames, *_value(renamed(a, renames), b, ()))


def apply(changes: Iterable[Change], data: Any) -> Any:
    """``data`` with ``changes`` made; raises :class:`ChangeError` where one does not fit. ``data`` itself stays."""
    changes = tuple(changes)
    tree = renamed(data, [c for c in changes if isinstance(c, Rename)])
    for change in changes:
        match change:
            case Set(()):
                _expect(change.path, tree, change.old)
                tree = change.new
            case Set(path) | Remove(path) | Add(path):
                tree = _edited(tree, path[:-1], change)
            case Reorder(section):
                tree = _edited(tree, section, change)
    return tree


def to_json(change: Change) -> dict[str, Any]:
    """A plain mapping with the ``kind`` of the change."""
    return {"kind": _NAMES[type(change)], **asdict(change)}


def from_json(data: Mapping[str, Any]) -> Change:
    """The change that :func:`to_json` wrote, also after a way through JSON text."""
    fields = {key: _tuples(value) for key, value in data.items() if key != "kind"}
    kind = str(data.get("kind"))
    if kind not in _KINDS:
        raise ChangeError(f"`{kind}` is not a kind of change; valid: {', '.join(_KINDS)}")
    try:
        return _KINDS[kind](**fields)
    except TypeError:
        raise ChangeError(f"a change of kind `{kind}` does not have the keys {', '.join(fields)}") from None


def members(value: Any, path: Path_) -> dict[str, Any] | None:
    """The members of a mapping by name, of a list of expressions by text; None for what is replaced as a whole."""
    if isinstance(value, dict):
        return value
    if path and path[-1] in (*EXPRESSION_LISTS, *PAIR_LISTS) and isinstance(value, tuple | list):
        keyed = {expression(item): item for item in value}
        return keyed if len(keyed) == len(value) else None
    return None


def expression(item: Any) -> str:
    """An expression of a goal, or a pair, as one text: ``any(OnTop(cup, plate), not Open(box))``, ``cup and plate``."""
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
    """Whether two shapes are of different kinds, so that nothing of the one is left in the other."""
    return isinstance(a, dict) and isinstance(b, dict) and not a.keys() & b.keys()


def _edited(tree: Any, section: Path_, change: Set | Add | Remove | Reorder) -> Any:
    """``tree`` after a change among the members at ``section``; mappings are changed in place."""
    place, inner = tree, [tree]
    for k, key in enumerate(section):
        there = members(place, section[:k])
        if there is None or key not in there:
            raise ChangeError(f"there is no `{'.'.join(section[: k + 1])}`")
        place = there[key]
        inner.append(place)
    there = members(place, section)
    if there is None:
        raise ChangeError(f"`{'.'.join(section)}` has no named members")
    _change(there, change)
    for k in range(len(section), 0, -1):  # a list of expressions is made anew, and so is what holds it
        if isinstance(inner[k], dict):
            break
        holder = members(inner[k - 1], section[: k - 1]) or {}
        holder[section[k - 1]] = tuple(there.values())
        there = holder
    return tree


def _change(there: dict[str, Any], change: Set | Add | Remove | Reorder) -> None:
    match change:
        case Set(path):
            _expect(path, there.get(path[-1]), change.old, path[-1] in there)
            there[path[-1]] = copied(change.new)
        case Remove(path):
            _expect(path, there.get(path[-1]), change.old, path[-1] in there)
            del there[path[-1]]
        case Add(path):
            if path[-1] in there:
                raise ChangeError(f"`{'.'.join(path)}` is there already")
            behind = list(there.items())[change.position :]
            there[path[-1]] = copied(change.value)
            for key, value in behind:
                del there[key]
                there[key] = value
        case Reorder():
            items = [(key, there[key]) for key in change.order if key in there]
            items += [(key, value) for key, value in there.items() if key not in set(change.order)]
            there.clear()
            there.update(items)


def _expect(path: Path_, found: Any, old: Any, there: bool = True) -> None:
    if not there:
        raise ChangeError(f"there is no `{'.'.join(path)}`")
    if not same(found, old):
        raise ChangeError(f"`{'.'.join(path)}` is not what it was when the change was made")


def _tuples(value: Any) -> Any:
    match value:
        case dict():
            return {key: _tuples(item) for key, item in value.items()}
        case list() | tuple():
            return tuple(_tuples(item) for item in value)
    return value
