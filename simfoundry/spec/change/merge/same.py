"""Whether two values of documents say the same."""

from __future__ import annotations

from typing import Any

from simfoundry.spec.change.merge.conditions import is_list_of_conditions, matched, spelled
from simfoundry.spec.change.merge.conflict import Path_
from simfoundry.spec.yaml.tree import CommentedTree

_CONDITIONS = ("goal", "not")
"""Keys of conditions."""


def same(a: CommentedTree | None, b: CommentedTree | None, path: Path_ = ()) -> bool:
    """Whether two values at ``path`` say the same: the order of keys and conditions, and spaces in these, mean nothing.

    ``1`` is ``1.0`` but not ``true``.
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


def identical(a: CommentedTree, b: CommentedTree) -> bool:
    """Whether two trees are the same to the last comment, and in the same order."""
    if a is b:
        return True
    if (a.above, a.beside, a.end) != (b.above, b.beside, b.end):
        return False
    x: Any = a.value
    y: Any = b.value
    if isinstance(x, dict) and isinstance(y, dict):
        return list(x) == list(y) and all(map(identical, x.values(), y.values()))
    if isinstance(x, tuple) and isinstance(y, tuple):
        return len(x) == len(y) and all(map(identical, x, y))
    return type(x) is type(y) and bool(x == y)
