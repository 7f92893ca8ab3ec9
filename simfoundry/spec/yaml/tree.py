"""Document trees that preserve comments and layout during formatting, merging, and editing."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.yaml.comments import BLANK, Notes, read_notes
from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Document, Path_

# Key of the document kind.
KIND = "simfoundry"


@dataclass(frozen=True, slots=True)
class TextLayout:
    """The way in which a person wrote a value.

    Attributes:
        one_line: True for a collection on a single line, False if its members are on separate lines, and None if
            neither applies.
        anchor: The name of the value's anchor, or an empty string.
        alias: True if the value was written as an alias of the anchor.
    """

    one_line: bool | None = None
    anchor: str = ""
    alias: bool = False


# Layouts without an anchor.
_LAYOUTS = {one_line: TextLayout(one_line) for one_line in (True, False, None)}


@dataclass(frozen=True, slots=True)
class YamlTree:
    """A value with the comments around it. Each comment is the text from ``#`` to the end of the line.

    An empty string among the comments is a blank line.

    Attributes:
        value: A scalar, a mapping of trees, or a tuple of trees.
        above: Comments before the value's key, or at the top of the document.
        beside: Comment at the end of the value's line.
        end: Comments after the last entry of a mapping or list, or at the end of the document.
        layout: The layout of a value that was read from a text, or None for a value that a program computed.
    """

    value: Any
    above: tuple[str, ...] = ()
    beside: str = ""
    end: tuple[str, ...] = ()
    layout: TextLayout | None = None

    @property
    def one_line(self) -> bool | None:
        """Return :attr:`TextLayout.one_line`, or None for a computed value."""
        return self.layout.one_line if self.layout is not None else None

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
        yield from (((), text) for text in (*self.above, self.beside) if text)
        value: Any = self.value if isinstance(self.value, dict | tuple) else ()
        for part, child in value.items() if isinstance(value, dict) else enumerate(value):
            yield from (((part, *path), text) for path, text in child.comments())
        yield from (((), text) for text in self.end if text)


def plain_tree(data: Any) -> YamlTree:
    """Return a tree without comments."""
    if isinstance(data, dict):
        return YamlTree({key: plain_tree(item) for key, item in data.items()})
    if isinstance(data, tuple | list):
        return YamlTree(tuple(plain_tree(item) for item in data))
    return YamlTree(data)


def with_data(tree: YamlTree, data: Any) -> YamlTree:
    """Return a tree of the plain ``data``, with the comments and layout of ``tree``, and the key order of ``data``.

    Comments of removed values are dropped. A mapping entry keeps its comments if its key still exists, even if its
    value changes. A list item keeps its comments if an equal item exists, or if it was changed but has the same
    neighbors.
    """
    old = tree.value
    if isinstance(data, dict) and isinstance(old, dict):
        return replace(tree, value={k: with_data(old[k], v) if k in old else plain_tree(v) for k, v in data.items()})
    if isinstance(data, tuple | list) and isinstance(old, tuple):
        return replace(tree, value=_items(old, tuple(data)))
    layout = None if isinstance(data, dict | tuple | list) or isinstance(old, dict | tuple) else tree.layout
    return YamlTree(plain_tree(data).value, tree.above, tree.beside, layout=layout)


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
    """Return the tree of a document, without its bases but with all comments. Aliases contain their values.

    Raises:
        SpecError: If a key occurs twice, because one of the values would be lost.
    """
    if document.duplicates:
        raise SpecError(document.duplicates)
    text = document.text.removeprefix("\ufeff")
    notes = read_notes(text, document.root, KIND) if "#" in text or BLANK.search(text) else None
    return _with_notes(document.root, notes, set())


def _with_notes(node: Node, notes: Notes | None, anchored: set[int]) -> YamlTree:
    """Return the tree of a node. ``anchored`` contains the identities of the anchored nodes before it in the text."""
    inside = notes.inside if notes is not None else {}
    value, layout = node.value, _LAYOUTS[node.one_line]
    if node.anchor:
        layout = TextLayout(node.one_line, node.anchor, id(node) in anchored)
    if isinstance(node.children, dict):
        value = {key: _with_notes(child, inside.get(key), anchored) for key, child in node.children.items()}
    elif isinstance(node.children, list):
        value = tuple([_with_notes(child, inside.get(k), anchored) for k, child in enumerate(node.children)])
    if node.anchor:
        anchored.add(id(node))
    if notes is None:
        return YamlTree(value, layout=layout)
    return YamlTree(value, tuple(notes.above), notes.beside, tuple(notes.end), layout)
