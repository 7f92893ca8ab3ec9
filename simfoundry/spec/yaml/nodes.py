"""Compose YAML parser events into values with positions."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import yaml

from simfoundry.errors import PicklableError
from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity

# Maximum nesting depth; specs in this repository have at most 9 levels, and Python's recursion limit is 1000.
MAX_DEPTH = 64

# Maximum number of values, counting repetitions by aliases; a scene with 1,000 objects has about 16,000 values.
MAX_NODES = 150_000

_INT = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_RADIX = re.compile(r"0o[0-7]+\Z|0x[0-9a-fA-F]+\Z")
_WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


def is_word(text: str) -> bool:
    """Return True if YAML reads an unquoted text as null, a truth value or a number that is not finite."""
    return text in _WORDS


# Characters that can start a number.
_NUMERIC = frozenset("0123456789+-.")

# Key positions of all nodes that are not mappings; never modified.
_NO_KEYS: dict[str, tuple[int, int]] = {}


@dataclass(slots=True)
class Node:
    """A value with its position, counted from 1.

    Mappings also store the positions of their keys, and unquoted scalars store their text. ``weight`` is the number of
    contained values, including repetitions by aliases. ``file`` is set if the value and its key come from a file that
    the document extends rather than from the document itself. ``anchor`` is the name after ``&``; an alias shares the
    node of its anchor. ``one_line`` is True for a collection in brackets or braces on a single line, False if its
    members are on separate lines, and None if neither applies, as for a long list that is wrapped.
    """

    value: Any
    line: int
    column: int
    children: dict[str, Node] | list[Node] | None = None
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)
    plain: str = ""
    weight: int = 1
    file: str = ""
    anchor: str = ""
    one_line: bool | None = None

    @property
    def members(self) -> Collection[Node]:
        """Return the values of a mapping or the items of a list."""
        return self.children.values() if isinstance(self.children, dict) else self.children or ()

    @property
    def place(self) -> tuple[int, int]:
        """Return the line and column."""
        return self.line, self.column

    def with_members(
        self, members: dict[str, Node] | list[Node], keys: dict[str, tuple[int, int]] | None = None
    ) -> Node:
        """Return a copy with other members. ``keys`` are their positions, by default those in this node."""
        value: Any
        if isinstance(members, dict):
            known = self.keys if keys is None else keys
            value = {key: member.value for key, member in members.items()}
            weight = 1 + sum([member.weight for member in members.values()])
            places = {key: known.get(key, self.place) for key in members}
        else:
            value, places = tuple([member.value for member in members]), _NO_KEYS
            weight = 1 + sum([member.weight for member in members])
        return Node(value, self.line, self.column, members, places, "", weight, self.file)


class YamlError(PicklableError):
    """Raised if a YAML text could not be read."""

    def __init__(
        self,
        code: str,
        message: str,
        line: int = 0,
        column: int = 0,
        hint: str = "",
        word: str = "",
        fixes: tuple[Fix, ...] = (),
    ) -> None:
        super().__init__(message)
        self.code, self.message, self.line, self.column, self.hint = code, message, line, column, hint
        self.word, self.fixes = word, fixes

    def diagnostic(self, file: str) -> Diagnostic:
        """Return the error as a :class:`Diagnostic` of ``file``."""
        place = (file, self.line, self.column, "", self.hint)
        return Diagnostic(self.code, Severity.ERROR, self.message, *place, word=self.word, fixes=self.fixes)


@dataclass(slots=True)
class _Open:
    """An open collection: its start, its members and, for a mapping, the key whose value has not been read yet.

    ``key`` contains the key's name, line, column, and text if it is plain.
    """

    start: Any
    node: Node
    children: dict[str, Node] | list[Node]
    key: tuple[str, int, int, str] | None = None


class Composer:
    """A builder of :class:`Node` trees from parser events. It is not recursive, so nesting cannot exhaust the stack."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.roots: list[Node] = []
        self.documents = 0
        self.nodes = 0
        self.stack = [_Open(None, Node((), 1, 1), self.roots)]  # the bottom entry is the text itself
        self.anchors: dict[str, Node] = {}
        self.duplicates: list[Diagnostic] = []

    def _scalar(self, event: Any) -> None:
        mark = event.start_mark
        plain = "" if event.style else event.value
        top = self.stack[-1]
        if top.key is None and type(top.children) is dict:
            self._key(top, event, mark.line + 1, mark.column + 1, plain)
        else:
            self._add(Node(_value(event), mark.line + 1, mark.column + 1, None, _NO_KEYS, plain), event.anchor)

    def _key(self, top: _Open, event: Any, line: int, column: int, plain: str) -> None:
        """Start a key of the mapping on top of the stack. Keys count as values."""
        if event.tag is not None:
            raise _tag_error(event)
        if plain == "<<":
            raise YamlError("SF004", "merge keys (<<) are not part of YAML 1.2", line, column, "write the keys out")
        self._count(line, column)
        if event.anchor is not None:
            self.anchors[event.anchor] = Node(_value(event), line, column, None, _NO_KEYS, plain)
        top.key = (event.value, line, column, plain)

    def _document(self, event: Any) -> None:
        self.documents += 1
        if self.documents > 1:
            message = "a second document starts here, but a spec must be a single document"
            raise YamlError("SF004", message, *_mark(event), "move it to a separate file")

    def _start(self, event: Any) -> None:
        line, column = _mark(event)
        if event.tag is not None:
            raise _tag_error(event)
        if len(self.stack) > MAX_DEPTH:
            raise YamlError("SF005", f"the document is nested more than {MAX_DEPTH} levels deep", line, column)
        top = self.stack[-1]
        if top.key is None and type(top.children) is dict:
            raise YamlError("SF004", "a key must be a plain word", line, column)
        children: dict[str, Node] | list[Node] = {} if type(event) is yaml.MappingStartEvent else []
        keys = _NO_KEYS if isinstance(children, list) else {}
        self.stack.append(_Open(event, Node(None, line, column, children, keys), children))

    def _end(self, event: Any) -> None:
        top = self.stack.pop()
        node, children = top.node, top.children
        if isinstance(children, dict):
            node.value = {key: child.value for key, child in children.items()}
            node.weight += sum([child.weight for child in children.values()])
        else:
            node.value = tuple([child.value for child in children])
            node.weight += sum([child.weight for child in children])
        if top.start.flow_style:
            node.one_line = node.line == event.end_mark.line + 1 or _one_line_of_several(node)
        else:
            node.one_line = False
        self._add(node, top.start.anchor)

    def _alias(self, event: Any) -> None:
        if event.anchor not in self.anchors:
            message = f"the alias *{event.anchor} has no complete anchor before it"
            raise YamlError("SF002", message, *_mark(event), "write the value out")
        node = self.anchors[event.anchor]
        self.nodes += node.weight
        self._add(node, None)

    def _count(self, line: int, column: int) -> None:
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise YamlError("SF005", f"the document has more than {MAX_NODES} values", line, column)

    def _add(self, node: Node, anchor: str | None) -> None:
        """Add a value to the collection on top of the stack."""
        self._count(node.line, node.column)
        top = self.stack[-1]
        if isinstance(top.children, list):
            last = top.children[-1] if top.children else None
            if last is not None and "(" in last.plain and node.plain and top.start.flow_style and _is_open(last):
                top.children[-1] = _joined(last, node, top.node)
            else:
                top.children.append(node)
        else:
            self._add_to_mapping(top, top.children, node)
        if anchor is not None:
            self.anchors[anchor] = node
            node.anchor = anchor

    def _add_to_mapping(self, top: _Open, children: dict[str, Node], node: Node) -> None:
        if top.key is None:  # an alias or the end of a collection
            raise YamlError("SF004", "a key must be a plain word", node.line, node.column)
        name, line, column, plain = top.key
        top.key = None
        if plain and node.value is None and not node.plain and top.start.flow_style:
            last = next(reversed(children.values()), None)
            if last is not None and _is_open(last):  # `{goal: OnTop(cup, desk)}` is one string, as in a list
                last.value = last.plain = f"{last.plain}, {plain}"
                return
        if name in children:
            first = top.node.keys[name][0]
            message = f"`{name}` appears twice in one mapping"
            hint = f"it first appears on line {first}; remove or rename one of them"
            self.duplicates.append(Diagnostic("SF003", Severity.ERROR, message, self.file, line, column, name, hint))
            return
        children[name] = node
        top.node.keys[name] = (line, column)


def _one_line_of_several(node: Node) -> bool | None:
    """Return the value of :attr:`Node.one_line` for a collection in brackets or braces on several lines."""
    if isinstance(node.children, dict):
        return False
    lines = [item.line for item in node.members]  # an alias has the line of its anchor, which is never greater
    rows = all(a < b for a, b in pairwise(lines)) and lines[:1] >= [node.line + (len(lines) == 1)]
    return False if rows else None


def _joined(first: Node, rest: Node, parent: Node) -> Node:
    """Return a string that YAML splits inside parentheses in a bracketed list, as in ``[OnTop(cup, desk), Open(box)]``.

    YAML splits such strings at the comma. Only unquoted scalars have ``plain`` set. Quoted scalars are not changed.
    Aliases of the first part refer to the whole string.
    """
    if first.place < parent.place:  # an alias
        first = Node(first.value, first.line, first.column)
    first.value = first.plain = f"{first.plain or first.value}, {rest.plain}"
    return first


def _is_open(node: Node) -> bool:
    """Return True if an unquoted text has an unclosed parenthesis."""
    return bool(node.plain) and node.plain.count("(") > node.plain.count(")")


def _mark(event: Any) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1


def _tag_error(event: Any) -> YamlError:
    return YamlError("SF004", f"the tag {event.tag} is not supported", *_mark(event), "remove the tag")


def _value(event: Any) -> Any:
    """Return the value of a scalar."""
    if event.tag is not None:
        raise _tag_error(event)
    text: str = event.value
    if event.style:  # quoted and block scalars are always strings
        return text
    if text in _WORDS:
        return _WORDS[text]
    if text[0] not in _NUMERIC:
        return text
    if _INT.match(text):
        return _integer(text, 10, event)
    if _FLOAT.match(text):
        return float(text)
    if _RADIX.match(text):
        return _integer(text[2:], 8 if text[1] == "o" else 16, event)
    return text


def _integer(text: str, base: int, event: Any) -> int:
    if len(text) > 100:
        raise YamlError("SF104", "the number has more than 100 digits", *_mark(event))
    return int(text, base)


EVENTS: dict[type, Callable[[Composer, Any], None]] = {
    yaml.ScalarEvent: Composer._scalar,
    yaml.MappingStartEvent: Composer._start,
    yaml.SequenceStartEvent: Composer._start,
    yaml.MappingEndEvent: Composer._end,
    yaml.SequenceEndEvent: Composer._end,
    yaml.AliasEvent: Composer._alias,
    yaml.DocumentStartEvent: Composer._document,
    yaml.DocumentEndEvent: lambda composer, event: None,
    yaml.StreamStartEvent: lambda composer, event: None,
}
