"""Acts other than moves: what each writes, and that undoing it restores every byte."""

from __future__ import annotations

import difflib
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.studio.acts.act import Act, ActError
from simfoundry.studio.acts.add import AddObject
from simfoundry.studio.acts.cameras import AddCamera, MoveCamera, RemoveCamera
from simfoundry.studio.acts.conditions import AddGoal, AddRelation, RemoveGoal, RemoveRelation
from simfoundry.studio.acts.duplicate import DuplicateObject
from simfoundry.studio.acts.joints import SetJoint
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.acts.regions import RemoveRegion, SetRegion
from simfoundry.studio.acts.remove import RemoveObject
from simfoundry.studio.acts.resize import ResizeObject
from simfoundry.studio.session import StudioSession
from tests.conftest import REPOSITORY
from tests.studio.conftest import SCENE, TASK


def changes(path: Path, act: Act, file: str = "") -> list[str]:
    """Return the removed and added lines of an act, in one document, after checking that it can be undone."""
    session = StudioSession(path)
    before = dict(session.texts)
    session.apply(act)
    shown = (path.with_name(file) if file else path).resolve()
    lines = list(difflib.ndiff(before.get(shown, "").splitlines(), session.texts[shown].splitlines()))
    session.undo()
    assert dict(session.texts) == before
    return [f"{line[0]}{line[2:].strip()}" for line in lines if line[0] in "+-"]


@pytest.fixture
def cabinet(desk: Path) -> Path:
    """A scene with a cabinet that has a drawer and a door."""
    shutil.copy(REPOSITORY / "specs/assets/cabinet.asset.yaml", desk.parent)
    desk.write_text(
        SCENE.replace(
            "cameras:", "  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [0.3, -0.9, 0]}}\n\ncameras:"
        )
    )
    return desk


def test_a_joint_is_moved_within_its_limits(cabinet: Path) -> None:
    session = StudioSession(cabinet)
    assert session.scene is not None
    joints = {j.name: j for j in session.scene.objects["cabinet"].joints if j.has_axis}
    name, joint = next((n, j) for n, j in joints.items() if j.type == "prismatic")
    (_, new) = changes(cabinet, SetJoint("cabinet", name, 0.1))
    assert new.endswith(f"pose: {{xyz: [0.3, -0.9, 0]}}, joints: {{{name}: 0.1}}}}")
    assert joint.limits is not None
    (_, new) = changes(cabinet, SetJoint("cabinet", name, 5.0))
    assert f"{{{name}: {round(joint.limits[1], 4):g}}}" in new
    with pytest.raises(ActError, match=f"no joint `hinge`.*{name}"):
        changes(cabinet, SetJoint("cabinet", "hinge", 0.1))


@pytest.mark.parametrize(
    ("written", "expected"), [("{lid: {deg: 10}}", "{lid: {deg: 30}}"), ("{lid: 0.1}", "{lid: 0.5236}")]
)
def test_a_rotation_keeps_its_unit(desk: Path, written: str, expected: str) -> None:
    (desk.parent / "box.asset.yaml").write_text(
        "simfoundry: asset/1\nname: box\nlinks:\n  base: {mass: 1, parts: {a: {shape: {box: [0.2, 0.2, 0.1]}}}}\n"
        "  lid: {mass: 0.1, parts: {a: {shape: {box: [0.2, 0.2, 0.01]}}}}\njoints:\n"
        "  lid: {type: revolute, parent: base, child: lid, axis: [0, 1, 0], limits_deg: [0, 90]}\n"
    )
    entry = (
        f"  chest: {{asset: box.asset.yaml, fixed: true, pose: {{xyz: [0, 0.9, 0]}}, joints: {written}}}\n\ncameras:"
    )
    desk.write_text(SCENE.replace("cameras:", entry))
    lines = changes(desk, SetJoint("chest", "lid", math.radians(30)))
    assert lines[1].endswith(f"joints: {expected}}}")


# -- objects -----------------------------------------------------------------------------------------------------------


def test_a_new_object_gets_a_free_place_on_the_largest_support(desk: Path) -> None:
    act = AddObject("cup", {"shape": {"cylinder": {"radius": 0.04, "height": 0.1}}})
    assert changes(desk, act) == [
        "+cup:", "+shape: {cylinder: {radius: 0.04, height: 0.1}}", "+mass: 0.2", "+place: {on: desk, xy: [0, 0]}"
    ]  # fmt: skip
    session = StudioSession(desk)
    for k in range(12):
        session.apply(AddObject(f"cup_{k}", {"shape": {"box": (0.1, 0.1, 0.1)}, "material": "wood"}))
    session.examine()
    assert [d for d in session.findings if d.code == "SF405"] == []  # no overlaps
    assert session.findings == ()


def test_an_asset_is_added_inside_of_the_project_only(desk: Path) -> None:
    shutil.copy(REPOSITORY / "specs/assets/mug.asset.yaml", desk.parent)
    (desk.parent / "meshes").mkdir(exist_ok=True)
    lines = changes(desk, AddObject("cup", {"asset": "mug.asset.yaml"}, "tray", (-0.25, -0.1)))
    assert lines == ["+cup:", "+asset: mug.asset.yaml", "+place: {on: tray, xy: [-0.25, -0.1]}"]
    for reference in ("../mug.asset.yaml", "/etc/passwd", "nothing.glb"):
        with pytest.raises(ActError):
            changes(desk, AddObject("cup", {"asset": reference}))


@pytest.mark.parametrize(
    ("name", "fields", "reason"),
    [
        ("mug", {"shape": {"sphere": 0.1}}, "already exists"),
        ("Mug", {"shape": {"sphere": 0.1}}, "name"),
        ("null", {"shape": {"sphere": 0.1}}, "YAML reads `null` as a value, not as a name"),
        ("true", {"shape": {"sphere": 0.1}}, "YAML reads `true` as a value, not as a name"),
        ("1", {"shape": {"sphere": 0.1}}, "`1` cannot be the name of a new object"),
        ("m" * 65, {"shape": {"sphere": 0.1}}, "at most 64 characters"),
        ("cup", {"shape": {"sphere": -0.1}}, "greater than 0"),
        ("cup", {"shape": {"cube": 1}}, "cube"),
        ("cup", {}, "one of `shape`, `asset` is needed"),
    ],
)
def test_an_object_that_is_not_valid_is_not_added(
    desk: Path, name: str, fields: dict[str, object], reason: str
) -> None:
    session = StudioSession(desk)
    with pytest.raises(ActError, match=reason):
        session.apply(AddObject(name, fields))
    assert session.text == SCENE


def test_one_duplicate_is_an_entry_and_several_are_a_repeat_where_it_fits(desk: Path) -> None:
    assert changes(desk, DuplicateObject("ball")) == [
        "+ball_2:", "+shape: {sphere: 0.02}", "+mass: 0.05", "+pose: {xyz: [$gap, -0.14, 0.0201]}"
    ]  # fmt: skip
    assert changes(desk, DuplicateObject("ball", 3)) == ["+repeat: {count: 4, step: [0, 0.06]}"]
    lines = changes(desk, DuplicateObject("mug", 2, (0.1, 0.0)))  # a relation names the mug
    assert [line for line in lines if "mug" in line or "place" in line] == [
        "+mug_2:", "+place: {on: desk, xy: [0.3, 0.1]}", "+mug_3:", "+place: {on: desk, xy: [0.4, 0.1]}"
    ]  # fmt: skip


def test_a_copy_of_a_row_becomes_one_more_copy(desk: Path) -> None:
    desk.write_text(SCENE.replace("    mass: 0.05\n", "    mass: 0.05\n    repeat: {count: 3, step: 0.1}  # a row\n"))
    assert changes(desk, DuplicateObject("ball_2", 2)) == [
        "-repeat: {count: 3, step: 0.1}  # a row", "+repeat: {count: 5, step: 0.1}  # a row"
    ]  # fmt: skip


def test_what_stood_on_a_removed_object_falls(desk: Path) -> None:
    text = SCENE.replace("place: {on: desk, xy: [0.2, 0.1]}", "place: {inside: tray}")
    desk.write_text(text)
    lines = changes(desk, RemoveObject("tray"))
    assert "-place: {inside: tray}" in lines and "+place: {on: desk, xy: [-0.25, -0.1]}" in lines
    assert "-- OnTop(tray, desk)" in lines and "-- OnTop(mug, desk)  # must stay" not in lines


def test_what_the_goal_needs_is_not_removed(task: Path) -> None:
    session = StudioSession(task)
    with pytest.raises(ActError, match="mug"):
        session.apply(RemoveObject("mug"))
    assert changes(task, RemoveObject("ball"), "desk.scene.yaml")[0] == "-ball:"


def test_a_copy_can_be_removed(desk: Path) -> None:
    text = SCENE.replace("    mass: 0.05\n", "    mass: 0.05\n    repeat: {count: 3, step: 0.1}\n")
    desk.write_text(text)
    session = StudioSession(desk)
    session.apply(RemoveObject("ball_2"))
    assert session.scene is not None and set(session.scene.objects) == {"desk", "mug", "tray", "ball_1", "ball_3"}


def test_an_inherited_object_is_overridden(desk: Path) -> None:
    over = desk.with_name("over.scene.yaml")
    over.write_text("simfoundry: scene/1\nextends: desk.scene.yaml\nname: over\n")
    assert changes(over, SetProperties("mug", {"mass": 0.4})) == ["+", "+objects:", "+mug:", "+mass: 0.4"]
    assert changes(over, RemoveObject("ball")) == ["+", "+objects:", "+ball: null"]


# -- relations, goals, regions, cameras --------------------------------------------------------------------------------


def test_relations_are_added_and_removed_with_the_others_as_they_were(desk: Path) -> None:
    assert changes(desk, AddRelation("RightOf(mug,tray)")) == ["+- RightOf(mug, tray)"]
    assert changes(desk, RemoveRelation("OnTop(tray, desk)")) == ["-- OnTop(tray, desk)"]
    for text, reason in (
        ("OnTop(mug, desk)", "already"),
        ("Near(mug)", "not a predicate"),
        ("OnTop(cup, desk)", "cup"),
    ):
        with pytest.raises(ActError, match=reason):
            changes(desk, AddRelation(text))


def test_the_goal_is_extended_and_shortened(task: Path) -> None:
    assert set(changes(task, AddGoal("Upright(mug)"))) == {
        "-goal: Inside(mug, tray)", "+goal:", "+all:", "+- Inside(mug, tray)", "+- Upright(mug)"
    }  # fmt: skip
    session = StudioSession(task)
    with pytest.raises(ActError, match="a task needs a goal"):
        session.apply(RemoveGoal("Inside(mug, tray)"))
    session.apply(AddGoal("Upright(mug)"))
    session.apply(AddGoal("Released(mug)"))
    session.apply(RemoveGoal("Upright(mug)"))
    session.apply(RemoveGoal("Released(mug)"))
    assert "goal: Inside(mug, tray)\n" in session.text


def test_goals_and_regions_need_a_task(desk: Path) -> None:
    for act in (AddGoal("Upright(mug)"), SetRegion("mug"), RemoveRegion("mug")):
        with pytest.raises(ActError, match="needs a task"):
            changes(desk, act)


def test_regions_are_set_and_removed(task: Path) -> None:
    assert changes(task, SetRegion("mug", x=(0.35, 0.12345))) == [
        "-mug: {x: [0.1, 0.3], y: [0.0, 0.2]}", "+mug: {x: [0.123, 0.35], y: [0.0, 0.2]}"
    ]  # fmt: skip
    assert changes(task, SetRegion("tray", yaw_deg=(-90, 90))) == [
        "+tray: {x: [-0.35, -0.15], y: [-0.2, 0], yaw_deg: [-90, 90]}"
    ]
    assert changes(task, RemoveRegion("mug"))[0] == "-reset:" and "reset:" in TASK


def test_a_moved_camera_keeps_looking_unless_it_is_turned(desk: Path) -> None:
    session = StudioSession(desk)
    assert session.scene is not None
    X_WC = session.scene.draft.cameras["front"].X_WC
    lines = changes(desk, MoveCamera("front", Pose.of(X_WC.p + np.array([0, 0.2, 0]), X_WC.q)))
    assert lines[1].endswith("pose: {xyz: [1.2, 0.2, 0.8], look_at: [0, 0, 0]}}")
    turned = X_WC @ Pose.of(q=quat_from_rpy(0, 0, 0.2))
    new = [line for line in changes(desk, MoveCamera("front", turned)) if line.startswith("+")]
    assert "quat_wxyz" in "".join(new) and "look_at" not in "".join(new)
    session.apply(MoveCamera("front", turned))
    assert session.scene.draft.cameras["front"].X_WC.angle_to(turned) < 1e-5


def test_cameras_are_added_and_removed(desk: Path) -> None:
    lines = changes(desk, AddCamera("side", Pose.of((0, 1, 0.5)), (0.0, 0.0, 0.05), 40.04))
    assert lines == ["+side: {size: [640, 480], fov_deg: 40, pose: {xyz: [0, 1, 0.5], look_at: [0, 0, 0.05]}}"]
    assert "-cameras:" in changes(desk, RemoveCamera("front"))
    with pytest.raises(ActError, match="no camera `left`"):
        changes(desk, RemoveCamera("left"))


@pytest.mark.parametrize(
    ("name", "lengths", "old", "new"),
    [
        ("mug", {"radius": 0.05, "height": 0.1}, "{radius: 0.04, height: 0.1}", "{radius: 0.05, height: 0.1}"),
        ("tray", {"x": 0.4, "y": 0.2, "z": 0.05, "wall": 0.01}, "size: [0.3, 0.2", "size: [0.4, 0.2"),
        ("tray", {"x": 0.3, "y": 0.2, "z": 0.05, "wall": 0.02}, "wall: 0.01", "wall: 0.02"),
        ("ball", {"radius": 0.03}, "sphere: 0.02", "sphere: 0.03"),
        ("desk", {"x": 1.2, "y": 0.8, "z": 0.06}, "box: [1.2, 0.8, 0.04]", "box: [1.2, 0.8, 0.06]"),
    ],
)
def test_a_shape_is_resized_upward(desk: Path, name: str, lengths: dict[str, float], old: str, new: str) -> None:
    session = StudioSession(desk)
    session.apply(ResizeObject(name, lengths))
    expected = SCENE.replace(old, new)
    expected = expected.replace("0.0201]", "0.0301]") if name == "ball" else expected
    expected = expected.replace("xyz: [0, 0, -0.02]", "xyz: [0, 0, -0.01]") if name == "desk" else expected
    assert session.text == expected
    session.undo()
    assert session.text == SCENE
    for wrong in ({"radius": -0.1}, {"depth": 1.0}, {}):
        with pytest.raises(ActError):
            session.apply(ResizeObject("ball", wrong))
    assert session.text == SCENE
