"""The scalars of a text as the YAML parser sees them, with their offsets."""

from __future__ import annotations

from typing import Any

import yaml

from simfoundry.language_server.cursor.scan import Slot
from simfoundry.spec.yaml.text import Path_


def leaves(text: str) -> list[tuple[Slot, Path_, int, int, str]]:
    """Each scalar of a text: a key or a value, its path, its offsets, and its style."""
    out: list[tuple[Slot, Path_, int, int, str]] = []
    stack: list[list[Any]] = []  # path, and the index or the key

    def path() -> Path_:
        return tuple(entry[0] for entry in stack)

    def after() -> None:
        if stack and isinstance(stack[-1][0], int):
            stack[-1][0] += 1
        elif stack:
            stack[-1][0] = None

    for event in yaml.parse(text, yaml.SafeLoader):
        assert event.start_mark is not None and event.end_mark is not None
        start, end = event.start_mark.index, event.end_mark.index
        match event:
            case yaml.MappingStartEvent():
                stack.append([None])
            case yaml.SequenceStartEvent():
                stack.append([0])
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                stack.pop()
                after()
            case yaml.ScalarEvent() | yaml.AliasEvent():
                style = "*" if isinstance(event, yaml.AliasEvent) else event.style or ""
                start += len(text[start:end]) - len(text[start:end].lstrip("&")) and text[start:end].find(" ") + 1
                if stack and stack[-1][0] is None:
                    stack[-1][0] = getattr(event, "value", "")
                    out.append((Slot.KEY, path(), start, end, style))
                else:
                    if start < end:
                        out.append((Slot.VALUE, path(), start, end, style))
                    after()
    return out


def joined(text: str, found: list[tuple[Slot, Path_, int, int, str]]) -> list[tuple[Slot, Path_, int, int, str]]:
    """The scalars with the predicates in brackets and braces put together, as our reader does."""
    out: list[tuple[Slot, Path_, int, int, str]] = []
    shift: dict[Path_, int] = {}
    for slot, path, start, end, style in found:
        if out:
            _, before, first, last, other = out[-1]
            piece = text[first:last]
            apart = text[last:start].strip() == ","
            if other == style == "" and piece.count("(") > piece.count(")") and apart and len(path) == len(before):
                out[-1] = (out[-1][0], before, first, end, "")
                shift[path[:-1]] = shift.get(path[:-1], 0) + 1
                continue
        moved = tuple(part - shift.get(path[:k], 0) if isinstance(part, int) else part for k, part in enumerate(path))
        out.append((slot, moved, start, end, style))
    return out
