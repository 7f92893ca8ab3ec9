"""Moving objects: what is written, and what stays as it was written."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.studio.acts.carry import carried_objects
from simfoundry.studio.acts.move import MoveObject, Snap
from simfoundry.studio.session import StudioSession
from tests.studio.conftest import SCENE, TASK
from tests.studio.test_session import changed_lines


def move(desk: Path, text: str, act: MoveObject) -> list[str]:
    """Return the new lines after a move in a scene."""
    desk.write_text(text)
    session = StudioSession(desk)
    session.apply(act)
    after = session.text
    session.undo()
    assert session.text == text
    return [new for _, new in changed_lines(text, after)]


def test_a_place_stays_a_place_and_drops_onto_its_support(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("mug", Pose.of((0.31234, -0.2, 0.4))))
    assert line == "place: {on: desk, xy: [0.3123, -0.2]}"


def test_an_overlapping_object_is_lifted(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("mug", Pose.of((0.3, -0.2, 0.01))))
    assert line == "place: {on: desk, xy: [0.3, -0.2]}"


def test_what_is_dropped_into_a_container_is_inside_of_it(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("mug", Pose.of((-0.25, -0.1, 0.3))))
    assert line == "place: {inside: tray, xy: [-0.25, -0.1]}"


def test_a_pose_stays_a_pose_and_keeps_its_expressions(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("ball", Pose.of((0.12, 0.2, 0.5))))
    assert line == "pose: {xyz: [$gap, 0.2, 0.0201]}"


def test_without_a_drop_the_object_stays_in_the_air(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("mug", Pose.of((0.3, 0.1, 0.5)), drop=False))
    assert line == "pose: {xyz: [0.3, 0.1, 0.5]}"


def test_a_comment_beside_a_place_stays_beside_the_pose(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("tray", Pose.of((0.3, 0.1, 0.5)), drop=False))
    assert line == "pose: {xyz: [0.3, 0.1, 0.5]}  # near the wall"


def test_off_the_desk_there_is_nothing_to_fall_onto(desk: Path) -> None:
    (line,) = move(desk, SCENE, MoveObject("ball", Pose.of((2.0, 0.0, 0.5))))
    assert line == "pose: {xyz: [2, 0, 0.5]}"


def test_a_turn_about_z_is_a_yaw(desk: Path) -> None:
    turned = Pose.of((0.2, 0.1, 0.0502), quat_from_rpy(0, 0, math.radians(30)))
    (line,) = move(desk, SCENE, MoveObject("tray", Pose.of((-0.25, -0.1, 0.0252), turned.q)))
    assert line == "place: {on: desk, xy: [-0.25, -0.1], yaw_deg: 30}  # near the wall"


def test_a_tilted_object_rests_on_its_side(desk: Path) -> None:
    lying = Pose.of((0.2, 0.1, 0.3), quat_from_rpy(math.radians(90), 0, 0))
    (line,) = move(desk, SCENE, MoveObject("mug", lying))
    assert line == "place: {on: desk, xy: [0.2, 0.1], rpy_deg: [90, 0, 0]}"


def test_moves_snap_to_a_grid_and_to_angles(desk: Path) -> None:
    near = Pose.of((0.207, 0.113, 0.2), quat_from_rpy(0, 0, math.radians(28)))
    (line,) = move(desk, SCENE, MoveObject("mug", near, snap=Snap(0.05, 15)))
    assert line == "place: {on: desk, xy: [0.2, 0.1], yaw_deg: 30}"


def test_a_moved_support_carries_what_stands_on_it(desk: Path) -> None:
    text = SCENE.replace("place: {on: desk, xy: [0.2, 0.1]}", "place: {inside: tray}")
    lines = move(desk, text, MoveObject("tray", Pose.of((0.25, 0.1, 0.0252))))
    assert lines == ["place: {on: desk, xy: [0.25, 0.1]}  # near the wall"]  # the mug follows by itself
    text = SCENE.replace("place: {on: desk, xy: [0.2, 0.1]}", "place: {inside: tray, xy: [-0.3, -0.1]}")
    lines = move(desk, text, MoveObject("tray", Pose.of((0.25, 0.1, 0.0252))))
    assert lines == ["place: {inside: tray, xy: [0.2, 0.1]}", "place: {on: desk, xy: [0.25, 0.1]}  # near the wall"]
    desk.write_text(text)
    session = StudioSession(desk)
    assert session.scene is not None
    session.apply(MoveObject("desk", Pose.of((0.5, 0, -0.02), quat_from_rpy(0, 0, math.radians(90)))))
    assert "place: {inside: tray, xy: [0.6, -0.3], yaw_deg: 90}" in session.text
    assert "pose: {xyz: [0.7, 0.12, 0.0201], yaw_deg: 90}" in session.text  # the ball


LEANING = """\
  box:
    shape: {box: [0.1, 0.2, 0.2]}
    mass: 0.2
    place: {on: desk, xy: [0.3, 0.25]}
  book:  # its upper edge touches the side of the box
    shape: {box: [0.02, 0.15, 0.2]}
    mass: 0.2
    pose: {xyz: [0.1956, 0.25, 0.0937], rpy_deg: [0, 27, 0]}
  ruler:  # lies across the edge of the tray, and its end is on the desk
    shape: {box: [0.3, 0.02, 0.004]}
    mass: 0.2
    pose: {xyz: [-0.0574, -0.1, 0.0409], rpy_deg: [0, 15, 0]}
  can:  # stands beside the box and touches it
    shape: {cylinder: {radius: 0.03, height: 0.1}}
    mass: 0.2
    place: {on: desk, xy: [0.38, 0.25]}
"""


def test_what_leans_on_a_moved_object_moves_with_it(desk: Path) -> None:
    text = SCENE.replace("\ncameras:", f"{LEANING}\ncameras:")
    desk.write_text(text)
    session = StudioSession(desk)
    assert session.scene is not None
    assert set(carried_objects(session.scene, "box")) == {"book"}
    assert set(carried_objects(session.scene, "tray")) == {"ruler"}
    assert set(carried_objects(session.scene, "can")) == set(carried_objects(session.scene, "book")) == set()
    session.apply(MoveObject("box", Pose.of((0.3, -0.2, 0.1))))
    assert "place: {on: desk, xy: [0.3, -0.2]}" in session.text
    assert "pose: {xyz: [0.1956, -0.2, 0.0937], rpy_deg: [0, 27, 0]}" in session.text
    session.apply(MoveObject("book", Pose.of((0.0, 0.3, 0.2), quat_from_rpy(0, math.radians(27), 0))))
    assert "place: {on: desk, xy: [0.3, -0.2]}" in session.text  # the box does not lean on the book
    assert session.undo() and session.undo() and session.text == text


def test_what_is_inside_moves_along_even_if_it_stands_on_something_else(desk: Path) -> None:
    text = SCENE.replace("place: {on: desk, xy: [0.2, 0.1]}", "pose: {xyz: [-0.25, -0.1, 0.2]}")  # above the tray
    lifted = text.replace("xyz: [-0.25, -0.1, 0.2]", "xyz: [-0.25, -0.1, 0.062]")  # 2 mm above its floor
    for scene, lines in ((text, 1), (lifted, 2)):
        assert len(move(desk, scene, MoveObject("tray", Pose.of((0.25, 0.1, 0.0252))))) == lines


@pytest.mark.parametrize(
    ("to", "place"),
    [
        ((-0.25, 0.2, 0.1), "{on: desk, left_of: tray, gap: 0.16}"),
        ((-0.2, 0.2, 0.1), "{on: desk, left_of: tray, offset: [0.05, 0.13]}"),
        ((-0.25, -0.35, 0.1), "{on: desk, xy: [-0.25, -0.35]}"),  # no longer to its left
    ],
)
def test_a_relation_is_kept_while_it_holds(desk: Path, to: tuple[float, float, float], place: str) -> None:
    text = SCENE.replace("place: {on: desk, xy: [0.2, 0.1]}", "place: {on: desk, left_of: tray}")
    (line,) = move(desk, text, MoveObject("mug", Pose.of(to)))
    assert line == f"place: {place}"


def test_a_local_position_stays_local(desk: Path) -> None:
    text = SCENE.replace("place: {on: desk, xy: [0.2, 0.1]}", "place: {inside: tray, local_xy: [0.05, 0]}")
    (line,) = move(desk, text, MoveObject("mug", Pose.of((-0.27, -0.12, 0.1))))
    assert line == "place: {inside: tray, local_xy: [-0.02, -0.02]}"


def test_a_pose_in_a_frame_stays_in_its_frame(desk: Path) -> None:
    text = SCENE.replace(
        "pose: {xyz: [$gap, -0.2, 0.0201]}", "pose: {frame: tray, xyz: [0.3, 0, -0.0049], quat_wxyz: [1, 0, 0, 0]}"
    )
    turned = Pose.of((0.1, -0.2, 0.3), quat_from_rpy(0, 0, math.radians(90)))
    (line,) = move(desk, text, MoveObject("ball", turned))
    assert line == "pose: {frame: tray, xyz: [0.35, -0.1, -0.005], quat_wxyz: [0.707107, 0, 0, 0.707107]}"


def test_one_copy_of_a_repeated_object_moves_alone(desk: Path) -> None:
    text = SCENE.replace("    mass: 0.05\n", "    mass: 0.05\n    repeat: {count: 3, step: 0.1}\n")
    desk.write_text(text)
    session = StudioSession(desk)
    session.apply(MoveObject("ball_2", Pose.of((0.3, 0.3, 0.3))))
    assert session.scene is not None
    assert session.scene.objects["ball_2"].X_WO.p == pytest.approx([0.3, 0.3, 0.0201], abs=1e-4)
    assert session.scene.objects["ball_3"].X_WO.p == pytest.approx([0.32, -0.2, 0.0201], abs=1e-4)
    session.undo()
    assert session.text == text


def test_what_the_task_places_is_moved_in_the_task(task: Path) -> None:
    text = TASK + "start: {place: {mug: {on: desk, xy: [0.1, 0.1]}}}\n"
    task.write_text(text)
    session = StudioSession(task)
    session.apply(MoveObject("mug", Pose.of((0.2, 0.25, 0.4))))
    session.apply(MoveObject("ball", Pose.of((0.12, 0.3, 0.4))))
    assert "start: {place: {mug: {on: desk, xy: [0.2, 0.25]}}}" in session.text
    assert "xyz: [$gap, 0.3, 0.0201]" in session.texts[task.with_name("desk.scene.yaml").resolve()]
    session.apply(MoveObject("mug", Pose.of((0.2, 0.25, 0.4)), drop=False))
    assert "start: {pose: {mug: {xyz: [0.2, 0.25, 0.4]}}}" in session.text
