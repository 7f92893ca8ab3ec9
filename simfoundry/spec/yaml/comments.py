"""Assign every comment and blank line in a text to the value that it describes or precedes."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import reduce
from itertools import takewhile
from typing import Any

import yaml

from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Path_

_BREAK = re.compile("\r\n|[\r\n\x85\u2028\u2029]")
_COMMENT = re.compile("#[^\r\n\x85\u2028\u2029]*")
_ANCHOR = re.compile("&[0-9A-Za-z_-]+")
# Blank line after the first line of a text.
BLANK = re.compile("[\n\r\x85\u2028\u2029][ \t]*[\n\r\x85\u2028\u2029]")
_GAP = re.compile("(?:[ \t\r\n\x85\u2028\u2029\ufeff]|#[^\r\n\x85\u2028\u2029]*)*")
# Header line of a block scalar with a comment.
_HEADER = re.compile("[|>][-+0-9]*[ \t]+(#[^\r\n\x85\u2028\u2029]*)")


@dataclass(slots=True)
class Notes:
    """The comments attached to a value and to its members, which are indexed by key or position.

    An empty string in ``above`` or ``end`` is a blank line.
    """

    above: list[str] = field(default_factory=list)
    beside: str = ""
    end: list[str] = field(default_factory=list)
    inside: dict[str | int, Notes] = field(default_factory=dict)

    def at(self, part: str | int) -> Notes:
        """Return the comments attached to the member with this key or index."""
        return self.inside.setdefault(part, Notes())


def read_notes(text: str, root: Node, first: str) -> Notes:
    """Return the comments in the text that was parsed into ``root``.

    Comments at the top are assigned to the document if ``first`` is its first key.
    """
    return _Reader(text, root, first).read()


@dataclass(slots=True)
class _Frame:
    """A mapping or list that is not closed yet. ``indent`` is its column, or -1 inside brackets."""

    node: Node
    path: Path_
    indent: int
    part: str | int | None = None  # the key or index of the entry that was read last
    value_next: bool = False  # a key was read and its value comes next
    open: int = 0  # unclosed parentheses in the last item of a bracketed list
    anchor: str = ""  # anchor of the scalar that was read last

    @property
    def mapping(self) -> bool:
        return isinstance(self.node.children, dict)


@dataclass(slots=True)
class _Pending:
    """A comment that is assigned to a value once the next event is known.

    ``alone`` is True if the comment is on its own line or after a dash. ``parted`` is True if the line above is blank.
    The blank line above an entry is an empty comment at the start of the entry's first line.
    """

    start: int
    column: int
    alone: bool
    text: str
    parted: bool = False

    @property
    def lines(self) -> list[str]:
        """Return the comment, after a blank line if there is one above it."""
        return ["", self.text] if self.parted else [self.text]


class _Reader:
    """A reader of parser events that assigns the comments between the events to values.

    A comment on its own line belongs to the next value, or to the end of the mapping or list that ends next if it is
    indented deeper than the parent of that collection. A comment after a value on the same line belongs to that value.
    A blank line belongs to the comment or entry below it. Blank lines at the start or end of a collection are omitted.
    """

    def __init__(self, text: str, root: Node, first: str) -> None:
        self.text, self.node, self.first = text, root, first
        self.root = Notes()
        self.starts = [0, *(m.end() for m in _BREAK.finditer(text))]
        self.has_blank = BLANK.search(text) is not None
        self.stack: list[_Frame] = []
        self.pending: list[_Pending] = []
        self.owner: tuple[str, Path_, int] = ("", (), -1)  # the last value that was read: kind, path, and end
        self.next = text.find("#")  # next position that may start a comment
        self.directives = 0  # end of the directives
        self.plain: dict[str, str] = {}  # unquoted scalars by anchor

    def read(self) -> Notes:
        events: Iterator[Any] = yaml.parse(self.text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        for event in events:
            match type(event).__name__:
                case "ScalarEvent":
                    self._scalar(event)
                case "AliasEvent":
                    self._gap(event.start_mark.index)
                    self._part_item(event.start_mark.index)
                    self._owned("scalar", self._next_path(self.plain.get(event.anchor, "")), event.end_mark.index)
                case "MappingStartEvent" | "SequenceStartEvent":
                    self._open(event)
                case "MappingEndEvent" | "SequenceEndEvent":
                    self._close(event)
                case "DocumentStartEvent":
                    self.directives = event.end_mark.index
        self._gap(len(self.text))
        self.root.end += _lines(self.pending)
        return self.root

    # -- events ---------------------------------------------------------------------------------------------------

    def _scalar(self, event: Any) -> None:
        end = event.end_mark.index
        start = min(self._start(event), end)
        if self.next >= 0 and self.next < start:
            self._gap(start)
        plain = "" if event.style else event.value
        if event.anchor is not None:
            self.plain[event.anchor] = plain
        frame = self.stack[-1] if self.stack else None
        if frame is not None and frame.mapping and not frame.value_next:
            self._part(start, frame)
            if not frame.path and frame.part is None and self.pending:
                self._take_top(event.value, start)
            self._key(frame, event.value, end)
        else:
            self._part_item(start, plain)
            self._owned("scalar", self._next_path(plain, event.anchor or ""), end)
        if 0 <= self.next < end:
            header = _HEADER.match(self.text, start) if event.style in ("|", ">") else None
            if header is not None:
                self._beside(header[1])
            self.next = self.text.find("#", end)

    def _key(self, frame: _Frame, key: str, end: int) -> None:
        assert isinstance(frame.node.children, dict)
        if key in frame.node.children:
            frame.part, frame.anchor = key, ""
        else:  # the rest of a preceding text with a comma
            self._join(frame, key)
        frame.value_next = True
        self._owned("key", (*frame.path, frame.part or ""), end)

    def _owned(self, kind: str, path: Path_, end: int) -> None:
        """Record a value or key that was read, and assign the pending comments to it."""
        if self.pending:
            notes = self._at(path)
            if notes.beside:  # beside the key, with the value on a later line
                notes.above.append(notes.beside)
                notes.beside = ""
            notes.above += _lines(self.pending)
            self.pending = []
        self.owner = (kind, path, end)

    def _open(self, event: Any) -> None:
        start = self._start(event)
        self._gap(start)
        self._part_item(start)
        in_list = bool(self.stack) and not self.stack[-1].mapping
        path = self._next_path("")
        siblings: Any = self.stack[-1].node.children if self.stack else None
        node = self.node if siblings is None else siblings[path[-1]]
        if event.flow_style:
            self._owned("open", path, event.end_mark.index)
        else:
            count = self._about_whole(start, in_list)
            self._at(path).above += _lines(self.pending[:count])
            del self.pending[:count]
        self.stack.append(_Frame(node, path, -1 if event.flow_style else self._column(start)))

    def _about_whole(self, start: int, in_list: bool) -> int:
        """Count the pending comments that belong to the next value as a whole rather than to its first entry.

        These comments are above or beside the dash of an item, or beside a colon on a separate line.
        """
        ends = [c.start for c in self.pending[1:]] + [start]
        for k in range(len(self.pending) - 1, -1, -1):
            comment = self.pending[k]
            dash = in_list and "-" in self.text[comment.start + len(comment.text) : ends[k]]
            if dash or not comment.alone:
                return k + 1
        return 0

    def _close(self, event: Any) -> None:
        self._gap(event.start_mark.index)
        frame = self.stack.pop()
        outer = self.stack[-1].indent if self.stack else -1
        inside = [*takewhile(lambda comment: frame.indent < 0 or comment.column > outer, self.pending)]
        if inside:
            self._at(frame.path).end += _lines(inside)
            del self.pending[: len(inside)]
        if frame.indent < 0:
            self.owner = ("close", frame.path, event.end_mark.index)

    def _join(self, frame: _Frame, rest: str) -> None:
        """Add the rest of a text with a comma to the text that its anchor refers to."""
        if frame.anchor:
            self.plain[frame.anchor] += f", {rest}"

    def _next_path(self, plain: str, anchor: str = "") -> Path_:
        """Return the path of the value that starts at the current position."""
        if not self.stack:
            return ()
        frame = self.stack[-1]
        if frame.mapping:
            frame.value_next = False
            frame.anchor = anchor or frame.anchor
        else:
            open_ = plain.count("(") - plain.count(")")
            if frame.indent < 0 and frame.open > 0 and plain:  # the rest of a text with a comma in parentheses
                frame.open += open_
                self._join(frame, plain)
            else:
                frame.part = 0 if frame.part is None else int(frame.part) + 1
                frame.open, frame.anchor = open_, anchor
        return (*frame.path, frame.part if frame.part is not None else "")

    # -- comments -------------------------------------------------------------------------------------------------

    def _gap(self, end: int) -> None:
        """Collect the comments before ``end``. The text up to ``end`` must contain only comments."""
        while 0 <= self.next < end:
            match = _COMMENT.match(self.text, self.next)
            assert match is not None
            start = self.next
            if start < self.directives and self.text[start - 1 : start].strip():
                self.next = self.text.find("#", start + 1)  # inside a directive
                continue
            self.next = self.text.find("#", match.end())
            self._comment(start, match[0].rstrip(" \t"))

    def _comment(self, start: int, text: str) -> None:
        line = start - self._column(start)
        alone = not self.text[line:start].strip(" \t\ufeff")
        kind, path, end = self.owner
        if not alone and end >= line and (path or not self.node.children):
            self._beside(text)
        else:
            first = kind == "key" and not self.pending
            parted = alone and not first and self._is_parted(start)
            self.pending.append(_Pending(start, start - line, alone, text, parted))

    def _beside(self, text: str) -> None:
        kind, path, _ = self.owner
        notes = self._at(path)
        if kind == "close" and notes.beside:
            notes.end.append(text)
        else:
            notes.above += [notes.beside] * bool(notes.beside)
            notes.beside = text

    def _take_top(self, key: str, start: int) -> None:
        """Assign the comments at the top, above the first ``key``, to the document.

        If a different key should come first, the comments between the last blank line and ``key`` belong to ``key``.
        """
        parted = len(self.pending)
        ends = [c.start for c in self.pending[1:]] + [start]
        for k in range(len(self.pending) if key != self.first else 0):
            comment = self.pending[k]
            if len(_BREAK.findall(self.text, comment.start + len(comment.text), ends[k])) > 1:
                parted = k + 1
        self.root.above += _lines(self.pending[:parted])
        del self.pending[:parted]

    # -- blank lines ----------------------------------------------------------------------------------------------

    def _part(self, start: int, frame: _Frame) -> None:
        """Record the blank line above the entry whose first line contains ``start``."""
        if (frame.part is not None or self.pending) and self._is_parted(start):
            line = start - self._column(start)
            here = bisect_right(self.pending, line, key=lambda comment: comment.start)
            self.pending.insert(here, _Pending(line, 0, True, ""))

    def _part_item(self, start: int, plain: str = "") -> None:
        """Record the blank line above the list item whose value starts at ``start``."""
        frame = self.stack[-1] if self.stack else None
        if frame is None or frame.mapping or not self.has_blank or (frame.indent < 0 and frame.open > 0 and plain):
            return
        number = bisect_right(self.starts, start) - 1
        while frame.indent >= 0 and not self._has_dash(number, frame.indent):
            number -= 1
        self._part(self.starts[number], frame)

    def _has_dash(self, number: int, column: int) -> bool:
        """Return True if an item starts on a line, numbered from 0, at ``column``."""
        line = self.text[self.starts[number] : self.starts[number] + column + 1]
        return number == 0 or (line[column:] == "-" and not line.strip("-?: \t"))

    def _is_parted(self, start: int) -> bool:
        """Return True if nothing but dashes precedes ``start`` on its line, and the line above is blank."""
        if not self.has_blank:
            return False
        number = bisect_right(self.starts, start) - 1
        if number == 0 or self.text[self.starts[number] : start].strip("-? \t"):
            return False
        return not self.text[self.starts[number - 1] : self.starts[number]].strip()

    def _at(self, path: Path_) -> Notes:
        return reduce(Notes.at, path, self.root)

    def _start(self, event: Any) -> int:
        """Return the start of the value, after its anchor if it has one."""
        start: int = event.start_mark.index
        anchor = _ANCHOR.match(self.text, start) if event.anchor is not None else None
        if anchor is None:
            return start
        gap = _GAP.match(self.text, anchor.end())
        assert gap is not None
        return gap.end()

    def _column(self, index: int) -> int:
        return index - self.starts[bisect_right(self.starts, index) - 1]


def _lines(comments: Iterable[_Pending]) -> list[str]:
    return [line for comment in comments for line in comment.lines]
