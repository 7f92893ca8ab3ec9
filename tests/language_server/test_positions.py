"""Positions of the protocol, offsets, and places of findings, on texts with every kind of line break."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lsprotocol import types

from simfoundry.language_server.positions import Lines

TEXTS = st.text(st.sampled_from("ab é😀\n\r\x85\u2028\ufeff"), max_size=30)
ENCODINGS = st.sampled_from(["utf-8", "utf-16", "utf-32"])


def units(text: str, encoding: str) -> int:
    size = {"utf-8": 1, "utf-16": 2, "utf-32": 4}[encoding]
    return len(text.encode({"utf-8": "utf-8", "utf-16": "utf-16-le", "utf-32": "utf-32-le"}[encoding])) // size


@given(TEXTS, ENCODINGS)
def test_each_offset_has_its_position(text: str, encoding: str) -> None:
    lines = Lines(text, encoding)
    for offset in range(len(text) + 1):
        if text[offset - 1 : offset + 1] == "\r\n":
            continue  # inside a line break
        before = re.split(r"\r\n|\n|\r", text[:offset])
        assert lines.position(offset) == types.Position(len(before) - 1, units(before[-1], encoding))
        assert lines.offset(lines.position(offset)) == offset


@given(TEXTS, ENCODINGS, st.integers(0, 40), st.integers(0, 40))
def test_any_position_is_in_the_text(text: str, encoding: str, line: int, character: int) -> None:
    lines = Lines(text, encoding)
    offset = lines.offset(types.Position(line, character))
    assert 0 <= offset <= len(text)
    assert lines.offset(lines.position(offset)) == offset


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("break_", ["\n", "\r\n", "\r", "\x85", "\u2028"])
def test_places_of_the_yaml_reader(mark: str, break_: str) -> None:
    from simfoundry.spec.yaml.text import parse

    text = f"{mark}a: 1{break_}é😀: {{b: x}}{break_}c: 3{break_}"
    root = parse(text).root
    assert isinstance(root.children, dict)
    lines = Lines(text)
    for key, place in root.keys.items():
        assert text.startswith(key, lines.place(*place))
