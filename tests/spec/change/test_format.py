"""Formatting has one result for each meaning, keeps every comment in its place, and does nothing the second time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simfoundry.spec.change.format import format_file, format_text
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.editor.schema import schemas
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.spelling import call, exact
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_yaml, write_tree
from tests.conftest import REPOSITORY
from tests.spec.strategies import ASSETS, SCENES
from tests.spec.yaml.layouts import DOCUMENTS, untidy
from tests.spec.yaml.test_tree import comments

SEEDS = st.integers(0, 2**32)
YAML_FILES = sorted(p for folder in ("specs", "tests") for p in (REPOSITORY / folder).rglob("*.yaml"))


def same(a: Any, b: Any) -> bool:
    """Equal in value, whatever the order of keys; predicates up to their spelling, and 1 and 1.0 alike."""
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, str):
        return isinstance(b, str) and call(a) == call(b)
    if isinstance(a, bool) or a is None:
        return a is b
    return not isinstance(b, bool | str | dict | tuple) and (a == b or (math.isnan(a) and math.isnan(b)))


def said(text: str) -> list[tuple[Any, str]]:
    """The comments of a text with their paths, without what formatting may change in them."""
    return sorted(((path, c.lstrip("# ")) for path, c in comments(text)), key=repr)


def check(text: str) -> str:
    """The canonical form, which must have the meaning and the comments of ``text``."""
    out = format_text(text)
    assert same(parse(text).data, parse(out).data), out
    assert said(text) == said(out), out
    assert format_text(out) == out
    assert all(line == line.rstrip() or "#" in line for line in out.split("\n"))
    assert out.endswith("\n") and not out.endswith("\n\n") and "\r" not in out
    return out


@given(DOCUMENTS, SEEDS, st.sampled_from(KINDS))
def test_any_document_in_any_layout(data: dict[str, Any], seed: int, kind: str) -> None:
    check(untidy(data, seed, kind)[0])


@given(SCENES | ASSETS)
def test_computed_documents_are_written_in_the_same_form(spec: Model) -> None:
    text = to_yaml(spec, comment="why\n\nhow")
    assert format_text(text) == text


@given(SCENES | ASSETS, SEEDS)
def test_one_meaning_has_one_form_but_for_the_layout(spec: Model, seed: int) -> None:
    canonical = to_yaml(spec)
    data = parse(canonical).data
    kind = data.pop("simfoundry")
    untidied = untidy(data, seed, kind, comments=False)[0]
    assert write_tree(plain_tree(parse(check(untidied)).data), type(spec)) == canonical
    check(untidy(data, seed, kind)[0])


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda p: p.name)
def test_every_document_of_the_repository(path: Path) -> None:
    try:
        text = path.read_text()
        known = parse(text)
    except YamlError:
        with pytest.raises(SpecError):
            format_file(path)
        return
    if known.duplicates or not isinstance(known.data, dict) or known.data.get("simfoundry") not in KINDS:
        with pytest.raises(SpecError):
            format_file(path)
        return
    check(text)


@pytest.mark.parametrize("path", sorted((REPOSITORY / "specs").rglob("*.yaml")), ids=lambda p: p.name)
def test_the_documents_of_the_repository_are_formatted(path: Path) -> None:
    assert not format_file(path).changed


def test_a_scene_reads_as_people_write_it() -> None:
    assert check(UNTIDY) == TIDY


UNTIDY = """\
#yaml-language-server: $schema=x.json
# A desk.

objects:   # what stands there
    cup:
        # 3 cm to the left of the plate
        pose: { xyz: [ 0.10, +2, 1e-3 ],yaw_deg: 1.0 }   #measured
        shape: {cylinder: {height: 0.1, # with the rim
            radius: .04}}
        mass:     0.250    # kitchen scale
        friction: 0.50
        material: 'wood'
    desk: {fixed: true, shape: {box: [1.4, 0.70, 0.04]}, material: wood}
    # no plate yet
    lamp: null


relations: [ OnTop( cup,desk ), # see the picture
    Upright(cup) ]
name: "desk"
simfoundry: scene/1
wobble: 3
description: "First line.\\nSecond: line."

materials: { wood: { friction: 0.5, density: 700, # dry oak
   }}
# end
"""
TIDY = """\
# yaml-language-server: $schema=x.json
# A desk.
simfoundry: scene/1
name: desk
description: |-
  First line.
  Second: line.

materials:
  wood:
    density: 700  # dry oak
    friction: 0.5

objects:  # what stands there
  cup:
    shape:
      cylinder:
        radius: 0.04
        height: 0.1  # with the rim
    material: wood
    mass: 0.25  # kitchen scale
    friction: 0.5
    # 3 cm to the left of the plate
    pose: {xyz: [0.1, 2, 0.001], yaw_deg: 1}  # measured
  desk: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, material: wood}
  # no plate yet
  lamp: null

relations:
  - OnTop(cup, desk)  # see the picture
  - Upright(cup)
wobble: 3
# end
"""


@pytest.mark.parametrize(
    ("written", "canonical"),
    [
        ("0.10", "0.1"),
        ("1e-3", "0.001"),
        ("+5", "5"),
        ("1.0", "1"),
        ("-0.0", "0"),
        ("012", "12"),
        ("0x1F", "31"),
        ("1E15", "1.0e+15"),
        ("1000000000000000000001", "1000000000000000000001"),
        ("0.1234567890123", "0.1234567890123"),
        ("0.00009", "9.0e-5"),
        ("1234567890123456.5", "1.2345678901234565e+15"),
        (".inf", ".inf"),
        ("-.Inf", "-.inf"),
        (".NaN", ".nan"),
        ("~", "null"),
        ("", "null"),
        ("True", "true"),
        ("'true'", '"true"'),
        ("'12'", '"12"'),
        ("'12 cups'", "12 cups"),
        ("'2026-01-02'", '"2026-01-02"'),
        ("'12:30'", '"12:30"'),
        ("'a, b'", "a, b"),
        ("'a: b'", '"a: b"'),
        ("'a # b'", '"a # b"'),
        ("a#b", "a#b"),
        ("'Schüssel (blau)'", "Schüssel (blau)"),
        ('"tab\\there"', '"tab\\there"'),
        ("['a, b', c]", '["a, b", c]'),
        ("[{b: 'a (x, y)', c: 1}]", '[{b: "a (x, y)", c: 1}]'),
        ("[{b: 'f(x, y', c: 1}]", '[{b: "f(x, y", c: 1}]'),
        (">\n  two\n  lines\n", '"two lines\\n"'),
        ("|\n  two\n  lines\n", "|\n  two\n  lines"),
        ("|+\n  two\n  lines\n", '"two\\nlines\\n\\n"'),
        ('" indented\\nlines"', '" indented\\nlines"'),
        ("[]", "[]"),
        ("{}", "{}"),
        ("[1, 2,]", "[1, 2]"),
        ("Name( a,b )", "Name( a,b )"),
    ],
)
def test_each_value_has_one_spelling(written: str, canonical: str) -> None:
    text = f"simfoundry: scene/1\nname: {written}\n"
    assert check(text) == f"simfoundry: scene/1\nname: {canonical}\n"


def test_predicates_are_spelled_alike_wherever_they_stand() -> None:
    text = (
        "simfoundry: task/1\ngoal: {all: [ OnTop( a,b ), {not: 'Open( c.d)'}]}\nsubtasks: {x: {goal: At(a,0.5 ,1)}}\n"
    )
    assert check(text) == (
        'simfoundry: task/1\ngoal: {all: ["OnTop(a, b)", {not: Open(c.d)}]}\nsubtasks: {x: {goal: "At(a, 0.5, 1)"}}\n'
    )


def test_long_texts_are_folded_and_long_lists_wrapped() -> None:
    words, numbers = " ".join(["word:"] * 40), ", ".join(["0.12345"] * 40)
    out = check(f"simfoundry: scene/1\ndescription: '{words}'  # why\ngravity: [{numbers}] # all\n")
    assert max(map(len, out.splitlines())) <= 118 and "\ndescription: >-  # why\n  word: word:" in out
    assert out.endswith("0.12345]  # all\n")


def test_comments_of_neighbors_are_aligned_unless_they_are_far_apart() -> None:
    text = "simfoundry: scene/1 # a\nname: x # b\ndescription: a long text that reaches far to the right # c\n"
    near, far = text.replace("description", "# apart\ndescription"), text
    assert "simfoundry: scene/1  # a\nname: x              # b\n# apart" in check(near)
    assert "simfoundry: scene/1  # a\nname: x  # b\n" in check(far)


def test_overlays_keep_their_keys() -> None:
    text = "simfoundry: scene/1\nextends: a.scene.yaml\nobjects: {a: {fixed: false, mass: null}}\n"
    assert check(text) == text


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("a: [", "SF002"),
        ("a: 1", "SF006"),
        ("- 1", "SF006"),
        ("", "SF006"),
        ("simfoundry: scene/1\na: 1\na: 2", "SF003"),
    ],
)
def test_what_cannot_be_formatted_is_a_finding(text: str, code: str) -> None:
    with pytest.raises(SpecError) as error:
        format_text(text, "x.yaml")
    assert [(d.code, d.file) for d in error.value.diagnostics] == [(code, "x.yaml")]


@given(st.floats(allow_nan=False) | st.integers(-(10**30), 10**30))
@example(5e-324)
@example(9007199254740993.0)
@example(1e22)
@example(123456789012345.6)
def test_numbers_are_exact_and_short(value: float) -> None:
    text = exact(value)
    back = parse(text).data
    assert back == value and exact(back) == text
    assert isinstance(value, int) or len(text) <= len(repr(value)) + 3  # a point and a sign


# -- the line that names the schema ----------------------------------------------------------------------------------

SCENE = "simfoundry: scene/1\nname: a\n"


@pytest.mark.parametrize("place", ["schemas", ".simfoundry/schemas", "specs/schemas"])
@pytest.mark.parametrize(
    "line", ["", "# yaml-language-server: $schema=../gone.json\n", "#yaml-language-server:   $schema=gone.json\n"]
)
def test_the_schema_is_named_where_it_is_found(tmp_path: Path, place: str, line: str) -> None:
    (tmp_path / ".git").mkdir()
    (tmp_path / place).mkdir(parents=True)
    (tmp_path / place / "scene.schema.json").write_text("{}")
    path = tmp_path / "specs" / "deep" / "a.scene.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(f"# first\n{line}{SCENE}")
    named = "../schemas" if place.startswith("specs") else f"../../{place}"
    expected = f"# yaml-language-server: $schema={named}/scene.schema.json\n# first\n{SCENE}"
    assert format_file(path).after == expected
    path.write_text(expected)
    assert not format_file(path).changed


def test_the_part_for_editors_is_named_where_the_schema_has_it(tmp_path: Path) -> None:
    (tmp_path / ".git").mkdir()
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "scene.schema.json").write_text(schemas()["scene.schema.json"])
    path = tmp_path / "a.scene.yaml"
    path.write_text(SCENE)
    expected = f"# yaml-language-server: $schema=schemas/scene.schema.json#/$defs/Editor\n{SCENE}"
    assert format_file(path).after == expected
    path.write_text(expected)
    assert not format_file(path).changed


@pytest.mark.parametrize("target", ["https://x.org/y.json", "own.json", "own.json#/$defs/Editor"])
def test_a_line_that_names_something_stays(tmp_path: Path, target: str) -> None:
    (tmp_path / ".git").mkdir()
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "scene.schema.json").write_text("{}")
    (tmp_path / "own.json").write_text("{}")
    path = tmp_path / "a.scene.yaml"
    path.write_text(f"# yaml-language-server: $schema={target}\n{SCENE}")
    assert not format_file(path).changed


def test_schemas_outside_the_project_and_of_other_kinds_are_not_named(tmp_path: Path) -> None:
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "scene.schema.json").write_text("{}")
    (tmp_path / "project" / ".git").mkdir(parents=True)
    (tmp_path / "project" / "schemas").mkdir()
    (tmp_path / "project" / "schemas" / "asset.schema.json").write_text("{}")
    path = tmp_path / "project" / "a.scene.yaml"
    for line in ("", "# yaml-language-server: $schema=gone.json\n"):
        path.write_text(line + SCENE)
        assert not format_file(path).changed
