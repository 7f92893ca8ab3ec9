"""Read the lines of a document upward from a place, to find the keys and dashes that contain it.

Only the lines on the way from the place to the start of the document are read, so that neither the size of the document
nor an error elsewhere matters. The texts in this module start with an empty line and use only ``\\n`` as line break.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from simfoundry.language_server.cursor.scan import (
    TokenPlace,
    find_in_value,
    is_empty,
    line_end,
    unquoted,
    value_start,
)
from simfoundry.spec.yaml.nodes import MAX_DEPTH
from simfoundry.spec.yaml.text import Path_

# Size [characters] of the first part of a text that is searched upward; each further part is four times as large.
_FIRST_PART = 2_000
# Overlap [characters] of these parts; lines that are indented further than this are not found at their border.
_OVERLAP = 300

# Largest number of lines in brackets that may be indented less than the line with the bracket.
_MAX_LINES = 500

_HEAD = re.compile(
    r"""[ \t]*(?:
    (?P<dash>-(?=[ \t\n]|\Z))
    | (?:&\S+[ \t]+)?
      (?P<key> (?: "(?:[^"\\\n]|\\[^\n])*" | '(?:[^'\n]|'')*' ) [ \t]*
        | (?:[^\s\-?:,\[\]{}\#&*!|>'"%@`]|[-?:](?=\S)) (?:[^\n:\#]|:(?!\s|\Z)|(?<=\S)\#)*
        | (?=:(?:[ \t\n]|\Z)) )
      (?P<colon>:)(?=\s|\Z)
    )""",
    re.VERBOSE,
)
_SIGNIFICANT = re.compile(r"\n[ ]*(?=[^\s#])")
# Line in brackets or braces that continues on the next line.
_CONTINUES = re.compile(r"[^\n]*[,\[{][ \t]*(?:[ \t]#[^\n]*)?(?=\n|\Z)")


@dataclass(frozen=True)
class Head:
    """A key or a dash at the start of a line.

    Attributes:
        line: Offset of the line.
        column: Column, counted from 0.
        key: The key, or None for a dash.
        start: Offset of the start of the key or dash.
        end: Offset of its end.
        after: Offset behind the colon or dash.
    """

    line: int
    column: int
    key: str | None
    start: int
    end: int
    after: int


@dataclass(frozen=True)
class Block:
    """A mapping or list in block style, or a place where one can start.

    Attributes:
        path: Path of the mapping or list.
        owner: The key or dash that it belongs to, or None for the whole document.
        kind: ``map``, ``list``, ``scalar`` for another value, or an empty string if there is no value yet.
        column: Column of the keys or dashes.
        first: Offset of its first line, or -1.
    """

    path: Path_
    owner: Head | None
    kind: str = ""
    column: int = 0
    first: int = -1

    @property
    def indent(self) -> int:
        """Return the column of the key or dash that it belongs to, or -1 for the whole document."""
        return self.owner.column if self.owner is not None else -1


@lru_cache(maxsize=64)
def _shallower(column: int, keys_too: bool) -> re.Pattern[str]:
    """Return a pattern for a line that starts left of a column or, with ``keys_too``, for a key that starts there."""
    less = rf"\n {{0,{column - 1}}}(?=[^\s#])" if column else r"\n(?!)"
    return re.compile(rf"{less}|\n {{{column}}}(?=[^\s#-]|-\S)" if keys_too else less)


@lru_cache(maxsize=64)
def _at_column(column: int, dash: bool) -> re.Pattern[str]:
    """Return a pattern for a line whose first character, at a column, is a dash or belongs to a key."""
    first = r"-(?:[ \t\n]|\Z)" if dash else r"[^\s#-]|-\S"
    return re.compile(rf"\n {{{column}}}(?={first})")


@lru_cache(maxsize=64)
def _key_at(column: int) -> re.Pattern[str]:
    """Return a pattern for a line whose first character, at a column, belongs to a key, which may be a plain word."""
    return re.compile(rf"\n {{{column}}}(?:(?P<word>\w+):(?=\s|\Z)|(?=[^\s#-]|-\S))")


def line_start(text: str, position: int) -> int:
    """Return the offset of the start of a line."""
    return text.rfind("\n", 0, position) + 1


def heads_at(text: str, line: int) -> list[Head]:
    """Return the dashes and the key at the start of a line."""
    heads: list[Head] = []
    position = line
    while len(heads) < MAX_DEPTH and (found := _HEAD.match(text, position)) is not None:
        if found["dash"]:
            start, end = found.span("dash")
            heads.append(Head(line, start - line, None, start, end, end))
            position = end
            continue
        start = found.start("key")
        key = found["key"].rstrip()
        heads.append(Head(line, start - line, unquoted(key), start, start + len(key), found.end("colon")))
        break
    return heads


def content(text: str, line: int) -> int:
    """Return the offset of the first character of a line that is not a space."""
    end = line
    while text[end : end + 1] in (" ", "\t"):
        end += 1
    return end


def next_line(text: str, position: int) -> int:
    """Return the offset of the next line that is neither empty nor a comment, or -1."""
    found = _SIGNIFICANT.search(text, line_end(text, position))
    return found.start() + 1 if found is not None else -1


def _above(text: str, line: int, pattern: re.Pattern[str]) -> int:
    """Return the offset of the nearest line above another one that matches a pattern, or -1."""
    end, size = line - 1, _FIRST_PART
    while end > 0:
        start = max(0, end - size)
        last = -1
        for found in pattern.finditer(text, start, end):
            last = found.start() + 1
        if last >= 0:
            return last
        if not start:
            break
        end, size = min(end, start + _OVERLAP), size * 4
    return -1


def flow_top(text: str, line: int, offset: int) -> int:
    """Return the line on which the brackets or braces open that continue on a line, or -1.

    The content of brackets may be indented less than the line on which they open.
    """
    top, steps = line, 0
    while steps < _MAX_LINES and (before := _above(text, top, _SIGNIFICANT)) >= 0 and _continues(text, before, top):
        top, steps = before, steps + 1
    if top == line:
        return -1
    heads = heads_at(text, top)
    start = value_start(text, heads[-1].after if heads else content(text, top))
    if is_empty(text, start) or text[start] not in "[{":
        return -1
    return top if find_in_value(text, start, min(offset, content(text, line)), 0) is not None else -1


def _continues(text: str, before: int, line: int) -> bool:
    first = text[content(text, line) :][:1] if line < len(text) else ""
    return first in tuple("]},") or _CONTINUES.match(text, before) is not None


@dataclass(frozen=True)
class _Ancestor:
    """A line above a place, with the keys and dashes that contain the place, and whether others follow them."""

    line: int
    heads: list[Head]
    ends_inside: bool


def _ancestors(text: str, line: int, column: int, in_list: bool) -> list[_Ancestor]:
    """Return the lines that contain a line, from the outermost one on."""
    found: list[_Ancestor] = []
    while column > 0 or in_list:
        line = _above(text, line, _shallower(column, in_list))
        if line < 0:
            break
        top = flow_top(text, line, line)
        if top >= 0:
            line = line_end(text, top) + 1
            continue
        heads = heads_at(text, line)
        used = [h for h in heads if h.column < column or (in_list and h.column == column and h.key is not None)]
        found.append(_Ancestor(line, used, len(used) < len(heads)))
        column = content(text, line) - line
        in_list = bool(heads) and heads[0].key is None
    return found[::-1]


def find_block(text: str, line: int, column: int, in_list: bool, offset: int) -> Block | tuple[Path_, TokenPlace]:
    """Return the mapping or list that contains a line, or the place of ``offset`` if it is inside a value above.

    Args:
        text: The text.
        line: Offset of the line.
        column: Column at which it starts.
        in_list: True if it starts with a dash.
        offset: Offset of the place.
    """
    path: list[str | int] = []
    owners: list[Head] = []
    for ancestor in _ancestors(text, line, column, in_list):
        for head in ancestor.heads:
            path.append(_index(text, owners[-1] if owners else None, head) if head.key is None else head.key)
            owners.append(head)
        if ancestor.ends_inside:
            continue
        start = value_start(text, owners[-1].after if ancestor.heads else content(text, ancestor.line))
        if is_empty(text, start):
            continue
        found = find_in_value(text, start, offset, owners[-1].column if owners else -1)
        if found is not None:
            return tuple(path), found
        if ancestor.heads:  # the value is complete, so the line must belong to the same mapping or list
            path.pop()
            owners.pop()
    return _block(text, tuple(path), owners[-1] if owners else None)


def _block(text: str, path: Path_, owner: Head | None) -> Block:
    """Return a mapping or list with its kind, which follows from its first line."""
    if owner is not None:
        beside = [head for head in heads_at(text, owner.line) if head.start > owner.start]
        if beside:
            return Block(path, owner, "list" if beside[0].key is None else "map", beside[0].column, owner.line)
    first = next_line(text, owner.line if owner is not None else 0)
    if first < 0:
        return Block(path, owner)
    start = content(text, first)
    heads = heads_at(text, first)
    least = owner.column + 1 if owner is not None else 0
    if heads and heads[0].key is None and owner is not None and owner.key is not None:
        least -= 1  # the dashes of a list may be below its key
    if start - first < least:
        return Block(path, owner)
    kind = "scalar" if not heads else "list" if heads[0].key is None else "map"
    return Block(path, owner, kind, start - first, first)


def _index(text: str, owner: Head | None, dash: Head) -> int:
    """Return the index of a list item."""
    if owner is not None and dash.line == owner.line:
        return 0
    return items_before(text, owner, dash.column, dash.line)


def items_before(text: str, owner: Head | None, column: int, line: int) -> int:
    """Return the number of dashes at a column between the owner of a list and a line."""
    if owner is None:
        return sum(1 for _ in _at_column(column, True).finditer(text, 0, line - 1))
    beside = [h for h in heads_at(text, owner.line) if h.key is None and h.start > owner.start and h.column == column]
    return len(beside) + sum(1 for _ in _at_column(column, True).finditer(text, owner.line, line - 1))


def keys_of(text: str, block: Block, position: int) -> Iterator[tuple[str, int]]:
    """Yield the keys of a mapping, which contains ``position``, with their offsets."""
    if block.kind != "map":
        return
    if block.owner is not None and block.first == block.owner.line:
        head = heads_at(text, block.first)[-1]
        yield str(head.key), head.start
    start = block.owner.line if block.owner is not None else 0
    after = _shallower(block.column, False).search(text, max(line_end(text, position), start))
    end = len(text) if after is None else after.start()
    for found in _key_at(block.column).finditer(text, start, end):
        if found["word"]:
            yield found["word"], found.start("word")
            continue
        for head in heads_at(text, found.start() + 1):
            yield str(head.key), head.start


def siblings_follow(text: str, line: int, column: int) -> str:
    """Return the kind of mapping or list to which the next line belongs if it starts at the same column."""
    following = next_line(text, line)
    if following < 0 or content(text, following) - following != column:
        return ""
    heads = heads_at(text, following)
    return "" if not heads else "list" if heads[0].key is None else "map"
