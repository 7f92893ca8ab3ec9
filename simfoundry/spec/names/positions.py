"""Places of values in a text: from the lines and columns of the parser to characters of the text."""

from __future__ import annotations

import re
from bisect import bisect_right

from simfoundry.spec.yaml.nodes import Node

_BOM = "\ufeff"

# Anchor before a value, with the space and comments that follow it.
_ANCHOR = re.compile(r"&[^\s,\[\]{}]+(?:\s+|#[^\n]*\n)*")

# Number of characters after `\` in an escape of a double-quoted string, if it is not 1.
_ESCAPES = {"x": 3, "u": 5, "U": 9}

# Escapes for spaces and line breaks, which the value contains as such.
_SPACES = frozenset("tnr vfNLP_")


class TextIndex:
    """A text with the starts of its lines. All offsets are character indices, counted from 0."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._bom = text.startswith(_BOM)
        self._starts = [0]
        for line in text.splitlines(keepends=True):  # a parsed text has no other line breaks than those of YAML
            self._starts.append(self._starts[-1] + len(line))

    def offset(self, line: int, column: int) -> int:
        """Return the offset of a place of the parser, which are counted from 1 and do not count a byte order mark."""
        return self._starts[min(line, len(self._starts)) - 1] + column - 1 + (self._bom and line == 1)

    def place(self, offset: int) -> tuple[int, int]:
        """Return the line and column of an offset, counted from 1, as findings show them."""
        line = bisect_right(self._starts, offset)
        return line, offset - self._starts[line - 1] + 1 - (self._bom and line == 1)

    def line(self, number: int) -> str:
        """Return a line, counted from 1, without its line break."""
        return "".join(self.text[slice(*self._starts[number - 1 : number + 1])].splitlines()) if number else ""

    def ranges(self, value: str, line: int, column: int) -> SourceMap:
        """Return where the characters of a scalar are in the text."""
        start = self.offset(line, column)
        anchor = _ANCHOR.match(self.text, start) if self.text.startswith("&", start) else None
        return SourceMap(self.text, anchor.end() if anchor is not None else start, value)

    def of(self, node: Node) -> SourceMap:
        """Return where the characters of a scalar node are in the text."""
        return self.ranges(str(node.value), node.line, node.column)


class SourceMap:
    """The position in the text of each character of a scalar."""

    def __init__(self, text: str, start: int, value: str) -> None:
        self._text, self._value = text, value
        quoted = text.startswith(('"', "'"), start)
        self._start = start + quoted
        self._map = None if text.startswith(value, self._start) else _aligned(text, start, value)

    def range(self, start: int, end: int) -> tuple[int, int]:
        """Return the range of the text for a range of the value, which must not be empty."""
        if self._map is None:
            return self._start + start, self._start + end
        if end > len(self._map):  # not reached for what the parser accepts
            return self._start, self._start
        return self._map[start], self._map[end - 1] + 1


def _aligned(text: str, start: int, value: str) -> list[int]:
    """Return the offset of each character of a scalar that is wrapped, escaped, or a block."""
    style = text[start : start + 1]
    at = start + 1 if style in ("'", '"') else start
    if style in ("|", ">"):
        at = text.find("\n", start) + 1
    found: list[int] = []
    for char in value:
        if not char.isspace():
            at = _next(text, at, style)
            if at >= len(text):
                break
        found.append(at)
        if not char.isspace():
            at += _length(text, at, style)
    return found


def _next(text: str, at: int, style: str) -> int:
    """Return the next offset of a character that is not a space, a line break, or part of a comment."""
    while at < len(text):
        if text[at].isspace():
            at += 1
        elif text[at] == "#" and style not in ("'", '"', "|", ">") and text[at - 1].isspace():
            at = (text.find("\n", at) + 1) or len(text)
        elif text[at] == "\\" and style == '"' and (text[at + 1 : at + 2].isspace() or text[at + 1] in _SPACES):
            at += 2
        else:
            break
    return at


def _length(text: str, at: int, style: str) -> int:
    """Return the number of characters in the text for one character of the value."""
    if style == '"' and text[at] == "\\":
        return 1 + _ESCAPES.get(text[at + 1 : at + 2], 1)
    return 2 if style == "'" and text.startswith("''", at) else 1
