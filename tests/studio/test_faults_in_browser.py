"""Faults in a real browser: nothing is lost, and the last good scene stays visible."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from simfoundry.studio.acts.properties import SetProperties
from tests.studio.browser import PATIENCE, StudioPage
from tests.studio.conftest import SCENE, OpenStudio

pytestmark = pytest.mark.slow


def select(studio: StudioPage, name: str) -> None:
    """Select an object by its name, and wait until its gizmo is there."""
    studio.choose("Selected", name)
    studio.until(lambda: studio.server.window.selected_object == name)
    studio.until(lambda: f"/objects/{name}/selection" in studio.server.window.canvas.nodes)


def begin_drag(studio: StudioPage, name: str) -> None:
    """Drag the red arrow of the selected object until its preview moves, without letting go."""
    window = studio.server.window
    node, tip = f"/objects/{name}", studio.tip_of_arrow(name)
    start = window.canvas.nodes[node].X_PN.p.tolist()
    studio.drag(tip, (tip[0] + 60, tip[1]), steps=30, release=False)
    studio.until(lambda: window.canvas.nodes[node].X_PN.p.tolist() != start, "the preview of the drag")


def test_a_browser_that_is_closed_during_a_drag_changes_nothing(desk: Path, open_studio: OpenStudio) -> None:
    studio = open_studio(desk)
    other = open_studio(studio.server)
    select(studio, "mug")
    window = studio.server.window
    start = window.canvas.nodes["/objects/mug"].X_PN.p.tolist()
    begin_drag(studio, "mug")
    studio.page.close()
    other.until(lambda: window.gizmo.dragged_by is None, "the end of the drag")
    other.until(lambda: window.canvas.nodes["/objects/mug"].X_PN.p.tolist() == start, "the return of the mug")
    assert other.text == SCENE == other.file_text
    other.until(lambda: other.control("Name").input_value() == "mug")
    other.enter("Name", "beaker")  # and the other window goes on
    other.press("Apply")
    other.until(lambda: "  beaker:" in other.text)


def test_two_windows_at_once_lose_no_act(desk: Path, open_studio: OpenStudio) -> None:
    one = open_studio(desk)
    two = open_studio(one.server)
    select(one, "mug")
    begin_drag(one, "mug")
    two.server.window.submit(SetProperties("tray", {"mass": 0.6}))  # an act that another window submits meanwhile
    two.until(lambda: "mass: 0.6" in two.text)
    assert "xy: [0.2, 0.1]" in two.text  # the drag is not an edit yet
    one.page.mouse.up()
    one.until(lambda: "xy: [0.2, 0.1]" not in one.text, "the move")
    assert "mass: 0.6" in one.text
    two.press("Undo")
    two.until(lambda: "xy: [0.2, 0.1]" in two.text, "undoing the move in the other window")
    one.press("Undo")
    one.until(lambda: one.text == SCENE)
    assert one.problems == two.problems == []


def test_an_invalid_file_is_a_finding_and_the_last_good_scene_stays(desk: Path, open_studio: OpenStudio) -> None:
    studio = open_studio(desk)
    select(studio, "mug")
    studio.enter("Name", "beaker")
    studio.press("Apply")
    studio.until(lambda: "  beaker:" in studio.text)
    edited = studio.text
    studio.tab("Check")
    desk.write_text(SCENE.replace("objects:", "objects: ["))
    studio.page.get_by_text("the file on disk could not be parsed").first.wait_for()
    assert studio.text == edited and "/objects/beaker" in studio.server.window.canvas.nodes
    desk.write_text(SCENE.replace("mass: 0.5", "mass: heavy"))  # valid YAML, but not a scene
    studio.page.get_by_text("The scene shows an earlier text").first.wait_for()
    assert "/objects/beaker" in studio.server.window.canvas.nodes
    desk.write_text(SCENE.replace("mass: 0.5", "mass: 0.55"))
    studio.until(lambda: studio.text == edited.replace("mass: 0.5", "mass: 0.55"), "the merge")
    studio.until(lambda: studio.server.session.is_current)
    studio.press("Save")
    studio.until(lambda: studio.file_text == edited.replace("mass: 0.5", "mass: 0.55"))


@contextmanager
def served(document: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the command in a process of its own, and yield it with the address that it prints."""
    command = [sys.executable, "-m", "simfoundry", "studio", str(document), "--port", "0", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        text = ""
        while not text.rstrip().endswith("}"):
            line = process.stdout.readline()
            assert line, "the studio ended"
            text += line
        yield process, str(json.loads(text)["address"])
    finally:
        process.kill()
        process.wait()


def test_a_killed_server_loses_no_act(desk: Path, chromium: Any) -> None:
    page = chromium.new_page(viewport={"width": 1000, "height": 700})
    page.set_default_timeout(PATIENCE * 1000)
    with served(desk) as (process, address):
        page.goto(address)
        page.get_by_text("SimFoundry Studio").wait_for()
        studio = StudioPage(page, None)  # type: ignore[arg-type]
        studio.choose("Selected", "mug")
        studio.until(lambda: studio.control("Name").input_value() == "mug", "the selection")
        studio.enter("Name", "beaker")
        studio.press("Apply")
        page.get_by_text("undo: rename objects.mug to beaker").wait_for()
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert desk.read_text() == SCENE
    with served(desk) as (_, address):
        page.goto(address)
        page.get_by_text("Unsaved edits of an earlier studio").wait_for()
        studio.press("Restore")
        page.get_by_text("undo: rename objects.mug to beaker").wait_for()
        assert desk.read_text() == SCENE
        studio.press("Save")
        renamed = SCENE.replace("mug:", "beaker:").replace("OnTop(mug", "OnTop(beaker")
        studio.until(lambda: desk.read_text() == renamed, "saving")
    page.close()
