"""Formatting of a document as a list of small edits, so that the cursor stays where it is."""

from __future__ import annotations

import difflib
from pathlib import Path

from lsprotocol import types

from simfoundry.language_server.positions import Lines
from simfoundry.spec.change.format import format_open_text
from simfoundry.spec.diagnostics import SpecError


def format_edits(path: Path, lines: Lines) -> list[types.TextEdit]:
    """Return the edits that bring a text into the form that ``simfoundry fmt`` writes.

    A text that cannot be parsed is left as it is.
    """
    try:
        after = format_open_text(lines.text, path)
    except SpecError:
        return []
    if "\r\n" in lines.text:  # which line breaks to save is the editor's choice
        after = after.replace("\n", "\r\n")
    return text_edits(lines, after)


def text_edits(lines: Lines, after: str) -> list[types.TextEdit]:
    """Return the edits that turn a text into another one: the changed lines, without what they have in common."""
    if lines.text == after:
        return []
    old, new = (text.splitlines(keepends=True) for text in (lines.text, after))
    edits, start = list[types.TextEdit](), 0
    places = [0]
    for line in old:
        start += len(line)
        places.append(start)
    # Lines that occur often, such as blank ones, are compared as well: a document is at most some thousand lines long.
    for tag, a, b, c, d in difflib.SequenceMatcher(None, old, new, autojunk=len(old) > MOST_COMPARED).get_opcodes():
        if tag != "equal":
            edits += _narrowed(lines, places[a], "".join(old[a:b]), "".join(new[c:d]))
    return edits


# Number of lines above which frequent lines are not compared, because the time grows with the square of their number.
MOST_COMPARED = 2000


def _narrowed(lines: Lines, start: int, old: str, new: str) -> list[types.TextEdit]:
    """Return the edit of a few lines, without the start and the end that they have in common."""
    before = _common(old, new)
    after = _common(old[before:][::-1], new[before:][::-1])
    if (before and old[before - 1 : before + 1] == "\r\n") or (after and old[len(old) - after - 1 :][:2] == "\r\n"):
        before = after = 0  # a position between the two characters of a line break does not exist
    end = len(old) - after
    return [types.TextEdit(lines.range(start + before, start + end), new[before : len(new) - after])]


def _common(a: str, b: str) -> int:
    """Return the number of characters at the start that two texts have in common."""
    return next((k for k, (one, other) in enumerate(zip(a, b, strict=False)) if one != other), min(len(a), len(b)))
