"""Lists of conditions or of pairs, which are sets: the items of three lists that are the same item."""

from __future__ import annotations

from collections import Counter
from typing import Any

from simfoundry.spec.change.diff.changes import EXPRESSION_LISTS, PAIR_LISTS, expression
from simfoundry.spec.change.merge.conflict import Path_
from simfoundry.spec.yaml.spelling import call
from simfoundry.spec.yaml.tree import CommentedTree

__all__ = ["is_list_of_conditions", "matched", "spelled"]

_JOINED = ("all", "any")


def is_list_of_conditions(path: Path_, *values: Any) -> bool:
    """Whether lists at ``path`` are sets of conditions, or of pairs."""
    if not path or path[-1] not in (*EXPRESSION_LISTS, *PAIR_LISTS):
        return False
    is_item = _is_pair if path[-1] in PAIR_LISTS else _is_condition
    return all(isinstance(value, tuple) and all(map(is_item, value)) for value in values)


def matched(items: tuple[CommentedTree, ...], base: dict[str, CommentedTree] | None = None) -> dict[str, CommentedTree]:
    """The items of a list by what they say; an `all` or `any` that changed is called like the one in ``base``.

    Equal items are told apart by a number.
    """
    names = _numbered([spelled(item.data) for item in items])
    if base is not None:
        known = set(base)
        free = [(name, _kind(item)) for name, item in base.items() if name not in names]
        for k, item in enumerate(items):
            kind = _kind(item)
            twin = next((name for name, other in free if other == kind), None) if kind else None
            if twin is not None and names[k] not in known:
                free = [pair for pair in free if pair[0] != twin]
                names[k] = twin
    return dict(zip(names, items, strict=True))


def spelled(condition: Any) -> str:
    """A condition, or a pair, as one text, however it is spaced or ordered."""
    return expression(_spelled(condition))


def _is_condition(tree: CommentedTree) -> bool:
    value = tree.value
    if isinstance(value, dict) and len(value) == 1:
        key, below = next(iter(value.items()))
        if key in _JOINED:
            return isinstance(below.value, tuple) and all(map(_is_condition, below.value))
        return key == "not" and _is_condition(below)
    return isinstance(value, str)


def _is_pair(tree: CommentedTree) -> bool:
    items = tree.value
    return isinstance(items, tuple) and len(items) == 2 and all(isinstance(item.value, str) for item in items)


def _spelled(condition: Any) -> Any:
    match condition:
        case str():
            return call(condition)
        case dict():
            return {key: _spelled(item) for key, item in condition.items()}
        case tuple():
            return tuple(_spelled(item) for item in condition)
    return condition


def _numbered(texts: list[str]) -> list[str]:
    counts = Counter[str]()
    names = []
    for text in texts:
        counts[text] += 1
        names.append(text if counts[text] == 1 else f"{text} #{counts[text]}")
    return names


def _kind(item: CommentedTree) -> str:
    """``all`` or ``any`` of an item that joins others; empty for any other."""
    value = item.value
    key = next(iter(value)) if isinstance(value, dict) and len(value) == 1 else ""
    return key if key in _JOINED else ""
