"""Older versions are brought up to date step by step, comments included; shown with versions made up here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from simfoundry.spec.change.migrate import STEPS, Migration, migrated, renamed
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.yaml.tree import CommentedTree
from tests.cli.command import run

OLD = """\
# a desk
simfoundry: scene/a
name: desk
things:            # what stands there
  # the red one
  cup: {weight: 0.2, shape: {sphere: 0.05}}     # weighed
"""


def in_grams(tree: CommentedTree) -> CommentedTree:
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
  cup:  # weighed
    shape: {sphere: 0.05}
    mass: 2
"""
    )


def test_what_is_up_to_date_is_left_alone() -> None:
    text = "simfoundry:   scene/1\nname:   desk\n"
    assert migrated(text, "a", STEPS_HERE) == text
    assert migrated(migrated(OLD, "a", STEPS_HERE), "a", STEPS_HERE) == migrated(OLD, "a", STEPS_HERE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("simfoundry: scene/9\n", "`scene/9` is no version"),
        ("name: a\n", "the key `simfoundry` is missing"),
        ("simfoundry: [\n", "a value should stand here"),
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
    assert (done.code, done.out) == (0, "1 document: none of an older version\n")
    assert path.read_text() == "simfoundry:   scene/1\nname: a\n"
    path.write_text("simfoundry: scene/0\nname: a\n")
    done = run("migrate", str(tmp_path))
    assert done.code == 2 and "SF006" in done.err and "scene/1" in done.err
