"""Three-way merges of trees: unions, order, conflicts, and invariants."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.change.merge.conflict import dotted
from simfoundry.spec.change.merge.texts import resolve
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import to_data
from tests.spec.change.edits import clashing, edited, independent
from tests.spec.change.merging import BASES, SCENE, TASK, as_sets, both, changed, merge, seeds, table, text_of
from tests.spec.strategies import ASSETS, SCENES

# -- what always holds ------------------------------------------------------------------------------------------------


@seeds
@pytest.mark.parametrize("name", BASES)
def test_independent_edits_merge_into_both(name: str, seeds: range) -> None:
    base = BASES[name]
    several = 0
    for seed in seeds:
        ours, theirs = independent(base, random.Random(f"{name}{seed}"))
        several += bool(ours) and bool(theirs)
        merged = merge(base, edited(base, ours), edited(base, theirs))
        assert merged.conflicts == (), (seed, ours, theirs)
        for order in ([*ours, *theirs], [*theirs, *ours]):
            assert as_sets(merged.data) == as_sets(edited(base, order)), (seed, ours, theirs)
        mirrored = merge(base, edited(base, theirs), edited(base, ours))
        assert text_of(mirrored) == text_of(merged), (seed, ours, theirs)
    assert several > len(seeds) / 2


@pytest.mark.parametrize("name", BASES)
def test_conflicts_are_the_same_from_both_sides(name: str) -> None:
    base, conflicts = BASES[name], 0
    for seed in range(60):
        ours, theirs = (edited(base, e) for e in clashing(base, random.Random(f"{name}{seed}")))
        conflicts += len(both(ours, theirs, base).conflicts)
    assert conflicts > 10


def test_a_document_with_conflicts_loads_with_exactly_these(tmp_path: Path) -> None:
    path, seen = tmp_path / "table.scene.yaml", 0
    for seed in range(60):
        sides = [[e for e in side if e.kind == "set"] for side in clashing(BASES["scene"], random.Random(seed))]
        merged = merge(BASES["scene"], *(edited(BASES["scene"], side) for side in sides))
        loaded = load(path, text=text_of(merged))
        assert [d.code for d in loaded.errors] == ["SF209"] * len(merged.conflicts), seed
        assert loaded.document is not None
        assert loaded.document.data["conflicts" if merged.conflicts else "name"] == (
            {dotted(c.path): c.record() for c in merged.conflicts} or "table"
        )
        seen += len(merged.conflicts)
    assert seen > 10


@given(st.one_of(st.tuples(SCENES, SCENES), st.tuples(ASSETS, ASSETS)))
def test_merging_with_what_is_unchanged_changes_nothing(specs: tuple[Any, Any]) -> None:
    base, other = (to_data(spec) for spec in specs)
    for merged in (merge(base, other, other), merge(base, base, other), merge(base, other, base)):
        assert merged.conflicts == ()
        assert json.dumps(merged.data) == json.dumps(other)


@given(SCENES, SCENES, SCENES)
def test_any_three_documents_merge_into_one_that_can_be_read_and_decided(
    a: SceneSpec, b: SceneSpec, c: SceneSpec
) -> None:
    base, ours, theirs = (to_data(spec) for spec in (a, b, c))
    merged = merge(base, ours, theirs)
    assert parse(text_of(merged)).data["objects" if merged.data.get("objects") else "name"] is not None
    entries = merged.data.get("conflicts", {})
    assert [dotted(c.path) for c in merged.conflicts] == list(entries)
    if entries:
        for side in ("ours", "theirs"):
            decided, keys = resolve(merged.tree, SceneSpec, side)
            assert keys == list(entries) and "conflicts" not in decided.data
    assert table(merge(base, theirs, ours), swap=True).keys() == table(merged).keys() or any(
        isinstance(c.base, str) and c.path[-1] == c.base for c in merged.conflicts
    )


# -- what is united ---------------------------------------------------------------------------------------------------


def test_fields_of_one_object_are_independent() -> None:
    ours = changed(("mass: 0.2", "mass: 0.25"), ("yaw_deg: 30", "yaw_deg: 45"))
    theirs = changed(("friction: 0.4\n", "friction: 0.6\n"), ("[0.4, 0.12, 0.05]", "[0.5, 0.12, 0.05]"))
    cup = both(ours, theirs).data["objects"]["cup"]
    assert (cup["mass"], cup["friction"]) == (0.25, 0.6)
    assert cup["pose"] == {"xyz": (0.5, 0.12, 0.05), "yaw_deg": 45}


def test_relations_are_a_set() -> None:
    ours = changed(("  - OnTop(cup, desk)", "  - NextTo(cup, plate)"))
    theirs = changed(("  - OnTop(cup, desk)\n", "  - OnTop(cup,desk)\n  - Upright(cup)\n  - NextTo(cup,plate)\n"))
    assert both(ours, theirs).data["relations"] == ("OnTop(plate, desk)", "Upright(cup)", "NextTo(cup, plate)")


def test_the_last_relation_goes_while_another_comes() -> None:
    base = changed(("  - OnTop(cup, desk)\n", ""))
    ours = {key: value for key, value in base.items() if key != "relations"}
    merged = both(ours, {**base, "relations": (*base["relations"], "Upright(cup)")}, base)
    assert (merged.data["relations"], merged.conflicts) == (("Upright(cup)",), ())


def test_in_an_overlay_a_list_that_goes_is_not_an_empty_one() -> None:
    base = {"simfoundry": "scene/1", "extends": "a.scene.yaml", "name": "b", "relations": ("OnTop(cup, desk)",)}
    ours = {key: value for key, value in base.items() if key != "relations"}
    merged = both(ours, {**base, "relations": ("OnTop(cup, plate)",)}, base)
    assert list(table(merged)) == ["relations"]


def test_goals_are_sets_inside_and_out() -> None:
    base = BASES["task"]
    nested = "{any: [Upright(cup), Released(cup)]}"
    ours = changed((nested, "{any: [Upright(cup)]}, NextTo(cup, block)"), text=TASK)
    theirs = changed((nested, "{any: [Upright(cup), Released(cup), Lifted(cup)]}, Upright(plate)"), text=TASK)
    expected = ("OnTop(cup, plate)", {"any": ("Upright(cup)", "Lifted(cup)")}, "NextTo(cup, block)", "Upright(plate)")
    assert both(ours, theirs, base).data["goal"]["all"] == expected


def test_a_condition_of_conditions_that_one_removes_and_the_other_changes_is_a_conflict_of_the_list() -> None:
    nested = ", {any: [Upright(cup), Released(cup)]}"
    ours = changed((nested, ""), text=TASK)
    theirs = changed((nested, ", {any: [Upright(cup)]}"), text=TASK)
    merged = both(ours, theirs, BASES["task"])
    assert list(table(merged)) == ["goal.all"]
    assert merged.data["goal"]["all"] == ("OnTop(cup, plate)",)


def test_both_add_one_object() -> None:
    ours = changed(("robots:", "  fork: {shape: {sphere: 0.1}, mass: 1}\nrobots:"))
    theirs = changed(("robots:", "  fork: {shape: {sphere: 0.1}, mass: 2, friction: 0.3}\nrobots:"))
    merged = both(ours, theirs)
    assert merged.data["objects"]["fork"] == {"shape": {"sphere": 0.1}, "mass": 1, "friction": 0.3}
    assert [str(c) for c in merged.conflicts] == ["objects.fork.mass: ours 1, theirs 2 (new)"]


def test_both_add_one_document() -> None:
    theirs = changed(("mass: 0.2", "mass: 0.3"))
    merged = merge(None, BASES["scene"], theirs)
    assert [str(c) for c in merged.conflicts] == ["objects.cup.mass: ours 0.2, theirs 0.3 (new)"]


def test_a_change_of_spelling_is_none() -> None:
    theirs = changed(("goal: OnTop(cup, plate),", 'goal: "OnTop(cup,plate)",'), ("15.5", "15.50"), text=TASK)
    ours = changed(("goal: OnTop(cup, plate),", "goal: Released(cup),"), ("15.5", "20"), text=TASK)
    merged = both(ours, theirs, BASES["task"])
    assert merged.conflicts == () and merged.data == ours


# -- order ------------------------------------------------------------------------------------------------------------


def test_what_is_added_follows_what_it_followed() -> None:
    new = "{shape: {sphere: 0.1}, mass: 1}"
    ours = changed(("  cup:\n", f"  zebra: {new}\n  cup:\n"), ("robots:", f"  last: {new}\nrobots:"))
    theirs = changed(("  cup:\n", f"  ant: {new}\n  bee: {new}\n  cup:\n"), ("  desk:\n", f"  first: {new}\n  desk:\n"))
    names = list(both(ours, theirs).data["objects"])
    assert names == ["first", "desk", "plate", "ant", "bee", "zebra", "cup", "block", "last"]


def test_the_side_that_reorders_decides_the_order() -> None:
    base = BASES["task"]
    swapped = {**base, "subtasks": dict(reversed(base["subtasks"].items()))}
    added = {**base, "subtasks": {**base["subtasks"], "rest": {"goal": "Released(cup)"}}}
    assert list(both(added, swapped, base).data["subtasks"]) == ["put", "rest", "pick"]


def test_two_orders_of_steps_are_a_conflict_and_of_objects_are_none() -> None:
    steps = {name: {"goal": f"Grasped({name})"} for name in "abc"}
    base = {"simfoundry": "task/1", "name": "t", "subtasks": steps}
    ours = {**base, "subtasks": {name: steps[name] for name in "bac"}}
    theirs = {**base, "subtasks": {name: steps[name] for name in "acb"}}
    merged = both(ours, theirs, base)
    assert table(merged) == {"subtasks": (("a", "b", "c"), ("b", "a", "c"), ("a", "c", "b"))}
    assert list(merged.data["subtasks"]) == ["b", "a", "c"]
    decided, _ = resolve(merged.tree, model_of("task/1"), "theirs")
    assert list(decided.data["subtasks"]) == ["a", "c", "b"]
    objects = BASES["scene"]["objects"]
    reordered = [
        {**BASES["scene"], "objects": {n: objects[n] for n in names}}
        for names in (("cup", "desk", "plate", "block"), ("desk", "cup", "block", "plate"))
    ]
    assert both(*reordered).conflicts == ()


# -- conflicts --------------------------------------------------------------------------------------------------------


def test_two_values_are_a_conflict_and_ours_stays() -> None:
    merged = both(changed(("mass: 0.2", "mass: 0.25")), changed(("mass: 0.2", "mass: 0.31")))
    assert merged.data["objects"]["cup"]["mass"] == 0.25
    assert merged.data["conflicts"] == {"objects.cup.mass": {"base": 0.2, "ours": 0.25, "theirs": 0.31}}
    assert [str(c) for c in merged.conflicts] == ["objects.cup.mass: ours 0.25, theirs 0.31 (was 0.2)"]


def test_what_one_removed_and_the_other_changed_stays() -> None:
    cup = SCENE[SCENE.index("  cup:") : SCENE.index("  block:")]
    merged = both(changed((cup, "")), changed(("mass: 0.2", "mass: 0.31")))
    assert merged.data["objects"]["cup"]["mass"] == 0.31
    (conflict,) = merged.conflicts
    assert conflict.path == ("objects", "cup") and "ours" not in merged.data["conflicts"]["objects.cup"]


def test_an_estimate_is_one_value() -> None:
    merged = both(changed(("value: 0.1", "value: 0.11")), changed(("0.05, 0.2]", "0.08, 0.12]")))
    assert list(table(merged)) == ["objects.block.mass"]
    assert merged.data["objects"]["block"]["mass"] == {"value": 0.11, "range": (0.05, 0.2), "source": "vlm"}


@pytest.mark.parametrize(
    ("ours", "theirs", "paths"),
    [
        (("yaw_deg: 30", "yaw_deg: 40"), ("yaw_deg: 30", "rpy_deg: [1, 2, 3]"), {"pose.yaw_deg", "pose.rpy_deg"}),
        (
            ("pose: {xyz: [0.4, 0.12, 0.05], yaw_deg: 30}", "place: {on: desk}"),
            ("0.12, 0.05]", "0.13, 0.05]"),
            {"pose", "place"},
        ),
        (("mass: 0.2\n", "density: 500\n"), ("mass: 0.2\n", "mass: 0.3\n"), {"mass", "density"}),
        (
            ("shape: {cylinder: {radius: 0.04, height: 0.1}}", "shape: {sphere: 0.1}"),
            ("height: 0.1}}", "height: 0.2}}"),
            {"shape.cylinder", "shape.sphere"},
        ),
        (
            ("shape: {cylinder: {radius: 0.04, height: 0.1}}", "asset: cup.glb"),
            ("shape: {cylinder: {radius: 0.04, height: 0.1}}", "shape: {sphere: 0.1}"),
            {"shape", "asset"},
        ),
    ],
)
def test_keys_that_exclude_each_other_stand_and_fall_together(
    ours: tuple[str, str], theirs: tuple[str, str], paths: set[str]
) -> None:
    a, b = changed(ours), changed(theirs)
    for first, second in ((a, b), (b, a)):
        merged = both(first, second)
        assert set(table(merged)) == {f"objects.cup.{path}" for path in paths}
        assert merged.data["objects"] == first["objects"]
        for side, expected in (("ours", first), ("theirs", second)):
            decided, _ = resolve(merged.tree, SceneSpec, side)  # type: ignore[arg-type]
            assert decided.data == expected
            one, keys = resolve(merged.tree, SceneSpec, side, [sorted(table(merged))[0]])  # type: ignore[arg-type]
            assert (one.data, set(keys)) == (expected, set(table(merged)))


def test_names_are_not_keys_that_exclude_each_other() -> None:
    new = "{shape: {sphere: 0.1}, mass: 1}"
    merged = both(changed(("robots:", f"  box: {new}\nrobots:")), changed(("robots:", f"  sphere: {new}\nrobots:")))
    assert merged.conflicts == () and {"box", "sphere"} <= merged.data["objects"].keys()


def test_the_start_of_a_task_has_each_object_once() -> None:
    base = BASES["task"]
    ours = changed(("{on: desk, xy: [0.3, 0.1]}}", "{on: desk, xy: [0.3, 0.1]}, block: {on: plate}}"), text=TASK)
    theirs = changed(("start: {place: {cup:", "start: {pose: {block: {xyz: [0, 0, 1]}}, place: {cup:"), text=TASK)
    merged = both(ours, theirs, base)
    assert set(table(merged)) == {"start.place.block", "start.pose.block"}
    assert "block" in merged.data["start"]["place"] and "block" not in merged.data["start"]["pose"]


def test_a_joint_and_its_limits_are_one_decision() -> None:
    joint = {"type": "revolute", "parent": "a", "child": "b", "limits_deg": (0, 90)}
    base = {"simfoundry": "asset/1", "name": "x", "joints": {"door": joint}}
    slides = {"type": "prismatic", "parent": "a", "child": "b", "limits": (0, 0.2)}
    ours = {**base, "joints": {"door": {**slides, "damping": 0.5}}}
    theirs = {**base, "joints": {"door": {**joint, "limits_deg": (0, 100), "friction": 0.1}}}
    merged = both(ours, theirs, base)
    assert set(table(merged)) == {"joints.door.type", "joints.door.limits", "joints.door.limits_deg"}
    assert merged.data["joints"]["door"] == {**slides, "damping": 0.5, "friction": 0.1}


def test_open_conflicts_of_both_sides_survive() -> None:
    def with_entries(data: Any, **entries: Any) -> Any:
        return {**data, "conflicts": {key.replace("_", "."): value for key, value in entries.items()}}

    plain, old = BASES["scene"], {"base": 1, "ours": 2, "theirs": 3}
    a = with_entries(changed(("mass: 0.2", "mass: 0.25")), a_b=old, objects_cup_mass=old)
    b = with_entries(changed(("mass: 0.2", "mass: 0.31")), c_d=old, a_b={**old, "theirs": 4})
    entries = both(a, b, plain).data["conflicts"]
    assert entries == {
        "a.b": old,
        "a.b #2": {**old, "theirs": 4},
        "c.d": old,
        "objects.cup.mass": old,
        "objects.cup.mass #2": {"base": 0.2, "ours": 0.25, "theirs": 0.31},
    }
    decided = merge(with_entries(plain, a_b=old, c_d=old), plain, with_entries(plain, a_b=old, c_d=old, e_f=old))
    assert decided.data["conflicts"] == {"e.f": old}
