"""Takes the pictures of ``docs/studio.md`` anew: ``python specs/render_studio.py``, or only those that are named.

Each is what a browser without a display shows of the studio. It needs Chromium, and the extra ``dev``.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from render_pictures import small

from simfoundry.capture.run import run_capture
from simfoundry.geometry.frames import Pose, look_at
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.server import StudioServer
from simfoundry.studio.view.panels.capture import OBJECTS, CapturePanel

SPECS = Path(__file__).resolve().parent
PICTURES = SPECS.parent / "docs" / "images" / "studio"
TASK = SPECS / "tasks" / "stack_dishware.task.yaml"

SIZE = {"width": 1120, "height": 680}
"""Size of the window [px]: a laptop's, on which the panels leave two thirds to the scene."""

WIDTH = 800
"""Width of a picture [px], at which the labels can still be read."""

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Chromium without a display and without a GPU."""

PATIENCE_S = 120.0
"""Seconds in which the browser must show what it was told; a software renderer on a busy machine takes a few."""

WITHOUT_MESSAGES = ".mantine-Notifications-root { display: none }"

Point = tuple[float, float, float]


class Window:
    """A window of the studio."""

    def __init__(self, page: Any, server: StudioServer) -> None:
        self.page, self.server, self.view = page, server, server.window

    def until(self, condition: Callable[[], Any]) -> None:
        """Waits until something holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError("the studio does not show what it should")
            self.page.wait_for_timeout(50)

    def tab(self, name: str) -> None:
        """Opens a tab."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def select(self, name: str) -> None:
        """Selects an object."""
        self.view.select(f"objects.{name}")
        self.until(lambda: f"/objects/{name}/selection" in self.view.canvas.nodes)

    def look(self, eye: Point, target: Point) -> None:
        """Looks from one point [m] at another."""
        (client,) = self.server.viser.get_clients().values()
        X_WC = look_at(np.array(eye), np.array(target))
        client.camera.position, client.camera.wxyz, client.camera.look_at = X_WC.p, X_WC.q, np.array(target)

    def picture(self) -> Image.Image:
        """What the window shows, once it rests."""
        self.page.wait_for_timeout(4000)
        with tempfile.TemporaryDirectory(prefix="simfoundry-pictures-") as folder:
            path = Path(folder) / "picture.png"
            self.page.screenshot(path=path)
            with Image.open(path) as shown:
                return shown.convert("RGB")


def edit(window: Window) -> None:
    """An object is selected, with its arrows, and was moved."""
    window.view.submit(MoveObject("bowl", Pose.of((0.53, -0.02, 0.1))))
    window.until(lambda: window.server.session.is_modified)
    window.select("bowl")
    window.look((1.25, 0.55, 0.6), (0.48, 0.0, 0.05))


def goal(window: Window) -> None:
    """The relations and the goal of a task, with their truth and their margin."""
    window.tab("Goal")
    window.look((1.25, 0.55, 0.6), (0.48, 0.0, 0.05))


def regions(window: Window) -> None:
    """The cameras with what they see, and the regions in which objects start."""
    window.select("cup")
    window.look((1.1, 0.75, 0.85), (0.42, 0.05, 0.0))


def refine(window: Window) -> None:
    """A reconstructed object on its cloud, with the fit of its pose."""
    window.until(lambda: "/capture/cloud" in window.view.canvas.nodes)
    window.tab("Capture")
    window.view.panel(CapturePanel).density.value = 20  # so that a software renderer shows the arrows in time
    window.select("pink_can")
    window.look((-0.45, -0.35, 0.45), (0.2, 0.05, 0.03))


def pieces(window: Window) -> None:
    """The objects that were found in the capture, by color, as its camera sees them."""
    window.until(lambda: "/capture/cloud" in window.view.canvas.nodes)
    window.tab("Capture")
    window.page.get_by_text("Look through the camera").click()
    panel = window.view.panel(CapturePanel)
    panel.colors.value, panel.size.value, panel.density.value = OBJECTS, 3.0, 100
    window.view.select("objects.blue_box")


OF_TASK = {"edit": edit, "goal": goal, "regions": regions}
OF_CAPTURE = {"refine": refine, "pieces": pieces}


def main() -> int:
    """Take all, or those that the command line names; returns the exit code."""
    names = sys.argv[1:] or [*OF_TASK, *OF_CAPTURE]
    if unknown := [n for n in names if n not in {*OF_TASK, *OF_CAPTURE}]:
        print(f"there is no picture {', '.join(unknown)}; there are {', '.join((*OF_TASK, *OF_CAPTURE))}")
        return 2
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="simfoundry-pictures-") as temporary:
        captured = Path(temporary) / "build" / "desk" / "desk.scene.yaml"
        if set(names) & set(OF_CAPTURE):
            (Path(temporary) / "simfoundry.yaml").touch()
            shutil.copytree(SPECS / "captures" / "desk", Path(temporary) / "capture")
            run_capture(Path(temporary) / "capture", captured.parent)
        for name in names:
            os.environ["XDG_STATE_HOME"] = f"{temporary}/{name}"  # so that no picture offers the edits of another one
            with opened(TASK if name in OF_TASK else captured) as window:
                (OF_TASK | OF_CAPTURE)[name](window)
                data = small(window.picture(), WIDTH, 0.0)
            (PICTURES / f"{name}.png").write_bytes(data)
            print(f"{name}.png  {len(data) / 1000:.0f} kB", flush=True)
    return 0


@contextmanager
def opened(document: Path) -> Iterator[Window]:
    """A window of the studio with a document, which is never saved."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with StudioServer(document, port=0) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(1000 * PATIENCE_S)
        page.goto(server.address)
        page.get_by_text("SimFoundry Studio").wait_for()
        page.add_style_tag(content=WITHOUT_MESSAGES)
        window = Window(page, server)
        window.until(server.viser.get_clients)
        yield window
        browser.close()


if __name__ == "__main__":
    sys.exit(main())
