"""Find a character offset inside a YAML value, also if the value is not complete yet.

The texts in this module use only ``\\n`` as line break.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from simfoundry.spec.yaml.text import Path_


class Slot(StrEnum):
    """The role of a place in a document."""

    KEY = "key"
    """A key of a mapping, or the place for one."""
    VALUE = "value"
    """A scalar, or the place for a value."""
    NONE = "none"
    """A comment, punctuation, or the space beside a complete value."""


Style = Literal["plain", "quoted", "block", "alias"]


@dataclass(frozen=True)
class TokenPlace:
    """A place inside a value.

    Attributes:
        slot: The role of the place.
        below: Path from the value to the place.
        start: Offset of the start of the token, or of the place if there is no token.
        end: Offset of the end of the token.
        style: How the token is written.
        opening: Offset of the innermost bracket or brace around the place, or -1.
    """

    slot: Slot
    below: Path_
    start: int
    end: int
    style: Style = "plain"
    opening: int = -1


# Largest number of tokens that are read to find the cursor in brackets, which takes about 50 ms. Brackets that close
# before the cursor count as one token.
MAX_TOKENS = 20_000

# Longest predicate [characters] that is put together from parts.
_MAX_JOINED = 1_000

# Longest distance [characters] behind the cursor that is searched for other keys in the same braces.
REACH = 20_000

_INDICATOR = r",\[\]{}"
# Plain scalar in brackets or braces. It may continue on the next line, unless that line starts with a key.
_FLOW_PLAIN = rf"""
    (?: [^\s{_INDICATOR}\#"'&*!|>%@`:] | (?<!["']):(?=[^\s{_INDICATOR}]) )
    (?: [^\s{_INDICATOR}:\#] | :(?=[^\s{_INDICATOR}]) | (?<=\S)\#
      | (?:[ \t]+ | [ \t]*\n\s*(?!["']?\w+["']?\s*:\s)) (?=[^\s{_INDICATOR}:\#]|:(?=[^\s{_INDICATOR}])) )*
"""
_FLOW = re.compile(
    rf"""
    (?P<space>\s+) | (?P<open>[\[{{]) | (?P<close>[\]}}]) | (?P<comma>,)
    | (?P<comment>(?<![^\s\[\]{{}},])\#[^\n]*)
    | (?P<quote>["']) | (?P<property>[&!][^\s{_INDICATOR}]*) | (?P<alias>\*[^\s{_INDICATOR}]*)
    | (?P<plain>{_FLOW_PLAIN}) | (?P<colon>:) | (?P<other>.)
    """,
    re.VERBOSE,
)
# Brackets without comments that hold at most two levels of others.
_SIMPLE = r"""[^\[\]{}"'#] | "[^"\\\n]*" | '[^'\n]*'"""
_COMPLETE = re.compile(
    rf"[\[{{](?: {_SIMPLE} | [\[{{](?: {_SIMPLE} | [\[{{](?: {_SIMPLE} )*[\]}}] )*[\]}}] )*[\]}}]", re.VERBOSE
)
# Next part of an unquoted text that is split at a comma inside parentheses; behind a key, only if it is not a key.
_NEXT_PART = re.compile(rf"\s*,\s*(?P<part>{_FLOW_PLAIN})(?P<colon>\s*:(?=[\s{_INDICATOR}]|\Z))?", re.VERBOSE)
_OPEN_END = re.compile(r"\s*,[ \t]*(?=[\]}\n]|\Z)")

_ON_LINE = {'"': re.compile(r'"(?:[^"\\\n]|\\[^\n])*"'), "'": re.compile(r"'(?:[^'\n]|'')*'")}
_ON_LINES = {
    '"': re.compile(r'"(?:[^"\\]|\\.)*"(?=[ \t]*(?:\n|\Z|[,\]}:]|[ \t]#))', re.DOTALL),
    "'": re.compile(r"'(?:[^']|'')*'(?=[ \t]*(?:\n|\Z|[,\]}:]|[ \t]#))"),
}
_KEY_LINE = re.compile(r"\n[ \t]*(?:- +)*\w+:(?:\s|\Z)")
_UNCLOSED = re.compile(r"[^\n,\]}]*")
_PROPERTIES = re.compile(r"[ \t]*(?:[&!][^\s,\[\]{}]*(?:[ \t]+|(?=\n|\Z)))*")
# Operators after which an expression goes on.
_OPERATORS = ("+", "-", "*", "/")
_BLOCK_PLAIN = re.compile(r"(?:[^\n#]|(?<=\S)#)*")
_BLOCK_HEADER = re.compile(r"[|>][-+0-9]*[ \t]*(?:(?<=\s)#[^\n]*)?(?=\n|\Z)")
_NEXT_LINE = re.compile(r"\n(?:[ \t]*\n)*(?P<indent> *)(?=[^\s#])")


def value_start(text: str, position: int) -> int:
    """Return the offset of the first character of a value on a line, behind its anchor.

    If there is no value, this is the offset of the comment or of the end of the line.
    """
    found = _PROPERTIES.match(text, position)
    return found.end() if found is not None else position


def is_empty(text: str, start: int) -> bool:
    """Return True if no value starts at an offset that :func:`value_start` has returned."""
    return start >= len(text) or text[start] in "\n#"


def line_end(text: str, position: int) -> int:
    """Return the offset of the end of a line."""
    end = text.find("\n", position)
    return len(text) if end < 0 else end


def find_in_value(text: str, start: int, offset: int, indent: int) -> TokenPlace | None:
    """Return the place of an offset inside the value that starts at ``start``, or None if the value ends before it.

    Args:
        text: The text.
        start: Offset of the first character of the value, which must not be empty.
        offset: The offset to find.
        indent: Column of the key or dash of the value. Its other lines are indented further.
    """
    char = text[start]
    if offset < start:
        return TokenPlace(Slot.NONE, (), offset, offset)
    if char in "[{":
        return _in_flow(text, start, offset)
    if char in "\"'":
        end = quoted_end(text, start)
        return TokenPlace(Slot.VALUE, (), start, end, "quoted") if offset <= end else None
    if char in "|>" and (header := _BLOCK_HEADER.match(text, start)) is not None:
        end = _block_end(text, header.end(), indent)
        return TokenPlace(Slot.VALUE, (), start, end, "block") if offset <= end else None
    end = _plain_end(text, start, indent)
    goes_on = _depth(text[start:end]) > 0 or text[start:end].endswith(_OPERATORS)
    if offset > end and goes_on and not text[end:offset].strip(" \t"):
        end = offset
    style: Style = "alias" if char == "*" else "plain"
    return TokenPlace(Slot.VALUE, (), start, end, style) if offset <= end else None


def quoted_end(text: str, start: int) -> int:
    """Return the end of a quoted string. If it is not closed, it ends at the next comma or bracket of its line."""
    quote = text[start]
    found = _ON_LINE[quote].match(text, start)
    if found is None:
        found = _ON_LINES[quote].match(text, start)
        if found is not None and _KEY_LINE.search(text, start, found.end()):
            found = None
    if found is None:
        found = _UNCLOSED.match(text, start)
    return found.end() if found is not None else start


def unquoted(token: str) -> str:
    """Return the text of a key or scalar without its quotes."""
    if token[:1] == "'":
        return token[1:].removesuffix("'").replace("''", "'")
    if token[:1] != '"':
        return token
    try:
        return str(json.loads(token))
    except ValueError:
        return token.strip('"')


def _plain_end(text: str, start: int, indent: int) -> int:
    """Return the end of an unquoted scalar outside of brackets, which may continue on lines that are indented."""
    end = start
    line = _BLOCK_PLAIN.match(text, start)
    while line is not None:
        end = start + len(line.group().rstrip())
        following = _NEXT_LINE.match(text, line.end())
        if following is None or len(following["indent"]) <= indent:
            break
        start = following.end()
        line = _BLOCK_PLAIN.match(text, start)
        if line is None or re.search(r":(?:\s|\Z)", line.group()):
            break
    return end


def _block_end(text: str, position: int, indent: int) -> int:
    """Return the end of a block scalar, whose header ends at ``position``."""
    end = position
    while end < len(text):
        stop = line_end(text, end + 1)
        line = text[end + 1 : stop]
        if line.strip(" ") and len(line) - len(line.lstrip(" ")) <= indent:
            return position
        if len(line) > indent + 1:
            position = stop
        end = stop
    return position


def _depth(text: str) -> int:
    """Return the number of parentheses that are open at the end of an unquoted text."""
    return text.count("(") - text.count(")")


@dataclass
class _Bracket:
    """An open bracket or brace, and how far its content has been read.

    Attributes:
        opening: Offset of the bracket or brace.
        name: Index of the current item, or the current key.
        state: What has been read of the current item or member.
    """

    opening: int
    name: str | int
    state: Literal["start", "key", "value", "done"] = "start"

    @property
    def in_list(self) -> bool:
        """Return True for a bracket, and False for a brace."""
        return isinstance(self.name, int)

    def next(self) -> None:
        """Start the next item or member."""
        self.name = self.name + 1 if isinstance(self.name, int) else ""
        self.state = "start"


@dataclass
class _Flow:
    """A reader of the tokens of a value in brackets or braces."""

    text: str
    position: int
    stack: list[_Bracket] = field(default_factory=list)

    def tokens(self, offset: int) -> Iterator[tuple[str, int, int]]:
        """Yield the kind, start and end of each token except spaces. The caller passes each one to :meth:`read`.

        Inner brackets that close before ``offset`` are a single token of the kind ``complete``.
        """
        while (found := _FLOW.match(self.text, self.position)) is not None:
            kind, (start, end) = str(found.lastgroup), found.span()
            if kind == "open" and self.stack and (whole := _COMPLETE.match(self.text, start, offset)) is not None:
                kind, end = "complete", whole.end()
            if kind == "quote":
                kind, end = "quoted", quoted_end(self.text, start)
            elif kind == "plain" and self.expects_value:
                end = self._joined(start, end)
            self.position = end
            if kind != "space":
                yield kind, start, end

    @property
    def expects_value(self) -> bool:
        """Return True if the next scalar is a value."""
        return bool(self.stack) and (self.stack[-1].in_list or self.stack[-1].state == "value")

    def read(self, kind: str, start: int, end: int) -> None:
        """Note a token."""
        top = self.stack[-1] if self.stack else None
        if kind == "open":
            self.stack.append(_Bracket(start, 0 if self.text[start] == "[" else ""))
        elif kind == "close":
            self.stack.pop()
            if self.stack:
                self.stack[-1].state = "done"
        elif top is None:
            return
        elif kind == "comma":
            top.next()
        elif kind == "complete":
            top.state = "done"
        elif kind == "colon" and not top.in_list:
            top.state = "value"
        elif kind in ("plain", "quoted", "alias"):
            if top.in_list or top.state == "value":
                top.state = "done"
            elif top.state == "start":
                top.name, top.state = unquoted(self.text[start:end]), "key"

    def _joined(self, start: int, end: int) -> int:
        """Return the end of an unquoted text that YAML splits at commas, as in ``[OnTop(cup, desk)]``."""
        depth, limit = _depth(self.text[start:end]), start + _MAX_JOINED
        while depth > 0 and end < limit:
            part = _NEXT_PART.match(self.text, end, limit)
            if part is None:
                rest = _OPEN_END.match(self.text, end)
                return rest.end() if rest is not None else end
            if part["colon"] and not self.stack[-1].in_list:
                return end
            end = part.end("part")
            depth += _depth(part["part"])
        return end


def _in_flow(text: str, start: int, offset: int) -> TokenPlace | None:
    """Return the place of an offset in a value in brackets or braces, or None if the value ends before it."""
    if offset == start:
        return TokenPlace(Slot.NONE, (), offset, offset)
    flow = _Flow(text, start)
    last = (start, start)  # the token before the cursor, which goes on behind an operator
    for count, (kind, first, end) in enumerate(flow.tokens(offset)):
        scalar = kind in ("plain", "quoted", "alias")
        if offset < first or (offset == first and not scalar):
            break
        if count > MAX_TOKENS:
            return TokenPlace(Slot.NONE, (), offset, offset)
        if offset <= end and scalar:
            style: Style = "alias" if kind == "alias" else "quoted" if kind == "quoted" else "plain"
            return _found(flow, first, end, style)
        if kind in ("comment", "property") and offset <= end:
            return TokenPlace(Slot.NONE, _path(flow), offset, offset, opening=flow.stack[-1].opening)
        flow.read(kind, first, end)
        last = (first, end) if kind == "plain" else (end, end)
        if not flow.stack:
            return None if offset > end else TokenPlace(Slot.NONE, (), offset, offset)
    if text[last[0] : last[1]].endswith(_OPERATORS) and not text[last[1] : offset].strip(" \t"):
        return TokenPlace(Slot.VALUE, _path(flow), last[0], offset, opening=flow.stack[-1].opening)
    return _found(flow, offset, offset)


def _found(flow: _Flow, start: int, end: int, style: Style = "plain") -> TokenPlace:
    """Return the place of a token, or of the empty place in which one may be inserted."""
    top = flow.stack[-1]
    path = _path(flow)
    if top.state == "start" and not top.in_list:
        name = unquoted(flow.text[start:end])
        return TokenPlace(Slot.KEY, (*path[:-1], name), start, end, style, top.opening)
    slot = Slot.VALUE if top.state == "value" or (top.in_list and top.state == "start") else Slot.NONE
    return TokenPlace(slot, path, start, end, style, top.opening)


def _path(flow: _Flow) -> Path_:
    return tuple(bracket.name for bracket in flow.stack)


def flow_keys(text: str, opening: int, cursor: int) -> Iterator[tuple[str, int]]:
    """Yield the keys between the braces that open at ``opening``, with their offsets.

    The search ends at the closing brace, far behind the cursor, or at a line that does not belong to the braces because
    it is not indented further than the line with the opening brace.
    """
    flow = _Flow(text, opening)
    line = text.rfind("\n", 0, opening) + 1
    indent = opening - line - len(text[line:opening].lstrip(" "))
    for count, (kind, start, end) in enumerate(flow.tokens(cursor)):
        before = text.rfind("\n", 0, start) + 1
        outside = start > cursor and before > opening and start - before <= indent and kind in ("plain", "quoted")
        if count > MAX_TOKENS or start > cursor + REACH or (outside and not text[before:start].strip()):
            return
        depth = len(flow.stack)
        key = depth == 1 and flow.stack[0].state == "start" and kind in ("plain", "quoted")
        flow.read(kind, start, end)
        if not flow.stack:
            return
        if key:
            yield str(flow.stack[0].name), start
