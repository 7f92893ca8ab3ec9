"""The texts that completion inserts: snippets in block style or in braces, with placeholders."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

from lsprotocol import types

from simfoundry.language_server.cursor.cursor import Cursor
from simfoundry.language_server.positions import Lines
from simfoundry.spec.editor.snippets import Body, one_line

# Placeholder such as ``${2:0.5}`` or ``${1|auto,hull|}``, or a final position such as ``$0``.
_PLACEHOLDER = re.compile(r"\$\{(\d+):([^{}]*)\}|\$\{(\d+)\|([^{}|]*)\|\}|\$(\d)")
# Largest number of names that a placeholder lists as choices.
_MAX_CHOICES = 20


@dataclass(frozen=True)
class Offer:
    """Something that completion offers.

    Attributes:
        label: What the editor shows.
        kind: The kind of thing.
        insert: The text to insert, by default the label. It may have placeholders.
        detail: Short description beside the label, or a function that returns it if the offer is shown.
        text: Longer description, as Markdown.
        group: Offers of a lower group are shown first; inside a group, the order is kept.
        typed: What the user types to find it, by default the label.
        whole: True if it replaces the whole token and not only the word at the cursor.
        has_places: False if the text has no placeholders, whatever it contains.
    """

    label: str
    kind: types.CompletionItemKind
    insert: str = ""
    detail: str | Callable[[], str] = ""
    text: str = ""
    group: int = 1
    typed: str = ""
    whole: bool = False
    has_places: bool = True


def placeholder(number: int, options: Iterable[str]) -> str:
    """Return a placeholder with a list of choices, or with the first one if a list of them could not be written."""
    listed = list(options)
    if len(listed) == 1 or len(listed) > _MAX_CHOICES or any(set(option) & set(",|\\$}") for option in listed):
        return f"${{{number}:{listed[0]}}}"
    return f"${{{number}|{','.join(listed)}|}}" if listed else f"${number}"


def filled(snippet: str) -> str:
    """Return a snippet with each placeholder replaced by its initial value, for editors without snippets."""
    return _PLACEHOLDER.sub(lambda found: found[2] or (found[4] or "").partition(",")[0], snippet)


def shifted(body: Body, by: int = 1) -> Body:
    """Return a snippet with all placeholders renumbered, so that others fit before them."""
    if isinstance(body, dict):
        return {str(shifted(key, by)): shifted(value, by) for key, value in body.items()}
    if isinstance(body, tuple):
        return tuple(shifted(item, by) for item in body)
    return re.sub(r"\$\{(\d+)(?=[:|])", lambda found: f"${{{int(found[1]) + by}", body)


def lowest(body: Body) -> int:
    """Return the lowest number of a placeholder, or 0 if there are none."""
    return min((int(number) for number in re.findall(r"\$\{(\d+)[:|]", one_line(body))), default=0)


def after_colon(body: Body, indent: int, in_flow: bool) -> str:
    """Return a value with what separates it from its key: a space, or a line break and indentation.

    ``indent`` is the column of the key, relative to the line on which the text is inserted.
    """
    if body == "{$0}" and not in_flow:
        return f"\n{' ' * (indent + 2)}$0"
    if in_flow or not body or isinstance(body, str):
        return f" {one_line(body)}"
    return "\n" + "\n".join(block_lines(body, indent + 2))


def block_lines(body: Body, indent: int) -> list[str]:
    """Return the lines of a mapping or list in block style."""
    space = " " * indent
    if isinstance(body, dict):
        return [f"{space}{key}:{after_colon(value, indent, False)}" for key, value in body.items()]
    if isinstance(body, tuple):
        return [f"{space}- {one_line(item)}" for item in body]
    return [f"{space}{body}"]


@dataclass(frozen=True)
class Insertion:
    """The place in a text where completion inserts."""

    lines: Lines
    cursor: Cursor

    @property
    def base(self) -> int:
        """Return the indentation of the line, to which editors add that of the other lines of a snippet."""
        line = self.lines.text[self._line : self.start]
        return len(line) - len(line.lstrip(" "))

    @property
    def indent(self) -> int:
        """Return the column of the keys at the cursor, relative to the indentation of the line."""
        return max(self.cursor.indent - self.base, 0)

    @property
    def start(self) -> int:
        """Return the offset at which text is replaced; on an empty line with a wrong indentation, its start."""
        cursor = self.cursor
        wrong = (
            not cursor.text and not cursor.in_flow and self.is_own_line and cursor.offset - self._line != cursor.indent
        )
        return self._line if wrong else cursor.start

    @property
    def is_own_line(self) -> bool:
        """Return True if there are only spaces before the cursor."""
        return not self.lines.text[self._line : self.cursor.offset].strip(" ")

    @cached_property
    def _line(self) -> int:
        text = self.lines.text
        return max(text.rfind(mark, 0, self.cursor.offset) for mark in "\n\r") + 1

    @cached_property
    def _ranges(self) -> dict[tuple[int, int], types.Range]:
        return {}

    def _range(self, start: int, end: int) -> types.Range:
        if (start, end) not in self._ranges:  # most offers replace the same range
            self._ranges[start, end] = self.lines.range(start, end)
        return self._ranges[start, end]

    @property
    def rest(self) -> str:
        """Return the rest of the line after the token."""
        text, end = self.lines.text, self.cursor.end
        return re.split(r"[\r\n]", text[end : end + 200], maxsplit=1)[0]

    def item(self, offer: Offer, number: int, snippets: bool) -> types.CompletionItem:
        """Return an offer as the protocol has it."""
        cursor, word = self.cursor, self.cursor.word
        start, end = (self.start, cursor.end) if offer.whole else (word.start, word.end)
        insert = offer.insert or offer.label
        lead = cursor.lead
        if start < cursor.start:
            lead = " " * cursor.indent + lead
        before = self.lines.text[start : cursor.offset]
        has_places = offer.has_places and _PLACEHOLDER.search(insert) is not None
        detail = offer.detail if isinstance(offer.detail, str) else offer.detail()
        return types.CompletionItem(
            label=offer.label,
            kind=offer.kind,
            detail=detail or None,
            documentation=types.MarkupContent(types.MarkupKind.Markdown, offer.text) if offer.text else None,
            sort_text=f"{offer.group}{number:04}",
            filter_text=(offer.typed or offer.label) if not before.strip() else _filter(before, offer),
            insert_text_format=types.InsertTextFormat.Snippet if has_places and snippets else None,
            insert_text_mode=types.InsertTextMode.AdjustIndentation if "\n" in insert else None,
            text_edit=types.TextEdit(
                self._range(start, end), lead + (insert if snippets or not has_places else filled(insert))
            ),
        )


def _filter(before: str, offer: Offer) -> str:
    """Return what editors compare with the text before the cursor, which may start with a quote."""
    quote = before[0] if before[0] in "\"'" else ""
    return quote + (offer.typed or offer.label)
