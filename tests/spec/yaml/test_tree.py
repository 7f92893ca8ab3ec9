"""Comments are found wherever they stand, belong to what they are about, and none is lost."""

from __future__ import annotations

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import Path_, parse
from simfoundry.spec.yaml.tree import YamlTree, plain_tree, read_tree, with_data
from simfoundry.spec.yaml.write import write_tree
from tests.spec.yaml.layouts import DOCUMENTS, VALUES, untidy

SEEDS = st.integers(0, 2**32)


def comments(text: str) -> list[tuple[Path_, str]]:
    """The comments of a text with their paths; those above the first key are the document's or that key's."""
    found = read_tree(parse(text)).comments()
    return [(() if path == ("simfoundry",) else path, said) for path, said in found]


def name_of(comment: str) -> str:
    return str(re.search(r"c\d+\.", comment)[0])  # type: ignore[index]


@given(DOCUMENTS, SEEDS)
def test_no_comment_is_lost_whatever_the_layout(data: dict[str, Any], seed: int) -> None:
    text, _, count = untidy(data, seed)
    document = parse(text)
    tree = read_tree(document)
    assert sorted(name_of(c) for _, c in tree.comments()) == sorted(f"c{k + 1}." for k in range(count)), text
    assert repr(tree.data) == repr(document.data)


@given(DOCUMENTS, SEEDS)
def test_a_comment_belongs_to_what_it_is_about(data: dict[str, Any], seed: int) -> None:
    text, expected, _ = untidy(data, seed)
    found = {name_of(c): path for path, c in read_tree(parse(text)).comments()}
    first = next(iter(parse(text).data))
    for name, path in expected.items():
        allowed = {path, (first,)} if path == () else {path}
        assert found[name] in allowed, (name, text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: 1 # x", {("a",): ["# x"]}),
        ("a: b#c", {}),
        ("a: 'b # c' # x", {("a",): ["# x"]}),
        ('a: "b # c"#x', {("a",): ["#x"]}),
        ("a: |  # x\n  b # c\n\n # y\n# z", {("a",): ["# x"], (): ["# y", "# z"]}),
        ("a: >-\n  b\n  # c\nb: 1", {}),
        ("a: b\n # x\n#y\nb: 1", {("b",): ["# x", "#y"]}),
        ("a: [#x\n1,#y\n2#z\n]", {("a",): ["#x"], ("a", 0): ["#y"]}),
        ("a: [ # x\n  1, # y\n  # z\n  2 # w\n  # v\n  ] # u", {
            ("a",): ["# x", "# v", "# u"], ("a", 0): ["# y"], ("a", 1): ["# z", "# w"]}),
        ("a: {b: {c: 1}} # x", {("a",): ["# x"]}),
        ("a: # x\n  # y\n  1 # z", {("a",): ["# x", "# y", "# z"]}),
        ("a: &x # x\n  1\nb: *x # y", {("a",): ["# x"], ("b",): ["# y"]}),
        ("a: &x # x\n  # y\n  b: 1\nc: *x", {("a",): ["# x"], ("a", "b"): ["# y"]}),
        ("a:\n- # x\n  # y\n  b: 1\n# z\n- 2\n# w\nc: 1", {
            ("a", 0): ["# x"], ("a", 0, "b"): ["# y"], ("a", 1): ["# z"], ("c",): ["# w"]}),
        ("a:\n  b:\n    c: 1\n    # x\n   # y\n  # z\n # w\n# v\nd: 1", {
            ("a", "b"): ["# x", "# y"], ("a",): ["# z", "# w"], ("d",): ["# v"]}),
        ("a:\n  b:\n    c: 1\n# x\n    # y", {(): ["# x", "# y"]}),
        ("a: # x\nb: # y", {("a",): ["# x"], ("b",): ["# y"]}),
        ("a:\n  - # x\n  - # y", {("a", 0): ["# x"], ("a", 1): ["# y"]}),
        ("? a # x\n: # y\n  1", {("a",): ["# x", "# y"]}),
        ("%YAML 1.2 # x\n# y\n--- # z\na: 1\n... # w\n# v", {(): ["# x", "# y", "# z", "# w", "# v"]}),
        ("a: [f(b, # x\n  c), # y\n  d] # z", {("a", 0): ["# x", "# y"], ("a",): ["# z"]}),
        ("a: {b: f(c, # x\n  d), # y\n  e: 1} # z", {("a", "b"): ["# x", "# y"], ("a",): ["# z"]}),
        ("a: [b: 1 # x\n  ]", {("a", 0, "b"): ["# x"]}),
        ("a: 1\x85# x\u2028b: 1 # y", {("b",): ["# x", "# y"]}),
        ("\ufeff# x\r\na: 1 # y\r\n", {(): ["# x"], ("a",): ["# y"]}),
        ("# x\n\n# y\na: 1", {(): ["# x"], ("a",): ["# y"]}),
        ("# x\n\n# y\nsimfoundry: 1", {(): ["# x", "# y"]}),
        ("# x", {(): ["# x"]}),
        ("5 # x", {(): ["# x"]}),
        ("{ # x\n a: 1 # y\n} # z", {(): ["# x", "# z"], ("a",): ["# y"]}),
    ],
)  # fmt: skip
def test_where_comments_belong(text: str, expected: dict[Path_, list[str]]) -> None:
    found: dict[Path_, list[str]] = {}
    for path, comment in read_tree(parse(text)).comments():
        found.setdefault(path, []).append(comment)
    if "2#z" in text:  # no comment: YAML wants a space before it
        assert read_tree(parse(text)).data == {"a": (1, "2#z")}
    assert found == expected


def test_a_key_written_twice_is_a_finding() -> None:
    with pytest.raises(SpecError, match="`a` appears twice"):
        read_tree(parse("a: 1 # x\na: 2 # y\n"))


TREE = """\
# top
a: 1  # one
b:    # two
  # three
  c: 1
  d: 2
  # four
e:
  - OnTop(x, y)  # five
  # six
  - Open(z)
  # seven
"""


def with_(data: Any) -> str:
    return write_tree(with_data(read_tree(parse(TREE)), data), None)


def test_other_data_keep_the_comments_of_what_remains() -> None:
    data = parse(TREE).data
    assert with_(data) == TREE
    assert with_({**data, "a": 7, "f": 8}) == TREE.replace("a: 1", "a: 7") + "f: 8\n"
    assert with_({"b": {"d": 2}, "a": None}) == "# top\nb:  # two\n  d: 2\n  # four\na: null  # one\n"
    assert with_({"b": 5}) == "# top\nb: 5  # two\n"


@pytest.mark.parametrize(
    ("items", "expected"),
    [
        (("Open(z)",), "  # six\n  - Open(z)\n"),
        (("New(x)", "OnTop(x, y)", "Open(z)"), "  - New(x)\n  - OnTop(x, y)  # five\n  # six\n  - Open(z)\n"),
        (("Open(z)", "OnTop(x, y)"), "  # six\n  - Open(z)\n  - OnTop(x, y)  # five\n"),
        (("OnTop(x, w)", "Open(z)"), "  - OnTop(x, w)  # five\n  # six\n  - Open(z)\n"),
        (("New(x)", "New(y)", "New(z)"), "  - New(x)\n  - New(y)\n  - New(z)\n"),
    ],
)
def test_items_of_lists_keep_their_comments(items: tuple[str, ...], expected: str) -> None:
    assert with_({"e": items}) == f"# top\ne:\n{expected}  # seven\n"


@given(DOCUMENTS, VALUES, SEEDS)
def test_a_tree_takes_any_data(data: dict[str, Any], other: Any, seed: int) -> None:
    tree = read_tree(parse(untidy(data, seed)[0]))
    assert with_data(tree, tree.data) == tree
    for new in (other, {**data, "x": other}):
        changed = with_data(tree, new)
        assert repr(changed.data) == repr(new)
        assert {c for _, c in changed.comments()} <= {c for _, c in tree.comments()}
        again = write_tree(changed, SceneSpec)
        assert sorted(c for _, c in read_tree(parse(again)).comments()) == sorted(
            c if c[1:2] in " !" else f"# {c[1:]}" for _, c in changed.comments()
        )


def test_plain_data_make_a_tree_without_comments() -> None:
    assert plain_tree({"a": [1, {"b": None}]}) == YamlTree(
        {"a": YamlTree((YamlTree(1), YamlTree({"b": YamlTree(None)})))}
    )
