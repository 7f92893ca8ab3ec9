"""Merges of documents that use reuse: what both sides add to lists, templates and parameters, and names of copies."""

from __future__ import annotations

import pytest

from simfoundry.spec.change.merge.texts import merge_texts
from simfoundry.spec.yaml.text import parse
from tests.corpora.reuse_merges import merge_pairs

SCENE = """\
simfoundry: scene/1
name: bar

parameters:
  gap: 0.1  # centre to centre

include:
  left: {scene: station.scene.yaml}

objects:
  bar:
    fixed: true
    shape: {box: [2, 0.6, 1]}
    material: left_oak
  cup:
    shape: {cylinder: {radius: 0.03, height: 0.09}}
    mass: 0.2
    place: {on: bar}
    repeat: {count: [3, 2], step: [$gap, $gap]}
  cup_2_1:
    mass: 0.3
no_contact: [[cup, bar]]

relations:
  - OnTop(cup, bar)
  - OnTop(cup_1_1, bar)
"""


@pytest.mark.slow  # 4 s: many random merges
def test_independent_edits_of_reuse_merge_into_both() -> None:
    outcome = merge_pairs(50, seed=1)
    assert outcome.clashes == 5
    assert outcome.wrong == []


def _merged(ours: str, theirs: str) -> str:
    first, second = merge_texts(SCENE, ours, theirs), merge_texts(SCENE, theirs, ours)
    assert (first.conflicts, second.conflicts) == ((), ())
    assert parse(first.text).data == parse(second.text).data
    return first.text


def test_copies_follow_the_new_name_of_a_repeated_object() -> None:
    named = SCENE.replace("cup", "mug")
    told = SCENE.replace("cup_2_1:\n    mass: 0.3", "cup_2_1:\n    mass: 0.4\n  cup_1_2:\n    mass: 0.5")
    told = told.replace("[[cup, bar]]", "[[cup, bar], [cup_1_1, cup_1_2]]") + "  - OnTop(cup_3_2, bar)\n"
    text = _merged(named, told)
    assert "cup" not in text
    data = parse(text).data
    assert data["objects"]["mug_2_1"] == {"mass": 0.4}
    assert data["objects"]["mug_1_2"] == {"mass": 0.5}
    assert ("mug_1_1", "mug_1_2") in data["no_contact"]
    assert "OnTop(mug_3_2, bar)" in data["relations"]


def test_members_follow_the_new_name_of_an_include() -> None:
    named = SCENE.replace("left", "west")
    told = SCENE.replace(
        "  cup_2_1:", "  left_tool_1:\n    mass: 0.5\n  left_hand:\n    shape: {sphere: 0.1}\n  cup_2_1:"
    )
    objects = parse(_merged(named, told)).data["objects"]
    assert objects["bar"]["material"] == "west_oak"
    assert objects["west_tool_1"] == {"mass": 0.5}
    assert "left_hand" in objects  # an object of this scene that happens to be called like this


def test_two_values_of_one_parameter_are_a_conflict() -> None:
    ours, theirs = (SCENE.replace("gap: 0.1 ", f"gap: {value} ") for value in (0.12, 0.15))
    merged = merge_texts(SCENE, ours, theirs)
    assert [c.path for c in merged.conflicts] == [("parameters", "gap")]
    assert "# centre to centre" in merged.text
    assert parse(merged.text).data["conflicts"] == {"parameters.gap": {"base": 0.1, "ours": 0.12, "theirs": 0.15}}


def test_one_removes_a_copy_that_the_other_changes() -> None:
    ours = SCENE.replace("cup_2_1:\n    mass: 0.3", "cup_2_1: null")
    theirs = SCENE.replace("mass: 0.3", "mass: 0.4")
    assert [c.path for c in merge_texts(SCENE, ours, theirs).conflicts] == [("objects", "cup_2_1")]
