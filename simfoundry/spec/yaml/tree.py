"""Document trees that preserve comments during formatting, merging, and editing."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.yaml.comments import Notes, read_notes
from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Document, Path_

# Key of the document kind.
KIND = "simfoundry"


@dataclass(frozen=True, slots=True)
class YamlTree:
    """A value with the comments around it. Each comment is the text from ``#`` to the end of the line.

    Attributes:
        value: A scalar, a mapping of trees, or a tuple of trees.
        above: Comments before the value's key, or at the top of the document.
        beside: Comment at the end of the value's line.
        end: Comments after the last entry of a mapping or list, or at the end of the document.
    """

    value: Any
    above: tuple[str, ...] = ()
    beside: str = ""
    end: tuple[str, ...] = ()

    @property
    def data(self) -> Any:
        """Return the plain data: mappings, tuples, and scalars, as in :class:`Document`."""
        if isinstance(self.value, dict):
            return {key: child.data for key, child in self.value.items()}
        if isinstance(self.value, tuple):
            return tuple(child.data for child in self.value)
        return self.value

    def comments(self) -> Iterator[tuple[Path_, str]]:
        """Yield every comment with the path of its value, in the order of the text."""
        yield from (((), text) for text in (*self.above, *[self.beside] * bool(self.beside)))
        value: Any = self.value if isinstance(self.value, dict | tuple) else ()
        for part, child in value.items() if isinstance(value, dict) else enumerate(value):
            yield from (((part, *path), text) for path, text in child.comments())
        yield from (((), text) for text in self.end)


def plain_tree(data: Any) -> YamlTree:
    """Return a tree without comments."""
    if isinstance(data, dict):
        return YamlTree({key: plain_tree(item) for key, item in data.items()})
    if isinstance(data, tuple | list):
        return YamlTree(tuple(plain_tree(item) for item in data))
    return YamlTree(data)


def with_data(tree: YamlTree, data: Any) -> YamlTree:
    """Return a tree of the plain ``data``, with the comments from ``tree``. Keys are in the order of ``data``.

    Comments of removed values are dropped. A mapping entry keeps its comments if its key still exists, even if its
    value changes. A list item keeps its comments if an equal item exists, or if it was changed but has the same
    neighbors.
    """
    old = tree.value
    if isinstance(data, dict) and isinstance(old, dict):
        return replace(tree, value={k: with_data(old[k], v) if k in old else plain_tree(v) for k, v in data.items()})
    if isinstance(data, tuple | list) and isinstance(old, tuple):
        return replace(tree, value=_items(old, tuple(data)))
    return YamlTree(plain_tree(data).value, tree.above, tree.beside)


def _items(old: tuple[YamlTree, ...], new: tuple[Any, ...]) -> tuple[YamlTree, ...]:
    """Return the new items of a list, each with the comments attached to the corresponding old item."""
    before, after = [repr(item.data) for item in old], [repr(item) for item in new]
    source: dict[int, int] = {}  # index of the old item for each new item
    for _, first, last, start, end in difflib.SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        if last - first == end - start:
            source.update(zip(range(start, end), range(first, last), strict=True))
    moved = {before[k]: k for k in range(len(old)) if k not in source.values()}
    for k, text in enumerate(after):
        if k not in source and text in moved:
            source[k] = moved.pop(text)
    return tuple(with_data(old[source[k]], item) if k in source else plain_tree(item) for k, item in enumerate(new))


def read_tree(document: Document) -> YamlTree:
    """Return the tree of a document, without its bases but with all comments. Aliases are expanded.

    Raises:
        SpecError: If a key occurs twice, because one of the values would be lost.
    """
    if document.duplicates:
        raise SpecError(document.duplicates)
    text = document.text.removeprefix("\ufeff")
    return _with_notes(document.root, read_notes(text, document.root, KIND) if "#" in text else None)


def _with_notes(node: Node, notes: Notes | None) -> YamlTree:
    inside = notes.inside if notes is not None else {}
    value = node.value
    if isinstance(node.children, dict):
        value = {key: _with_notes(child, inside.get(key)) for key, child in node.children.items()}
    elif isinstance(node.children, list):
        value = tuple([_with_notes(child, inside.get(k)) for k, child in enumerate(node.children)])
    if notes is None:
        return YamlTree(value)
    return YamlTree(value, tuple(notes.above), notes.beside, tuple(notes.end))
