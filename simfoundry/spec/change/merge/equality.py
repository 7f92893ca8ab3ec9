"""Compare document values semantically. Lists of conditions and lists of pairs are treated as sets."""

from __future__ import annotations

from typing import Any

from simfoundry.spec.change.diff.changes import EXPRESSION_LISTS, PAIR_LISTS, copied, expression
from simfoundry.spec.change.merge.conflict import Path_, numbered
from simfoundry.spec.yaml.spelling import call
from simfoundry.spec.yaml.tree import YamlTree

_JOINED = ("all", "any")

# Keys of conditions.
_CONDITIONS = ("goal", "not")


def is_list_of_conditions(path: Path_, *values: Any) -> bool:
    """Return True if all values at ``path`` are lists of conditions or of pairs, whose order is not significant."""
    if not path or path[-1] not in (*EXPRESSION_LISTS, *PAIR_LISTS):
        return False
    is_item = _is_pair if path[-1] in PAIR_LISTS else _is_condition
    return all(isinstance(value, tuple) and all(map(is_item, value)) for value in values)


def matched(items: tuple[YamlTree, ...], base: dict[str, YamlTree] | None = None) -> dict[str, YamlTree]:
    """Return the items of a list, keyed by their normalized text.

    If an item with `all` or `any` has changed, it gets the key of the corresponding item in ``base``. Equal items get
    numbered keys.
    """
    found: dict[str, YamlTree] = {}
    for item in items:
        found[numbered(spelled(item.data), found)] = item
    free = {name: _kind(item) for name, item in (base or {}).items() if name not in found}
    names = list(found)
    for k, (name, item) in enumerate(found.items()):
        old = next((old for old, kind in free.items() if kind and kind == _kind(item)), None)
        if old is not None and name not in (base or {}):
            names[k] = old
            del free[old]
    return dict(zip(names, items, strict=True))


def spelled(condition: Any) -> str:
    """Return the normalized text of a condition or a pair, independent of spacing and order."""
    return expression(copied(condition, lambda item: call(item) if isinstance(item, str) else item))


def _is_condition(tree: YamlTree) -> bool:
    value = tree.value
    if isinstance(value, dict) and len(value) == 1:
        key, below = next(iter(value.items()))
        if key in _JOINED:
            return isinstance(below.value, tuple) and all(map(_is_condition, below.value))
        return key == "not" and _is_condition(below)
    return isinstance(value, str)


def _is_pair(tree: YamlTree) -> bool:
    items = tree.value
    return isinstance(items, tuple) and len(items) == 2 and all(isinstance(item.value, str) for item in items)


def _kind(item: YamlTree) -> str:
    """Return ``all`` or ``any`` for an item that combines other conditions, or an empty string for other items."""
    value = item.value
    key = next(iter(value)) if isinstance(value, dict) and len(value) == 1 else ""
    return key if key in _JOINED else ""


def same(a: YamlTree | None, b: YamlTree | None, path: Path_ = ()) -> bool:
    """Return True if two values at ``path`` have the same meaning, ignoring the order of keys and conditions.

    ``1`` equals ``1.0`` but not ``true``.
    """
    if a is None or b is None:
        return a is b
    x, y = a.value, b.value
    if isinstance(x, dict):
        return isinstance(y, dict) and x.keys() == y.keys() and all(same(x[k], y[k], (*path, k)) for k in x)
    if isinstance(x, tuple):
        if not isinstance(y, tuple) or len(x) != len(y):
            return False
        if is_list_of_conditions(path, x, y):
            return matched(x).keys() == matched(y).keys()
        return all(same(i, j, path) for i, j in zip(x, y, strict=True))
    if isinstance(x, bool) or isinstance(y, bool):
        return x is y
    if isinstance(x, str) and isinstance(y, str) and path[-1:] and path[-1] in _CONDITIONS:
        return spelled(x) == spelled(y)
    return bool(x == y) or (x != x and y != y)


def identical(a: YamlTree, b: YamlTree) -> bool:
    """Return True if two trees are equal, have the same comments in the same order, and have the same layout."""
    if a is b:
        return True
    if (a.above, a.beside, a.end, a.layout) != (b.above, b.beside, b.end, b.layout):
        return False
    x: Any = a.value
    y: Any = b.value
    if isinstance(x, dict) and isinstance(y, dict):
        return list(x) == list(y) and all(map(identical, x.values(), y.values()))
    if isinstance(x, tuple) and isinstance(y, tuple):
        return len(x) == len(y) and all(map(identical, x, y))
    return type(x) is type(y) and bool(x == y)
