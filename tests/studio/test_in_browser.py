"""The studio in a real browser: each test acts as a person would, and asserts the text of the file."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from simfoundry.cli.main import app
from tests.studio.browser import StudioPage
from tests.studio.conftest import SCENE, OpenStudio

pytestmark = pytest.mark.slow


def main_of(*arguments: str) -> int:
    """Run a command and return its exit code."""
    return int(app(list(arguments), prog_name="simfoundry", standalone_mode=False) or 0)


def has_entry(studio: StudioPage, name: str) -> bool:
    """Return True if the text has an entry with a name."""
    return f"  {name}:" in studio.text


def _select(studio: StudioPage, name: str) -> None:
    studio.choose("Selected", name)
    studio.until(lambda: studio.server.window.selected_object == name)
    studio.until(lambda: "/objects/" + name + "/selection" in studio.server.window.canvas.nodes)


def _drag_gizmo(studio: StudioPage, name: str, by: tuple[float, float]) -> None:
    """Drag the red arrow of the gizmo, along x of the object, by a distance along x and y of the screen [px]."""
    tip = studio.tip_of_arrow(name)
    studio.drag(tip, (tip[0] + by[0], tip[1] + by[1]))


def test_an_object_is_selected_and_renamed_and_saved(desk: Path, open_studio: OpenStudio) -> None:
    studio = open_studio(desk)
    _select(studio, "mug")
    studio.until(lambda: studio.control("Name").input_value() == "mug")
    studio.enter("Name", "beaker")
    studio.press("Apply")
    renamed = SCENE.replace("mug:", "beaker:").replace("OnTop(mug", "OnTop(beaker")
    studio.until(lambda: studio.text == renamed, "the rename")
    assert studio.file_text == SCENE
    studio.press("Save")
    studio.until(lambda: studio.file_text == renamed, "saving")
    studio.press("Undo")
    studio.until(lambda: studio.text == SCENE, "undoing")
    assert studio.problems == []


def test_a_dragged_object_lands_on_the_desk(desk: Path, open_studio: OpenStudio) -> None:
    studio = open_studio(desk)
    _select(studio, "mug")
    _drag_gizmo(studio, "mug", (60.0, 0.0))
    studio.until(lambda: studio.text != SCENE, "the move")
    (line,) = [line for line in studio.text.splitlines() if line not in SCENE.splitlines()]
    assert line.startswith("    place: {on: desk, xy: [") and "xy: [0.2, 0.1]" not in line
    studio.page.keyboard.press("Control+z")
    studio.until(lambda: studio.text == SCENE, "undoing by a key")


def test_a_change_on_disk_appears(desk: Path, open_studio: OpenStudio) -> None:
    studio = open_studio(desk)
    studio.page.wait_for_timeout(1000)  # until the meshes can be hit
    assert studio.server.session.scene is not None
    mug = studio.server.session.scene.objects["mug"].X_WO.p
    studio.page.mouse.click(*studio.screen_point(tuple(mug.tolist())))
    studio.until(lambda: studio.server.window.selected_object == "mug", "selecting by a click")
    _select(studio, "ball")
    desk.write_text(SCENE.replace("sphere: 0.02", "sphere: 0.03").replace("0.0201", "0.0301"))
    studio.until(lambda: "sphere: 0.03" in studio.text, "the change")
    assert studio.server.window.selected_object == "ball"
    mass = studio.control("Mass [kg]")
    studio.until(lambda: mass.input_value() == "0.05", "the mass of the ball")


def test_a_newcomer_builds_a_scene_with_a_goal_and_types_nothing_but_names(
    tmp_path: Path, open_studio: OpenStudio
) -> None:
    path = tmp_path / "kitchen.scene.yaml"
    assert main_of("new", str(path)) == 0
    studio = open_studio(path)
    session = studio.server.session
    for kind in ("box", "tray"):
        studio.choose("What", kind)
        studio.press("Add")
        studio.until(partial(has_entry, studio, kind), f"adding a {kind}")
    studio.press("Save")
    studio.until(lambda: "  tray:" in studio.file_text, "saving")
    studio.tab("Goal")
    studio.enter("Task name", "tidy")
    studio.press("New task")
    studio.until(lambda: session.path.name == "tidy.task.yaml", "the task")
    studio.choose("Predicate", "Inside")
    studio.choose("First", "box")
    studio.choose("Second", "tray")
    studio.press("Add condition")
    studio.until(lambda: "Inside(box, tray)" in studio.text, "the goal")
    studio.press("Save")
    task = tmp_path / "tidy.task.yaml"
    studio.until(lambda: "Inside(box, tray)" in task.read_text(), "saving the task")
    assert main_of("check", str(tmp_path)) == 0
    scene = session.scene
    assert scene is not None and len(scene.objects) == 5 and studio.problems == []
