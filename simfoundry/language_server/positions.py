"""Conversion between positions in the protocol, character offsets, and the lines and columns of findings.

The protocol ends lines at LF, CR LF and CR, and counts columns in code units of an encoding that is agreed on at the
start. The YAML reader also ends lines at U+0085, U+2028 and U+2029, and counts lines and columns from 1, in characters.
Only character offsets, counted from 0, have the same meaning everywhere.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from functools import cached_property
from itertools import accumulate

from lsprotocol import types

_PROTOCOL_BREAK = re.compile(r"\r\n|\n|\r")
_YAML_BREAK = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
_BOM = "\ufeff"


class Lines:
    """A text, and the offsets at which its lines start."""

    def __init__(self, text: str, encoding: str = types.PositionEncodingKind.Utf16) -> None:
        self.text = text
        self.encoding: str = types.PositionEncodingKind(encoding).value  # a member's `str` is its name, not its value

    def offset(self, position: types.Position) -> int:
        """Return the offset of a position. A position beyond the end of its line or of the text is moved there."""
        if position.line < 0:
            return 0
        if position.line >= len(self._starts):
            return len(self.text)
        start, end = self.bounds(position.line)
        line = self.text[start:end]
        if line.isascii():
            return start + min(max(position.character, 0), len(line))
        ends = list(accumulate(map(self._units, line)))
        return start + bisect_right(ends, max(position.character, 0))

    def position(self, offset: int) -> types.Position:
        """Return the position of an offset. An offset inside a line break belongs to the end of the line."""
        line = bisect_right(self._starts, min(max(offset, 0), len(self.text))) - 1
        start, end = self.bounds(line)
        before = self.text[start : min(offset, end)]
        return types.Position(line, len(before) if before.isascii() else sum(map(self._units, before)))

    def range(self, start: int, end: int) -> types.Range:
        """Return the range between two offsets."""
        return types.Range(self.position(start), self.position(end))

    def span(self, within: types.Range) -> tuple[int, int]:
        """Return the offsets of the start and end of a range, in this order."""
        start, end = sorted((self.offset(within.start), self.offset(within.end)))
        return start, end

    @property
    def count(self) -> int:
        """Return the number of lines."""
        return len(self._starts)

    def bounds(self, line: int) -> tuple[int, int]:
        """Return the offsets of the start and end of a line, counted from 0, without its line break."""
        start = self._starts[line]
        if line + 1 == len(self._starts):
            return start, len(self.text)
        end = self._starts[line + 1] - 1
        return start, end - (self.text[end - 1 : end + 1] == "\r\n")

    def place(self, line: int, column: int) -> int:
        """Return the offset of a finding's line and column, counted from 1. Line 0 stands for the whole text."""
        if line <= 0:
            return 0
        if line > len(self._yaml_starts):
            return len(self.text)
        mark = line == 1 and self.text.startswith(_BOM)  # the YAML reader does not count it as a column
        return min(self._yaml_starts[line - 1] + max(column - 1, 0) + mark, len(self.text))

    @cached_property
    def _starts(self) -> list[int]:
        return [0, *(found.end() for found in _PROTOCOL_BREAK.finditer(self.text))]

    @cached_property
    def _yaml_starts(self) -> list[int]:
        if not any(mark in self.text for mark in "\x85\u2028\u2029"):
            return self._starts
        return [0, *(found.end() for found in _YAML_BREAK.finditer(self.text))]

    def _units(self, char: str) -> int:
        """Return the number of code units that a character takes in the agreed encoding."""
        if self.encoding == "utf-8":
            return len(char.encode("utf-8", "surrogatepass"))
        return 1 + (self.encoding == "utf-16" and char > "\uffff")
