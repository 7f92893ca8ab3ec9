"""A small project, and a browser that drives the studio."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.studio.browser import StudioPage as StudioPage
from tests.studio.browser import browser_or_skip, opened_page

if TYPE_CHECKING:
    from simfoundry.studio.server import StudioServer

SCENE = """\
# A desk with things on it.
simfoundry: scene/1
name: desk

parameters: {gap: 0.12}

materials:
  wood: {density: 700, friction: 0.5}  # oak
  ceramic: {density: 2400, friction: 0.35}

objects:
  # The desk itself.
  desk:
    fixed: true
    shape: {box: [1.2, 0.8, 0.04]}
    material: wood
    pose: {xyz: [0, 0, -0.02]}

  mug:  # the red one
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    material: ceramic
    mass: 0.3
    place: {on: desk, xy: [0.2, 0.1]}
  tray:
    shape: {open_box: {size: [0.3, 0.2, 0.05], wall: 0.01}}
    mass: 0.5
    place: {on: desk, xy: [-0.25, -0.1]}  # near the wall
  ball:
    shape: {sphere: 0.02}
    mass: 0.05
    pose: {xyz: [$gap, -0.2, 0.0201]}

cameras:
  front: {size: [640, 480], fov_deg: 50, pose: {xyz: [1.2, 0, 0.8], look_at: [0, 0, 0]}}

relations:
  - OnTop(mug, desk)  # must stay
  - OnTop(tray, desk)
"""

TASK = """\
simfoundry: task/1
name: put_mug
scene: desk.scene.yaml
instruction: Put the mug into the tray.
goal: Inside(mug, tray)
reset:
  objects:
    mug: {x: [0.1, 0.3], y: [0.0, 0.2]}
"""


@pytest.fixture(autouse=True)
def state_folder(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the journals, which is not that of the user."""
    folder = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    return folder


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """The path of a scene in a project of its own."""
    (tmp_path / "simfoundry.yaml").touch()
    path = tmp_path / "desk.scene.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def task(desk: Path) -> Path:
    """The path of a task in the scene ``desk``."""
    path = desk.with_name("put_mug.task.yaml")
    path.write_text(TASK)
    return path


# -- the browser


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A browser that runs without a display."""
    with browser_or_skip() as browser:
        yield browser


OpenStudio = Callable[..., StudioPage]


@pytest.fixture
def open_studio(chromium: Any) -> Iterator[OpenStudio]:
    """A function that opens a document in the studio, and a window of it in the browser.

    Given a server, it opens one more window of it.
    """
    from simfoundry.studio.server import StudioServer

    servers: list[StudioServer] = []
    pages: list[Any] = []

    def open_window(path: Path | StudioServer) -> StudioPage:
        if not isinstance(path, StudioServer):
            servers.append(StudioServer(path, port=0))
        studio = opened_page(chromium, path if isinstance(path, StudioServer) else servers[-1])
        pages.append(studio.page)
        return studio

    yield open_window
    for page in pages:
        page.close()
    for server in servers:
        server.stop()
