"""The structure of a document: symbols, folding ranges, and selections that grow from a value to its entry."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from lsprotocol import types
from lsprotocol.types import SymbolKind

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.positions import Lines
from simfoundry.spec.yaml.spans import TextSpan

# Kinds of the members of sections, as editors show them with an icon. Sections within members are listed as well.
MEMBER_KINDS = {
    "objects": SymbolKind.Object,
    "templates": SymbolKind.Class,
    "variants": SymbolKind.EnumMember,
    "materials": SymbolKind.Constant,
    "parameters": SymbolKind.Variable,
    "include": SymbolKind.Module,
    "frames": SymbolKind.Struct,
    "robots": SymbolKind.Class,
    "cameras": SymbolKind.Interface,
    "lights": SymbolKind.Event,
    "links": SymbolKind.Struct,
    "parts": SymbolKind.Field,
    "joints": SymbolKind.Operator,
    "axes": SymbolKind.Operator,
    "sites": SymbolKind.Key,
    "actuators": SymbolKind.Method,
    "sensors": SymbolKind.Property,
    "subtasks": SymbolKind.Function,
    "relations": SymbolKind.Boolean,
}

# Longest detail beside a symbol [characters]; editors cut it off at about this length.
MOST_DETAIL = 60

# Keys that tell most about a member, in order of preference.
_TELLING = (
    "like",
    "category",
    "asset",
    "shape",
    "model",
    "type",
    "mesh",
    "goal",
    "scene",
    "density",
    "on",
    "instruction",
)


def document_symbols(analysis: Analysis) -> list[types.DocumentSymbol]:
    """Return the sections of a document and their members, in the order of the text."""
    return list(_symbols(analysis.lines, analysis.spans, analysis.source.data if analysis.source else None, ""))


def _symbols(lines: Lines, span: TextSpan, data: object, section: str) -> Iterator[types.DocumentSymbol]:
    """Yield the symbols of the members of a mapping or list. ``section`` is its name if its members have names."""
    for key, child in span.entries():
        value = _member(data, key)
        inside: list[types.DocumentSymbol] = []
        if not section:
            kind = SymbolKind.Namespace if key in MEMBER_KINDS and child.members else SymbolKind.Property
            if key in MEMBER_KINDS:
                inside = list(_symbols(lines, child, value, str(key)))
        else:
            kind = MEMBER_KINDS[section]
            nested = {k: s for k, s in child.entries() if k in MEMBER_KINDS and s.members}
            for name, below in nested.items():
                inside += _symbols(lines, below, _member(value, name), str(name))
        name = str(key) if isinstance(key, str) else lines.text[child.start : child.end]
        whole = lines.range(child.outer, child.end)
        start, end = (child.key, child.key_end) if child.key >= 0 else (child.start, child.end)
        yield types.DocumentSymbol(
            name=_short(name) or "—",  # a symbol must have a name
            kind=kind,
            range=whole,
            selection_range=lines.range(start, end),
            detail=_detail(value, bool(section)) if isinstance(key, str) else None,
            children=inside or None,
        )


def _member(data: object, key: str | int) -> object:
    if isinstance(data, dict):
        return data.get(key)
    return data[key] if isinstance(data, tuple) and isinstance(key, int) and key < len(data) else None


def _detail(value: object, named: bool) -> str:
    """Describe a value in a few words: the value itself, or what is most telling about a member."""
    if isinstance(value, dict):
        if not named:
            return str(len(value)) if value else ""
        key = next((key for key in _TELLING if value.get(key) is not None), None)
        if key is None:
            return ""
        told = value[key]
        return _short(next(iter(told), "") if isinstance(told, dict) else told if isinstance(told, str | int) else key)
    if isinstance(value, tuple):
        return _short(", ".join(map(str, value))) if all(isinstance(v, int | float) for v in value) else str(len(value))
    return "" if value is None else _short(value)


def _short(value: object) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= MOST_DETAIL else f"{text[: MOST_DETAIL - 1]}…"


# -- folding -----------------------------------------------------------------------------------------------------------

_COMMENT = re.compile(r"[ \t]*#")


def folding_ranges(analysis: Analysis) -> list[types.FoldingRange]:
    """Return the ranges that an editor can fold: entries, brackets over several lines, and blocks of comments."""
    lines = analysis.lines
    found: dict[int, types.FoldingRange] = {}
    for start, end in _comment_blocks(lines):
        found[start] = types.FoldingRange(start, end, kind=types.FoldingRangeKind.Comment)
    todo = [analysis.spans] if analysis.spans.members else []
    while todo:
        span = todo.pop(0)
        first, last = lines.position(span.outer).line, lines.position(span.end).line
        # The last line of brackets stays visible, as that of braces in other languages.
        last -= span.flow and not lines.text[lines.bounds(last)[0] : span.end - 1].strip()
        if span is not analysis.spans and last > first:
            found.setdefault(first, types.FoldingRange(first, last))
        todo += [child for child in span.members if child.members or "\n" in lines.text[child.outer : child.end]]
    return [found[line] for line in sorted(found)]


def _comment_blocks(lines: Lines) -> Iterator[tuple[int, int]]:
    """Yield the first and last line of each block of at least two comment lines."""
    start = None
    for line in range(lines.count + 1):
        is_comment = line < lines.count and _COMMENT.match(lines.text, *lines.bounds(line)) is not None
        if is_comment and start is None:
            start = line
        elif not is_comment and start is not None:
            if line - start > 1:
                yield start, line - 1
            start = None


# -- selection ---------------------------------------------------------------------------------------------------------

_WORD = re.compile(r"[\w$-]+(?:\.[\w-]+)*")


def selection_ranges(analysis: Analysis, positions: Sequence[types.Position]) -> list[types.SelectionRange]:
    """Return, for each position, the ranges around it from the whole text in to the word."""
    return [_selection(analysis, position) for position in positions]


def _selection(analysis: Analysis, position: types.Position) -> types.SelectionRange:
    lines = analysis.lines
    offset = lines.offset(position)
    ranges = [(0, len(lines.text)), (analysis.spans.start, analysis.spans.end)]
    for _, span in analysis.spans.path_to(offset):
        ranges.append((span.outer, span.end))
        if span.key >= 0 and offset <= span.key_end:
            ranges.append((span.key, span.key_end))
        elif offset >= span.start:
            ranges.append((span.start, span.end))
    line_start, line_end = lines.bounds(lines.position(offset).line)
    words = (m.span() for m in _WORD.finditer(lines.text, line_start, line_end))
    ranges += [word for word in words if word[0] <= offset <= word[1]][:1]
    found: types.SelectionRange | None = None
    outer = (-1, len(lines.text) + 1)
    for start, end in ranges:
        if start <= offset <= end and outer[0] <= start and end <= outer[1] and (start, end) != outer:
            outer = start, end
            found = types.SelectionRange(lines.range(start, end), parent=found)
    return found or types.SelectionRange(lines.range(offset, offset))
