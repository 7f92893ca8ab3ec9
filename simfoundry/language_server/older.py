"""Answers from an older text of a document, moved to where its lines are now."""

from __future__ import annotations

import copy
from typing import Any, TypeVar

from lsprotocol import types

from simfoundry.language_server.positions import Lines

T = TypeVar("T")


class _ChangedError(Exception):
    """Raised if a position is in the part of the text that has changed."""


class LineShift:
    """The lines that two texts have in common at their start and at their end."""

    def __init__(self, old: Lines, new: Lines) -> None:
        before, after = old.text.splitlines(), new.text.splitlines()
        most = min(len(before), len(after))
        pairs = zip(before, after, strict=False)
        self._same = next((k for k, (a, b) in enumerate(pairs) if a != b), most)
        backward = zip(reversed(before[self._same :]), reversed(after[self._same :]), strict=False)
        rest = next((k for k, (a, b) in enumerate(backward) if a != b), most - self._same)
        self._end, self._shift = len(before) - rest, len(after) - len(before)

    def line(self, line: int) -> int | None:
        """Return the present number of a line of the older text, or None if it has changed."""
        if line < self._same:
            return line
        return line + self._shift if line >= self._end else None

    def older_line(self, line: int) -> int | None:
        """Return the number that a line of the present text had in the older one, or None if it has changed."""
        if line < self._same:
            return line
        return line - self._shift if line - self._shift >= self._end else None

    def moved(self, answer: T) -> T:
        """Return an answer with all positions moved. Items at positions that have changed are left out."""
        try:
            found: T = self._moved(answer)
        except _ChangedError:
            return [] if isinstance(answer, list) else None  # type: ignore[return-value]
        return found

    def _moved(self, value: Any) -> Any:
        if isinstance(value, list):
            kept = []
            for item in value:
                try:
                    kept.append(self._moved(item))
                except _ChangedError:
                    continue
            return kept
        if isinstance(value, types.Position):
            line = self.line(value.line)
            if line is None:
                raise _ChangedError
            return types.Position(line, value.character)
        if isinstance(value, types.Range):
            return self._moved_range(value)
        if isinstance(value, types.FoldingRange):
            first, last = self.line(value.start_line), self.line(value.end_line)
            if first is None or last is None:
                raise _ChangedError
            return _changed(value, start_line=first, end_line=last)
        fields = getattr(type(value), "__attrs_attrs__", ())
        return _changed(value, **{field.name: self._moved(getattr(value, field.name)) for field in fields})

    def _moved_range(self, value: types.Range) -> types.Range:
        """Return a range whose ends are moved. A range of several lines may contain the change."""
        return types.Range(self._moved(value.start), self._moved(value.end))


def _changed(value: Any, **fields: Any) -> Any:
    """Return a copy of a type of the protocol with other fields."""
    if not fields:
        return value
    new = copy.copy(value)
    for name, field in fields.items():
        setattr(new, name, field)
    return new
