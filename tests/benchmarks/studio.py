"""How long people wait for the studio: prints the median and the slowest of each wait, in a real browser.

    python -m tests.benchmarks.studio [--edits 10]

For scenes of 20 and 200 objects, the file is changed as an editor would, and the time is taken until the studio has
sent the change, and until the browser has drawn two frames with it. Then an object is dragged by its gizmo, and the
time is taken from the release of the mouse button until the text has changed. At last, the view is turned, and the time
between its pictures is taken, which has no bar, because it is that of the software renderer. The bars are 0.5 s and 2 s
from the file to the picture, and 0.2 s from the gizmo to the text (medians). The exit status is 1 if one is missed.
Needs Chromium, which `make browser` installs; it draws in software here, which takes most of the time to the picture.
"""

from __future__ import annotations

import argparse
import itertools
import math
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from simfoundry.studio.server import StudioServer, spare_collections
from tests.studio.browser import SEVERAL_FRAMES, StudioPage, launched_browser, opened_page

# Longest medians [s]: from the file to the picture for few and for many objects, and from the gizmo to the text.
FEW, MANY, GIZMO = 0.5, 2.0, 0.2

# Number of objects, beside the table.
SIZES = (20, 200)


class Waits(NamedTuple):
    """Seconds that a person waited."""

    what: str
    seconds: list[float]
    bar: float


def scene_text(count: int, radius: float, relations: int = 9) -> str:
    """Return a scene of cups on a table, of which the first one has a radius [m], with a number of relations."""
    lines = [
        "simfoundry: scene/1", "name: many", "materials:", "  clay: {density: 1800, friction: 0.4}", "objects:",
        "  table: {fixed: true, shape: {box: [4, 4, 0.04]}, material: clay, pose: {xyz: [0, 0, -0.02]}}",
    ]  # fmt: skip
    for k in range(count):
        size = radius if k == 0 else 0.03
        xy = f"[{0.15 * (k % 20) - 1.4:.2f}, {0.15 * (k // 20) - 0.7:.2f}]"
        shape = f"{{cylinder: {{radius: {size:.4f}, height: 0.1}}}}"
        lines.append(f"  cup_{k}: {{shape: {shape}, material: clay, place: {{on: table, xy: {xy}}}}}")
    lines += ["relations:", *(f"  - OnTop(cup_{k}, table)" for k in range(relations)), ""]
    return "\n".join(lines)


# Waits until a text is on the page, and until two more frames are drawn, with what was received together with it.
DRAWN = """text => new Promise(done => {
  const look = () => document.body.innerText.includes(text)
    ? requestAnimationFrame(() => requestAnimationFrame(done)) : requestAnimationFrame(look);
  look();
})"""


def from_file_to_picture(studio: StudioPage, count: int, edits: int) -> list[float]:
    """Return the seconds from each change of the file until the browser shows it.

    Each change makes a cup wider and states one more relation, which the page lists.
    """
    studio.tab("Goal")
    waits = []
    for k in range(1, edits + 1):
        studio.page.wait_for_timeout(1500)  # until the findings and pictures of the last change have arrived
        start = time.perf_counter()
        studio.server.session.path.write_text(scene_text(count, 0.03 + 0.0005 * k, 9 + k))
        studio.page.evaluate(DRAWN, f"OnTop(cup_{8 + k}, table)")
        waits.append(time.perf_counter() - start)
    studio.tab("Edit")
    return waits


def from_file_to_message(studio: StudioPage, count: int, edits: int) -> list[float]:
    """Return the seconds from each change of the file until the studio has sent what changed, without a browser."""
    canvas, waits = studio.server.window.canvas, []
    for k in range(edits):
        studio.page.wait_for_timeout(1500)
        before, start = canvas.sent, time.perf_counter()
        studio.server.session.path.write_text(scene_text(count, 0.04 + 0.0005 * k))
        while canvas.sent == before:
            time.sleep(0.002)
        waits.append(time.perf_counter() - start)
    return waits


def from_gizmo_to_text(studio: StudioPage, edits: int) -> list[float]:
    """Return the seconds from each release of the gizmo until the text has changed."""
    session, window = studio.server.session, studio.server.window
    changed: list[float] = []
    session.subscribe(lambda what: changed.append(time.perf_counter()) if what.startswith("move") else None)
    window.select("objects.cup_5")
    studio.until(lambda: window.gizmo.size > 0, "the gizmo")
    studio.page.wait_for_timeout(1000)
    waits = []
    for k in range(edits):
        assert session.scene is not None
        item = session.scene.objects["cup_5"]
        tip = studio.screen_point(tuple((item.X_WO.p + item.X_WO.rotation[:, 0] * window.gizmo.size * 0.8).tolist()))
        changed.clear()
        studio.drag(tip, (tip[0] + (12 if k % 2 else -12), tip[1]), steps=4, release=False)
        start = time.perf_counter()
        studio.page.mouse.up()
        studio.until(lambda: changed, "a move")
        waits.append(changed[0] - start)
        studio.page.wait_for_timeout(500)
    return waits


# Notes the time of each picture that the browser draws, by a call that each of them needs.
NOTING = """() => {
  window.drawn = [];
  const draw = WebGL2RenderingContext.prototype.drawElements;
  WebGL2RenderingContext.prototype.drawElements = function (...args) {
    const now = performance.now();
    if (!drawn.length || now - drawn[drawn.length - 1] > 4) drawn.push(now);
    return draw.apply(this, args);
  };
}"""


def between_pictures(studio: StudioPage, seconds: float = 5.0) -> list[float]:
    """Return the seconds between pictures while the view is turned by the mouse."""
    page = studio.page
    page.evaluate(NOTING)
    page.mouse.move(300, 600)
    page.mouse.down()
    end, k = time.perf_counter() + seconds, 0
    while time.perf_counter() < end:
        k += 1
        page.mouse.move(300 + k % 60, 600 - k % 30)
        page.wait_for_timeout(10)
    page.mouse.up()
    drawn = page.evaluate("() => drawn")
    return [(b - a) / 1000 for a, b in itertools.pairwise(drawn)]


def measure(count: int, edits: int, browser: Any) -> list[Waits]:
    """Measure with a scene of ``count`` objects."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "many.scene.yaml"
        path.write_text(scene_text(count, 0.03))
        with StudioServer(path, port=0) as server:
            spare_collections()  # as the command does
            studio = opened_page(browser, server)
            studio.page.evaluate(SEVERAL_FRAMES)  # loading the page is another wait
            pictures = from_file_to_picture(studio, count, edits)
            messages = from_file_to_message(studio, count, edits)
            texts = from_gizmo_to_text(studio, edits)
            studio.server.window.select("")
            turning = between_pictures(studio)
            studio.page.close()
    bar = FEW if count <= SIZES[0] else MANY
    return [
        Waits(f"{count} objects: file to picture", pictures, bar),
        Waits(f"{count} objects: file to message", messages, bar),
        Waits(f"{count} objects: gizmo to text", texts, GIZMO),
        Waits(f"{count} objects: from picture to picture", turning, math.inf),
    ]


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edits", type=int, default=10, choices=range(1, 11))
    edits = parser.parse_args().edits
    missed = False
    print(f"{'wait':<40}{'median':>9}{'slowest':>9}{'bar':>7}")
    with launched_browser() as browser:
        for count in SIZES:
            for waits in measure(count, edits, browser):
                median = statistics.median(waits.seconds)
                missed |= median > waits.bar
                print(f"{waits.what:<40}{median:>8.3f}s{max(waits.seconds):>8.3f}s{waits.bar:>6.1f}s", flush=True)
    sys.exit(missed)


if __name__ == "__main__":
    main()
