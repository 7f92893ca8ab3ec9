"""Sessions in real time, which run in a thread while a test plays the person and the device."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

from simfoundry.teleop.live import LivePlan, run_live
from simfoundry.teleop.run import TeleopReport
from simfoundry.teleop.sources import LiveSource
from simfoundry.teleop.teleoperator import Teleoperator

# Seconds in which a session does what it is told on a busy machine.
PATIENCE_S = 60.0


class RunningSession:
    """A session in a thread."""

    def __init__(self, plan: LivePlan) -> None:
        self.plan = replace(plan, port=0)
        self.address = ""
        self.report: TeleopReport | None = None
        self.error: Exception | None = None
        self.teleoperators: list[Teleoperator] = []
        self.servers: list[Any] = []
        self._ready = Event()
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()
        while not self._ready.wait(0.05):
            assert self._thread.is_alive(), self.error

    @property
    def teleoperator(self) -> Teleoperator:
        return self.teleoperators[0]

    @property
    def source(self) -> LiveSource:
        source = self.teleoperator.source
        assert isinstance(source, LiveSource)
        return source

    def _work(self) -> None:
        try:
            self.report = run_live(self.plan, self._is_open, self._watch)
        except Exception as error:
            self.error = error

    def _watch(self, teleoperator: Teleoperator, server: Any) -> None:
        self.teleoperators.append(teleoperator)
        self.servers.append(server)

    def _is_open(self, address: str) -> None:
        self.address = address
        self._ready.set()

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait until a condition holds."""
        end = time.monotonic() + PATIENCE_S
        while not (found := condition()):
            assert self._thread.is_alive() or self.report is not None, self.error
            assert time.monotonic() < end, f"{what} did not happen: {self.teleoperator.status}"
            time.sleep(0.01)
        return found

    def ended(self) -> TeleopReport:
        """Wait for the end of the session."""
        self._thread.join(PATIENCE_S)
        assert self.error is None and self.report is not None, self.error
        return self.report


class PagePerson:
    """A window of the page without a browser: it holds keys and sends them as the page does."""

    def __init__(self, address: str, **headers: str) -> None:
        from websockets.sync.client import connect

        place = address.removeprefix("http://").partition("/")[0]
        origin: Any = f"http://{place}"
        self.socket = connect(f"ws://{place}/teleop-socket", origin=origin, additional_headers=headers)
        self.held: list[str] = []
        self._ended = Event()
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def hold(self, *keys: str) -> None:
        """Hold exactly these keys."""
        self.held = list(keys)
        self.send(keys=self.held)

    def press(self, key: str) -> None:
        """Press a key, and release it."""
        self.send(keys=[*self.held, key])
        self.send(keys=self.held)

    def send(self, **content: Any) -> None:
        """Send a packet, unless the session has just ended."""
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed):
            self.socket.send(json.dumps(content))

    def close(self) -> None:
        """Close the window."""
        self._ended.set()
        self._thread.join()
        self.socket.close()

    def _work(self) -> None:
        while not self._ended.wait(0.2):
            self.send(keys=self.held)


@contextmanager
def running(touch: Path, out: Path, device: str, count: int = 1, **more: Any) -> Iterator[RunningSession]:
    """Run a session, and end it."""
    session = RunningSession(LivePlan(touch, out, device, count, **more))
    try:
        yield session
    finally:
        from simfoundry.teleop.commands import Control

        session.source.press(Control.QUIT)
        session._thread.join(PATIENCE_S)
