"""YAML as a person reads it, and texts that mean harm."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from simfoundry.spec.load import load
from simfoundry.spec.yaml.nodes import MAX_DEPTH, YamlError
from simfoundry.spec.yaml.text import parse

HEAD = "simfoundry: scene/1\nname: hostile\n"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"),
        ("yes", "yes"),
        ("Off", "Off"),
        ("y", "y"),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("12", 12),
        ("-0", 0),
        ("+7", 7),
        ("012", 12),
        ("1_000", "1_000"),
        ("0o17", 15),
        ("0xfF", 255),
        ("0b11", "0b11"),
        ("1e-3", 1e-3),
        ("1.5E+2", 150.0),
        (".5", 0.5),
        ("1.", 1.0),
        (".", "."),
        ("12:30", "12:30"),
        ("12:30:45", "12:30:45"),
        ("2026-01-02", "2026-01-02"),
        ("1.2.3", "1.2.3"),
        ("=", "="),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("inf", "inf"),
        ("nan", "nan"),
        ('"12"', "12"),
        ("'true'", "true"),
        ("|\n  12", "12"),
    ],
)
def test_scalars_mean_what_yaml_1_2_says(text: str, value: object) -> None:
    found = parse(f"a: {text}").data["a"]
    assert (found, type(found)) == (value, type(value))


def test_nan_is_a_number_that_specs_refuse(tmp_path: Path) -> None:
    assert math.isnan(parse("a: .nan").data["a"])
    path = tmp_path / "a.scene.yaml"
    path.write_text(HEAD + "gravity: [0, 0, .nan]\n")
    assert [d.code for d in load(path, tmp_path).findings] == ["SF104"]


@pytest.mark.parametrize(
    ("text", "items"),
    [
        ("[OnTop(a, b), Closed(c.d)]", ("OnTop(a, b)", "Closed(c.d)")),
        ("[OnTop(a,b), OnTop(b,\n  c)]", ("OnTop(a, b)", "OnTop(b, c)")),
        ("[f(a, 1, true), 2]", ("f(a, 1, true)", 2)),
        ("\n- OnTop(a, b)\n- Closed(c.d)", ("OnTop(a, b)", "Closed(c.d)")),
        ("\n- OnTop(a\n- b)", ("OnTop(a", "b)")),  # only brackets have commas to lose
        ('["OnTop(a", "b)"]', ("OnTop(a", "b)")),
        ("[(a), b]", ("(a)", "b")),
    ],
)
def test_parentheses_keep_a_relation_together(text: str, items: tuple[object, ...]) -> None:
    assert parse(f"relations: {text}").data["relations"] == items


def test_places_point_at_values_and_at_the_keys_of_mappings() -> None:
    document = parse("first: 1\ncup:\n  pose: {xyz: [1, 2, 3]}\n  mass: 2\n")
    assert document.place(("first",)) == (1, 8)
    assert document.place(("first",), of_key=True) == (1, 1)
    assert document.place(("cup",)) == (2, 1)
    assert document.place(("cup", "pose")) == (3, 3)
    assert document.place(("cup", "pose", "xyz", 1)) == (3, 19)
    assert document.place(("cup", "number", "mass", "number")) == (4, 9)  # tags of unions are passed over
    assert document.place(("cup", "absent")) == (2, 1)
    assert document.place(("absent",)) == (1, 1)
    assert document.known(("cup", "number", "mass", "number", 3)) == ("cup", "mass")


def test_columns_do_not_count_a_byte_order_mark() -> None:
    document = parse("\ufeffname: x\n")
    assert document.data == {"name": "x"}
    assert document.place(("name",)) == (1, 7)


def bomb() -> str:
    lines = ["a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    return "\n".join(lines)


HOSTILE = {
    "alias bomb": (bomb(), "SF005"),
    "anchors within anchors": ("a: " + "".join(f"&a{k} [" for k in range(60)) + "1," * 150_000 + "]" * 60, "SF005"),
    "deep brackets": ("a: " + "[" * 100_000, "SF005"),
    "deep braces": ("a: " + "{b: " * 100_000, "SF005"),
    "deep dashes": ("a:\n" + "- " * 100_000 + "x", "SF005"),
    "deep lines": ("".join(f"{' ' * k}a:\n" for k in range(MAX_DEPTH + 2)), "SF005"),
    "many values": ("a: [" + "1," * 400_000 + "]", "SF005"),
    "python tag": ("a: !!python/object/apply:os.system [ls]", "SF004"),
    "tag of a number": ("a: !!int 3", "SF004"),
    "tag of a key": ("!!str a: 3", "SF004"),
    "own anchor": ("a: &x [1, *x]", "SF002"),
    "merge key": ("a: &x {b: 1}\nc: {<<: *x}", "SF004"),
    "second document": ("a: 1\n---\nb: 2", "SF004"),
    "list as key": ("? [a, b]\n: 1", "SF004"),
    "alias as key": ("a: &x b\n*x : 1", "SF004"),
    "tab": ("a:\n\tb: 1", "SF002"),
    "tab after spaces": ("a:\n  b: 1\n\tc: 2", "SF002"),
    "escape character": ("a: \x1b[2J", "SF002"),
    "delete character": ("a: \x7f", "SF002"),
    "lone surrogate": ("a: \ud800", "SF002"),
    "endless number": ("a: " + "9" * 100_000, "SF104"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_text_ends_in_one_finding(name: str) -> None:
    text, code = HOSTILE[name]
    with pytest.raises(YamlError) as caught:
        parse(text)
    assert caught.value.code == code
    assert caught.value.line >= 1 and caught.value.column >= 1


def test_aliases_that_repeat_little_are_allowed() -> None:
    assert parse("a: &x [1, 2]\nb: [*x, *x]").data["b"] == ((1, 2), (1, 2))


@pytest.mark.parametrize(
    "text", ["", "# only a comment\n", "3", "[]", "null", "simfoundry:\n", "simfoundry: [scene/1]"]
)
def test_what_is_no_document_is_one_finding(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text(text)
    assert [(d.code, d.line) for d in load(path, tmp_path).findings] == [("SF006", 1)]


def test_thousands_of_errors_are_shown_as_some(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text(HEAD + "objects: {" + ", ".join(f"o{k}: {{shap: 1}}" for k in range(20_000)) + "}\n")
    found = load(path, tmp_path).findings
    assert 100 < len(found) < 300
    assert found[-1].message.endswith("more errors are not shown")


def test_thousands_of_unknown_names_are_shown_as_some(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    objects = "".join(f"  o{k}: {{shape: {{sphere: 1}}, mass: 9, material: wod{k}}}\n" for k in range(2000))
    materials = "".join(f"  wood{k}: {{density: 700}}\n" for k in range(2000))
    path.write_text(HEAD + "materials:\n" + materials + "objects:\n" + objects)
    loaded = load(path, tmp_path)
    assert 100 < len(loaded.errors) < 300
    assert len(loaded.findings) - len(loaded.errors) < 300


def scene_with(folder: Path, asset: str) -> list[str]:
    path = folder / "a.scene.yaml"
    path.write_text(HEAD + f"objects:\n  cup: {{asset: {asset}, mass: 0.2}}\n")
    return [d.code for d in load(path, folder).findings]


def test_links_and_dots_cannot_leave_the_project(tmp_path: Path) -> None:
    project, outside = tmp_path / "project", tmp_path / "outside"
    (project / "inner").mkdir(parents=True)
    outside.mkdir()
    (outside / "cup.obj").write_text("v 0 0 0\n")
    (project / "inner" / "cup.obj").write_text("v 0 0 0\n")
    (project / "link.obj").symlink_to(outside / "cup.obj")
    (project / "folder").symlink_to(outside)
    (project / "ring.obj").symlink_to(project / "ring.obj")
    (project / "gone.obj").symlink_to(project / "nothing.obj")
    assert scene_with(project, "link.obj") == ["SF204"]
    assert scene_with(project, "folder/cup.obj") == ["SF204"]
    assert scene_with(project, "../outside/cup.obj") == ["SF204"]
    assert scene_with(project, f"{outside}/cup.obj") == ["SF204"]
    assert scene_with(project, f"{project}/inner/cup.obj") == ["SF204"]  # a document that moves must still work
    assert scene_with(project, "~/cup.obj") == ["SF203"]
    assert scene_with(project, "ring.obj") == ["SF203"]
    assert scene_with(project, "gone.obj") == ["SF203"]
    assert scene_with(project, "a" * 300 + ".obj") == ["SF203"]
    assert scene_with(project, "a/" * 5000 + "a.obj") == ["SF204"]
    assert scene_with(project, "inner/../inner/cup.obj") == []


def test_a_named_pipe_is_not_waited_for(tmp_path: Path) -> None:
    import os

    os.mkfifo(tmp_path / "a.scene.yaml")
    os.mkfifo(tmp_path / "cup.obj")
    assert [d.code for d in load(tmp_path / "a.scene.yaml", tmp_path).findings] == ["SF001"]
    (tmp_path / "a.scene.yaml").unlink()
    assert scene_with(tmp_path, "cup.obj") == ["SF203"]
    (finding,) = load(tmp_path / "a.scene.yaml", tmp_path).findings
    assert finding.message == "`cup.obj` is not a file" and finding.hint == "it is a pipe or a device; name a file"


def test_an_asset_that_is_a_document_of_another_kind_or_broken(tmp_path: Path) -> None:
    (tmp_path / "a.asset.yaml").write_text("simfoundry: asset/1\nname: Ä\n")
    path = tmp_path / "s.scene.yaml"
    path.write_text(HEAD + "objects:\n  cup: {asset: a.asset.yaml}\n  mug: {asset: s.asset.yaml}\n")
    (tmp_path / "s.asset.yaml").symlink_to(path)
    loaded = load(path, tmp_path)
    assert sorted(d.code for d in loaded.errors) == ["SF006", "SF102", "SF106"]
