"""Keeping a state: what physics reached becomes one edit of the text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.state import SceneState
from simfoundry.studio.acts.act import ActError
from simfoundry.studio.acts.keep import SUNK_M, KeepState
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.session import StudioSession
from tests.studio.conftest import SCENE, TASK
from tests.studio.test_session import changed_lines


def state_with(session: StudioSession, poses: dict[str, Pose]) -> SceneState:
    """Return the initial state of a session's scene, with other poses of some objects."""
    scene = session.scene
    assert scene is not None
    return SceneState.of({**scene.start.poses, **poses}, scene.start.joints, scene.start.motions)


def test_moved_objects_are_written_as_they_were(desk: Path) -> None:
    session = StudioSession(desk)
    poses = {"mug": Pose.of((0.23, 0.1, 0.05)), "ball": Pose.of((0.3, -0.2, 0.0199))}
    session.apply(KeepState(state_with(session, poses)))
    assert changed_lines(SCENE, session.text) == [
        ("place: {on: desk, xy: [0.2, 0.1]}", "place: {on: desk, xy: [0.23, 0.1]}"),
        ("pose: {xyz: [$gap, -0.2, 0.0201]}", "pose: {xyz: [0.3, -0.2, 0.0199]}"),
    ]
    assert session.undo() == "settle and keep" and session.text == SCENE


def test_what_only_sinks_into_its_contacts_stays_as_it_is(desk: Path) -> None:
    session = StudioSession(desk)
    assert session.scene is not None
    sunk = np.array([0.0, 0.0, -0.9 * SUNK_M])
    poses = {name: Pose.of(pose.p + sunk, pose.q) for name, pose in session.scene.start.poses.items()}
    session.apply(KeepState(state_with(session, poses)))
    assert session.text == SCENE and session.history.labels == ()


def test_a_mug_that_fell_over_gets_its_rotation(desk: Path) -> None:
    session = StudioSession(desk)
    lying = Pose.of((0.2, 0.1, 0.04), quat_from_rpy(np.pi / 2, 0.0, 0.0))
    session.apply(KeepState(state_with(session, {"mug": lying})))
    (pair,) = changed_lines(SCENE, session.text)
    assert pair[1] == "place: {on: desk, xy: [0.2, 0.1], rpy_deg: [90, 0, 0]}"
    assert session.scene is not None and session.scene.objects["mug"].X_WO.p == pytest.approx(lying.p, abs=1e-3)


def test_objects_that_moved_together_stand_on_each_other(desk: Path) -> None:
    session = StudioSession(desk)
    poses = {"tray": Pose.of((-0.2, -0.1, 0.025)), "ball": Pose.of((-0.2, -0.1, 0.03))}
    session.apply(KeepState(state_with(session, poses)))
    assert "place: {on: desk, xy: [-0.2, -0.1]}  # near the wall" in session.text
    assert "pose: {xyz: [-0.2, -0.1, 0.03]}" in session.text


def test_in_a_task_the_start_is_written(task: Path) -> None:
    started = TASK + "start: {place: {mug: {on: desk, xy: [0.1, 0.2]}}}\n"
    task.write_text(started)
    session = StudioSession(task)
    session.apply(KeepState(state_with(session, {"mug": Pose.of((0.15, 0.2, 0.05))})))
    assert session.text == started.replace("[0.1, 0.2]}}}", "[0.15, 0.2]}}}")
    assert not any(session.texts[path] != text for path, text in session.file_texts.items() if path != session.path)


def test_a_state_of_other_objects_is_refused(desk: Path) -> None:
    session = StudioSession(desk)
    state = state_with(session, {})
    session.apply(RenameSymbol("mug", "beaker"))
    with pytest.raises(ActError, match="start it again"):
        session.apply(KeepState(state))
