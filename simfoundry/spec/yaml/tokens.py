"""Find the token at a place in a line of a text, and a word inside a token."""

from __future__ import annotations

import re

_TOKEN = re.compile(
    r"""
    "(?:[^"\\]|\\.)*"?                      # a quoted string, which may continue on the next line
    | '(?:[^']|'')*'?
    | [A-Za-z]\w*[ ]?\([^()\[\]{}"'#]*\)?     # a predicate with its arguments
    | [-?](?=\ |$)                           # the start of an item
    | [\[{]                                  # a list or mapping, which is closed below
    | [^\s,\[\]{}"'#:]                       # an unquoted string, up to a comment, a comma in brackets, or a colon
      (?:(?!:(?:\s|$)|\s\#|\s+$)[^,\[\]{}])*
    | \S
    """,
    re.VERBOSE,
)
_BRACKETS = {"[": "]", "{": "}"}


def token_at(line: str, column: int, plain: str = "") -> str:
    """Return the token that starts at a column of a line, counted from 1, or an empty string if none starts there.

    A token is a key, a scalar, or a list or mapping in brackets or braces, as far as it is on this line. ``plain`` is
    the text of the token if it is known to be an unquoted scalar, which outside brackets may contain commas.
    """
    rest = line[column - 1 :] if column > 0 else ""
    if plain and rest.startswith(plain):
        return plain
    found = _TOKEN.match(rest)
    if found is None:
        return ""
    return rest[: _closing(rest)] if found[0] in _BRACKETS else found[0].rstrip()


def _closing(text: str) -> int:
    """Return the end of the bracket that opens at the start of a text, or of the text before a comment."""
    depth, k = [], 0
    while k < len(text):
        char = text[k]
        if char in "\"'" and (found := _TOKEN.match(text, k)) is not None:
            k = found.end()
            continue
        if char == "#" and text[k - 1 : k].isspace():
            break
        if char in _BRACKETS:
            depth.append(_BRACKETS[char])
        elif depth and char == depth[-1]:
            depth.pop()
            if not depth:
                return k + 1
        k += 1
    return len(text[:k].rstrip())


def word_in(token: str, word: str, index: int = 0) -> int:
    """Return where a word stands in a token, or -1 if it does not.

    ``index`` is its place in the value of the token, without quotes. If it is not there, because the value is spelled
    differently in the text, the nearest occurrence is returned.
    """
    index += token[:1] in ("'", '"')
    if token.startswith(word, index):
        return index
    whole = re.compile(rf"(?<![\w]){re.escape(word)}(?![\w])")
    return min((found.start() for found in whole.finditer(token)), key=lambda start: abs(start - index), default=-1)
