"""The place of every value in a text, as character offsets."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

_BOM = "\ufeff"


@dataclass(slots=True)
class TextSpan:
    """The place of a value in a text. All positions are character offsets, counted from 0.

    Attributes:
        start: The start of the value.
        end: The end of the value, exclusive.
        key: The start of the value's key, or -1 if the value has no key.
        key_end: The end of the key, exclusive, or -1.
        flow: True for a collection in brackets or braces.
        plain: True for a scalar without quotes.
        children: The members of a collection, or None for scalars and aliases.
    """

    start: int
    end: int
    key: int = -1
    key_end: int = -1
    flow: bool = False
    plain: bool = False
    children: dict[str, TextSpan] | list[TextSpan] | None = None

    @property
    def outer(self) -> int:
        """Return the start of the key, or of the value if it has no key."""
        return self.key if self.key >= 0 else self.start

    @property
    def members(self) -> Collection[TextSpan]:
        """Return the values of a mapping or the items of a list."""
        return self.children.values() if isinstance(self.children, dict) else self.children or ()

    def at(self, path: Sequence[str | int]) -> TextSpan | None:
        """Return the span of the value at a path below this one, or None if the text has no such value."""
        span = self
        for part in path:
            if isinstance(span.children, dict) and part in span.children:
                span = span.children[str(part)]
            elif isinstance(span.children, list) and isinstance(part, int) and 0 <= part < len(span.children):
                span = span.children[part]
            else:
                return None
        return span

    def entries(self) -> Iterator[tuple[str | int, TextSpan]]:
        """Yield the key or index and the span of each member."""
        if isinstance(self.children, dict):
            yield from self.children.items()
        else:
            yield from enumerate(self.children or ())

    def path_to(self, offset: int) -> list[tuple[str | int, TextSpan]]:
        """Return the keys and indices from this span down to the innermost one whose key or value has an offset."""
        steps: list[tuple[str | int, TextSpan]] = []
        span = self
        while found := next((e for e in span.entries() if e[1].outer <= offset <= max(e[1].end, e[1].key_end)), None):
            steps.append(found)
            span = found[1]
        return steps


def locate_values(text: str) -> TextSpan:
    """Locate every value in a text that can be parsed. Predicates that YAML splits at a comma are one value."""
    shift = len(text) - len(text.removeprefix(_BOM))
    events: Iterator[Any] = yaml.parse(text[shift:], Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    for event in events:
        if not isinstance(event, yaml.StreamStartEvent | yaml.DocumentStartEvent):
            return _Locator(text, events, shift).span(event)
    return TextSpan(shift, shift)


# Events at the end of a collection.
_ENDS: Any = (yaml.SequenceEndEvent, yaml.MappingEndEvent)


@dataclass
class _Locator:
    """The events of a text that have not been read yet. ``shift`` is the length of its byte order mark."""

    text: str
    events: Iterator[Any]
    shift: int

    def span(self, event: Any) -> TextSpan:
        """Return the span of the value that an event starts."""
        start, end = event.start_mark.index + self.shift, event.end_mark.index + self.shift
        flow = bool(getattr(event, "flow_style", False))
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[TextSpan] = []
            while not isinstance(event := next(self.events), _ENDS):
                item = self.span(event)
                if flow and items and item.plain and self._is_open(items[-1]):
                    items[-1].end = item.end
                else:
                    items.append(item)
            end = event.end_mark.index + self.shift if flow else items[-1].end if items else end
            return TextSpan(start, end, flow=flow, children=items)
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(start, end, flow)
        style = getattr(event, "style", None)
        if style in ("|", ">"):
            end = start + len(self.text[start:end].rstrip())
        return TextSpan(start, end, plain=isinstance(event, yaml.ScalarEvent) and not style)

    def _mapping(self, start: int, end: int, flow: bool) -> TextSpan:
        found: dict[str, TextSpan] = {}
        last: TextSpan | None = None
        while not isinstance(key := next(self.events), _ENDS):
            span = self.span(next(self.events))
            span.key, span.key_end = key.start_mark.index + self.shift, key.end_mark.index + self.shift
            span.end = max(span.end, span.key_end)
            if flow and last is not None and span.plain and span.start >= span.end and self._is_open(last):
                last.end = span.key_end  # the rest of a predicate in braces, which YAML reads as a key
                continue
            found[str(getattr(key, "value", ""))] = last = span
        end = key.end_mark.index + self.shift if flow else max((s.end for s in found.values()), default=end)
        return TextSpan(start, end, flow=flow, children=found)

    def _is_open(self, span: TextSpan) -> bool:
        """Return True if an unquoted text has an unclosed parenthesis."""
        if not span.plain:
            return False
        text = self.text[span.start : span.end]
        return text.count("(") > text.count(")")
