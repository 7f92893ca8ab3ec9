"""Serialization of XML elements as indented text for URDF and MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import lru_cache

DECLARATION = b"<?xml version='1.0' encoding='utf-8'?>\n"

_MARKUP = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;"}
_WHITE = {"\t": "&#09;", "\n": "&#10;", "\r": "&#13;"}
# The escaped form of each ASCII character. Including unchanged characters makes ``translate`` twice as fast.
_ESCAPES = [(_MARKUP | _WHITE).get(chr(k), chr(k)) for k in range(128)]


def xml_text(root: ET.Element) -> bytes:
    """Serialize an element tree with two-space indentation.

    This is ten times as fast as ElementTree's writer. Attributes keep their order. The text in an element is written
    unless it is only whitespace. Text between elements is ignored.
    """
    lines: list[str] = []
    _append(lines, root, "")
    lines.append("")
    return "\n".join(lines).encode()


@lru_cache(maxsize=16384)  # the same numbers and names occur repeatedly
def _escaped(value: str) -> str:
    return value.translate(_ESCAPES)


def _append(lines: list[str], element: ET.Element, indent: str) -> None:
    if callable(element.tag):  # a comment; its tag is the function that creates comments
        lines.append(f"{indent}<!-- {(element.text or '').strip().replace('--', '- -')} -->")
        return
    attributes = "".join([f' {name}="{_escaped(value)}"' for name, value in element.items()])
    text = "" if element.text is None or element.text.isspace() else _escaped(element.text)
    if len(element) == 0:
        end = f">{text}</{element.tag}>" if text else " />"
        lines.append(f"{indent}<{element.tag}{attributes}{end}")
        return
    lines.append(f"{indent}<{element.tag}{attributes}>{text}")
    for child in element:
        _append(lines, child, indent + "  ")
    lines.append(f"{indent}</{element.tag}>")
