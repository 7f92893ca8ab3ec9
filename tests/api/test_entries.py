"""Editing documents in place: what an edit changes, what it refuses, and that a refused edit changes nothing."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.backends import compile_scene
from simfoundry.scene.state import SceneState

TEXT = """\
simfoundry: scene/1
name: desk

materials:
  wood: {density: 700}
  steel: {density: 7800}

objects:
  table:
    fixed: true
    shape: {box: [1.4, 0.7, 0.04]}
    material: wood
    pose: {xyz: [0.45, 0, -0.02]}
  mug:
    shape: {cylinder: {radius: 0.04, height: 0.095}}
    material: steel
    place: {on: table, xy: [0.42, 0.12]}

relations: [OnTop(mug, table)]

allow: {SF402: it is hollow}
"""

TASK = """\
simfoundry: task/1
name: lift
scene: desk.scene.yaml
instruction: lift the mug
goal: Upright(mug)
subtasks:
  first: {goal: Upright(mug)}
reset:
  objects:
    mug: {x: [0.3, 0.5], y: [0, 0.2]}
"""


@pytest.fixture
def scene(tmp_path: Path) -> sf.SceneDocument:
    (tmp_path / "desk.scene.yaml").write_text(TEXT)
    return sf.load(tmp_path / "desk.scene.yaml")


@pytest.fixture
def task(scene: sf.SceneDocument) -> sf.TaskDocument:
    path = scene.path.with_name("lift.task.yaml")
    path.write_text(TASK)
    return sf.load_task(path)


# -- values that are read ------------------------------------------------------------------------------------------


def test_mappings_that_were_read_are_read_only(scene: sf.SceneDocument, task: sf.TaskDocument) -> None:
    bare = copy.copy(task)
    del bare.reset
    mappings = [
        scene.objects["mug"].joints,
        scene.objects["mug"].variants,
        scene.allow,
        task.reset.objects,
        bare.reset.objects,
        bare.start.joints,
    ]
    for mapping in mappings:
        assert isinstance(mapping, dict)
        for edit, values in (("__setitem__", ("a", 1)), ("update", ({"a": 1},)), ("setdefault", ("a",)), ("clear", ())):
            with pytest.raises(TypeError, match="assign a new value to its field"):
                getattr(mapping, edit)(*values)
        assert copy.deepcopy(mapping) == mapping and pickle.loads(pickle.dumps(mapping)) == mapping
    assert not scene.changes and not task.changes
    assert sf.load(scene.path).objects["table"].joints == {}


def test_a_read_only_mapping_can_be_extended_and_assigned(scene: sf.SceneDocument) -> None:
    scene.allow = {**scene.allow, "SF401": "not used yet"}
    assert scene.allow == {"SF402": "it is hollow", "SF401": "not used yet"} and "SF401: not used yet" in scene.text


# -- removing fields and members -----------------------------------------------------------------------------------


def test_removing_the_last_field_keeps_the_entry(scene: sf.SceneDocument) -> None:
    scene.materials["steel"].density = None
    assert "steel" in scene.materials and "  steel: {}\n" in scene.text
    scene.objects["mug"].mass = 0.3
    assert sf.load(scene.save()).materials["steel"].friction == 0.5


def test_removing_the_last_member_or_pose_field_removes_the_section_or_pose(scene: sf.SceneDocument) -> None:
    scene.objects["mug"].update(place=None, pose={"xyz": [0.4, 0, 0.1]})
    scene.objects["mug"].pose.update(xyz=None)
    scene.relations.clear()
    scene.objects.clear()
    assert not scene.objects and not any(key in scene.text for key in ("pose", "objects", "relations"))


@pytest.mark.parametrize("remove", ["rename", "delete", "pop"])
def test_an_entry_that_was_renamed_or_removed_cannot_be_used(scene: sf.SceneDocument, remove: str) -> None:
    mug, pose = scene.objects["mug"], scene.objects["mug"].pose
    if remove == "rename":
        scene.objects.rename("mug", "jug")
    elif remove == "delete":
        del scene.objects["mug"]
    else:
        scene.objects.pop("mug")
    text = scene.text
    for use in (
        lambda: setattr(mug, "mass", 0.5),
        lambda: setattr(pose, "yaw_deg", 5),
        lambda: mug.update(mass=None),
        lambda: mug.mass,
        lambda: pose.xyz,
        mug.to_data,
    ):
        with pytest.raises(sf.UnknownNameError, match="has no object `mug`"):
            use()
    assert scene.text == text and "mug" in repr(mug)


def test_pop_returns_the_content_of_a_member(scene: sf.SceneDocument) -> None:
    content = scene.objects["mug"].to_data()
    scene.objects["cup"] = scene.objects.pop("mug")
    assert scene.objects["cup"].to_data() == content and list(scene.objects) == ["table", "cup"]
    assert scene.objects.pop("mug", None) is None
    with pytest.raises(sf.UnknownNameError, match="has no object `mug`"):
        scene.objects.pop("mug")
    name, table = scene.objects.popitem()
    table.mass = 3.0
    assert name == "table" and table.fixed and list(scene.objects) == ["cup"]


# -- copies --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_a_copy_of_a_document_is_edited_on_its_own(
    scene: sf.SceneDocument, duplicate: Callable[[sf.SceneDocument], sf.SceneDocument]
) -> None:
    scene.objects["mug"].mass = 0.5
    other = duplicate(scene)
    assert other.text == scene.text and other.changes == scene.changes
    other.objects["mug"].mass = 0.7
    other.relations.clear()
    scene.objects["mug"].friction = 0.3
    assert (scene.objects["mug"].mass, other.objects["mug"].mass) == (0.5, 0.7)
    assert other.objects["mug"].friction is None and len(scene.relations) == 1


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_entries_can_be_copied(scene: sf.SceneDocument, duplicate: Callable[[object], object]) -> None:
    for entry in (scene.objects["mug"], scene.objects["mug"].pose, scene.objects, scene.relations):
        assert repr(duplicate(entry)) == repr(entry)


def test_a_copy_of_an_imported_document_keeps_its_meshes(scene: sf.SceneDocument, tmp_path: Path) -> None:
    scene.objects["mug"].shape = {"lathe": {"profile": [[0, 0], [0.03, 0], [0.04, 0.1], [0.02, 0.12], [0, 0.12]]}}
    imported = copy.copy(sf.load(scene.compile("mujoco", out=tmp_path / "build").entries["mujoco"]))
    assert imported._files()
    assert not [d for d in imported.check(lints=False) if d.severity == "error"]


def test_lowered_scenes_and_states_can_be_pickled(scene: sf.SceneDocument) -> None:
    lowered = scene.lower()
    state = SceneState.initial(lowered)
    other, other_state = pickle.loads(pickle.dumps((lowered, state)))
    assert compile_scene(other, "mjcf").files == compile_scene(lowered, "mjcf").files
    assert other_state.joints == state.joints and np.array_equal(other_state.poses["mug"].p, state.poses["mug"].p)
    with pytest.raises(TypeError):
        other_state.joints["a"] = 1.0


# -- what is refused -----------------------------------------------------------------------------------------------


REFUSED = [
    (lambda s: s.objects["mug"].update(place=None, pose={"xyz": [0, 0, "x"]}), sf.SpecError, "expected a number"),
    (lambda s: s.objects.update(cup={"shape": {"sphere": 1}}, b={"shape": {"sphere": -1}}), sf.SpecError, "SF104"),
    (lambda s: s.objects["mug"].update(mass=1, mas=2), sf.UnknownNameError, "no field `mas`"),
    (lambda s: s.update({5: 1}), sf.UnknownNameError, "no field `5`"),
    (
        lambda s: setattr(s, "extends", "a.scene.yaml"),
        AttributeError,
        "`extends` cannot be changed in Python; edit it in",
    ),
    (lambda s: setattr(s, "simfoundry", "x"), AttributeError, "`simfoundry` cannot be changed"),
    (lambda s: s.update(extends="a.scene.yaml"), sf.UnknownNameError, "`extends` cannot be changed"),
    (
        lambda s: setattr(s, "objcts", {}),
        AttributeError,
        "desk.scene.yaml has no field `objcts`; did you mean `objects`?",
    ),
    (lambda s: setattr(s, "save", 5), AttributeError, "desk.scene.yaml has no field `save`"),
    (lambda s: s.objcts, AttributeError, "desk.scene.yaml has no field `objcts`"),
    (lambda s: s.objects.add("Cup", shape={"sphere": 1}), sf.SpecError, "`Cup` is not a name"),
    (lambda s: s.objects.add("", shape={"sphere": 1}), sf.SpecError, "is not a name"),
    (lambda s: s.objects.add(5, shape={"sphere": 1}), sf.SpecError, "`5` is not a name"),
    (lambda s: setattr(s, "objects", {"Cup": {"shape": {"sphere": 1}}}), sf.SpecError, "`Cup` is not a name"),
    (lambda s: s.objects.rename("mug", "Cup"), sf.SpecError, "`Cup` is not a name"),
    (lambda s: s.objects.rename("mug", 5), sf.SpecError, "`5` is not a name"),
    (lambda s: s.objects[5], sf.UnknownNameError, "has no object `5`"),
    (lambda s: s.relations.append("bogus("), sf.SpecError, "SF202 `bogus(` is not of the form"),
    (lambda s: s.relations.append("OnTip(mug, table)"), sf.SpecError, "`OnTip` is not a predicate"),
    (lambda s: s.relations.append(5), sf.SpecError, "found `5`"),
    (lambda s: setattr(s, "relations", "OnTop(mug, table)"), sf.SpecError, "expected a list"),
    (lambda s: setattr(s.objects["mug"], "mass", object()), sf.SimfoundryError, "cannot be written to a document"),
    (lambda s: setattr(s.objects["mug"], "mass", float("nan")), sf.SpecError, "SF104"),
]


@pytest.mark.parametrize(("edit", "kind", "message"), REFUSED)
def test_a_refused_edit_of_a_scene_changes_nothing(
    scene: sf.SceneDocument, edit: Callable[[sf.SceneDocument], object], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind) as caught:
        edit(scene)
    assert message in str(caught.value)
    assert scene.text == TEXT and scene.changes == []


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: setattr(t, "goal", "foo("), "`foo(` is not of the form"),
        (
            lambda t: setattr(t, "goal", {"all": ["Upright(mug)", {"not": "Uprigt(mug)"}]}),
            "`Uprigt` is not a predicate",
        ),
        (lambda t: setattr(t.subtasks["first"], "goal", "foo"), "`foo` is not of the form"),
        (lambda t: t.subtasks.add("second", goal="Upright(mug, mug)"), "`Upright` takes 1 argument"),
        (lambda t: t.subtasks.add("goal", goal="foo"), "`foo` is not of the form"),
        (lambda t: setattr(t, "horizon", 5.5), "expected an integer"),
    ],
)
def test_a_refused_edit_of_a_task_changes_nothing(
    task: sf.TaskDocument, edit: Callable[[sf.TaskDocument], object], message: str
) -> None:
    with pytest.raises(sf.SpecError) as caught:
        edit(task)
    assert message in str(caught.value)
    assert task.text == TASK and task.changes == []


def test_names_that_are_not_strings_are_not_in_a_section(scene: sf.SceneDocument) -> None:
    assert 5 not in scene.objects  # type: ignore[comparison-overlap]
    assert scene.objects.get(5) is None  # type: ignore[call-overload]


def test_what_depends_on_the_rest_of_the_document_waits_for_the_check(scene: sf.SceneDocument) -> None:
    scene.relations.append("OnTop(cup, table)")
    assert [d.code for d in scene.check(lints=False)] == ["SF201"]
    scene.objects.add("cup", shape={"sphere": 0.03}, mass=0.1, place={"on": "table", "xy": [0.2, 0]})
    assert not scene.check(lints=False)


def test_a_refused_edit_reports_only_its_own_errors(scene: sf.SceneDocument) -> None:
    scene.objects["mug"].update(mass=0.2, density=500.0)
    with pytest.raises(sf.SpecError) as caught:
        scene.objects["table"].friction = -1
    assert [d.path for d in caught.value.diagnostics] == ["objects.table.friction"]


def test_several_members_can_be_set_at_once(scene: sf.SceneDocument) -> None:
    cup = {"shape": {"sphere": 0.03}, "mass": 0.1}
    scene.objects.update({"cup": cup}, mug=scene.objects["table"])
    scene.objects.update([("bowl", cup)])
    assert list(scene.objects) == ["table", "mug", "cup", "bowl"] and scene.objects["mug"].fixed


def test_relations_can_be_assigned(scene: sf.SceneDocument) -> None:
    scene.relations = [*scene.relations, "Upright(mug)"]
    scene.relations = scene.relations
    assert scene.relations == ["OnTop(mug, table)", "Upright(mug)"]
    scene.relations = []
    assert "relations" not in scene.text


def test_the_document_that_is_extended_can_be_read(scene: sf.SceneDocument) -> None:
    path = scene.path.with_name("b.scene.yaml")
    path.write_text("simfoundry: scene/1\nextends: desk.scene.yaml\nname: b\n")
    assert scene.extends is None and sf.load(path).extends == "desk.scene.yaml"
    assert scene.simfoundry == "scene/1" and scene.conflicts == {}
