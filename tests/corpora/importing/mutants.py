"""Seeded corruptions of model files: of bytes, numbers, attributes, elements and lines."""

from __future__ import annotations

import copy
import random
import re
from collections.abc import Callable
from xml.etree import ElementTree

NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
ATTRIBUTE = re.compile(rb"\s([\w:]+)\s*=\s*\"([^\"]*)\"")
STRANGE = (
    b"0",
    b"-1",
    b"nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"1e-320",
    b"-0.0",
    b"999999999999",
    b"x",
    b"",
    b"1,5",
    b"1 2",
)

Corruption = Callable[[bytes, random.Random], bytes | None]
"""Gives the corrupted bytes of a file; None where it does not apply."""


def flip_bytes(data: bytes, rng: random.Random) -> bytes | None:
    """Some bytes become others."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 3, 20))):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def cut(data: bytes, rng: random.Random) -> bytes | None:
    """The file ends early, or lacks a stretch."""
    start = rng.randrange(len(data))
    return data[:start] if rng.random() < 0.5 else data[:start] + data[start + rng.randrange(1, 200) :]


def repeat(data: bytes, rng: random.Random) -> bytes | None:
    """A stretch stands twice."""
    start = rng.randrange(len(data))
    return data[: start + rng.randrange(1, 200)] + data[start:]


def change_number(data: bytes, rng: random.Random) -> bytes | None:
    """A number becomes one that no such quantity has."""
    found = list(NUMBER.finditer(data))
    if not found:
        return None
    spot = rng.choice(found)
    return data[: spot.start()] + rng.choice(STRANGE) + data[spot.end() :]


def drop_attribute(data: bytes, rng: random.Random) -> bytes | None:
    """An attribute is gone."""
    found = list(ATTRIBUTE.finditer(data))
    if not found:
        return None
    spot = rng.choice(found)
    return data[: spot.start()] + data[spot.end() :]


def rename_attribute(data: bytes, rng: random.Random) -> bytes | None:
    """An attribute has the name of another."""
    found = list(ATTRIBUTE.finditer(data))
    if not found:
        return None
    spot, other = rng.choice(found), rng.choice(found)
    return data[: spot.start(1)] + other[1] + data[spot.end(1) :]


def swap_values(data: bytes, rng: random.Random) -> bytes | None:
    """Two attributes have each other's values."""
    found = list(ATTRIBUTE.finditer(data))
    if len(found) < 2:
        return None
    a, b = sorted(rng.sample(found, 2), key=lambda spot: spot.start())
    return data[: a.start(2)] + b[2] + data[a.end(2) : b.start(2)] + a[2] + data[b.end(2) :]


def change_elements(data: bytes, rng: random.Random) -> bytes | None:
    """An element is gone, stands twice, lies in another, or has the tag of another."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError):
        return None
    inner = [(parent, child) for parent in root.iter() for child in parent]
    if not inner:
        return None
    parent, child = rng.choice(inner)
    other = rng.choice(inner)[1]
    match rng.randrange(4):
        case 0:
            parent.remove(child)
        case 1:
            rng.choice([parent, other]).append(copy.deepcopy(child))
        case 2:
            parent.remove(child)
            (other if other not in list(child.iter()) else root).append(child)
        case _:
            child.tag = other.tag
    return ElementTree.tostring(root)


def change_lines(data: bytes, rng: random.Random) -> bytes | None:
    """A line is gone, stands twice, or stands elsewhere."""
    lines = data.splitlines(keepends=True)
    if len(lines) < 3:
        return None
    k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
    line = lines.pop(k)
    match rng.randrange(3):
        case 0:
            pass
        case 1:
            lines[k:k] = [line, line]
        case _:
            lines.insert(m, line)
    return b"".join(lines)


BINARY: tuple[Corruption, ...] = (flip_bytes, cut, repeat)
TEXT: tuple[Corruption, ...] = (*BINARY, change_number, change_number, change_lines)
XML: tuple[Corruption, ...] = (*TEXT, drop_attribute, rename_attribute, swap_values, change_elements, change_elements)


def mutant(data: bytes, suffix: str, rng: random.Random) -> tuple[str, bytes]:
    """A corruption of a file that differs from it, and what was done."""
    kinds = XML if suffix in (".xml", ".urdf") else TEXT if b"\0" not in data[:1000] else BINARY
    for _ in range(100):
        corruption = rng.choice(kinds)
        changed = corruption(data, rng) if data else None
        if changed is not None and changed != data:
            return corruption.__name__, changed
    return "nothing", data + b"\0"
