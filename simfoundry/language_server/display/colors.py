"""Colors in a document, which editors show and let people pick."""

from __future__ import annotations

import re
from collections.abc import Iterator

from lsprotocol import types

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.positions import Lines
from simfoundry.spec.models.base import HEX_COLOR
from simfoundry.spec.yaml.spans import TextSpan
from simfoundry.spec.yaml.write import number

# Key of every color in the language.
_KEY = "color"

# Decimals of a color that a person picks; a step of a byte is 0.004.
_DECIMALS = 3

_ANCHOR = re.compile(r"&\S+\s+")
_NUMBER = re.compile(r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?")


def document_colors(analysis: Analysis) -> list[types.ColorInformation]:
    """Return the colors of a document. Colors that contain parameters cannot be picked and are omitted."""
    found, todo = list[types.ColorInformation](), [analysis.spans]
    while todo:
        span = todo.pop()
        for key, child in span.entries():
            if key == _KEY and (values := color_values(analysis.lines.text, child)) is not None:
                red, green, blue, alpha = (*values, 1.0)[:4]
                color = types.Color(red=red, green=green, blue=blue, alpha=alpha)
                start = _value_start(analysis.lines.text, child)
                found.append(types.ColorInformation(analysis.lines.range(start, child.end), color))
            elif child.members:
                todo.append(child)
    return sorted(found, key=lambda one: (one.range.start.line, one.range.start.character))


def color_values(text: str, span: TextSpan) -> tuple[float, ...] | None:
    """Return the three or four numbers of a color, or None if the text is not a color."""
    if isinstance(span.children, list):
        items = [text[item.start : item.end] for item in span.children]
        if not 3 <= len(items) <= 4 or not all(_NUMBER.fullmatch(item) for item in items):
            return None
        values = tuple(float(item) for item in items)
        return values if all(0 <= value <= 1 for value in values) else None
    written = text[_value_start(text, span) : span.end].strip("'\"")
    if span.plain or not re.fullmatch(HEX_COLOR, written):
        return None
    return tuple(int(written[k : k + 2], 16) / 255 for k in range(1, len(written), 2))


def _value_start(text: str, span: TextSpan) -> int:
    """Return the start of a value after its anchor, if it has one."""
    anchor = _ANCHOR.match(text, span.start)
    return anchor.end() if anchor is not None else span.start


def color_presentations(lines: Lines, within: types.Range, color: types.Color) -> list[types.ColorPresentation]:
    """Return the texts for a picked color: first in the spelling that is there, and then in the other one."""
    start, end = lines.span(within)
    written = lines.text[start:end]
    spellings = [_numbers(color, written), _hexadecimal(color, written)]
    if not written.lstrip().startswith(("[", "-")):
        spellings.reverse()
    if "\n" in written:  # a list with an item on each line
        spellings = spellings[:1] if written.lstrip().startswith("[") else [_rows(lines, start, color, written)]
    return [types.ColorPresentation(label=text, text_edit=types.TextEdit(within, text)) for text in spellings]


def _components(color: types.Color, written: str) -> Iterator[float]:
    """Yield three components, or four if the color is not opaque or was written with an opacity."""
    yield from (color.red, color.green, color.blue)
    had_opacity = len(_NUMBER.findall(written)) == 4 if "#" not in written else len(written.strip("'\"")) == 9
    if color.alpha < 1 or had_opacity:
        yield color.alpha


def _numbers(color: types.Color, written: str) -> str:
    return f"[{', '.join(number(round(value, _DECIMALS)) for value in _components(color, written))}]"


def _hexadecimal(color: types.Color, written: str) -> str:
    quote = "'" if written.startswith("'") else '"'
    digits = "".join(f"{round(255 * min(max(value, 0.0), 1.0)):02x}" for value in _components(color, written))
    return f"{quote}#{digits.upper() if re.search('[A-F]', written) else digits}{quote}"


def _rows(lines: Lines, start: int, color: types.Color, written: str) -> str:
    """Return a list with an item on each line, indented as the first one."""
    indent = lines.text[lines.bounds(lines.position(start).line)[0] : start]
    values = [f"- {number(round(value, _DECIMALS))}" for value in _components(color, written)]
    return f"\n{indent}".join(values)
