"""Three-way merges that rename objects or preserve comments, and the resolution of conflicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.change.merge.conflict import MergeConflict, dotted, parts
from simfoundry.spec.change.merge.texts import ResolveError, UnmergeableError, merge_texts, new_errors, resolve
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import plain_tree, read_tree
from simfoundry.spec.yaml.write import write_tree
from tests.spec.change.merging import BASES, SCENE, both, changed, merge, table

# -- renames ----------------------------------------------------------------------------------------------------------


def renamed_cup(name: str) -> Any:
    return parse(SCENE.replace("  cup:", f"  {name}:").replace("(cup,", f"({name},")).data


def test_an_object_renamed_here_and_edited_there_is_one() -> None:
    theirs = changed(("mass: 0.2", "mass: 0.31"), ("  - OnTop(cup, desk)", "  - NextTo(cup, plate)"))
    merged = both(renamed_cup("mug"), theirs)
    assert list(merged.data["objects"]) == ["desk", "plate", "mug", "block"]
    assert merged.data["objects"]["mug"]["mass"] == 0.31
    assert merged.data["relations"] == ("OnTop(plate, desk)", "NextTo(mug, plate)")
    assert merged.conflicts == ()


def with_pairs(data: Any, *pairs: tuple[str, str]) -> Any:
    return {**data, "no_contact": pairs}


def test_pairs_without_contact_are_a_set_and_follow_a_new_name() -> None:
    base = with_pairs(BASES["scene"], ("cup", "plate"))
    theirs = with_pairs(BASES["scene"], ("cup", "plate"), ("cup.base", "desk"))
    merged = both(with_pairs(renamed_cup("mug"), ("mug", "plate")), theirs, base)
    assert merged.data["no_contact"] == (("mug", "plate"), ("mug.base", "desk"))
    ours = with_pairs(BASES["scene"], ("plate", "block"), ("plate", "cup"))
    merged = merge(base, ours, theirs)
    assert merged.conflicts == ()
    assert merged.data["no_contact"] == (("plate", "block"), ("cup", "plate"), ("cup.base", "desk"))
    gone = both(with_pairs(BASES["scene"]), theirs, base)
    assert (gone.data["no_contact"], gone.conflicts) == ((("cup.base", "desk"),), ())
    from_nothing = both(with_pairs(BASES["scene"], ("cup", "desk")), with_pairs(BASES["scene"], ("desk", "cup")))
    assert len(from_nothing.data["no_contact"]) == 1 and from_nothing.conflicts == ()


def test_what_is_allowed_and_what_is_open_follow_a_new_name() -> None:
    mass = {"base": 0.2, "ours": 0.25, "theirs": 0.3}

    def noted(data: Any, name: str, **more: str) -> Any:
        allow = {"SF402": {name: "a model", f"objects.{name}.mass": "weighed", **more}}
        return {**data, "allow": allow, "conflicts": {f"objects.{name}.mass": mass, f"objects.{name}.mass #2": mass}}

    base, ours = noted(BASES["scene"], "cup"), noted(renamed_cup("mug"), "mug")
    merged = both(ours, noted(BASES["scene"], "cup", block="foam"), base).data
    assert merged["allow"] == {"SF402": {"mug": "a model", "objects.mug.mass": "weighed", "block": "foam"}}
    assert list(merged["conflicts"]) == ["objects.mug.mass", "objects.mug.mass #2"]


def test_two_new_names_are_a_conflict_that_can_be_decided() -> None:
    base, ours, theirs = BASES["scene"], renamed_cup("mug"), renamed_cup("beaker")
    theirs["objects"]["beaker"]["mass"] = 0.31
    merged = merge(base, ours, theirs)
    assert table(merged) == {"objects.cup": ("cup", "mug", "beaker")}
    assert merged.data["objects"]["mug"]["mass"] == 0.31 and merged.data["relations"][1] == "OnTop(mug, desk)"
    for side, name in (("ours", "mug"), ("theirs", "beaker")):
        decided, _ = resolve(merged.tree, SceneSpec, side)  # type: ignore[arg-type]
        assert list(decided.data["objects"]) == ["desk", "plate", name, "block"]
        assert decided.data["relations"][1] == f"OnTop({name}, desk)"


def test_what_else_is_open_follows_a_new_name() -> None:
    ours, theirs = renamed_cup("mug"), renamed_cup("beaker")
    ours["objects"]["mug"]["mass"], theirs["objects"]["beaker"]["mass"] = 0.25, 0.31
    merged = merge(BASES["scene"], ours, theirs)
    decided, keys = resolve(merged.tree, SceneSpec, "theirs", ["objects.cup"])
    assert (keys, list(decided.data["conflicts"])) == (["objects.cup"], ["objects.beaker.mass"])
    taken = {**merged.data, "objects": {**merged.data["objects"], "beaker": {"shape": {"sphere": 0.1}, "mass": 1}}}
    with pytest.raises(ResolveError, match=r"`objects\.beaker` already exists"):
        resolve(plain_tree(taken), SceneSpec, "theirs")


def test_renamed_here_and_removed_there_is_a_conflict() -> None:
    theirs = {**BASES["scene"], "objects": {k: v for k, v in BASES["scene"]["objects"].items() if k != "cup"}}
    merged = both(renamed_cup("mug"), theirs)
    assert list(table(merged)) == ["objects.mug"] and "mug" in merged.data["objects"]


def test_a_new_name_that_means_something_else_there_is_no_rename() -> None:
    theirs = changed(("robots:", "  mug: {shape: {sphere: 0.1}, mass: 1}\nrobots:"))
    merged = both(renamed_cup("mug"), theirs)
    assert {"objects.mug.shape.sphere", "objects.mug.mass"} <= table(merged).keys()


# -- texts and comments -----------------------------------------------------------------------------------------------

COMMENTED = """\
# A table.
simfoundry: scene/1
name: table

# What stands on it.
objects:
  cup:  # the blue one
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    mass: 0.2  # a guess
    pose: {xyz: [0.1, 0, 0.05]}

relations:
  # It stands.
  - Upright(cup)
"""


def edit(*replacements: tuple[str, str]) -> str:
    text = COMMENTED
    for old, new in replacements:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def test_comments_of_both_sides_are_kept() -> None:
    ours = edit(("0.2  # a guess", "0.25  # weighed"), ("# A table.", "# A table.\n# Ours."))
    theirs = edit(
        ("# the blue one", "# the red one"),
        ("[0.1, 0, 0.05]}", "[0.2, 0, 0.05]}  # moved"),
        ("# It stands.", "# It stands upright."),
        ("- Upright(cup)\n", "- Upright(cup)\n  - Released(cup)  # at last\n"),
        ("\nrelations", "  # New.\n  fork: {shape: {sphere: 0.1}, mass: 1}  # sharp\n\nrelations"),
    )
    merged = merge_texts(COMMENTED, ours, theirs)
    assert merged.conflicts == ()
    assert (
        merged.text
        == """\
# A table.
# Ours.
simfoundry: scene/1
name: table

# What stands on it.
objects:
  cup:  # the red one
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    mass: 0.25                   # weighed
    pose: {xyz: [0.2, 0, 0.05]}  # moved
  # New.
  fork: {shape: {sphere: 0.1}, mass: 1}  # sharp

relations:
  # It stands upright.
  - Upright(cup)
  - Released(cup)  # at last
"""
    )
    assert merge_texts(COMMENTED, theirs, ours).text == merged.text


def test_comments_are_never_a_conflict_and_never_lost() -> None:
    ours, theirs = edit(("# a guess", "# ours")), edit(("# a guess", "# theirs"))
    merged = merge_texts(COMMENTED, ours, theirs)
    assert merged.conflicts == () and "    # theirs\n    mass: 0.2  # ours\n" in merged.text


def test_the_comment_of_a_value_in_conflict_waits_with_it() -> None:
    merged = merge_texts(COMMENTED, edit(("0.2  # a guess", "0.25")), edit(("0.2  # a guess", "0.31  # weighed")))
    assert "mass: 0.25\n" in merged.text
    assert "objects.cup.mass: {base: 0.2, ours: 0.25, theirs: 0.31}  # weighed\n" in merged.text
    tree = read_tree(parse(merged.text))
    assert "mass: 0.31  # weighed\n" in write_tree(resolve(tree, SceneSpec, "theirs")[0], SceneSpec)
    assert write_tree(resolve(tree, SceneSpec, "ours")[0], SceneSpec) == edit(("0.2  # a guess", "0.25"))


def test_comments_of_a_renamed_object_stay() -> None:
    ours = edit(("  cup:", "  mug:"), ("Upright(cup)", "Upright(mug)"))
    merged = merge_texts(COMMENTED, ours, edit(("0.2  # a guess", "0.31  # weighed")))
    assert "  mug:  # the blue one\n" in merged.text and "mass: 0.31  # weighed\n" in merged.text


def test_a_text_that_says_it_already_is_taken_as_it_is() -> None:
    ours = edit(("    pose: {xyz: [0.1, 0, 0.05]}", "    pose:   {xyz: [0.3, 0, 0.05]}"))
    assert merge_texts(COMMENTED, ours, COMMENTED).text == ours
    assert merge_texts(COMMENTED, COMMENTED, ours).text == ours


@pytest.mark.parametrize("broken", ["a: [", "- a\n", "a: 1\na: 2\n", "simfoundry: task/1\n", "", "a: !tag 1\n"])
def test_what_is_no_document_of_the_kind_is_refused(broken: str) -> None:
    for texts in ((COMMENTED, broken, COMMENTED), (COMMENTED, COMMENTED, broken)):
        with pytest.raises(UnmergeableError, match=r"could not be parsed: line|is not a document|different kinds"):
            merge_texts(*texts)


def test_errors_that_only_the_merge_makes_are_found(tmp_path: Path) -> None:
    path = tmp_path / "table.scene.yaml"
    extra = "  fork: {shape: {sphere: 0.1}, mass: 1, asset: gone.glb}\n\nrelations"
    base = edit(("\nrelations", "  plate: {shape: {sphere: 0.1}, mass: 1}\n\nrelations"))
    theirs = base.replace("- Upright(cup)", "- OnTop(cup, plate)").replace("\nrelations", extra)
    merged = merge_texts(base, COMMENTED, theirs)
    assert merged.conflicts == ()
    assert [(d.code, d.path) for d in new_errors(path, merged.text, COMMENTED, theirs)] == [("SF201", "relations.0")]
    assert len(load(path, text=merged.text).errors) == 2


# -- paths and deciding -----------------------------------------------------------------------------------------------


@given(st.lists(st.text(min_size=1, max_size=6), min_size=1, max_size=4).map(tuple))
def test_paths_are_read_back(path: tuple[str, ...]) -> None:
    if not path[-1].startswith("#") and " #" not in path[-1]:
        assert parts(dotted(path)) == path


def test_deciding_says_what_it_cannot() -> None:
    data = {**BASES["scene"], "conflicts": MergeConflict(("objects", "spoon", "mass"), 1, 2, 3).record()}
    with pytest.raises(ResolveError, match="no conflicts are recorded in this document"):
        resolve(plain_tree(BASES["scene"]), SceneSpec, "ours")
    entries = {"objects.spoon.mass": {"base": 1, "ours": 2, "theirs": 3}}
    data = {**BASES["scene"], "conflicts": entries}
    with pytest.raises(ResolveError, match=r"`objects\.spoon` no longer exists"):
        resolve(plain_tree(data), SceneSpec, "ours")
    with pytest.raises(
        ResolveError, match=r"no conflict is recorded at `objects\.cup`; recorded conflicts: `objects\.spo"
    ):
        resolve(plain_tree(data), SceneSpec, "ours", ["objects.cup"])


def test_deciding_some_leaves_the_others() -> None:
    ours = changed(("mass: 0.2", "mass: 0.25"), ("intensity: 0.8", "intensity: 0.7"))
    theirs = changed(("mass: 0.2", "mass: 0.31"), ("intensity: 0.8", "intensity: 0.9"))
    decided, keys = resolve(merge(BASES["scene"], ours, theirs).tree, SceneSpec, "theirs", ["objects.cup"])
    assert keys == ["objects.cup.mass"] and list(decided.data["conflicts"]) == ["lights.sun.intensity"]
    assert decided.data["objects"]["cup"]["mass"] == 0.31 and decided.data["lights"]["sun"]["intensity"] == 0.7
