"""The place of the cursor: it agrees with the parser at every offset of every document, and texts that are not complete
have one as well."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from simfoundry.language_server.cursor.cursor import Cursor, cursor_at
from simfoundry.language_server.cursor.scan import Slot
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.yaml.text import Path_, parse
from tests.conftest import REPOSITORY
from tests.language_server.tokens import joined, leaves

DOCUMENTS = sorted(
    path
    for folder in ("specs", "tests/corpora", "simfoundry/spec/editor/examples", "simfoundry/robots")
    for path in (REPOSITORY / folder).rglob("*.yaml")
    if is_document(path) or folder != "specs"
)

ODD = {
    "flow": "a: {b: [1, {c: d, 'e f': \"g, h\"}, []], i: {}}\nj: 1\n",
    "flow lines": "a: {\n  b: 1,\n  c: [\n    2,\n    3\n  ]\n}\nd: 4\n",
    "flow to the left": "a:\n  b: {\nc: 1,\n  d: [5,\n6]\n  }\n  e: f\ng: [1,\n2]\nh: 3\n",
    "json": '{\n  "a": {"b":1, "c": [true, null]},\n  "d": "e"\n}\n',
    "quotes": "'a b': 'it''s'\n\"c\\\"d\": \"e: [f\"\ng: \"two\n  lines\"\nh: {i: 'j\n  k'}\n",
    "block scalars": "a: |\n  b: 1\n  - c\n\n  # d\nd: >-\n  e\ng:\n  - |\n    h: 2\n  - i: |+\n      j\n\n    k: 3\n",
    "folded": "a: one\n  two\n  three\nb:\n  four\n  five\nc: [six\n  seven, eight]\n",
    "lists": "a:\n- b: 1\n  c: 2\n- - d\n  - e\n-\n  f: 3\n- g\nh:\n  -   i\n  - j: {k: l}\n    m: [n]\n",
    "anchors": "a: &x {b: 1}\nc: *x\nd: &y\n  e: &z 2\nf: [*z, *x, &w 3]\ng: {h: *y, i: &v j}\n",
    "comments": "# one: {\na: # two: [\n  b: 1 # three }\n  # four\n  c: 'd # e' # g\nf: [1, # six ]\n  2] # h\n",
    "predicates": "a: [OnTop(b, c), At(d, 1, 2), 'Open(e, f)']\ng: {h: OnTop(i, j), k: L(m,\n  n)}\no:\n  - P(q, r)\n",
    "colons": "a:b: c:d\ne: f:g\nh: {i: j:k, l:m: 1}\nn#o: p#q\n",
    "expressions": "a: $b\nc: {d: 2 * $e + 1, f: [$g, -$h]}\n",
    "marker": "# c\n---\na: 1\nb:\n  c: d\n",
    "empty values": "a:\nb: {c: , d: }\ne: [1, ]\nf:\n  -\n  - g:\n",
    "words": "a: ünï côde\nб: {ключ: значение}\n",
}


def with_breaks(text: str, name: str) -> str:
    return text.replace("\n", {"lf": "\n", "crlf": "\r\n", "cr": "\r", "bom": "\n"}[name])


def check(text: str, step: int = 1) -> None:
    parse(text)
    seen: dict[int, tuple[Slot, Path_, int, int, str]] = {}
    for leaf in joined(text, leaves(text)):
        for offset in range(leaf[2], leaf[3] + 1):
            seen[offset] = leaf
    for offset in range(0, len(text) + 1, step):
        cursor = cursor_at(text, offset)
        assert cursor.start <= offset <= cursor.end, (offset, cursor)
        if offset not in seen:
            assert cursor.start == cursor.end or cursor.style == "block", (text[:offset][-40:], cursor)
            continue
        slot, path, start, end, style = seen[offset]
        line = text.replace("\r", "\n")[:offset].rpartition("\n")[2]
        if style in ("|", ">") and not line.strip():
            continue  # before a line of a block scalar, or on an empty one
        shown = f"{text[:offset][-60:]}|{text[offset:][:30]}"
        assert (cursor.slot, cursor.path) == (slot, path), (shown, cursor, path)
        if style not in ("|", ">"):
            assert (cursor.start, cursor.end) == (start, end), (shown, cursor, start, end)


@pytest.mark.parametrize("breaks", ["lf", "crlf", "cr", "bom"])
@pytest.mark.parametrize("name", ODD)
def test_odd_texts_agree_with_the_parser(name: str, breaks: str) -> None:
    check("\ufeff" * (breaks == "bom") + with_breaks(ODD[name], breaks))


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_documents_agree_with_the_parser(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    check(text, 1 + len(text) // 250)


def at(text: str) -> Cursor:
    """The place of the ``|`` in a text."""
    before, _, after = text.partition("|")
    return cursor_at(before + after, len(before))


HEAD = "simfoundry: scene/1\nobjects:\n"

INCOMPLETE: dict[str, tuple[Slot, Path_]] = {
    "|": (Slot.VALUE, ()),
    "sim|": (Slot.VALUE, ()),
    "simfoundry:|": (Slot.VALUE, ("simfoundry",)),
    "a: 1\nb|": (Slot.KEY, ("b",)),
    HEAD + "  |": (Slot.VALUE, ("objects",)),
    HEAD + "  cup:\n    |": (Slot.VALUE, ("objects", "cup")),
    HEAD + "  cup:\n    ma|\n    shape: 1\n": (Slot.KEY, ("objects", "cup", "ma")),
    HEAD + "  cup:\n    shape: 1\n    ma|\n  b: 1\n": (Slot.KEY, ("objects", "cup", "ma")),
    HEAD + "  cup:\n    mass: 1\n      |\n": (Slot.KEY, ("objects", "cup", "")),
    HEAD + "  cup: {shape: {box: [1,2,3]}, |\n  mug: {mass: 1}\n": (Slot.KEY, ("objects", "cup", "")),
    HEAD + "  cup: {shape: {bo|\n  mug:\n    mass: 1\n": (Slot.KEY, ("objects", "cup", "shape", "bo")),
    HEAD + '  cup:\n    color: "#ff|\n    mass: 1\n': (Slot.VALUE, ("objects", "cup", "color")),
    HEAD + '  cup:\n    color: "#ff\n    mass: |1\n': (Slot.VALUE, ("objects", "cup", "mass")),
    HEAD + "  cup: {a: [1, 2\n  mug:\n    mass: |1\n": (Slot.VALUE, ("objects", "mug", "mass")),
    "a:\n  - b\n  |": (Slot.VALUE, ("a", 1)),
    "a:\n  - b: 1\n    |\n": (Slot.KEY, ("a", 0, "")),
    "a: {\n    |\n  }\nb: 1\n": (Slot.KEY, ("a", "")),
    "a: {b: 1,\n  |\nc: 1\n": (Slot.KEY, ("a", "")),
    "a: # |\n": (Slot.NONE, ("a",)),
}


@pytest.mark.parametrize("text", INCOMPLETE)
def test_incomplete_texts_have_a_place(text: str) -> None:
    cursor = at(text)
    assert (cursor.slot, cursor.path) == INCOMPLETE[text]


def test_keys_beside_the_cursor() -> None:
    assert at(HEAD + "  a:\n    x: 1\n    |\n    y: {z: 2}\n    v: |\n      w: 3\n  b: 1\n").keys == ("x", "y", "v")
    assert at("a: {x: {y: 1}, |\n  z: 2}\nb: 1\n").keys == ("x", "z")
    assert at("a: {x: {y: 1}, |\nb: 1\n").keys == ("x",)
    assert at("a:\n- x: 1\n  y|: 2\n  z: 3\n").keys == ("x", "z")


@pytest.mark.parametrize(
    ("text", "name", "index", "argument"),
    [
        ("goal: OnTop(|", "OnTop", 0, ""),
        ("goal: OnTop(cup, |", "OnTop", 1, ""),
        ("goals: [OnTop(cup, |]", "OnTop", 1, ""),
        ("goals: [OnTop(|)]", "OnTop", 0, ""),
        ('goal: "OnTop(cup, ta|ble)"', "OnTop", 1, "table"),
        ("all:\n  - Open(cabinet.|)", "Open", 0, "cabinet."),
        ("{goal: At(cup, 0.1, |0.2)}", "At", 2, "0.2"),
    ],
)
def test_arguments_of_predicates(text: str, name: str, index: int, argument: str) -> None:
    call = at(text).call
    assert call is not None
    assert (call.name, call.index, call.argument.text) == (name, index, argument)


def test_words() -> None:
    assert at("on: shelf.bo|ard").owner == "shelf"
    assert at("gap: 2 * $ga|p + 1").word.text == "$gap"
    assert at("gap: 2 * |").text == at("a: {gap: 2 * |}").text == "2 * "
    assert at("gap: 2 * |").word.text == ""
    assert at("gap: -0.|3").word.text == "-0.3"
    assert at('on: "ta|ble"').word.text == "table"
    assert at("goal: On|Top(a, b)").word.text == "OnTop"


def test_any_broken_text_has_a_place() -> None:
    random = Random(7)
    for text in [*ODD.values(), *(path.read_text(encoding="utf-8") for path in DOCUMENTS[:20])]:
        for _ in range(60):
            start, size = random.randrange(len(text)), random.randrange(12)
            noise = "".join(random.choices("{}[]:,-\"'#\n |>&*($ab", k=random.randrange(5)))
            broken = text[:start] + noise + text[start + size :]
            offset = random.randrange(len(broken) + 1)
            cursor = cursor_at(broken, offset)
            assert cursor.start <= offset <= cursor.end <= len(broken)
            assert cursor.word.start <= offset <= cursor.word.end + 1
            assert cursor.call is None or cursor.call.argument.start <= offset
            assert len(cursor.keys) < 1000
