"""Positions of the protocol, offsets, and places of findings, on texts with every kind of line break."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lsprotocol import types

from simfoundry.language_server.positions import Lines
from tests.editor.client import Server
from tests.language_server.conftest import DESK

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


def test_the_server_counts_code_units_like_the_editor(server: Server, project: Path) -> None:
    path = project / "desk.scene.yaml"
    text = DESK + "# \U0001f600 comment   \n"
    server.open(path, text)
    *_, edit = server.ask_about("textDocument/formatting", path, options={"tabSize": 2, "insertSpaces": True})
    assert edit["range"]["start"]["character"] == 12 and edit["range"]["end"]["character"] == 15  # in UTF-16
    line = text.count("\n") - 1
    start, end = {"line": line, "character": 2}, {"line": line, "character": 4}
    server.diagnostics_of(path, server.change(path, "e", start=start, end=end))
    *_, edit = server.ask_about("textDocument/formatting", path, options={"tabSize": 2, "insertSpaces": True})
    assert edit["range"]["start"]["character"] == 11 and edit["range"]["end"]["character"] == 14


@pytest.mark.parametrize("encoding", list(types.PositionEncodingKind))
def test_an_encoding_may_be_given_by_its_value(encoding: types.PositionEncodingKind) -> None:
    columns = {"utf-8": 5, "utf-16": 3, "utf-32": 2}
    for written in (encoding, encoding.value):
        assert Lines("\U0001f600x", written).position(2).character == columns[encoding.value]
