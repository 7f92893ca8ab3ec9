"""Older versions are brought up to date step by step, comments included; shown with versions made up here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from simfoundry.spec.change.format import STEPS, Migration, migrated
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import former_paths, with_present_keys
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import YamlTree
from tests.cli.command import run

OLD = """\
# a desk
simfoundry: scene/a
name: desk
things:            # what stands there
  # the red one
  cup: {weight: 0.2, shape: {sphere: 0.05}}     # weighed
"""


def in_grams(tree: YamlTree) -> YamlTree:
    """Weights in grams become masses in kilograms."""
    tree = renamed(tree, ("objects", "*", "weight"), "mass")
    objects = tree.value["objects"]
    scaled = {
        name: replace(
            item, value={**item.value, "mass": replace(item.value["mass"], value=item.value["mass"].value * 10)}
        )
        for name, item in objects.value.items()
    }
    return replace(tree, value={**tree.value, "objects": replace(objects, value=scaled)})


def renamed(tree: YamlTree, path: tuple[str, ...], name: str) -> YamlTree:
    """The tree in which the key at ``path`` (``*`` stands for any) is called ``name``."""
    head, *rest = path
    if not rest:
        return replace(tree, value={name if key == head else key: child for key, child in tree.value.items()})
    hit = {key: renamed(child, tuple(rest), name) if head in ("*", key) else child for key, child in tree.value.items()}
    return replace(tree, value=hit)


STEPS_HERE = {
    "scene/a": Migration("scene/b", lambda tree: renamed(tree, ("things",), "objects")),
    "scene/b": Migration("scene/1", in_grams),
}


def test_every_step_is_taken_and_comments_stay() -> None:
    assert (
        migrated(OLD, "a", STEPS_HERE)
        == """\
# a desk
simfoundry: scene/1
name: desk
objects:  # what stands there
  # the red one
  cup: {shape: {sphere: 0.05}, mass: 2}  # weighed
"""
    )


def test_what_is_up_to_date_is_left_alone() -> None:
    text = "simfoundry:   scene/1\nname:   desk\n"
    assert migrated(text, "a", STEPS_HERE) == text
    assert migrated(migrated(OLD, "a", STEPS_HERE), "a", STEPS_HERE) == migrated(OLD, "a", STEPS_HERE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("simfoundry: scene/9\n", "`scene/9` is not a known document kind"),
        ("name: a\n", "the `simfoundry` key is missing"),
        ("simfoundry: [\n", "expected a value"),
    ],
)
def test_what_is_no_version_is_said(text: str, words: str) -> None:
    with pytest.raises(SpecError) as error:
        migrated(text, "a")
    assert words in str(error.value)


def test_steps_lead_to_a_version_that_there_is() -> None:
    assert all(step.to in STEPS or step.to in KINDS for step in STEPS.values())
    assert not set(STEPS) & set(KINDS)
    with pytest.raises(ValueError, match="lead back"):
        migrated(OLD, "a", {"scene/a": Migration("scene/b", lambda t: t), "scene/b": Migration("scene/a", lambda t: t)})


def test_the_command_changes_nothing_that_is_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text("simfoundry:   scene/1\nname: a\n")
    done = run("migrate", str(tmp_path))
    assert (done.code, done.out) == (0, "1 document: none out of date\n")
    assert path.read_text() == "simfoundry:   scene/1\nname: a\n"
    path.write_text("simfoundry: scene/0\nname: a\n")
    done = run("migrate", str(tmp_path))
    assert done.code == 2 and "SF006" in done.err and "scene/1" in done.err


FORMER = """\
# a recipe
simfoundry: cousins/1
name:   desks
twin: desk.scene.yaml
scene: {objects: {cup: [LeftOf]}, together: 2, anchor: desk}   # two at once
distractors:
  shipped: true
  "without": [knife]
  mass: {most:   0.5}  # light ones
"""
SCENE = """\
simfoundry: scene/1
name: desk
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.1]}}
  cup:
    shape: {sphere: 0.04}
    mass: {value: 0.2, by: scale}
    place: {on: desk, at: [0, 0.1]}
    origin: {fit: 0.002, cousin: {recipe: a, seed: 1, index: 1, by: me}}
"""


def test_keys_that_were_renamed_are_found_and_mended_where_they_stand(tmp_path: Path) -> None:
    recipe, scene = tmp_path / "desks.cousins.yaml", tmp_path / "desk.scene.yaml"
    recipe.write_text(FORMER)
    scene.write_text(SCENE)
    found = {(d.code, d.line, d.column, d.message) for d in load(recipe).findings}
    assert ("SF101", 9, 10, "the `most` key was renamed to `max`") in found
    assert ("SF101", 5, 35, "the `together` key was renamed to `relations_per_object`") in found
    assert [d.line for d in load(scene).findings] == [7, 8, 9, 9]
    assert {d.hint for d in load(scene).findings} == {"run `simfoundry migrate` on the file"}
    assert run("migrate", "--check", str(tmp_path)).code == 1 and recipe.read_text() == FORMER
    assert run("migrate", str(tmp_path)).code == 0
    expected = FORMER
    for old, new in (("together", "relations_per_object"), ("shipped", "builtin_library"), ("most", "max")):
        expected = expected.replace(f"{old}:", f"{new}:")
    assert recipe.read_text() == expected.replace("without", "exclude_categories")
    assert "mass: {value: 0.2, source: scale}" in scene.read_text() and "generator: me" in scene.read_text()
    assert [d.code for d in load(scene).findings] == [] and [d.code for d in load(recipe).findings] == []


def test_former_keys_of_plain_data() -> None:
    data = parse(SCENE).data
    model = model_of("scene/1")
    present = with_present_keys(model, data)
    assert present["objects"]["cup"]["place"] == {"on": "desk", "local_xy": (0, 0.1)}
    assert present["objects"]["desk"] == data["objects"]["desk"] and not list(former_paths(model, present))
    both = {"objects": {"cup": {"place": {"at": (0, 0), "local_xy": (1, 1)}}}}
    assert with_present_keys(model, both) == both, "two values for one field are left for a person to decide"
