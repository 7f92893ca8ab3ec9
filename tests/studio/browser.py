"""A real browser that drives the studio, for tests and benchmarks."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from simfoundry.studio.view.window import PANEL_PX

if TYPE_CHECKING:
    from simfoundry.studio.server import StudioServer

# Chromium without a display and without a GPU.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]

# Seconds in which the browser shows what it was told; a software renderer on a busy machine takes many.
PATIENCE = 60.0

# Milliseconds for the page itself, which a second window on a busy machine needs, because the first one keeps drawing.
LOADING_MS = 240_000

# Size of the windows [px], and the number of drawn pixels for each: a software renderer takes as long as there are any.
SIZE, PIXEL_RATIO = {"width": 1000, "height": 700}, 0.4

# Waits until several frames are drawn, which takes seconds on a busy machine.
SEVERAL_FRAMES = """() => new Promise(done => {
  const wait = left => left ? requestAnimationFrame(() => wait(left - 1)) : done();
  wait(4);
})"""

# Number of characters of a document that a failure shows.
MAX_TEXT = 3000


class NoBrowserError(Exception):
    """Raised if there is no browser on this machine. The message says what is missing."""


@contextmanager
def launched_browser() -> Iterator[Any]:
    """Run a browser without a display.

    Raises:
        NoBrowserError: If Chromium or the package that drives it is not installed.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise NoBrowserError("playwright is not installed; `make browser` installs it") from None
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        raise NoBrowserError("Chromium is not installed; `make browser` installs it")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def browser_or_skip() -> Iterator[Any]:
    """Run a browser for tests, which are skipped where there is none."""
    with ExitStack() as stack:
        try:
            browser = stack.enter_context(launched_browser())
        except NoBrowserError as error:
            pytest.skip(str(error))
        yield browser


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
            text = self.text[:MAX_TEXT] if self.server is not None else ""
            assert time.monotonic() < end, f"{what or condition} did not happen:\n{text}"
            self.page.wait_for_timeout(30)  # which also handles the events of the page
        return found

    def is_laid_out(self) -> bool:
        """True if the panels are beside the view, and the server knows the size of the view that remains.

        Until then, points of the world are elsewhere on the screen than :meth:`screen_point` says.
        """
        width = self.page.evaluate("() => document.querySelector('canvas')?.clientWidth ?? 0")
        views = [client.camera.image_width for client in self.server.viser.get_clients().values()]
        return abs(SIZE["width"] - PANEL_PX - width) < 20 and all(view == width for view in views)

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

    def increase(self, label: str) -> None:
        """Press the button that increases the number with a label by one step."""
        row = f'//label[text()="{label}"]/ancestor::div[contains(@class, "mantine-Flex-root")][1]'
        self.page.locator(f'xpath={row}//button[@data-direction="up"]').first.click()

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
        width, height = client.camera.image_width, client.camera.image_height
        R = transforms.SO3(client.camera.wxyz).as_matrix()
        x, y, z = R.T @ (np.array(point) - client.camera.position)
        scale = height / 2 / np.tan(client.camera.fov / 2)
        return float(width / 2 + scale * x / z), float(height / 2 + scale * y / z)

    def look(self, eye: tuple[float, float, float], target: tuple[float, float, float]) -> None:
        """Look from one point [m] at another in the first window."""
        import numpy as np

        client = next(iter(self.server.viser.get_clients().values()))
        client.camera.position, client.camera.look_at = eye, target
        self.page.wait_for_timeout(2000)
        self.until(lambda: np.allclose(client.camera.position, eye, atol=1e-3), "the view")
        self.page.evaluate(SEVERAL_FRAMES)

    def tip_of_arrow(self, name: str) -> tuple[float, float]:
        """Look at the gizmo of a selected object from its side, and return where the tip of its red arrow is [px].

        From afar, or along the arrow, the tip is in front of a ring, which would be dragged instead.
        """
        import numpy as np

        item, size = self.server.session.scene.objects[name], self.server.window.gizmo.size  # type: ignore[union-attr]
        along = item.X_WO.rotation[:, 0]
        eye = item.X_WO.p + max(0.4, 4 * size) * (np.cross(along, (0.0, 0.0, 1.0)) + (0.0, 0.0, 0.5))
        self.look(tuple(eye.tolist()), tuple(item.X_WO.p.tolist()))
        return self.screen_point(tuple((item.X_WO.p + along * size * 0.95).tolist()))

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 12, release: bool = True) -> None:
        """Drag with the mouse from one point of the screen to another [px], as slowly as a person."""
        mouse = self.page.mouse
        mouse.move(*start)
        self.page.wait_for_timeout(400)  # the gizmo must notice the mouse first
        self.page.evaluate(SEVERAL_FRAMES)
        mouse.down()
        for k in range(1, steps + 1):
            mouse.move(*(a + (b - a) * k / steps for a, b in zip(start, end, strict=True)))
            self.page.wait_for_timeout(30)
        if release:
            mouse.up()


def opened_page(browser: Any, server: StudioServer) -> StudioPage:
    """Open one more window of a studio."""
    page = browser.new_page(viewport=SIZE, device_scale_factor=PIXEL_RATIO)
    page.set_default_timeout(PATIENCE * 1000)
    studio = StudioPage(page, server)
    page.on("pageerror", lambda error: studio.problems.append(str(error)))
    before = len(server.viser.get_clients())
    page.goto(server.address)
    page.get_by_text("SimFoundry Studio").wait_for(timeout=LOADING_MS)
    # Messages must not catch clicks that are meant for what is below them.
    page.add_style_tag(content=".mantine-Notifications-root { pointer-events: none; opacity: 0.3 }")
    studio.until(lambda: len(server.viser.get_clients()) > before, "a connection")
    studio.until(studio.is_laid_out, "the panels beside the view")
    return studio
