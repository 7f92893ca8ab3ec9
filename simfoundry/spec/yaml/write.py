"""Write YAML in a canonical form that is compact, produces stable diffs, and preserves comments and layout."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache, reduce
from itertools import groupby
from typing import Any

from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import KeyOrder, field_order, key_order
from simfoundry.spec.yaml.anchors import Alias, with_aliases
from simfoundry.spec.yaml.spelling import (
    Where,
    call,
    filled,
    folded,
    key_text,
    literal,
    number,
    rounded,
    scalar,
    string,
)
from simfoundry.spec.yaml.tree import YamlTree, plain_tree

__all__ = ["number", "to_data", "to_yaml", "write_tree"]

# Line width [columns], so that two documents fit side by side in a diff on a wide screen.
WIDTH = 110

# Maximum length of a simple key [characters]; YAML requires a question mark before longer keys.
MAX_KEY = 1000
# Maximum difference in length [columns] between neighboring lines whose comments are aligned.
NEIGHBORS = 24

# Sections whose members are written on several lines, unless a person wrote them on one.
_BLOCKS = ("objects", "links", "frames")

# Keys whose strings are predicates, such as ``OnTop(cup, desk)``.
_PREDICATES = ("relations", "goal", "all", "any", "not")

# Predicate with more than one argument.
_PAIR = re.compile(r"[A-Za-z]\w*\([^()]*,[^()]*\)\Z")

# A line and the comment beside it, which may be empty.
Line = tuple[str, str]


def to_yaml(spec: Model, comment: str = "") -> str:
    """Return the canonical text of a document.

    Fields are ordered, default values are omitted, and numbers are rounded to six decimals.
    """
    above = tuple(f"# {line}".rstrip() for line in comment.splitlines())
    return write_tree(replace(plain_tree(_rounded(to_data(spec))), above=above), type(spec))


def _rounded(data: Any) -> Any:
    match data:
        case float():
            number(data)  # raises for NaN and infinity
            return rounded(data)
        case dict():
            return {key: _rounded(item) for key, item in data.items()}
        case tuple():
            return tuple(_rounded(item) for item in data)
    return data


def write_tree(tree: YamlTree, model: type[Model] | None) -> str:
    """Return the canonical text of a document with its comments, blank lines, anchors and aliases.

    A collection stays on one line, if it fits, or on several lines if ``tree`` was read from a text that has it so.
    Keys of ``model`` are written in its order, followed by other keys. Names keep their order. Numbers are exact, so
    reading the text returns the tree's data, except for the spelling of predicates.
    """
    tree = with_aliases(_spelled(tree, False), key_order(model))
    writer = _Writer(tree)
    lines = [*_comments(_parted(tree.above, first=True), 0)]
    if isinstance(tree.value, dict) and tree.value:
        lines += writer.sections(tree, key_order(model), started=bool(lines))
    elif isinstance(tree.value, tuple) and tree.value:
        lines += writer.items(tree, key_order(model), 0)
    else:
        lines += [(writer.body(tree, key_order(model), "block"), tree.beside), *_comments(_end(tree), 0)]
    return "\n".join(_joined(lines)) + "\n"


def entry_lines(tree: YamlTree, path: tuple[str, ...], model: type[Model] | None, indent: int) -> list[str]:
    """Return the lines of one entry of a block mapping, indented by ``indent`` columns.

    Comments above the entry are omitted. Trailing comments and comments inside the entry are included.
    """
    slot, depth = _slot_at(path, model), 2 * (len(path) - 1)
    marked = with_aliases(_spelled(tree, path[-1] in _PREDICATES), slot)
    lines = _joined([*_Writer(marked).entry(path[-1], marked, slot, depth, path[0])])
    return [f"{' ' * indent}{line[depth:]}" if line.strip() else "" for line in lines]


def inline_text(data: Any, path: tuple[str, ...], model: type[Model] | None, in_braces: bool) -> str | None:
    """Return the text of a value that fits on one line after its key, or None if it needs several lines."""
    tree = _spelled(plain_tree(data), path[-1] in _PREDICATES or path[-2:-1] == ("relations",))
    writer = _Writer(tree)
    if ("\n" in tree.value) if isinstance(tree.value, str) else (writer.needs_lines and not in_braces):
        return None
    return writer.flow(tree, _slot_at(path, model), "value" if in_braces else "block")


def _slot_at(path: tuple[str, ...], model: type[Model] | None) -> KeyOrder:
    return reduce(KeyOrder.member, path, key_order(model))


def _spelled(tree: YamlTree, predicate: bool) -> YamlTree:
    """Return the tree with predicates in canonical form."""
    value: Any = tree.value
    if isinstance(value, str) and predicate:
        value = call(value)
    elif isinstance(value, dict):
        value = {key: _spelled(child, key in _PREDICATES) for key, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple([_spelled(child, predicate) for child in value])
    return tree if value == tree.value else replace(tree, value=value)


class _Writer:
    """A writer of mappings and lists.

    ``blocks`` contains the identities of trees that are not written on one line because they contain a comment, a long
    text, or a predicate, or because a person wrote them on several lines. Predicates are included because editors and
    other YAML readers split ``OnTop(cup, desk)`` at the comma inside brackets. A person who wrote them on one line gets
    them in quotes.
    """

    def __init__(self, tree: YamlTree) -> None:
        self.blocks: set[int] = set()
        self.needs_lines = self._collect(tree, False)

    def _collect(self, tree: YamlTree, on_one_line: bool) -> bool:
        """Collect blocks, and return True if the tree prevents its parent from being written on one line."""
        value = tree.value
        inside = bool(value) and (any(tree.end) or (tree.one_line is False and isinstance(value, dict | tuple)))
        if isinstance(value, str):
            inside = "\n" in value and literal(value) is not None
            if _PAIR.match(value) and not on_one_line:
                return True
        elif isinstance(value, dict | tuple):
            for child in value.values() if isinstance(value, dict) else value:
                inside |= self._collect(child, tree.one_line is True)
        if inside:
            self.blocks.add(id(tree))
        return inside or any(tree.above) or bool(tree.beside) or any(tree.end)

    def sections(self, tree: YamlTree, slot: KeyOrder, started: bool) -> Iterator[Line]:
        """Yield the entries of a document, with a blank line before each block that no person wrote."""
        for key in slot.ordered(tree.value):
            child = tree.value[key]
            written = [*self.entry(key, child, slot.member(key), 0, key)]
            parted = child.layout is None and written[0][0] == f"{key_text(key)}:"
            yield from _comments(_above(child, not started, parted), 0)
            yield from written
            started = True
        yield from _comments(_end(tree), 0)

    def entries(self, tree: YamlTree, slot: KeyOrder, indent: int, section: str) -> Iterator[Line]:
        """Yield the lines of the entries in a mapping, each entry below the previous one."""
        for k, key in enumerate(slot.ordered(tree.value)):
            child = tree.value[key]
            yield from _comments(_above(child, k == 0), indent)
            yield from self.entry(key, child, slot.member(key), indent, section)
        yield from _comments(_end(tree), indent)

    def items(self, tree: YamlTree, slot: KeyOrder, indent: int) -> Iterator[Line]:
        """Yield the lines of the items in a list, each item below the previous one."""
        for k, item in enumerate(tree.value):
            nested = isinstance(item.value, dict | tuple) and self.is_block(item, slot.item, indent + 2, indent + 2)
            above = (*_above(item, k == 0), *[item.beside] * (nested and bool(item.beside)))
            yield from _comments(above, indent)
            if nested:
                yield from self.nested_item(item, slot.item, indent)
            else:
                yield from self.short(f"{' ' * indent}-", item, slot.item, indent, item.beside)
        yield from _comments(_end(tree), indent)

    def nested_item(self, item: YamlTree, slot: KeyOrder, indent: int) -> Iterator[Line]:
        """Yield the lines of a multi-line item, starting after the dash."""
        inside = indent + 2
        mapping = isinstance(item.value, dict)
        first, *lines = self.entries(item, slot, inside, "") if mapping else self.items(item, slot, inside)
        dash = f"{' ' * indent}-{_anchor(item)}"
        if _anchor(item) or first[0].startswith("#", inside):
            yield from ((dash, ""), first)
        else:
            yield f"{dash} {first[0][inside:]}", first[1]
        yield from lines

    def entry(self, key: str, tree: YamlTree, slot: KeyOrder, indent: int, section: str) -> Iterator[Line]:
        """Yield the lines for a key and its value."""
        pad, value, beside = " " * indent, tree.value, tree.beside
        head = f"{pad}{key_text(key)}:"
        if len(key) > MAX_KEY:
            yield f"{pad}? {key_text(key)}", beside
            head, beside = f"{pad}:", ""
        if isinstance(value, dict) and value:
            section_or_member = tree.one_line is None and (indent == 0 or (indent == 2 and section in _BLOCKS))
            if section_or_member or self.is_block(tree, slot, len(head) + 1, indent + 2):
                yield f"{head}{_anchor(tree)}", beside
                yield from self.entries(tree, slot, indent + 2, section)
                return
        elif isinstance(value, tuple) and value and self.is_list_of_lines(tree, slot, len(head) + 1, indent + 2):
            yield f"{head}{_anchor(tree)}", beside
            yield from self.items(tree, slot, indent + 2)
            return
        yield from self.short(head, tree, slot, indent, beside)

    def short(self, head: str, tree: YamlTree, slot: KeyOrder, indent: int, beside: str) -> Iterator[Line]:
        """Yield the lines of a value that is not a block. This is a single line, except for long lists and texts."""
        head += _anchor(tree)
        if isinstance(tree.value, str):
            yield from self.text(head, tree.value, indent, beside)
            return
        flow = self.body(tree, slot, "block")
        if isinstance(tree.value, tuple) and len(head) + 1 + len(flow) > WIDTH:
            *lines, last = self.wrapped(head, tree, slot, indent)
            yield from ((line, "") for line in lines)
            yield last, beside
        else:
            yield f"{head} {flow}", beside

    def wrapped(self, head: str, tree: YamlTree, slot: KeyOrder, indent: int) -> list[str]:
        """Return the lines of a long list in brackets."""
        items = [f"{self.flow(item, slot.item, 'item')}," for item in tree.value]
        words = [f"{head} [{items[0]}", *items[1:]]
        return [*filled([*words[:-1], f"{words[-1][:-1]}]"], WIDTH, " " * (indent + 2))]

    def text(self, head: str, text: str, indent: int, beside: str) -> Iterator[Line]:
        """Yield the lines of a text. There are several if the text contains line breaks or is too long for one line."""
        lines = literal(text)
        line = f"{head} {string(text, 'block')}"
        if lines is None and len(line) > WIDTH:
            lines = folded(text, WIDTH - indent - 2)
        yield line if lines is None else f"{head} {lines[0]}", beside
        yield from ((f"{' ' * (indent + 2)}{part}" if part else "", "") for part in (lines or ())[1:])

    def is_block(self, tree: YamlTree, slot: KeyOrder, column: int, indent: int) -> bool:
        """Return True if a mapping or list is written on several lines, with ``indent``, rather than at ``column``."""
        if not tree.value:
            return False
        if isinstance(tree.value, tuple):
            return self.is_list_of_lines(tree, slot, column, indent)
        return id(tree) in self.blocks or column + len(self.flow(tree, slot, "block")) > WIDTH

    def is_list_of_lines(self, tree: YamlTree, slot: KeyOrder, column: int, indent: int) -> bool:
        """Return True if each item of a list gets its own line.

        This is the case if the list contains predicates, comments, items that are too long for one line, or items of
        which only one fits on a line.
        """
        if id(tree) in self.blocks:
            return True
        fits = column + len(self.flow(tree, slot, "block")) <= WIDTH
        if tree.one_line and fits:
            return False
        if any(isinstance(item.value, str) and "(" in item.value for item in tree.value):
            return True
        nested = [item for item in tree.value if isinstance(item.value, dict | tuple)]
        if any(indent + 1 + len(self.flow(item, slot.item, "item")) > WIDTH for item in nested):
            return True
        head = f"{' ' * (column - 1)}{_anchor(tree)}"
        return not fits and 1 < len(tree.value) == len(self.wrapped(head, tree, slot, indent - 2))

    def flow(self, tree: YamlTree, slot: KeyOrder, where: Where) -> str:
        """Format a value on a single line, after its anchor if it has one."""
        return f"{_anchor(tree)} {self.body(tree, slot, where)}".lstrip()

    def body(self, tree: YamlTree, slot: KeyOrder, where: Where) -> str:
        """Format a value on a single line, without its anchor."""
        value = tree.value
        if isinstance(value, dict):
            inside = (
                f"{key_text(key)}: {self.flow(value[key], slot.member(key), 'value')}" for key in slot.ordered(value)
            )
            return f"{{{', '.join(inside)}}}"
        if isinstance(value, tuple):
            return f"[{', '.join([self.flow(item, slot.item, 'item') for item in value])}]"
        return f"*{value.name}" if isinstance(value, Alias) else scalar(value, where)


def _anchor(tree: YamlTree) -> str:
    """Return the text of an anchor after a space, or an empty string."""
    return f" &{tree.layout.anchor}" if tree.layout is not None and tree.layout.anchor else ""


def _above(tree: YamlTree, first: bool, parted: bool = False) -> tuple[str, ...]:
    """Return the comments above a value, including those inside an empty collection, which has no lines for them.

    There is a blank line above them if ``parted`` is True, and none if the value is the ``first`` of its collection.
    """
    empty = not tree.value and isinstance(tree.value, dict | tuple)
    return _parted((*[""] * parted, *tree.above, *(tree.end if empty else ())), first)


def _end(tree: YamlTree) -> tuple[str, ...]:
    """Return the comments at the end of a collection, which does not end with a blank line."""
    return _parted(tree.end[::-1], first=True)[::-1]


def _parted(comments: tuple[str, ...], first: bool) -> tuple[str, ...]:
    """Return comments with single blank lines between them, and none above the ``first`` line of a collection."""
    before = ("" if first else "#", *comments)
    return tuple(text for above, text in zip(before, comments, strict=False) if text or above)


def _comments(comments: Iterable[str], indent: int) -> Iterator[Line]:
    yield from ((f"{' ' * indent}{_spaced(text)}" if text else "", "") for text in comments)


def _spaced(comment: str) -> str:
    """Return a comment with a space after its ``#``."""
    return comment if comment[1:2] in ("", " ", "\t", "!", "#") else f"# {comment[1:]}"


def _joined(lines: list[Line]) -> Iterator[str]:
    """Yield lines with their comments. The comments of neighboring lines of similar length are aligned."""
    for commented, run in groupby(lines, key=lambda line: bool(line[1])):
        neighbors = [*run]
        widths = [len(code) for code, _ in neighbors]
        column = max(widths) if max(widths) - min(widths) <= NEIGHBORS else 0
        for code, comment in neighbors:
            yield f"{code:<{column}}  {_spaced(comment)}" if commented else code


def to_data(spec: Model) -> dict[str, Any]:
    """Return the plain data of a document in canonical order, without values that equal their defaults."""
    given = spec.model_fields_set
    fields = [field for field in _fields(type(spec)) if field[1] or field[0] in given]
    values = [(name, needed, _data(getattr(spec, name)), default) for name, needed, default in fields]
    # A value written with the same text as the default would be read as the default and omitted the next time.
    return {name: data for name, needed, data, default in values if needed or not _written_alike(data, default)}


@cache
def _fields(model: type[Model]) -> tuple[tuple[str, bool, Any], ...]:
    """Return a (name, required, default) tuple for each field in canonical order."""
    fields = model.model_fields
    needed = {name for name, info in fields.items() if name == "simfoundry" or info.is_required()}
    return tuple((name, name in needed, _data(fields[name].default)) for name in field_order(model))


def _data(value: Any) -> Any:
    match value:
        case str() | float() | int() | None:  # tested first because most values are scalars
            return value
        case dict():
            return {key: _data(item) for key, item in value.items()}
        case tuple():
            return tuple([_data(item) for item in value])
        case Model():
            return to_data(value)
    return value


def _written_alike(a: Any, b: Any) -> bool:
    """Return True if two values are written as the same text, with numbers rounded to six decimals."""
    match a, b:
        case (float(), float() | int()) | (int(), float()):
            return rounded(a) == rounded(b)
        case tuple(), tuple():
            return len(a) == len(b) and all(map(_written_alike, a, b))
        case dict(), dict():
            return a.keys() == b.keys() and all(_written_alike(value, b[key]) for key, value in a.items())
    return bool(a == b)
