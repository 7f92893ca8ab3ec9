"""Texts of documents and files within Markdown. They cannot add links, commands, pictures, HTML or formatting to it."""

from __future__ import annotations

import re

# Characters with a meaning in Markdown, other than those that a name, an address or a number is written with.
_MARKS = re.compile(r"[\\`*\[\]()<>&!#|~]")
_ESCAPED = re.compile(rf"\\({_MARKS.pattern})")


def escaped(text: str) -> str:
    """Return Markdown that shows a text as it is, on one line."""
    return _MARKS.sub(r"\\\g<0>", " ".join(text.split()))


def code_span(text: str) -> str:
    """Return a text as code on one line. Code cannot contain escapes, so quotes replace backticks."""
    return "`" + " ".join(text.split()).replace("`", "'") + "`"


def plain_text(markdown: str) -> str:
    """Return a description without its Markdown, for editors that show plain text."""
    text = re.sub(r"^```\w*\n|\n```$", "", markdown, flags=re.MULTILINE)
    text = re.sub(r"(?<!\\)(\*\*|`)", "", text)
    return _ESCAPED.sub(r"\1", text)
