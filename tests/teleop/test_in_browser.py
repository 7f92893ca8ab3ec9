"""The page in a real browser: keys, the gizmo and a headset drive rollouts in real time."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.data.store import read_shards
from simfoundry.teleop.run import replay_session
from tests.studio.browser import LOADING_MS, PATIENCE, PIXEL_RATIO, SIZE, browser_or_skip
from tests.teleop.live import RunningSession, running
from tests.teleop.streams import write_bench
from tests.teleop.test_live import MAX_REACTION_MS

pytestmark = pytest.mark.slow

# A headset whose right controller moves 25 cm away from the person within four seconds, while it is squeezed.
HEADSET = """
(() => {
  let frame = 0;
  const buttons = [0, 1, 0, 0, 0, 0].map((value) => ({ value, pressed: value > 0.5 }));
  const input = { handedness: "right", gripSpace: {}, gamepad: { buttons } };
  const session = {
    inputSources: [input],
    updateRenderState() {},
    async requestReferenceSpace(kind) { if (kind !== "local-floor") throw new Error(kind); return {}; },
    addEventListener() {},
    requestAnimationFrame(callback) {
      setTimeout(() => {
        frame += 1;
        const position = { x: 0.2, y: 1.1, z: -0.3 - Math.min(0.25, frame * 0.002) };
        const transform = { position, orientation: { x: 0, y: 0, z: 0, w: 1 } };
        callback(0, { getPose: () => ({ transform }) });
      }, 1000 / 72);
    },
  };
  const xr = { isSessionSupported: async () => true, requestSession: async () => session };
  Object.defineProperty(navigator, "xr", { value: xr });
  window.XRWebGLLayer = class {};
})();
"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser that runs without a display."""
    with browser_or_skip() as browser:
        yield browser


@pytest.fixture(scope="module")
def touch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The task of the streams with a horizon of ten minutes, because browsers without a GPU are slow."""
    path = write_bench(tmp_path_factory.mktemp("browser"))
    path.write_text(path.read_text().replace("horizon: 60", "horizon: 9000"))
    return path


class Window:
    """One window of the page."""

    def __init__(self, browser: Any, session: RunningSession, script: str = "") -> None:
        self.session = session
        self.page = browser.new_page(viewport=SIZE, device_scale_factor=PIXEL_RATIO)
        self.page.set_default_timeout(PATIENCE * 1000)
        self.problems: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        if script:
            self.page.add_init_script(script)
        self.page.goto(session.address, timeout=LOADING_MS)
        self.page.get_by_text("SimFoundry teleoperation").wait_for(timeout=LOADING_MS)

    def until(self, condition: Any, what: str) -> None:
        """Wait until a condition holds."""
        for _ in range(round(PATIENCE / 0.03)):
            if condition():
                return
            self.page.wait_for_timeout(30)
        raise AssertionError(f"{what} did not happen: {self.session.teleoperator.status}")

    def until_shown(self, text: str) -> None:
        """Wait until the page shows a text."""
        self.page.get_by_text(text).first.wait_for()

    def push(self, button: str) -> None:
        """Push a button, without waiting for it to stop moving, which takes long if nothing else is drawn fast."""
        self.page.get_by_role("button", name=button, exact=True).first.dispatch_event("click")

    def screen_point(self, point: Any) -> tuple[float, float]:
        """Return where a point of the world [m] is on the screen [px]."""
        from viser import transforms

        camera = next(iter(self.server.get_clients().values())).camera
        x, y, z = transforms.SO3(camera.wxyz).as_matrix().T @ (np.array(point) - camera.position)
        scale = SIZE["height"] / 2 / np.tan(camera.fov / 2)
        return float(SIZE["width"] / 2 + scale * x / z), float(SIZE["height"] / 2 + scale * y / z)

    @property
    def server(self) -> Any:
        return self.session.servers[0]


OpenWindow = Callable[..., Window]


@pytest.fixture
def open_window(chromium: Any) -> Iterator[OpenWindow]:
    """A function that opens a window of a session, which is closed after the test."""
    opened: list[Window] = []

    def open_one(session: RunningSession, script: str = "") -> Window:
        opened.append(Window(chromium, session, script))
        return opened[-1]

    yield open_one
    for window in opened:
        window.page.close()


def check(session: RunningSession, window: Window, touch: Path, folder: Path, stream: Path) -> None:
    """Check that a session went well: in real time, with a demonstration that a replay repeats."""
    report = session.ended()
    print(json.dumps({"reaction_ms": dict(report.reaction_ms), "late": report.late, "steps": report.steps}))
    assert report.summary.kept == 1 and report.refused == {} and window.problems == []
    assert report.reaction_ms["median"] <= MAX_REACTION_MS and report.late <= 0.25 * report.steps, report
    (demo,) = sf.demonstrations(folder)
    assert (demo.trajectory,) == report.summary.digests[-1:]
    again = replay_session(touch, stream, folder.parent / "again", 1)
    assert again.summary.digests == report.summary.digests
    first, second = (
        [dict(a.about) for _, found in read_shards(f) for a in found] for f in (folder, folder.parent / "again")
    )
    assert first == second


def test_held_keys_move_the_robot_and_buttons_decide(open_window: OpenWindow, touch: Path, tmp_path: Path) -> None:
    stream = tmp_path / "s.jsonl"
    with running(touch, tmp_path / "demos", "keyboard", stream=stream) as session:
        window = open_window(session)
        window.until(lambda: session.teleoperator.status.step > 3, "the start")
        window.until_shown("Touch the block.")
        window.until_shown("Touching(arm, block)")
        keyboard, status = window.page.keyboard, session.teleoperator.status
        keyboard.press("Space")
        window.until(lambda: status.grippers["arm"] == 1.0, "a closed gripper")
        window.push("Mark sub-task")
        window.until(lambda: len(status.marks) == 1, "a mark")
        keyboard.press("p")
        window.until_shown("Paused.")
        keyboard.press("p")
        window.push("Try again")
        window.until(lambda: not status.marks, "another try")
        keyboard.down("w")
        window.until_shown("Success after")
        keyboard.up("w")
        keyboard.press("Enter")
        window.until(lambda: session.report is not None, "the end")
        check(session, window, touch, tmp_path / "demos", stream)


def test_the_gizmo_moves_the_robot(open_window: OpenWindow, touch: Path, tmp_path: Path) -> None:
    stream = tmp_path / "s.jsonl"
    with running(touch, tmp_path / "demos", "gizmo", stream=stream) as session:
        window = open_window(session)
        window.until(lambda: session.teleoperator.status.step > 3, "the start")
        window.page.wait_for_timeout(2000)  # the gizmo is drawn
        hand = session.teleoperator.motion("arm").goal.p  # type: ignore[attr-defined]
        start, end = (window.screen_point(hand + [x, 0, 0]) for x in (0.13, 0.33))
        mouse = window.page.mouse
        mouse.move(*start)
        window.page.wait_for_timeout(400)
        mouse.down()
        for k in range(1, 21):
            mouse.move(*(a + (b - a) * k / 20 for a, b in zip(start, end, strict=True)))
            window.page.wait_for_timeout(30)
        mouse.up()
        window.until_shown("Success after")
        window.page.keyboard.press("Enter")
        window.until(lambda: session.report is not None, "the end")
        check(session, window, touch, tmp_path / "demos", stream)


def test_a_headset_drives_from_its_browser(open_window: OpenWindow, touch: Path, tmp_path: Path) -> None:
    stream = tmp_path / "s.jsonl"
    with running(touch, tmp_path / "demos", "vr", stream=stream) as session:
        window = open_window(session, HEADSET)
        assert session.teleoperator.status.step == 0, "without a controller, the session waits"
        window.push("Use a headset")
        window.until_shown("Success after")
        window.page.keyboard.press("Enter")
        window.until(lambda: session.report is not None, "the end")
        check(session, window, touch, tmp_path / "demos", stream)


def test_a_closed_window_pauses_the_session(open_window: OpenWindow, touch: Path, tmp_path: Path) -> None:
    with running(touch, tmp_path / "demos", "keyboard") as session:
        window = open_window(session)
        window.until(lambda: session.teleoperator.status.step > 3, "the start")
        window.page.close()
        session.until(lambda: session.teleoperator.status.lost == "the window of the page was closed", "the loss")
        steps = session.teleoperator.total_steps
        again = open_window(session)
        again.until(lambda: session.teleoperator.total_steps > steps, "going on")
