"""A newcomer, from an empty folder to a scene of five objects with a goal: only commands, clicks, and names."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.studio.browser import LOADING_MS, PATIENCE, SIZE, StudioPage
from tests.studio.test_faults_in_browser import served

pytestmark = pytest.mark.slow

# The longest time that this may take [s]: five minutes, for a person who knows where to click.
LIMIT_S = 300.0


def simfoundry(folder: Path, *arguments: str) -> str:
    """Run a command in a folder, and return what it prints."""
    command = [sys.executable, "-m", "simfoundry", *arguments]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


def is_selected(studio: StudioPage, name: str) -> bool:
    return bool(studio.control("Selected").input_value() == name)


def holds(page: Any, condition: str) -> None:
    """Wait until the table of conditions says that one holds."""
    page.locator(f'xpath=//tr[contains(., "{condition}")]').first.wait_for()


def test_from_an_empty_folder_to_five_objects_with_a_goal(tmp_path: Path, chromium: Any) -> None:
    start = time.monotonic()
    assert "simfoundry studio kitchen.scene.yaml" in simfoundry(tmp_path, "new", "kitchen.scene.yaml")
    scene = tmp_path / "kitchen.scene.yaml"
    page = chromium.new_page(viewport=SIZE, device_scale_factor=0.4)
    page.set_default_timeout(PATIENCE * 1000)
    with served(scene) as (_, address):
        page.goto(address)
        page.get_by_text("SimFoundry Studio").wait_for(timeout=LOADING_MS)
        page.add_style_tag(content=".mantine-Notifications-root { pointer-events: none; opacity: 0.3 }")
        studio = StudioPage(page, None)  # type: ignore[arg-type]
        for kind, name in (("tray", "basket"), ("sphere", "orange")):
            studio.choose("What", kind)
            studio.enter("New name", name)
            studio.press("Add")
            page.get_by_text(f"undo: add {name}").wait_for()
            studio.until(partial(is_selected, studio, name), "its selection")
        studio.increase("radius [cm]")  # the orange becomes larger by one step
        page.get_by_text("undo: resize orange").wait_for()
        studio.press("Save")
        studio.until(lambda: "orange:" in scene.read_text())
        studio.tab("Goal")
        studio.enter("Task name", "tidy_up")
        studio.press("New task")
        page.get_by_text("tidy_up.task.yaml").first.wait_for()
        studio.choose("Predicate", "Inside")
        studio.choose("First", "orange")
        studio.choose("Second", "basket")
        studio.press("Add condition")
        holds(page, "Inside(orange, basket)")
        studio.press("Save")
        task = tmp_path / "tidy_up.task.yaml"
        studio.until(lambda: "Inside(orange, basket)" in task.read_text())
    page.close()
    taken = time.monotonic() - start
    facts = json.loads(simfoundry(tmp_path, "check", ".", "--json"))
    assert not [finding for finding in facts["findings"] if finding["severity"] == "error"], facts
    for text in ("  table:", "  mug:", "  plate:", "  basket:", "  orange:", "shape: {sphere: 0.04}"):
        assert text in scene.read_text(), scene.read_text()
    print(f"\nfrom an empty folder to a goal in {taken:.0f} s")
    assert taken < LIMIT_S
