"""Find where in a document the cursor is, also in a text that cannot be parsed at the moment."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from simfoundry.language_server.cursor.blocks import (
    Block,
    Head,
    content,
    find_block,
    flow_top,
    heads_at,
    items_before,
    keys_of,
    line_start,
    next_line,
    siblings_follow,
)
from simfoundry.language_server.cursor.scan import (
    Slot,
    Style,
    TokenPlace,
    find_in_value,
    flow_keys,
    is_empty,
    line_end,
    unquoted,
    value_start,
)
from simfoundry.spec.yaml.text import Path_


@dataclass(frozen=True)
class Word:
    """A part of a text."""

    start: int
    end: int
    text: str


@dataclass(frozen=True)
class PredicateCall:
    """A predicate whose arguments contain the cursor, as in ``OnTop(mug, |``.

    ``index`` is the index of the argument with the cursor, and ``arguments`` are the texts of all arguments.
    """

    name: str
    index: int
    argument: Word
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Cursor:
    """The place of the cursor in a document.

    Attributes:
        offset: Offset of the cursor.
        slot: Whether the cursor is at a key, at a value, or at neither.
        path: Path of the key or value. A key that has not been typed yet has an empty name, and an item that has not
            been typed yet has the index that it will have.
        start: Offset of the start of the token (a key or a scalar), or of the cursor if there is no token.
        end: Offset of its end.
        text: The token as it is written, with its quotes.
        style: How the token is written.
        in_flow: True in braces or brackets.
        indent: Column of the keys or dashes of the mapping or list around the cursor, if it is in block style.
        alone: True if a value is on a line of its own, so that it may become the first key of a mapping or the first
            item of a list.
        lead: What is missing before the token: the dash of a list item, or the space behind a colon or dash.
        has_members: True if the value of the key follows on the next lines.
    """

    offset: int
    slot: Slot
    path: Path_
    start: int
    end: int
    text: str = ""
    style: Style = "plain"
    in_flow: bool = False
    indent: int = 0
    alone: bool = False
    lead: str = ""
    has_members: bool = False
    _siblings: Callable[[], tuple[str, ...]] = field(default=tuple, repr=False, compare=False)

    @property
    def container(self) -> Path_:
        """Return the path of the mapping or list that contains the key or value."""
        return self.path[:-1]

    @property
    def before(self) -> str:
        """Return the part of the token that is before the cursor."""
        return self.text[: self.offset - self.start]

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Return the other keys of the mapping that contains the key."""
        return self._siblings()

    @cached_property
    def call(self) -> PredicateCall | None:
        """Return the predicate whose arguments contain the cursor."""
        opening = _CALL.match(self.text)
        at = self.offset - self.start
        if opening is None or self.slot is not Slot.VALUE or at < opening.end():
            return None
        closing = self.text.find(")", opening.end())
        inside = self.text[opening.end() : closing if closing >= 0 else len(self.text.rstrip("\"'"))]
        if at > opening.end() + len(inside):
            return None
        arguments = inside.split(",")
        index = inside[: at - opening.end()].count(",")
        start = opening.end() + sum(len(argument) + 1 for argument in arguments[:index])
        end = start + len(arguments[index])
        while start < at and self.text[start].isspace():
            start += 1
        while end > max(at, start) and self.text[end - 1].isspace():
            end -= 1
        argument = Word(self.start + start, self.start + end, self.text[start:end])
        return PredicateCall(opening["name"], index, argument, tuple(text.strip() for text in arguments))

    @cached_property
    def word(self) -> Word:
        """Return the part of the token to which the cursor belongs.

        This is an argument or the name of a predicate, a parameter such as ``$gap`` in an expression, or else the whole
        token without quotes.
        """
        if self.call is not None:
            return self.call.argument
        at = self.offset - self.start
        if "$" in self.text and self.slot is Slot.VALUE:
            for found in _PARAMETER.finditer(self.text):
                if found.start() <= at <= found.end():
                    return Word(self.start + found.start(), self.start + found.end(), found.group())
            return Word(self.offset, self.offset, "")
        if (
            self.slot is Slot.VALUE
            and _SUM.match(self.text)
            and not _IN_NUMBER.match(self.text[max(at - 1, 0) : at + 1])
        ):
            return Word(self.offset, self.offset, "")
        name = _CALL.match(self.text)
        if name is not None and self.slot is Slot.VALUE and name.start("name") <= at <= name.end("name"):
            start, end = name.span("name")
            return Word(self.start + start, self.start + end, name["name"])
        if self.style != "quoted" or at == 0:
            return Word(self.start, self.end, self.text)
        closed = len(self.text) > 1 and self.text[-1] == self.text[0]
        inner = self.text[1:-1] if closed else self.text[1:]
        return Word(self.start + 1, self.start + 1 + len(inner), inner)

    @property
    def typed(self) -> str:
        """Return the part of :attr:`word` that is before the cursor."""
        return self.word.text[: max(self.offset - self.word.start, 0)]

    @property
    def owner(self) -> str:
        """Return the name before the dot, as ``cabinet`` in ``cabinet.drawer``, if the cursor is behind the dot."""
        return self.typed.rpartition(".")[0]


_CALL = re.compile(r"""["']?\s*(?P<name>[A-Za-z]\w*)\s*\(""")
_PARAMETER = re.compile(r"\$\w*|\w+")
# Arithmetic in which a parameter or number may be missing, and the characters beside an offset inside of a number.
_SUM = re.compile(r"[). 0-9]*[-+*/(][-+*/(). 0-9]*\Z")
_IN_NUMBER = re.compile(r".?[\w.]")
_OTHER_BREAKS = str.maketrans("\r\x85\u2028\u2029", "\n\n\n\n")


def cursor_at(text: str, offset: int) -> Cursor:
    """Return the place of an offset in a text.

    Only the lines that contain the place are read, upward by their indentation and brackets.
    """
    plain = text.replace("\r\n", " \n")
    if any(mark in plain for mark in "\r\x85\u2028\u2029"):
        plain = plain.translate(_OTHER_BREAKS)
    if plain.startswith("\ufeff"):
        plain = f"\n{plain[1:]}"
    marker = _MARKER.match(plain)
    if marker is not None:
        plain = f"{plain[: marker.end() - 3]}   {plain[marker.end() :]}"
    return _Finder(f"\n{plain}", min(max(offset, 0), len(text)) + 1).find()


_MARKER = re.compile(r"(?:\s*(?:[#%][^\n]*)?\n)*---(?=\s|\Z)")


class _Finder:
    """A search for the place of an offset in a text that starts with an additional empty line."""

    def __init__(self, text: str, offset: int) -> None:
        self.text, self.offset = text, offset
        self.line = line_start(text, offset)
        self.first = content(text, self.line)
        end = line_end(text, self.line)
        self.blank = self.first >= end
        self.comment = not self.blank and text[self.first] == "#"

    def find(self) -> Cursor:
        """Return the place."""
        top = flow_top(self.text, self.line, self.offset)
        if top >= 0:
            return self._in_line(top, heads_at(self.text, top))
        heads = [] if self.comment else heads_at(self.text, self.line)
        column = max(self.offset if self.blank else 0, self.first) - self.line
        if self.blank:
            column = self.offset - self.line
        in_list = bool(heads) and heads[0].key is None
        block = find_block(self.text, self.line, column, in_list, self.offset)
        if not isinstance(block, Block):
            return self._value(block[0], block[1])
        if self.comment and self.offset > self.first:
            return self._none((*block.path, ""))
        if heads:
            return self._at_heads(block, heads)
        if self.blank or self.comment:
            return self._blank(block, column)
        return self._bare(block)

    # -- lines with keys and dashes -----------------------------------------------------------------------------

    def _in_line(self, line: int, heads: list[Head]) -> Cursor:
        """Return the place in the brackets that open on a line above."""
        column = content(self.text, line) - line
        block = find_block(self.text, line, column, bool(heads) and heads[0].key is None, self.offset)
        if not isinstance(block, Block):
            return self._value(*block)
        path = self._path(block, heads)
        start = value_start(self.text, heads[-1].after if heads else content(self.text, line))
        found = find_in_value(self.text, start, self.offset, column)
        return self._none(path) if found is None else self._value(path, found)

    def _path(self, block: Block, heads: list[Head]) -> Path_:
        """Return the path of the value behind the keys and dashes at the start of a line."""
        path: list[str | int] = [*block.path]
        owner = block.owner
        for head in heads:
            if head.key is not None:
                path.append(head.key)
            elif owner is not None and owner.line == head.line:
                path.append(0)
            else:
                path.append(items_before(self.text, owner, head.column, head.line))
            owner = head
        return tuple(path)

    def _at_heads(self, block: Block, heads: list[Head]) -> Cursor:
        for number, head in enumerate(heads):
            path = self._path(block, heads[: number + 1])
            if self.offset <= head.end and head.key is not None and self.offset >= head.start:
                inner = block if not number else Block(path[:-1], heads[number - 1], "map", head.column, head.line)
                keys = self._keys(inner, head.start)
                return self._cursor(Slot.KEY, path, head.start, head.end, indent=head.column, _siblings=keys)
            if self.offset < head.after or (self.offset == head.after and number + 1 < len(heads)):
                return self._none(path)
        last = heads[-1]
        start = value_start(self.text, last.after)
        if is_empty(self.text, start):
            if self.offset > start and start < len(self.text) and self.text[start] == "#":
                return self._none(path)
            below = next_line(self.text, self.line)
            deeper = below >= 0 and content(self.text, below) - below > last.column
            lead = " " if self.offset == last.after else ""
            members = deeper or (last.key is not None and siblings_follow(self.text, self.line, last.column) == "list")
            return self._cursor(
                Slot.VALUE, path, self.offset, self.offset, indent=last.column, lead=lead, has_members=members
            )
        found = find_in_value(self.text, start, self.offset, last.column)
        return self._none(path) if found is None else self._value(path, found, last.column)

    # -- lines without -------------------------------------------------------------------------------------------

    def _blank(self, block: Block, column: int) -> Cursor:
        """Return the place on an empty line."""
        if block.kind == "map":
            keys = self._keys(block, -1)
            path = (*block.path, "")
            return self._cursor(Slot.KEY, path, self.offset, self.offset, indent=block.column, _siblings=keys)
        if block.kind == "list":
            path = (*block.path, items_before(self.text, block.owner, block.column, self.line))
            return self._cursor(Slot.VALUE, path, self.offset, self.offset, indent=block.column, lead="- ")
        if block.kind == "scalar":
            return self._none(block.path)
        indent = max(column, block.indent + 1)
        return self._cursor(Slot.VALUE, block.path, self.offset, self.offset, indent=indent, alone=True)

    def _bare(self, block: Block) -> Cursor:
        """Return the place on a line with neither a key nor a dash: a value, or a key that is not complete yet."""
        kind, column = block.kind, block.column
        if block.first == self.line:
            kind, column = siblings_follow(self.text, self.line, self.first - self.line), self.first - self.line
        elif kind == "scalar":
            found = find_in_value(self.text, block.first + column, self.offset, block.indent)
            return self._none(block.path) if found is None else self._value(block.path, found)
        if self.offset < self.first:
            return self._none(block.path)
        found = find_in_value(self.text, self.first, self.offset, block.indent)
        if not kind:
            if found is None:
                return self._none(block.path)
            return self._value(block.path, found, column, alone=found.style == "plain" and not found.below)
        if found is None or found.below:
            return self._none(block.path)
        end = min(found.end, line_end(self.text, self.line))
        if kind == "list":
            path = (*block.path, items_before(self.text, block.owner, column, self.line))
            return self._cursor(Slot.VALUE, path, found.start, end, style=found.style, indent=column, lead="- ")
        keys = self._keys(Block(block.path, block.owner, "map", column, block.first), self.first)
        path = (*block.path, unquoted(self.text[found.start : end]))
        return self._cursor(Slot.KEY, path, found.start, end, style=found.style, indent=column, _siblings=keys)

    # -- results -------------------------------------------------------------------------------------------------

    def _keys(self, block: Block, own: int) -> Callable[[], tuple[str, ...]]:
        return lambda: tuple(key for key, start in keys_of(self.text, block, self.offset) if start != own)

    def _value(self, path: Path_, found: TokenPlace, indent: int = 0, alone: bool = False) -> Cursor:
        if found.opening < 0:
            return self._cursor(
                found.slot, (*path, *found.below), found.start, found.end, style=found.style, indent=indent, alone=alone
            )
        lead = " " if found.slot is Slot.VALUE and self.text[self.offset - 1] == ":" else ""

        def keys() -> tuple[str, ...]:
            if self.text[found.opening] != "{":
                return ()
            listed = flow_keys(self.text, found.opening, self.offset)
            return tuple(key for key, start in listed if start != found.start)

        path = (*path, *found.below)
        return self._cursor(
            found.slot, path, found.start, found.end, style=found.style, in_flow=True, lead=lead, _siblings=keys
        )

    def _none(self, path: Path_) -> Cursor:
        return self._cursor(Slot.NONE, path, self.offset, self.offset)

    def _cursor(self, slot: Slot, path: Path_, start: int, end: int, **more: object) -> Cursor:
        text = self.text[start:end]
        return Cursor(self.offset - 1, slot, path, start - 1, end - 1, text, **more)  # type: ignore[arg-type]
