"""Trying a scene in a real browser: physics, policies and cousins, none of which change the text by themselves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from simfoundry.studio.trial.physics import PhysicsTrial
from simfoundry.studio.trial.rollouts import RolloutTrial
from simfoundry.studio.view.panels.cousins import CousinsPanel
from tests.studio.browser import StudioPage
from tests.studio.conftest import SCENE, OpenStudio
from tests.studio.test_rollouts import POLICY, TASK

pytestmark = pytest.mark.slow


def height(studio: StudioPage, name: str) -> float:
    """Return the height at which an object is shown [m]."""
    return float(studio.server.window.canvas.nodes[f"/objects/{name}"].X_PN.p[2])


def test_physics_plays_and_only_settling_changes_the_text(desk: Path, open_studio: OpenStudio) -> None:
    lifted = SCENE.replace("0.0201]", "0.3]")
    desk.write_text(lifted)
    studio = open_studio(desk)
    studio.tab("Try")
    studio.press("Play")
    studio.until(lambda: isinstance(studio.server.window.stage.trial, PhysicsTrial), "physics")
    studio.until(lambda: height(studio, "ball") < 0.03, "the fall of the ball")
    assert studio.text == lifted and not studio.server.session.is_modified
    assert not studio.server.window.is_editable
    studio.press("Reset")
    studio.until(lambda: height(studio, "ball") == pytest.approx(0.3), "the reset")
    studio.press("Settle and keep")
    studio.until(lambda: studio.text != lifted, "the edit")
    (line,) = [line for line in studio.text.splitlines() if line not in lifted.splitlines()]
    assert line.startswith("    pose: {xyz: [$gap, -0.2, 0.0"), line
    assert studio.server.session.undo_label == "settle and keep"
    studio.until(lambda: studio.server.window.stage.trial is None and studio.server.window.is_editable)
    assert studio.file_text == lifted
    studio.press("Undo")
    studio.until(lambda: studio.text == lifted, "undoing")
    studio.until(lambda: height(studio, "ball") == pytest.approx(0.3), "the document's pose")
    assert studio.problems == []


def test_a_policy_is_watched_and_a_hanging_one_is_stopped(desk: Path, open_studio: OpenStudio) -> None:
    from simfoundry.studio.server import StudioServer

    robots = "robots: {arm: {model: demo_arm, pose: {xyz: [-0.5, 0.3, 0]}}}\n\n"
    desk.write_text(SCENE.replace("cameras:", f"{robots}cameras:"))
    desk.with_name("policies.py").write_text(POLICY)
    task = desk.with_name("wave.task.yaml")
    task.write_text(TASK)
    policy = f"python:{desk.with_name('policies.py')}:Hang"
    with StudioServer(task, port=0, policies=(policy,)) as server:
        studio = open_studio(server)
        studio.tab("Try")
        studio.press("Run")
        studio.until(lambda: isinstance(server.window.stage.trial, RolloutTrial), "the rollout")
        trial = server.window.stage.trial
        assert isinstance(trial, RolloutTrial)
        studio.until(lambda: trial.playback.count >= 6, "the first states")
        studio.page.get_by_text("running").first.wait_for()
        arm = [name for name in server.window.canvas.nodes if name.startswith("/robots/arm/")]
        assert arm and trial.is_running
        studio.press("Stop")
        studio.until(lambda: not trial.is_running, "the stop")
        studio.page.get_by_text("Stopped.").first.wait_for()
        trial.playback.seek(0.2)
        first = server.window.shown_state
        trial.playback.seek(0.0)
        assert first is not None and server.window.shown_state is not first
        studio.press("Close")
        studio.until(lambda: server.window.stage.trial is None)
        assert studio.text == TASK and not server.session.is_modified


def test_cousins_are_reviewed(desk: Path, open_studio: OpenStudio) -> None:
    folder = desk.parent / "build" / "cousins"
    folder.mkdir(parents=True)
    cousins = []
    for index, x in ((1, 0.3), (2, 0.4)):
        text = f"simfoundry: scene/1\nname: c{index}\nextends: ../../desk.scene.yaml\n"
        text += f"objects: {{mug: {{place: {{on: desk, xy: [{x}, 0]}}}}}}\n"
        (folder / f"{index:06d}.scene.yaml").write_text(text)
        cousins.append({"index": index, "files": {"scene": f"{index:06d}.scene.yaml"}, "asked": ["OnTop(mug, desk)"]})
    (folder / "manifest.json").write_text(json.dumps({"simfoundry": "cousins-run/1", "cousins": cousins}))
    studio = open_studio(desk)
    nodes = studio.server.window.canvas
    studio.tab("Try")
    studio.page.get_by_text("Cousins", exact=True).click()
    studio.until(lambda: "build/cousins" in studio.server.window.panel(CousinsPanel)._folders.list.options, "the run")
    studio.choose("Cousin run", "build/cousins")
    studio.until(lambda: nodes.nodes["/objects/mug"].X_PN.p[0] == pytest.approx(0.3), "the first cousin")
    studio.press("Reject")  # without a reason
    studio.page.get_by_text("a rejection needs a reason").first.wait_for()
    studio.enter("Reason", "the mug hides the tray")
    studio.page.keyboard.press("Tab")
    studio.until(lambda: not (folder / "review.json").exists())
    studio.press("Reject")
    studio.until((folder / "review.json").exists, "the review")
    assert json.loads((folder / "review.json").read_text())["cousins"] == {
        "1": {"verdict": "rejected", "reason": "the mug hides the tray"}
    }
    studio.until(lambda: nodes.nodes["/objects/mug"].X_PN.p[0] == pytest.approx(0.4), "the next cousin")
    studio.press("Play")  # physics of the cousin, which ends at its own poses
    studio.until(lambda: isinstance(studio.server.window.stage.trial, PhysicsTrial), "physics")
    trial = studio.server.window.stage.trial
    assert isinstance(trial, PhysicsTrial)
    studio.until(lambda: trial.elapsed > 0.2, "physics of the cousin")
    assert nodes.nodes["/objects/mug"].X_PN.p[0] == pytest.approx(0.4, abs=1e-3)
    studio.press("Settle and keep")
    studio.page.get_by_text("cannot be kept in the document").first.wait_for()
    studio.press("Back to the document")
    studio.until(lambda: nodes.nodes["/objects/mug"].X_PN.p[0] == pytest.approx(0.2), "the document")
    assert studio.text == SCENE == studio.file_text


def test_a_click_pokes_an_object_and_a_handle_pulls_it(desk: Path, open_studio: OpenStudio) -> None:
    studio = open_studio(desk)
    window, nodes = studio.server.window, studio.server.window.canvas

    def shown(name: str) -> list[float]:
        place: list[float] = nodes.nodes[f"/objects/{name}"].X_PN.p.tolist()
        return place

    studio.tab("Try")
    studio.press("Play")
    studio.until(lambda: isinstance(window.stage.trial, PhysicsTrial), "physics")
    trial = window.stage.trial
    assert isinstance(trial, PhysicsTrial)
    studio.until(lambda: trial.elapsed > 0.1, "physics to run")
    away = next(np.array(client.camera.position) for client in studio.server.viser.get_clients().values())
    start = shown("mug")
    studio.page.mouse.click(*studio.screen_point((start[0], start[1], start[2])))
    studio.until(lambda: np.linalg.norm(np.subtract(shown("mug"), start)) > 0.003, "the mug to be poked")
    moved = np.subtract(shown("mug"), start)[:2]
    assert moved @ (np.array(start) - away)[:2] > 0  # along the line of sight, away from the eye
    studio.until(lambda: window.selected_object == window.pull._name == "mug", "the handle")
    studio.page.wait_for_timeout(1000)
    start = shown("mug")
    tip = studio.screen_point((start[0] + 0.1, start[1], start[2]))  # on the red arrow
    end = studio.screen_point((start[0] - 0.1, start[1], start[2]))
    studio.drag(tip, end, steps=30, release=False)
    studio.until(lambda: shown("mug")[0] < start[0] - 0.05, "the mug to follow")
    studio.page.mouse.up()
    studio.until(lambda: window.pull._target is None, "the handle to be let go")
    assert studio.text == SCENE == studio.file_text and not studio.server.session.is_modified
    assert studio.problems == []
