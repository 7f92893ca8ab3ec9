"""Sessions in real time: keys reach the robot at once, what is unplugged pauses, and a replay repeats everything."""

from __future__ import annotations

import http.client
import json
import math
import os
import pty
import socket
import time
import tty
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array
from simfoundry.teleop.devices.dynamixel import TURN, status_packet
from simfoundry.teleop.devices.spacemouse import button_report, translation_report
from simfoundry.teleop.live import DeviceAddress, LivePlan, run_live
from simfoundry.teleop.run import replay_session
from tests.teleop.live import PagePerson, RunningSession, running
from tests.teleop.streams import AHEAD, HOME, LEADER, write_bench

pytest.importorskip("viser")

# Longest time from the arrival of a key to its action [s].
MAX_REACTION_MS = 50.0


@pytest.mark.slow  # 3 s
def test_keys_drive_a_rollout_in_real_time_and_its_stream_repeats_it(touch: Path, tmp_path: Path) -> None:
    stream = tmp_path / "s.jsonl"
    with running(touch, tmp_path / "demos", "keyboard", stream=stream) as session:
        assert session.teleoperator.status.lost == "" or "no window" in session.teleoperator.status.lost
        with closing(PagePerson(session.address)) as person:
            session.until(lambda: not session.teleoperator.status.lost, "the start")
            person.hold("KeyW")
            begun, steps = time.monotonic(), session.teleoperator.total_steps
            time.sleep(0.5)
            rate = (session.teleoperator.total_steps - steps) / (time.monotonic() - begun)
            person.press("KeyP")
            session.until(lambda: session.teleoperator.status.is_paused, "a pause")
            time.sleep(0.1)  # the action that had begun
            still = session.teleoperator.total_steps
            time.sleep(0.2)
            assert session.teleoperator.total_steps == still
            person.press("KeyM")
            person.press("KeyP")
            session.until(lambda: session.report or session.teleoperator.total_steps > still, "going on")
            while session.report is None:
                person.press("Enter")
                time.sleep(0.1)
        report = session.ended()
    assert (report.summary.kept, report.summary.failures, report.refused) == (1, {}, {})
    assert 20 < rate < 40 or report.late > 0
    assert report.reaction_ms["median"] <= MAX_REACTION_MS, report
    (demo,) = sf.demonstrations(tmp_path / "demos")
    assert [mark.name for mark in demo.marks] == ["reach"]
    again = replay_session(touch, stream, tmp_path / "again", 1)
    assert again.summary.digests == report.summary.digests
    names = ("demonstrations.json", "shards/00000.npz")
    first, second = ([(tmp_path / f / name).read_bytes() for name in names] for f in ("demos", "again"))
    assert first == second


class Leader:
    """A program that sends the joints of a leader to whoever connects."""

    def __init__(self) -> None:
        self.joints, self.press = HOME, list[str]()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._ended, self.is_plugged = Event(), Event()
        self.is_plugged.set()
        self.port = self._server.getsockname()[1]
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        self._server.settimeout(0.05)
        while not self._ended.is_set():
            if not self.is_plugged.wait(0.05):
                continue
            with suppress(OSError), self._server.accept()[0] as connection:
                while self.is_plugged.is_set() and not self._ended.wait(0.01):
                    press, self.press = self.press, []
                    content = {"joints": self.joints.tolist(), "press": press}
                    connection.sendall(json.dumps(content).encode() + b"\n")

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._server.close()


def reach(session: RunningSession, joints: Array) -> bool:
    """Return True if the arm is sent to these joints."""
    at = getattr(session.teleoperator.motion("arm"), "_at", np.zeros(7))
    return bool(len(at) == 7 and np.abs(at - joints).max() < 0.02)


def test_a_leader_that_is_unplugged_pauses_the_session_until_it_is_back(touch: Path, tmp_path: Path) -> None:
    with closing(Leader()) as leader:
        at = DeviceAddress("tcp", "127.0.0.1", leader.port)
        with running(touch, tmp_path / "demos", "joints", at=at) as session:
            half = HOME + 0.2 * (AHEAD - HOME)
            leader.joints = half
            session.until(lambda: reach(session, half), "the motion to the leader")
            leader.is_plugged.clear()
            session.until(lambda: "was unplugged or closed" in session.teleoperator.status.lost, "the loss")
            assert session.teleoperator.status.lost == (
                f"the device at 127.0.0.1:{leader.port} was unplugged or closed: the other end was closed"
            )
            steps = session.teleoperator.total_steps
            time.sleep(0.2)
            assert session.teleoperator.total_steps <= steps + 1
            leader.joints = AHEAD
            leader.is_plugged.set()
            session.until(lambda: not session.teleoperator.status.lost, "the connection")
            session.until(lambda: session.teleoperator.status.step > 10, "going on")
            while session.report is None:
                leader.press = ["save"]
                time.sleep(0.1)
            assert session.ended().summary.kept == 1


class Servos:
    """Servos at the other end of a serial line, which answer requests."""

    def __init__(self) -> None:
        self._line, slave = pty.openpty()
        tty.setraw(slave)
        self.path = Path(os.ttyname(slave))
        self.joints, self.dead = HOME, set[int]()
        self.requests = 0
        self._ended = Event()
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        arm = LEADER.arms["arm"]
        assert arm.gripper is not None
        while not self._ended.is_set():
            data = os.read(self._line, 4096)
            for _ in range(data.count(b"\x82\x84\x00\x04\x00")):
                self.requests += 1
                angles = self.joints * np.array(arm.signs) + np.array(arm.offsets)
                for servo, angle in zip(arm.servos, (*angles, math.radians(200)), strict=True):
                    if servo not in self.dead:
                        os.write(self._line, status_packet(servo, round(float(angle) / (2 * math.pi) * TURN)))


@pytest.mark.slow  # 5 s: it waits for silence
def test_servos_are_asked_for_their_positions_and_a_dead_one_pauses_the_session(touch: Path, tmp_path: Path) -> None:
    servos = Servos()
    leader = tmp_path / "leader.yaml"
    leader.write_text(
        "arms: {arm: {ids: [1, 2, 3, 4, 5, 6, 7], signs: [1, -1, 1, 1, 1, -1, 1], offsets: [0, 3.14159265, 0, "
        "-1.57079633, 0, 0, 3.14159265], gripper: {id: 8, open_deg: 200, closed_deg: 158}}}\n"
    )
    at = DeviceAddress("file", path=servos.path)
    with running(touch, tmp_path / "demos", "joints", at=at, leader=leader) as session:
        servos.joints = half = HOME + 0.2 * (AHEAD - HOME)
        session.until(lambda: reach(session, half), "the motion to the leader")
        servos.dead = {5}
        session.until(lambda: session.teleoperator.status.lost, "silence")
        assert session.teleoperator.status.lost == "the leader arm has been silent for 0.5 s"
        servos.dead, servos.joints = set(), AHEAD
        session.until(lambda: not session.teleoperator.status.lost, "the answer")
        with closing(PagePerson(session.address)) as person:  # keys control the attempt with any device
            while session.report is None:
                person.press("Enter")
                time.sleep(0.1)
        assert session.ended().summary.kept == 1 and servos.requests > 30


@pytest.mark.slow  # 4 s: it waits for the device to be searched again
def test_a_space_mouse_is_found_again_after_it_was_unplugged(touch: Path, tmp_path: Path) -> None:
    path = tmp_path / "hidraw0"
    with running(touch, tmp_path / "demos", "spacemouse", at=DeviceAddress("file", path=path)) as session:
        session.until(lambda: "cannot be opened: No such file" in session.teleoperator.status.lost, "the absence")
        os.mkfifo(path)
        for is_last in (False, True):
            device = os.open(path, os.O_RDWR)  # a pipe, which keeps reports apart if they are read at once
            session.until(lambda: not session.teleoperator.status.lost, "the connection")
            os.write(device, button_report(0))
            time.sleep(0.1)
            os.write(device, button_report())
            time.sleep(0.1)
            if not is_last:
                session.until(lambda: session.teleoperator.status.grippers.get("arm") == 1.0, "a closed gripper")
                os.write(device, translation_report(0, -300, 0))
                time.sleep(0.1)
                os.close(device)
                session.until(lambda: "was unplugged or closed" in session.teleoperator.status.lost, "the loss")
        with closing(PagePerson(session.address)) as person:
            while session.report is None:
                os.write(device, translation_report(0, -300, 0))
                person.press("Enter")
                time.sleep(0.05)
        os.close(device)
        assert session.ended().summary.kept == 1


@pytest.mark.slow  # 3 s: it moves in real time
def test_controllers_send_packets_over_udp(touch: Path, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with running(touch, tmp_path / "demos", "vr", at=DeviceAddress("udp", "127.0.0.1", port)) as session:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            k = 0
            while session.report is None:
                k += 1
                packet = {
                    "hand": "right", "position": [0, 1, -min(0.3, 0.004 * k)], "orientation": [0, 0, 0, 1],
                    "squeeze": 1, "trigger": 0, "press": ["save"] if k % 20 == 0 else [],
                }  # fmt: skip
                sender.sendto(json.dumps(packet).encode(), ("127.0.0.1", port))
                sender.sendto(b"x" * 5000, ("127.0.0.1", port))
                time.sleep(0.015)
        report = session.ended()
    assert report.summary.kept == 1 and set(report.refused) == {"it is longer than 4096 bytes"}


def test_a_flood_is_bounded_and_the_session_goes_on(touch: Path, tmp_path: Path) -> None:
    with running(touch, tmp_path / "demos", "keyboard") as session, closing(PagePerson(session.address)) as person:
        session.until(lambda: session.teleoperator.status.step > 2, "the start")
        for _ in range(3000):
            session.source.packet(b'{"keys": [NaN]}')
        person.socket.send("x" * 100_000)
        person.hold("KeyW")
        assert len(session.source._waiting) <= 1000
        while session.report is None:
            person.press("Enter")
            time.sleep(0.1)
        report = session.ended()
    assert report.summary.kept == 1 and report.dropped >= 1000
    assert report.refused["it is longer than 4096 bytes"] == 1


# -- the page


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSession]:
    """A session that waits for a window."""
    folder = tmp_path_factory.mktemp("page")
    with running(write_bench(folder), folder / "demos", "vr", token="0123456789abcdef") as running_session:
        yield running_session


def answer(session: RunningSession, path: str, **headers: str) -> tuple[int, bytes]:
    place = session.address.removeprefix("http://").partition("/")[0]
    connection = http.client.HTTPConnection(place, timeout=10)
    connection.request("GET", path, headers=headers)
    found = connection.getresponse()
    return found.status, found.read()


def test_the_page_loads_its_script_and_strangers_get_nothing(session: RunningSession) -> None:
    token = "?token=0123456789abcdef"
    status, page = answer(session, f"/{token}")
    assert status == 200 and page.index(b'<script src="teleop.js">') < page.index(b"<meta")
    status, script = answer(session, f"/teleop.js{token}")
    assert status == 200 and script.startswith(b"const KNOWN_KEYS = [") and b"const HAS_HEADSET = true;" in script
    for path in ("/", "/teleop.js", "/teleop-socket"):
        assert answer(session, path)[0] == 403
    assert answer(session, f"/teleop.js{token}", Origin="http://evil.example")[0] == 403


def test_the_last_window_drives_until_another_one_takes_over(session: RunningSession) -> None:
    place = session.address.replace("/?", "/teleop-socket?").replace("http", "ws")
    from websockets.sync.client import connect

    def drives(socket: object) -> bool:
        return bool(json.loads(socket.recv(timeout=10))["drives"])  # type: ignore[attr-defined]

    with connect(place) as first:
        assert drives(first)
        with connect(place) as second:
            assert drives(second) and not drives(first)
            first.send(b'{"take":true}')
            assert drives(first) and not drives(second)
        first.send("x" * 5000)
    session.until(lambda: session.teleoperator.status.lost == "the window of the page was closed", "the loss")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"device": "joints"}, "a leader arm needs its address"),
        ({"device": "joints", "at": DeviceAddress.parse("/dev/null")}, "needs --leader"),
        ({"device": "keyboard", "at": DeviceAddress.parse("tcp://a:1")}, "is on the page, not at a `tcp` address"),
        ({"device": "spacemouse", "at": DeviceAddress.parse("udp://a:1")}, "can be at `file` addresses"),
        ({"device": "vr", "at": DeviceAddress.parse("udp://0.0.0.0:0")}, "everybody can send packets to 0.0.0.0"),
        ({"device": "keyboard", "token": "short"}, "a token consists of at least 16"),
        ({"device": "keyboard", "control_hz": -1.0}, "the number of actions per second must be between 1 and 200"),
    ],
)
def test_what_cannot_work_is_refused_in_a_sentence(
    options: dict[str, object], reason: str, touch: Path, tmp_path: Path
) -> None:
    plan = LivePlan(**{"document": touch, "out": tmp_path / "demos", "count": 1, "port": 0, **options})  # type: ignore[arg-type]
    with pytest.raises(SimfoundryError, match=reason):
        run_live(plan)


@pytest.mark.parametrize("text", ["http://a:1", "tcp://a", "tcp://a:x", "udp://a:1/b", "tcp://a:99999"])
def test_addresses_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(SimfoundryError, match="is not an address; use a device file"):
        DeviceAddress.parse(text)
