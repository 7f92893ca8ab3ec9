"""Semantic tokens: what the words of a document name, which editors color by kind."""

from __future__ import annotations

import re
from collections.abc import Iterator

from lsprotocol import types

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.display.outline import MEMBER_KINDS
from simfoundry.spec.compose.parameters import PARAMETER
from simfoundry.spec.models.predicate import PREDICATES
from simfoundry.spec.models.types import REFERENCES
from simfoundry.spec.yaml.spans import TextSpan

LEGEND = types.SemanticTokensLegend(["function", "variable", "parameter", "property", "type"], ["declaration"])

# Numbers of the kinds in the legend.
_FUNCTION, _VARIABLE, _PARAMETER, _PROPERTY, _TYPE = range(5)

_CALL = re.compile(r"(?<!\w)([A-Za-z]\w*)\s*\(([^()]*)\)")
_ARGUMENT = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?")
_NAME = re.compile(r"([a-z][a-z0-9_]*)(\.[a-z][a-z0-9_]*)?\Z")

# Sections whose members are kinds of things rather than things.
_TYPES = ("materials", "templates")

# A token: its start and end as offsets, the number of its kind, and whether its name is defined here.
Token = tuple[int, int, int, bool]


def semantic_tokens(analysis: Analysis) -> types.SemanticTokens:
    """Return the tokens of a document: predicates, names, and parameters."""
    lines, data = analysis.lines, list[int]()
    last_line = last_column = 0
    for start, end, kind, defined in sorted(set(_tokens(analysis.lines.text, analysis.spans, "", 0))):
        first, last = lines.position(start), lines.position(end)
        if first.line != last.line or start >= end:
            continue  # a token is on one line
        column = first.character - (last_column if first.line == last_line else 0)
        data += (first.line - last_line, column, last.character - first.character, kind, int(defined))
        last_line, last_column = first.line, first.character
    return types.SemanticTokens(data)


def _tokens(text: str, span: TextSpan, field: str, depth: int) -> Iterator[Token]:
    """Yield the tokens below a value. ``field`` is the last key of its path, and ``depth`` the number of its keys."""
    for key, child in span.entries():
        name = key if isinstance(key, str) else field
        if isinstance(key, str) and field in MEMBER_KINDS and field != "relations":
            kind = _TYPE if field in _TYPES else _PARAMETER if field == "parameters" else _VARIABLE
            yield child.key, child.key_end, kind, depth == 1
        if child.children is not None:
            yield from _tokens(text, child, name, depth + 1)
        elif name not in ("description", "instruction"):
            yield from _value_tokens(text[child.start : child.end], child.start, name)


def _value_tokens(value: str, offset: int, field: str) -> Iterator[Token]:
    for found in PARAMETER.finditer(value):
        yield offset + found.start(), offset + found.end(), _PARAMETER, False
    for call in _CALL.finditer(value):
        if call[1] in PREDICATES:
            yield offset + call.start(1), offset + call.end(1), _FUNCTION, False
            for argument in _ARGUMENT.finditer(value, call.start(2), call.end(2)):
                yield from _dotted(argument, offset, _VARIABLE)
    bare = value.strip("'\"")
    if field in REFERENCES and (name := _NAME.match(bare)) is not None:
        shift = offset + value.index(bare)
        kind = _TYPE if REFERENCES[field][0] in _TYPES else _VARIABLE
        yield from _dotted(name, shift, kind)


def _dotted(found: re.Match[str], offset: int, kind: int) -> Iterator[Token]:
    """Yield the tokens of a name and of a part after a dot."""
    owner = found[0].partition(".")[0]
    start = offset + found.start()
    yield start, start + len(owner), kind, False
    if len(owner) < len(found[0]):
        yield start + len(owner) + 1, offset + found.end(), _PROPERTY, False
