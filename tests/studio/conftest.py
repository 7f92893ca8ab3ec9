"""A small project, and a browser that drives the studio."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

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

# Chromium without a display and without a GPU.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]

# Seconds in which the browser shows what it was told; a software renderer on a busy machine takes a few.
PATIENCE = 20.0


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A browser that runs without a display."""
    api = pytest.importorskip("playwright.sync_api")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("Chromium is not installed")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield browser
        browser.close()


@dataclass
class StudioPage:
    """One window of the studio, driven as a person would, and the server behind it."""

    page: Any
    server: StudioServer
    problems: list[str] = field(default_factory=list)

    @property
    def file_text(self) -> str:
        """The text of the document on disk."""
        return self.server.session.path.read_text()

    @property
    def text(self) -> str:
        """The text of the document in the studio."""
        return self.server.session.text

    def until(self, condition: Callable[[], Any], what: str = "") -> Any:
        """Wait until a condition holds, and return its value."""
        end = time.monotonic() + PATIENCE
        while not (found := condition()):
            assert time.monotonic() < end, f"{what or condition} did not happen:\n{self.text}"
            self.page.wait_for_timeout(30)  # which also handles the events of the page
        return found

    def tab(self, name: str) -> None:
        """Open a tab of the panels."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def press(self, button: str) -> None:
        """Press a button by its label."""
        self.page.get_by_role("button", name=button, exact=True).first.click()

    def control(self, label: str) -> Any:
        """Return the control with a label. Those of text are not linked to their labels."""
        row = f'//label[text()="{label}"]/ancestor::div[contains(@class, "mantine-Flex-root")][1]'
        return self.page.locator(f"xpath={row}//*[self::input or self::textarea]").first

    def enter(self, label: str, value: str) -> None:
        """Write into the control with a label."""
        self.control(label).fill(value)

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a dropdown."""
        self.control(label).click()
        self.page.get_by_role("option", name=option, exact=True).first.click()

    def screen_point(self, point: tuple[float, float, float]) -> tuple[float, float]:
        """Return where a point of the world [m] is on the screen [px]."""
        import numpy as np
        from viser import transforms

        client = self.until(lambda: next(iter(self.server.viser.get_clients().values()), None))
        size = self.page.viewport_size
        R = transforms.SO3(client.camera.wxyz).as_matrix()
        x, y, z = R.T @ (np.array(point) - client.camera.position)
        scale = size["height"] / 2 / np.tan(client.camera.fov / 2)
        return float(size["width"] / 2 + scale * x / z), float(size["height"] / 2 + scale * y / z)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 12, release: bool = True) -> None:
        """Drag with the mouse from one point of the screen to another [px], as slowly as a person."""
        mouse = self.page.mouse
        mouse.move(*start)
        self.page.wait_for_timeout(400)  # the gizmo must notice the mouse first
        mouse.down()
        for k in range(1, steps + 1):
            mouse.move(*(a + (b - a) * k / steps for a, b in zip(start, end, strict=True)))
            self.page.wait_for_timeout(30)
        if release:
            mouse.up()


OpenStudio = Callable[..., StudioPage]


@pytest.fixture
def open_studio(chromium: Any) -> Iterator[OpenStudio]:
    """A function that opens a document in the studio, and a window of it in the browser."""
    from simfoundry.studio.server import StudioServer

    servers: list[StudioServer] = []
    pages: list[Any] = []

    def open_window(path: Path | StudioServer) -> StudioPage:
        if isinstance(path, StudioServer):
            server = path
        else:
            server = StudioServer(path, port=0)
            servers.append(server)
        page = chromium.new_page(viewport={"width": 1000, "height": 700})
        pages.append(page)
        studio = StudioPage(page, server)
        page.on("pageerror", lambda error: studio.problems.append(str(error)))
        page.goto(server.address)
        page.get_by_text("SimFoundry Studio").wait_for()
        page.add_style_tag(content=".mantine-Notifications-root { pointer-events: none; opacity: 0.3 }")
        studio.until(lambda: server.viser.get_clients(), "a connection")
        return studio

    yield open_window
    for page in pages:
        page.close()
    for server in servers:
        server.stop()
