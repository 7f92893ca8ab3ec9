"""Changes made to a document: the proof that a diff says all that changed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from simfoundry.spec.change.diff.changes import (
    Add,
    Change,
    Path_,
    Remove,
    Rename,
    Reorder,
    Set,
    copied,
    members,
    renamed,
    same,
)

KINDS: dict[str, type[Change]] = {"set": Set, "add": Add, "remove": Remove, "rename": Rename, "reorder": Reorder}


class ChangeError(Exception):
    """A change that does not fit the document that it is applied to."""


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


def from_json(data: Mapping[str, Any]) -> Change:
    """The change that :func:`to_json` wrote, also after a way through JSON text."""
    fields = {key: _tuples(value) for key, value in data.items() if key != "kind"}
    kind = str(data.get("kind"))
    if kind not in KINDS:
        raise ChangeError(f"`{kind}` is not a kind of change; valid: {', '.join(KINDS)}")
    try:
        return KINDS[kind](**fields)
    except TypeError:
        raise ChangeError(f"a change of kind `{kind}` does not have the keys {', '.join(fields)}") from None


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
