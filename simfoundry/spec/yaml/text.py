"""Read YAML 1.2 strictly, and remember the position of every value.

Specs are data: mappings with string keys, sequences, strings, numbers, booleans and null. Tags, merge keys, duplicate
keys and more than one document are errors. Depth, size and the expansion of aliases are bounded.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from simfoundry.spec.diagnostics import Diagnostic, Severity

MAX_BYTES = 4 * 2**20
MAX_DEPTH = 64
MAX_NODES = 150_000

_INT = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_RADIX = re.compile(r"0o[0-7]+\Z|0x[0-9a-fA-F]+\Z")
UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What may not stand in a YAML text as it is."""
_WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}

_NUMERIC = frozenset("0123456789+-.")
"""What a number starts with."""

_NO_KEYS: dict[str, tuple[int, int]] = {}
"""The keys of all that is no mapping; nobody adds to it."""

Path_ = tuple[str | int, ...]


@dataclass(slots=True)
class Node:
    """A value with its position (from 1); a mapping has the positions of its keys, an unquoted scalar its text.

    ``weight`` counts the values in it, each as often as an alias repeats it. ``file`` is set where the value, and the
    key before it, comes from another file than the document itself: one that it extends.
    """

    value: Any
    line: int
    column: int
    children: dict[str, Node] | list[Node] | None = None
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)
    plain: str = ""
    weight: int = 1
    file: str = ""


class YamlError(Exception):
    """An error that stops the reading of a text."""

    def __init__(self, code: str, message: str, line: int = 0, column: int = 0, hint: str = "") -> None:
        super().__init__(message)
        self.code, self.message, self.line, self.column, self.hint = code, message, line, column, hint

    def diagnostic(self, file: str) -> Diagnostic:
        """Return the error as a :class:`Diagnostic` of ``file``."""
        return Diagnostic(self.code, Severity.ERROR, self.message, file, self.line, self.column, "", self.hint)


@dataclass(frozen=True)
class Document:
    """A text that was read: plain ``data`` (mappings, tuples, scalars) and the tree of positions."""

    file: str
    text: str
    data: Any
    root: Node
    duplicates: tuple[Diagnostic, ...]
    added: dict[Path_, tuple[str, ...]] = field(default_factory=dict)
    """The members that it adds to what it extends, by path, with the names of those that are there."""

    def place(self, path: Sequence[str | int], of_key: bool = False) -> tuple[int, int]:
        """Return line and column of the value at ``path`` (or its key), or of the nearest ancestor.

        A mapping is pointed at by its key: its own text starts with a key of something else. Parts of ``path`` that the
        data does not have (the tags of a union) are passed over.
        """
        key = leaf = (self.root.line, self.root.column)
        for _, key, node in self._walk(path):
            leaf = key if isinstance(node.children, dict) else (node.line, node.column)
        return key if of_key else leaf

    def source(self, path: Sequence[str | int]) -> str:
        """Return the file that :meth:`place` refers to."""
        files = [self.root.file, *(node.file for _, _, node in self._walk(path))]
        return files[-1] or self.file

    def finding(
        self,
        code: str,
        path: Sequence[str | int],
        message: str,
        hint: str = "",
        severity: Severity = Severity.ERROR,
        of_key: bool = False,
    ) -> Diagnostic:
        """Return a finding at ``path``."""
        line, column = self.place(path, of_key)
        dotted = ".".join(map(str, path))
        return Diagnostic(code, severity, message, self.source(path), line, column, dotted, hint)

    def known(self, path: Sequence[str | int]) -> Path_:
        """Return the parts of ``path`` that exist in the data."""
        return tuple(part for part, _, _ in self._walk(path))

    def _walk(self, path: Sequence[str | int]) -> Iterator[tuple[str | int, tuple[int, int], Node]]:
        """Yield each existing part of ``path``, with the position of its key (or item) and its value."""
        node = self.root
        for part in path:
            if isinstance(node.children, dict) and isinstance(part, str) and part in node.children:
                key, node = node.keys[part], node.children[part]
            elif isinstance(node.children, list) and isinstance(part, int) and part < len(node.children):
                node = node.children[part]
                key = (node.line, node.column)
            else:
                continue
            yield part, key, node


def read(path: Path) -> Document:
    """Read a file; raises :class:`YamlError` with a place if the text cannot be read."""
    try:
        if path.exists() and not path.is_file():
            raise YamlError("SF001", "this is not a file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise YamlError("SF005", f"the file has {size / 2**20:.0f} MiB; at most {MAX_BYTES // 2**20} are read")
        data = path.read_bytes()
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8").splitlines(keepends=True) or [""]
        fresh = before[-1].endswith(("\n", "\r"))
        line, column = len(before) + fresh, 1 if fresh else len(before[-1]) + 1
        message = f"the byte 0x{data[error.start]:02x} is no UTF-8 text"
        raise YamlError("SF001", message, line, column, "save the file as UTF-8") from None
    except OSError as error:
        if error.errno == errno.ELOOP:
            hint = "let one of the links point to a file, or remove them"
            raise YamlError("SF001", "the file cannot be read: its links form a ring", hint=hint) from None
        raise YamlError("SF001", f"the file cannot be read: {error.strerror or error}") from None
    return parse(text, str(path))


_MARKERS = tuple(re.compile(pattern) for pattern in (r"<{7,}(?: |$)", r"={7,}$", r">{7,}(?: |$)"))
"""Lines of a conflict as git leaves it, in order; a repository may have longer markers than seven characters."""


def _conflict(text: str) -> int:
    """Return the line, from 1, in which a conflict of git starts; 0 without one."""
    start, wanted = 0, 0
    for number, line in enumerate(text.splitlines() if "<<<<<<<" in text else (), 1):
        if _MARKERS[wanted].match(line):
            start, wanted = (start or number), wanted + 1
            if wanted == len(_MARKERS):
                return start
    return 0


def parse(text: str, file: str = "<text>") -> Document:
    """Read a text; raises :class:`YamlError` with a place if it cannot be read."""
    conflict = _conflict(text)
    if conflict:
        hint = "choose between the lines and remove the markers; or merge by meaning: `simfoundry git install`, then "
        hint += f"`git checkout --merge -- {file}`"
        raise YamlError("SF209", "here is a conflict that git left to decide", conflict, 1, hint)
    odd = UNPRINTABLE.search(text, 1 if text.startswith("\ufeff") else 0)
    if odd is not None:
        before = text[: odd.start()].splitlines(keepends=True)
        whole = not before or before[-1].endswith(("\n", "\r"))
        line, column = len(before) + whole, 1 if whole else len(before[-1]) + 1
        message = f"the character U+{ord(odd.group()):04X} may not stand in a text"
        raise YamlError("SF002", message, line, column, "remove it, or write it as an escape in double quotes")
    composer = _Composer(file)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        next_event = loader(text).get_event
        while type(event := next_event()) is not yaml.StreamEndEvent:
            _EVENTS[type(event)](composer, event)
    except yaml.YAMLError as error:
        raise _syntax_error(error, text) from None
    root = composer.roots[0] if composer.roots else Node(None, 1, 1)
    return Document(file, text, root.value, root, tuple(composer.duplicates))


_SYNTAX = (
    ("mapping values are not allowed", "a `:` may not stand here", "is a line indented too far, or quotes missing?"),
    ("could not find expected ':'", "a `:` is missing", "a key is followed by a colon and a space"),
    ("expected <document start>", "the text does not continue here", "indent all keys of the document alike"),
    ("expected key", "a key should stand here", "indent it like the keys beside it"),
    ("expected '-' indicator", "a `-` should stand here", "indent it like the items beside it"),
    ("expected ',' or ']'", "a `,` or `]` should stand here", "the list that starts in line {start} is not closed"),
    ("expected ',' or '}'", "a `,` or `}}` should stand here", "the mapping that starts in line {start} is not closed"),
    ("expected node content", "a value should stand here", "is a bracket not closed, or a comma too many?"),
    ("unexpected end of stream", "these quotes are not closed", ""),
    ("unknown escape character", "this escape is not known", "in double quotes a backslash is written twice"),
    ("tab character", "a tab may not stand here", "indent with spaces, not tabs"),
)
"""What the parser says, and what a person can do with."""


def _syntax_error(error: yaml.YAMLError, text: str) -> YamlError:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if mark is None:
        return YamlError("SF002", problem)
    line, column = mark.line + 1, mark.column + 1
    opening = getattr(error, "context_mark", None)
    for said, message, hint in _SYNTAX:
        if said in problem:
            start = opening.line + 1 if opening is not None else line
            if not hint and opening is not None:  # the parser noticed at the end of the text what went wrong here
                line, column = start, opening.column + 1
            return YamlError("SF002", message.format(), line, column, hint.format(start=start))
    if "cannot start any token" in problem:
        found = text.removeprefix("\ufeff").splitlines()[mark.line][mark.column :][:1]
        if found == "\t":
            return YamlError("SF002", "a tab may not stand here", line, column, "indent with spaces, not tabs")
        return YamlError("SF002", f"a text may not start with `{found}`", line, column, "put it in double quotes")
    return YamlError("SF002", problem, line, column)


@dataclass(slots=True)
class _Open:
    """An open collection: its start, its members, and in a mapping the key that waits for a value.

    ``key`` is the key's name, line, column, and text where it is plain.
    """

    start: Any
    node: Node
    children: dict[str, Node] | list[Node]
    key: tuple[str, int, int, str] | None = None

    @property
    def wants_key(self) -> bool:
        """True if a key comes next."""
        return self.key is None and type(self.children) is dict


class _Composer:
    """Builds :class:`Node` trees from parser events without recursion, so that depth cannot exhaust the stack."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.roots: list[Node] = []
        self.documents = 0
        self.nodes = 0
        self.stack = [_Open(None, Node((), 1, 1), self.roots)]  # at the bottom the text itself
        self.anchors: dict[str, Node] = {}
        self.duplicates: list[Diagnostic] = []

    def _nothing(self, event: Any) -> None:
        """Ignore an event."""

    def _scalar(self, event: Any) -> None:
        mark = event.start_mark
        plain = "" if event.style else event.value
        top = self.stack[-1]
        if top.key is None and type(top.children) is dict:
            self._key(top, event, mark.line + 1, mark.column + 1, plain)
        else:
            self._add(Node(_value(event), mark.line + 1, mark.column + 1, None, _NO_KEYS, plain), event.anchor)

    def _key(self, top: _Open, event: Any, line: int, column: int, plain: str) -> None:
        """Start a key of the mapping on top of the stack; it counts as a value."""
        if event.tag is not None:
            raise _tag_error(event)
        if plain == "<<":
            raise YamlError("SF004", "merge keys (<<) are not YAML 1.2", line, column, "write the keys out")
        self._count(line, column)
        if event.anchor is not None:
            self.anchors[event.anchor] = Node(_value(event), line, column, None, _NO_KEYS, plain)
        top.key = (event.value, line, column, plain)

    def _document(self, event: Any) -> None:
        self.documents += 1
        if self.documents > 1:
            message = "a second document starts here; a spec is one document"
            raise YamlError("SF004", message, *_mark(event), "write it into a file of its own")

    def _start(self, event: Any) -> None:
        line, column = _mark(event)
        if event.tag is not None:
            raise _tag_error(event)
        if len(self.stack) > MAX_DEPTH:
            raise YamlError("SF005", f"nested more than {MAX_DEPTH} levels deep", line, column)
        if self.stack[-1].wants_key:
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
            node.children = children = _rejoined(children) if top.start.flow_style else children
            node.value = tuple([child.value for child in children])
            node.weight += sum([child.weight for child in children])
        self._add(node, top.start.anchor)

    def _alias(self, event: Any) -> None:
        if event.anchor not in self.anchors:
            message = f"the alias *{event.anchor} has no finished anchor before it"
            raise YamlError("SF002", message, *_mark(event), "write the value out")
        node = self.anchors[event.anchor]
        self.nodes += node.weight
        self._add(node, None)

    def _count(self, line: int, column: int) -> None:
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise YamlError("SF005", f"more than {MAX_NODES} values", line, column)

    def _add(self, node: Node, anchor: str | None) -> None:
        """Add a value to the collection on top of the stack."""
        self._count(node.line, node.column)
        top = self.stack[-1]
        if isinstance(top.children, list):
            top.children.append(node)
        else:
            self._add_to_mapping(top, top.children, node)
        if anchor is not None:
            self.anchors[anchor] = node

    def _add_to_mapping(self, top: _Open, children: dict[str, Node], node: Node) -> None:
        if top.key is None:  # an alias, or a collection that ends
            raise YamlError("SF004", "a key must be a plain word", node.line, node.column)
        name, line, column, plain = top.key
        top.key = None
        if plain and node.value is None and not node.plain and top.start.flow_style:
            last = next(reversed(children.values()), None)
            if last is not None and _is_open(last):  # `{goal: OnTop(cup, desk)}` is one text, as in a list
                last.value = last.plain = f"{last.plain}, {plain}"
                return
        if name in children:
            first = top.node.keys[name][0]
            message = f"`{name}` is written twice in one mapping"
            hint = f"it stands first in line {first}; remove or rename one of the two"
            self.duplicates.append(Diagnostic("SF003", Severity.ERROR, message, self.file, line, column, name, hint))
            return
        children[name] = node
        top.node.keys[name] = (line, column)


def _rejoined(items: list[Node]) -> list[Node]:
    """Rejoin a bracketed sequence that plain YAML splits inside parentheses: ``[OnTop(cup, desk), Closed(box)]``.

    Plain YAML splits such a text at its comma. Only plain scalars carry ``plain``; quoted ones stay as they are.
    """
    if not any("(" in item.plain for item in items):
        return items
    out: list[Node] = []
    for item in items:
        last = out[-1] if out else None
        if last is not None and item.plain and _is_open(last):
            joined = f"{last.plain}, {item.plain}"
            out[-1] = Node(joined, last.line, last.column, plain=joined)
        else:
            out.append(item)
    return out


def _is_open(node: Node) -> bool:
    """True if a plain text has an unclosed parenthesis."""
    return bool(node.plain) and node.plain.count("(") > node.plain.count(")")


def _mark(event: Any) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1


def _tag_error(event: Any) -> YamlError:
    return YamlError("SF004", f"the tag {event.tag} is not data", *_mark(event), "remove the tag")


def _value(event: Any) -> Any:
    """Return the value of a scalar."""
    if event.tag is not None:
        raise _tag_error(event)
    text: str = event.value
    if event.style:  # quoted and block scalars are strings, whatever they look like
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
        raise YamlError("SF104", "a number of more than 100 digits", *_mark(event))
    return int(text, base)


_EVENTS: dict[type, Callable[[_Composer, Any], None]] = {
    yaml.ScalarEvent: _Composer._scalar,
    yaml.MappingStartEvent: _Composer._start,
    yaml.SequenceStartEvent: _Composer._start,
    yaml.MappingEndEvent: _Composer._end,
    yaml.SequenceEndEvent: _Composer._end,
    yaml.AliasEvent: _Composer._alias,
    yaml.DocumentStartEvent: _Composer._document,
    yaml.DocumentEndEvent: _Composer._nothing,
    yaml.StreamStartEvent: _Composer._nothing,
}
