"""YAML out: one canonical form, short enough to read and stable enough to diff."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from simfoundry.spec.base import Model
from simfoundry.spec.text import UNPRINTABLE, YamlError, parse

WIDTH = 110
DIGITS = 6
LARGE = 1e15
"""From here on numbers are written with an exponent."""

_RANK = {
    name: rank
    for rank, name in enumerate(
        (
            "simfoundry",
            "name",
            "description",
            "category",
            "fixed",
            "shape",
            "asset",
            "mesh",
            "scale",
            "visual",
            "material",
            "color",
            "mass",
            "density",
            "friction",
            "restitution",
            "collision",
            "solid",
            "pose",
            "joints",
        )
    )
}
"""Fields that people look for come first; the others follow in the order of their model."""

_BLOCKS = ("objects", "links", "frames")
"""Sections whose members are written over several lines."""

_PLAIN = re.compile(r"[A-Za-z_/.][A-Za-z0-9_/. ()+-]*\Z")


_ESCAPED = re.compile(f"[\x85\u2028\u2029\ufeff]|{UNPRINTABLE.pattern}")


def to_yaml(spec: Model, comment: str = "") -> str:
    """The canonical text of a document: fields in the order of the model, defaults left out, six decimals."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += _block(to_data(spec), 0)
    return "\n".join(lines) + "\n"


def to_data(spec: Model) -> dict[str, Any]:
    """Plain data of a document, in canonical order, without what equals its default."""
    fields = type(spec).model_fields
    out: dict[str, Any] = {}
    for name in sorted(fields, key=lambda n: _RANK.get(n, len(_RANK))):
        value = getattr(spec, name)
        needed = name == "simfoundry" or fields[name].is_required()
        if not needed and value == fields[name].default:
            continue
        data = _data(value)
        # As text: what is written like the default would be read as the default, and then not be written again.
        if needed or _flow(data) != _flow(_data(fields[name].default)):
            out[name] = data
    return out


def _data(value: Any) -> Any:
    match value:
        case Model():
            return to_data(value)
        case dict():
            return {key: _data(item) for key, item in value.items()}
        case tuple():
            return tuple(_data(item) for item in value)
    return value


def _block(data: Mapping[str, Any], indent: int, section: str = "") -> Iterator[str]:
    for key, value in data.items():
        yield from _entry(f"{' ' * indent}{_string(key)}:", value, indent, section if indent else key)


def _entry(head: str, value: Any, indent: int, section: str) -> Iterator[str]:
    """One key with its value: on one line where it fits and is no section or member of a section of blocks."""
    if isinstance(value, tuple) and any(isinstance(v, str) and "(" in v for v in value):
        yield head
        yield from (f"{' ' * (indent + 2)}- {_text(v)}" for v in value)
        return
    flow = _flow(value)
    mapping = isinstance(value, Mapping) and len(value) > 0
    block = mapping and (indent == 0 or (indent == 2 and section in _BLOCKS))
    if not block and len(head) + 1 + len(flow) <= WIDTH:
        yield f"{head} {flow}"
    elif mapping:
        yield head
        yield from _block(value, indent + 2, section)
    elif isinstance(value, tuple | list) and value:
        yield from _wrapped(f"{head} [", [_flow(item) for item in value], indent + 2)
    else:
        yield f"{head} {flow}"


def _wrapped(head: str, items: list[str], indent: int) -> Iterator[str]:
    """A long list in brackets, as many items a line as fit."""
    line = head
    for k, item in enumerate(items):
        text = item + ("]" if k == len(items) - 1 else ",")
        if line != head and len(line) + 1 + len(text) > WIDTH:
            yield line
            line = " " * indent + text
        else:
            line += text if line == head else f" {text}"
    yield line


def _flow(value: Any) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case float():
            return number(value)
        case str():
            return _string(value)
        case Mapping():
            return "{" + ", ".join(f"{_string(k)}: {_flow(v)}" for k, v in value.items()) + "}"
        case _:
            return "[" + ", ".join(_flow(v) for v in value) + "]"


def number(value: float) -> str:
    """A number with at most six decimals, without an exponent where it is of ordinary size."""
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be written in a spec")
    if value != 0 and not 10 ** (2 - DIGITS) <= abs(value) < LARGE:
        return _shortest(f"{value:.3e}" if abs(value) < 1 else f"{value:.15e}")
    text = f"{value:.{DIGITS}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _shortest(text: str) -> str:
    mantissa, exponent = text.split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"


@functools.lru_cache(maxsize=4096)
def _string(text: str) -> str:
    """Plain where a reader gets the same string back inside brackets, else in double quotes."""
    return text if _PLAIN.match(text) and _reads_back(f"[{text}]", (text,)) else _quoted(text)


def _text(text: str) -> str:
    """An item of a list over several lines: plain where a reader gets the same string back."""
    return text if _reads_back(f"- {text}", (text,)) else _quoted(text)


def _quoted(text: str) -> str:
    """In double quotes; what YAML does not allow, or takes for the end of a line, is written as an escape."""
    return _ESCAPED.sub(lambda m: f"\\u{ord(m.group()):04x}", json.dumps(text, ensure_ascii=False))


def _reads_back(text: str, data: tuple[str, ...]) -> bool:
    try:
        return bool(parse(text).data == data)
    except YamlError:
        return False
