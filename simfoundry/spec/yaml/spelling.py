"""Format scalars: numbers in their shortest form, and strings with quotes only if required."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterator
from typing import Any, Literal

from simfoundry.spec.models.predicate import canonical
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import UNPRINTABLE, parse

# Number of decimals; micrometers and milligrams are finer than the accuracy of any capture.
DIGITS = 6
# Numbers at least this large are written with an exponent.
LARGE = 1e15

# Context of a string: block style, in a list in brackets, or in a mapping in braces.
Where = Literal["block", "item", "value"]

# Test document for a string in each context; the string does not need quotes if it reads back unchanged.
_FRAME: dict[Where, tuple[str, Any]] = {
    "block": ("a: {}", lambda text: {"a": text}),
    "item": ("[a, {}, b]", lambda text: ("a", text, "b")),
    "value": ("{{a: {}, b: 1}}", lambda text: {"a": text, "b": 1}),
}

_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:[./-][A-Za-z0-9_]+)*\Z")
_PLAIN = re.compile("(?:[\\w/.($]|-(?=[$(]))[^\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff]*\\Z")
# Pattern for strings that people or other YAML readers may interpret as a number, a time, or a date.
_LIKE_NUMBER = re.compile(r"[0-9][-+.0-9a-fA-F_:xoTtZz ]*\Z")
# Words that YAML 1.1 readers take for a truth value. As keys, such as `on`, they stay without quotes.
_TRUTH_VALUES = ("yes", "no", "on", "off")
_CALL = re.compile(r"\s*([A-Za-z]\w*)\s*\(([^()]*)\)\s*\Z")
_ARGUMENT = re.compile(r"\s*[\w.+-]+\s*\Z")


def number(value: float) -> str:
    """Format a number with at most six decimals, and without an exponent unless it is very large or small."""
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be written in a spec")
    return exact(rounded(value))


def rounded(value: float) -> float:
    """Round a number to six decimals, or a tiny number to four significant digits, which is more precise."""
    if value == 0 or not math.isfinite(value) or abs(value) >= LARGE:
        return value
    return float(f"{value:.3e}" if abs(value) < 10 ** (2 - DIGITS) else f"{value:.{DIGITS}f}")


def exact(value: float) -> str:
    """Format a number as the shortest text that every YAML reader reads back as the same number."""
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    if abs(value) < LARGE and value == int(value):
        return str(int(value))
    text = repr(value)
    if abs(value) >= LARGE and "e" not in text:
        digits = text.lstrip("-").partition(".")[0]
        fraction = text.partition(".")[2].rstrip("0")
        text = f"{'-' * (value < 0)}{digits[0]}.{digits[1:]}{fraction}e{len(digits) - 1}"
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    # With a point and a sign, YAML 1.1 readers also take it for a number, and not for a string.
    return f"{mantissa}{'' if '.' in mantissa else '.0'}e{int(exponent):+d}" if exponent else mantissa


def call(text: str) -> str:
    """Format a predicate in canonical form, as in ``OnTop(cup, desk)``. Other strings are returned unchanged."""
    match = _CALL.match(text)
    if match is None or not all(map(_ARGUMENT.match, match[2].split(","))):
        return text
    name, arguments = canonical(match[1], tuple(a.strip() for a in match[2].split(",")))
    return f"{name}({', '.join(arguments)})"


def scalar(value: Any, where: Where) -> str:
    """Format a scalar."""
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case int() | float():
            return exact(value)
    return string(str(value), where)


@functools.lru_cache(maxsize=8192)
def string(text: str, where: Where) -> str:
    """Format a string on one line, without quotes if it reads back unchanged and otherwise in double quotes."""
    if text.lower() in _TRUTH_VALUES:
        return quoted(text)
    if _is_word(text):
        return text
    # Other YAML readers end an unquoted string in brackets or braces at a comma.
    closed = where == "block" or ("," not in text and text.count("(") == text.count(")"))
    fitting = closed and _PLAIN.match(text) and not _LIKE_NUMBER.match(text)
    template, wanted = _FRAME[where]
    return text if fitting and _reads_back(template.format(text), wanted(text)) else quoted(text)


def key_text(key: str) -> str:
    """Format a key, without quotes if it is an unambiguous word."""
    return key if _is_word(key) else quoted(key)


def _is_word(text: str) -> bool:
    return bool(_WORD.match(text)) and text.lower() not in ("null", "true", "false")


def quoted(text: str) -> str:
    """Format a string in double quotes. Characters that YAML forbids or treats as line breaks are escaped."""
    escaped = f"[\x85\u2028\u2029\ufeff]|{UNPRINTABLE.pattern}"
    return re.sub(escaped, lambda m: f"\\u{ord(m.group()):04x}", json.dumps(text, ensure_ascii=False))


@functools.lru_cache(maxsize=1024)
def literal(text: str) -> tuple[str, ...] | None:
    """Return the header ``|`` and the lines of a multi-line string, or None if another style is required."""
    if "\n" not in text.rstrip("\n"):
        return None
    lines = tuple(text.removesuffix("\n").split("\n"))
    if any(line != line.rstrip() or (line and not line.isprintable()) for line in lines):
        return None
    return _block("|" if text.endswith("\n") else "|-", lines, text)


@functools.lru_cache(maxsize=1024)
def folded(text: str, width: int) -> tuple[str, ...] | None:
    """Return the header ``>-`` and the lines of a long string, wrapped at spaces, or None if it needs another style."""
    if not text.isprintable():
        return None
    lines = tuple(filled(text.split(" "), width))
    return _block(">-", lines, text) if len(lines) > 1 and max(map(len, lines)) <= width else None


def _block(head: str, lines: tuple[str, ...], text: str) -> tuple[str, ...] | None:
    written = "\n".join([f"a: {head}", *(f"  {line}".rstrip() for line in lines), "b: 1\n"])
    return (head, *lines) if _reads_back(written, {"a": text, "b": 1}) else None


def filled(words: list[str], width: int, indent: str = "") -> Iterator[str]:
    """Yield lines that each contain as many words as fit. All lines except the first are indented."""
    line = words[0]
    for word in words[1:]:
        if len(line) + 1 + len(word) > width:
            yield line
            line = f"{indent}{word}"
        else:
            line += f" {word}"
    yield line


def _reads_back(text: str, data: Any) -> bool:
    try:
        return bool(parse(text).data == data)
    except YamlError:
        return False
