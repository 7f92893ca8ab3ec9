"""Formatting leaves lines, groups, anchors and aliases as people wrote them."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml
from hypothesis import assume, given
from hypothesis import strategies as st

from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.merge.texts import merge_texts
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import YamlTree, plain_tree, read_tree
from simfoundry.spec.yaml.write import WIDTH, write_tree
from tests.spec.change.test_format import check, same
from tests.spec.yaml.layouts import DOCUMENTS, untidy

SEEDS = st.integers(0, 2**32)

EIGHT_OBJECTS = """\
simfoundry: scene/1
name: breakfast
viewpoint: arm
materials:
  wood: {density: 700, friction: 0.5}
  ceramic: {density: 2400, friction: 0.35}

objects:
  table: {fixed: true, shape: {box: [1.2, 0.8, 0.04]}, material: wood, pose: {xyz: [0.5, 0, -0.02]}}
  board: {shape: {box: [0.3, 0.2, 0.02]}, material: wood, place: {on: table, xy: [0.4, 0.2]}}

  # the dishes
  mug: {shape: {cylinder: {radius: 0.04, height: 0.1}}, material: ceramic, place: {on: table, xy: [0.4, 0]}}
  cup: {shape: {cylinder: {radius: 0.03, height: 0.06}}, material: ceramic, place: {on: board}}
  plate: {shape: {cylinder: {radius: 0.1, height: 0.015}}, material: ceramic, place: {on: table, behind: mug}}
  bread: {shape: {box: [0.1, 0.08, 0.08]}, mass: 0.3, place: {on: plate}}
  jam: {shape: {cylinder: {radius: 0.03, height: 0.08}}, mass: 0.4, place: {on: table, behind: board}}
  knife: {shape: {box: [0.2, 0.02, 0.004]}, mass: 0.05, place: {on: table, in_front_of: mug}}

robots: {arm: {model: franka_panda}}
cameras: {front: {size: [640, 480], fx: 500, fy: 500, pose: {xyz: [-0.5, 0, 0.6], look_at: [0.5, 0, 0]}}}
relations: [Upright(mug), Upright(cup), "OnTop(bread, plate)"]
"""


def test_eight_objects_on_22_lines_stay_on_22_lines() -> None:
    assert check(EIGHT_OBJECTS) == EIGHT_OBJECTS
    assert EIGHT_OBJECTS.count("\n") == 22
    apart = EIGHT_OBJECTS.replace(": {", ":   { ").replace("}\n", ",  }\n").replace("\n\n", "\n  \n\n\n")
    assert check(apart) == check(apart.replace("\n", "\r\n")) == check("\ufeff" + apart) == EIGHT_OBJECTS


def form(written: str) -> str:
    """The canonical form of what follows the first key."""
    head = "simfoundry: scene/1\n"
    return check(head + written).removeprefix(head)


@pytest.mark.parametrize(
    ("written", "canonical"),
    [
        # lines of mappings
        ("a: {b: 1, c: {d: 2}}\n", "a: {b: 1, c: {d: 2}}\n"),
        ("a:\n  b: 1\n", "a:\n  b: 1\n"),
        ("a: {b: 1,\n c: {d: 2}}\n", "a:\n  b: 1\n  c: {d: 2}\n"),
        ("a: {b: {c: 1\n}, d: {}}\n", "a:\n  b:\n    c: 1\n  d: {}\n"),
        ("a: {\n}\n", "a: {}\n"),
        ("objects: {a: {mass: 1}}\n", "objects: {a: {mass: 1}}\n"),
        ("objects:\n  a: {mass: 1}\n  b:\n    mass: 1\n", "objects:\n  a: {mass: 1}\n  b:\n    mass: 1\n"),
        ("a: {b: 'é\u4e2d', c: 1}\n", "a: {b: é\u4e2d, c: 1}\n"),
        # lines of lists
        ("a: [1, [2, 3]]\n", "a: [1, [2, 3]]\n"),
        ("a:\n- 1\n- [2, 3]\n", "a:\n  - 1\n  - [2, 3]\n"),
        ("a:\n- - 1\n  - 2\n", "a:\n  - - 1\n    - 2\n"),
        ("a: [[1, 0],\n    [0, 1]]\n", "a:\n  - [1, 0]\n  - [0, 1]\n"),
        ("a: [1, 2,\n    3, 4]\n", "a: [1, 2, 3, 4]\n"),
        ("a: [\n  1\n]\n", "a:\n  - 1\n"),
        # predicates, which other readers split at commas outside quotes
        ("relations: [OnTop(a, b), Open(c)]\n", 'relations: ["OnTop(a, b)", Open(c)]\n'),
        ("relations: [OnTop(a, b), # x\n  Open(c)]\n", "relations:\n  - OnTop(a, b)  # x\n  - Open(c)\n"),
        ("a: {goal: OnTop( a,b )}\n", 'a: {goal: "OnTop(a, b)"}\n'),
        ("goal:\n  not: OnTop(a, b)\n", "goal:\n  not: OnTop(a, b)\n"),
        # groups
        ("a: 1\n\n \n\nb: 2\n\n", "a: 1\n\nb: 2\n"),
        ("a:\n\n  b: 1\n\n  c: 2\n\n\nd: 3\n", "a:\n  b: 1\n\n  c: 2\n\nd: 3\n"),
        ("a:\n\n- 1\n\n- 2\n-\n\n  3\n\n- b: 1\n\n  c: 2\n", "a:\n  - 1\n\n  - 2\n  - 3\n\n  - b: 1\n\n    c: 2\n"),
        ("a: 1\n\n# x\n\n# y\nb: 2\n\n# z\n", "a: 1\n\n# x\n\n# y\nb: 2\n\n# z\n"),
        ("a:\n  # x\n\n  b: 1\n\n  # y\n\n# z\nc: 2\n", "a:\n  # x\n\n  b: 1\n\n  # y\n\n# z\nc: 2\n"),
        ("a:\n\n  - - 1\n\n    # x\n\n  # y\n  - 2\n", "a:\n  - - 1\n\n    # x\n\n  # y\n  - 2\n"),
        ("a: |\n  x\n\n  y\n\nb: >-\n  c\n\n  d\n\ne: 1\n", "a: |\n  x\n\n  y\n\nb: |-\n  c\n  d\n\ne: 1\n"),
        ("a: {b: 1,\n\n  c: 2}\n", "a:\n  b: 1\n\n  c: 2\n"),
        ("objects: {}\n\nname: a\nmaterials: {}\n", "\nname: a\nmaterials: {}\nobjects: {}\n"),
        # anchors
        ("a: &x 1\nb: *x\nc: &unused 2\n", "a: &x 1\nb: *x\nc: &unused 2\n"),
        ("a: &x {b: &y [1], c: *y}\nd: [*x, *y]\n", "a: &x {b: &y [1], c: *y}\nd: [*x, *y]\n"),
        ("a: &x\n  b: 1\nc:\n- *x\n- &y\n  d: 2\n- *y\n", "a: &x\n  b: 1\nc:\n  - *x\n  - &y\n    d: 2\n  - *y\n"),
        ("a: &x\n  # why\n  b: 1\nc: *x # too\n", "a: &x\n  # why\n  b: 1\nc: *x  # too\n"),
        ("a: &x |\n  two\n  lines\nb: *x\n", "a: &x |\n  two\n  lines\nb: *x\n"),
        ("objects: &o {}\nmaterials: *o\n", "materials: &o {}\nobjects: *o\n"),
        ("a: &x 1\nb: *x\nc: &x 2\nd: *x\n", "a: &x 1\nb: *x\nc: &x 2\nd: *x\n"),
        ("objects: &x 1\nname: &x b\nmaterials: *x\n", "name: &x b\nmaterials: *x\nobjects: &x 1\n"),
        ("a: &x 1\nobjects: *x\nb: &x 2\nname: *x\n", "name: 2\nobjects: 1\na: &x 1\nb: &x 2\n"),
        ("goal: &g OnTop( a,b )\nname: *g\n", "name: OnTop( a,b )\ngoal: &g OnTop(a, b)\n"),
        ("? &k a\n: *k\n", "a: a\n"),
        ("goal: [&x OnTop(a, b), *x, {not: *x}]\n", 'goal: [&x "OnTop(a, b)", *x, {not: *x}]\n'),
        ("a: {b: &x f(c, d, e), g: *x}\nh: [*x, 1]\n", 'a: {b: &x "f(c, d, e)", g: *x}\nh: [*x, 1]\n'),
    ],
)  # fmt: skip
def test_the_form_of_a_layout(written: str, canonical: str) -> None:
    assert form(written) == canonical


def test_what_no_longer_fits_on_a_line_is_written_on_several() -> None:
    long = ", ".join(f"key_{k}: {{value: {k}}}" for k in range(9))
    assert form(f"a: {{{long}}}\n") == "a:\n" + "".join(f"  key_{k}: {{value: {k}}}\n" for k in range(9))
    numbers = ", ".join(f"{k}.25" for k in range(60))
    wrapped = form(f"a: [{numbers}]\n")
    assert len(wrapped.splitlines()) > 2 and max(map(len, wrapped.splitlines())) <= WIDTH
    assert form(wrapped.replace(", 59.25]", "]")).count("\n") == wrapped.count("\n")
    exact = "a: {b: " + "x" * (WIDTH - 8) + "}\n"
    assert form(exact) == exact and form(exact.replace("xx", "xxx", 1)).startswith("a:\n  b: x")


def test_computed_documents_have_no_layout() -> None:
    data = parse(EIGHT_OBJECTS).data
    text = write_tree(plain_tree(data), SceneSpec)
    assert text.count("\n") > 50 and check(text) == text


# -- any layout ------------------------------------------------------------------------------------------------------


def members(tree: YamlTree) -> dict[Any, YamlTree]:
    value: Any = tree.value
    return value if isinstance(value, dict) else dict(enumerate(value)) if isinstance(value, tuple) else {}


def differences(before: YamlTree, after: YamlTree, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of short collections that changed between one line and several, or gained or lost a blank line."""
    found = []
    short = len(repr((path, before.data))) < WIDTH // 2
    for key, child in members(before).items():
        other, inside = members(after)[key], (*path, key)
        if child.value and before.one_line is False and child.one_line is not None and (short or not child.one_line):
            found += [(*inside, "lines")] * (child.one_line != other.one_line)
        first = key == next(iter(members(after)))
        if after.one_line is False and before.one_line is not None and not first:
            found += [(*inside, "blank")] * (("" in child.above) != ("" in other.above))
        found += differences(child, other, inside)
    return found


@given(DOCUMENTS, SEEDS)
def test_lines_and_groups_stay_in_any_document(data: dict[str, Any], seed: int) -> None:
    text = untidy(data, seed, comments=False)[0]
    before, after = read_tree(parse(text)), read_tree(parse(check(text)))
    if "&" not in text:  # an anchor that moves takes its lines with it
        assert differences(before, after) == [], text


CONDITIONS = st.recursive(
    st.sampled_from(["OnTop(a, b)", "At(a,0.5 ,1)", "Open(c)", "f(x", "a, b", "(", "a,b)"]),
    lambda inner: (
        st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.sampled_from(["all", "not", "x"]), inner, max_size=3)
    ),
    max_leaves=8,
)


def shape(data: Any) -> Any:
    """The data with lists as lists and all scalars but strings alike."""
    if isinstance(data, dict):
        return {key: shape(value) for key, value in data.items()}
    return [*map(shape, data)] if isinstance(data, tuple | list) else data if isinstance(data, str) else None


@given(st.dictionaries(st.sampled_from(["relations", "goal", "a"]), CONDITIONS, max_size=3), SEEDS)
def test_other_readers_find_the_same_predicates(data: dict[str, Any], seed: int) -> None:
    out = check(untidy(data, seed)[0])
    anchors = re.findall(r"&\w+", out)
    assume(len(anchors) == len(set(anchors)))  # PyYAML reads no anchor twice, although YAML allows it
    assert shape(yaml.load(out, Loader=yaml.BaseLoader)) == shape(parse(out).data)


@given(DOCUMENTS, DOCUMENTS, SEEDS)
def test_editing_one_value_changes_no_other_that_shares_its_anchor(
    data: dict[str, Any], other: dict[str, Any], seed: int
) -> None:
    text = untidy(data, seed)[0]
    kind = {"simfoundry": "scene/1"}
    for wanted in ({**kind, **data, **other}, kind | dict(list(data.items())[1:])):
        assert same(parse(edit_text(text, wanted, SceneSpec)).data, wanted)


@given(DOCUMENTS, DOCUMENTS, DOCUMENTS, SEEDS)
def test_merging_documents_merges_their_data(
    data: dict[str, Any], ours: dict[str, Any], theirs: dict[str, Any], seed: int
) -> None:
    sides = [data, {**data, **ours}, {**data, **theirs}]
    texts = [untidy(side, seed + k, comments=False)[0] for k, side in enumerate(sides)]
    plain = [write_tree(plain_tree(parse(text).data), model_of("scene/1")) for text in texts]
    assert same(parse(merge_texts(*texts).text).data, parse(merge_texts(*plain).text).data)


ANCHORED = """\
simfoundry: scene/1
name: a

objects:
  cup: &cup {shape: {sphere: 0.1}, mass: 1}
  mug: *cup

  # last
  jug: *cup  # like the cup
"""


def test_a_merge_keeps_layouts_and_changes_only_what_was_edited() -> None:
    ours = ANCHORED.replace("mug: *cup", "mug: {shape: {sphere: 0.1}, mass: 2}")
    theirs = ANCHORED.replace("\n\nobjects", "\nmaterials: {wood: {density: 700}}\n\nobjects")
    merged = merge_texts(ANCHORED, ours, theirs).text
    assert (
        merged
        == merge_texts(ANCHORED, theirs, ours).text
        == theirs.replace("mug: *cup", "mug: {shape: {sphere: 0.1}, mass: 2}")
    )
    without = ANCHORED.replace("  cup: &cup {shape: {sphere: 0.1}, mass: 1}\n", "").replace(
        "mug: *cup", "mug: &cup {shape: {sphere: 0.1}, mass: 1}"
    )
    assert merge_texts(ANCHORED, without, ANCHORED).text == without
    spread = ANCHORED.replace("{shape: {sphere: 0.1}, mass: 1}", "\n    shape: {sphere: 0.1}\n    mass: 1").replace(
        "cup: &cup \n", "cup: &cup\n"
    )
    renamed = ANCHORED.replace("name: a", "name: b")
    assert merge_texts(ANCHORED, spread, renamed).text == spread.replace("name: a", "name: b")
    assert merge_texts(ANCHORED, renamed, spread).text == spread.replace("name: a", "name: b")


def test_an_edit_of_an_anchored_value_leaves_its_aliases() -> None:
    data = parse(ANCHORED).data
    changed = {**data, "objects": {**data["objects"], "cup": {"shape": {"sphere": 0.1}, "mass": 3}}}
    assert parse(edit_text(ANCHORED, changed, SceneSpec)).data == changed
    changed["objects"].pop("cup")
    edited = edit_text(ANCHORED, changed, SceneSpec)
    assert edited == ANCHORED.replace("  cup: &cup {shape: {sphere: 0.1}, mass: 1}\n", "").replace(
        "mug: *cup", "mug: &cup {shape: {sphere: 0.1}, mass: 1}"
    )
