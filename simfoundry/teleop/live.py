"""Sessions in real time: a device, the page, and the stream that is recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np

from simfoundry.data.attempt import OpenTask
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.runtime.extras import need_extra
from simfoundry.teleop.device import TeleopDevice
from simfoundry.teleop.devices.dynamixel import DynamixelLeader
from simfoundry.teleop.leader import load_leader
from simfoundry.teleop.links.link import ByteLink, TeleopLink
from simfoundry.teleop.run import (
    TeleopReport,
    create_teleoperator,
    opened_session,
    session_report,
    stream_header,
    teleop_plan,
)
from simfoundry.teleop.session import TeleopSession
from simfoundry.teleop.settings import DeviceOptions, TeleopSettings, action_hz, joint_counts
from simfoundry.teleop.sources import LiveSource
from simfoundry.teleop.stream import MAX_HZ, MIN_HZ, StreamWriter
from simfoundry.teleop.teleoperator import Teleoperator

if TYPE_CHECKING:
    from viser import ViserServer

# Interval between requests to servos [s]: 60 per second, twice the rate of actions. At 57600 bit/s, eight servos answer
# within 20 ms, so slower lines give fewer.
REQUEST_S = 1 / 60


@dataclass(frozen=True)
class DeviceAddress:
    """The place of a device.

    Attributes:
        kind: ``file``, ``tcp``, ``udp``, or empty for the default of the device.
        host: The host of a socket.
        port: The port of a socket.
        path: The file of a device.
    """

    kind: str = ""
    host: str = ""
    port: int = 0
    path: Path | None = None

    @classmethod
    def parse(cls, text: str) -> DeviceAddress:
        """Parse a path, ``tcp://HOST:PORT`` or ``udp://HOST:PORT``.

        Raises:
            SimfoundryError: If it is something else.
        """
        if not text:
            return cls()
        if "://" not in text:
            return cls("file", path=Path(text))
        try:
            parts = urlsplit(text)
            port = parts.port
        except ValueError:
            parts, port = urlsplit(""), None
        if parts.scheme not in ("tcp", "udp") or port is None or parts.path not in ("", "/"):
            raise SimfoundryError(
                f"`{text}` is not an address; use a device file, `tcp://HOST:PORT` or `udp://HOST:PORT`"
            )
        return cls(parts.scheme, parts.hostname or "127.0.0.1", port)


@dataclass(frozen=True)
class LivePlan:
    """A session to run.

    Attributes:
        document: The task document.
        out: The folder of demonstrations.
        device: The name of the device.
        count: The number of demonstrations in the folder after which the session ends.
        seed: The seed of the initial states.
        control_hz: The number of actions per second [Hz]; by default, a multiple of the task's rate.
        options: The options of the device.
        at: The address of the device.
        leader: The description of leader arms of servos, or None.
        stream: The file to which the stream is recorded, or None.
        host: The address at which the page listens.
        port: The port of the page.
        token: The token that browsers must know.
    """

    document: Path
    out: Path
    device: str
    count: int
    seed: int = 0
    control_hz: float | None = None
    options: DeviceOptions = DeviceOptions()  # noqa: RUF009 - it is frozen
    at: DeviceAddress = DeviceAddress()
    leader: Path | None = None
    stream: Path | None = None
    host: str = "localhost"
    port: int = 8080
    token: str = ""


def run_live(
    plan: LivePlan,
    ready: Callable[[str], object] = lambda address: None,
    watch: Callable[[Teleoperator, ViserServer], object] = lambda teleoperator, server: None,
) -> TeleopReport:
    """Run a session until there are enough demonstrations, or until the person ends it.

    Args:
        plan: The session.
        ready: Receives the address of the page, once it is open.
        watch: Receives the policy, whose status can be followed, and the server of the page, before ``ready``.

    Raises:
        SimfoundryError: If the task, the device or the page cannot be opened.
    """
    from simfoundry.teleop.page.server import PageServer, page_token
    from simfoundry.teleop.page.socket import PageSocket
    from simfoundry.teleop.page.window import TeleopWindow

    need_extra("studio", "the page of a teleoperation")
    if plan.control_hz is not None and not MIN_HZ <= plan.control_hz <= MAX_HZ:
        raise SimfoundryError(f"the number of actions per second must be between {MIN_HZ:g} and {MAX_HZ:g}")
    token = page_token(plan.host, plan.token)
    _check_address(plan)
    with ExitStack() as stack:
        opened, store = stack.enter_context(opened_session(teleop_plan(plan.document, plan.out, plan.count, plan.seed)))
        settings = _settings(plan, opened)
        writer = None
        if plan.stream is not None:
            writer = stack.enter_context(StreamWriter(plan.stream, stream_header(opened.task.name, settings)))
        shown: list[Callable[[], object]] = []
        teleoperator = create_teleoperator(
            opened, settings, lambda device: LiveSource(device, settings.control_hz, writer),
            lambda: [refresh() for refresh in shown],
        )  # fmt: skip
        if teleoperator.device.space.of_hand:
            _warm_up(opened)
        source, device = teleoperator.source, teleoperator.device
        assert isinstance(source, LiveSource)
        socket = PageSocket(source, device.name, device.name == "vr" and not plan.at.kind)
        server = stack.enter_context(PageServer(socket, plan.host, plan.port, token))
        window = TeleopWindow(server.viser, opened.task, teleoperator, source, plan.count)
        stack.callback(window.close)
        shown.append(window.refresh)
        stack.enter_context(_linked(plan, settings, device, source, token))
        watch(teleoperator, server.viser)
        ready(server.address)
        session = TeleopSession(store.plan, opened, teleoperator, source, window)
        summary = session.run(store)
    return session_report(teleoperator, summary)


def _warm_up(opened: OpenTask) -> None:
    """Solve inverse kinematics once, because importing its packages takes seconds, which would make an action late."""
    from simfoundry.robots.arm import Arm

    for name in opened.task.robots:
        robot = opened.world.robot(name)
        positions = robot.positions()
        near = np.array([positions[joint] for joint in robot.joints])
        shifted = Pose.of(
            robot.frame("hand").p + np.array([0.0, 0.0, 0.01]), robot.frame("hand").q
        )  # 1 cm, as a command does
        Arm(opened.task.scene.robot(name)).approach(shifted, near)


def _settings(plan: LivePlan, opened: OpenTask) -> TeleopSettings:
    options = plan.options
    if plan.leader is not None:
        options = options.model_copy(
            update={"leader": load_leader(plan.leader, joint_counts(opened.task, opened.world))}
        )
    return TeleopSettings(plan.device, plan.control_hz or action_hz(opened.task), plan.seed, options)


def _check_address(plan: LivePlan) -> None:
    """Check that a device can be at its address.

    Raises:
        SimfoundryError: If it cannot.
    """
    possible = {
        "keyboard": (),
        "gizmo": (),
        "spacemouse": ("file",),
        "joints": ("file", "tcp", "udp"),
        "vr": ("tcp", "udp"),
    }
    kinds, kind = possible[plan.device], plan.at.kind
    if kind and kind not in kinds:
        other = f"can be at {' or '.join(f'`{each}`' for each in kinds)} addresses" if kinds else "is on the page"
        raise SimfoundryError(f"the device `{plan.device}` {other}, not at a `{kind}` address; change --at")
    if plan.device == "joints" and not kind:
        raise SimfoundryError("a leader arm needs its address, such as --at /dev/ttyUSB0 or --at tcp://localhost:6000")
    if plan.leader is not None and (plan.device != "joints" or kind == "udp"):
        raise SimfoundryError("--leader describes servos of the device `joints` at a serial line or a `tcp` address")
    if plan.device == "joints" and kind == "file" and plan.leader is None:
        raise SimfoundryError("a leader arm at a serial line needs --leader, which lists its servos")


@contextmanager
def _linked(
    plan: LivePlan, settings: TeleopSettings, device: TeleopDevice, source: LiveSource, token: str
) -> Iterator[None]:
    """Connect a device for the time of a session. Those of the page are connected by its socket."""
    link = _link(plan, settings, device, source, token)
    if link is None:
        yield
    else:
        with link:
            yield


def _link(
    plan: LivePlan, settings: TeleopSettings, device: TeleopDevice, source: LiveSource, token: str
) -> TeleopLink | None:
    from simfoundry.studio.guard import LOCAL_HOSTS
    from simfoundry.teleop.links.files import baud_constant, open_hid, open_serial
    from simfoundry.teleop.links.sockets import UdpLink, open_tcp

    at = plan.at
    request = device.request if isinstance(device, DynamixelLeader) else b""
    if device.name == "spacemouse":
        return ByteLink(source, "the SpaceMouse", partial(open_hid, at.path))
    if at.kind == "file":
        assert at.path is not None and settings.options.leader is not None
        baud_constant(settings.options.leader.baud)  # a speed that the system does not know is no reason to wait
        connect = partial(open_serial, at.path, settings.options.leader.baud)
        return ByteLink(source, f"the leader arm at {at.path}", connect, request, REQUEST_S)
    if at.kind == "tcp":
        what = f"the device at {at.host}:{at.port}"
        return ByteLink(source, what, partial(open_tcp, at.host, at.port), request, REQUEST_S)
    if at.kind == "udp":
        is_local = at.host in LOCAL_HOSTS
        if not is_local and not plan.token:
            raise SimfoundryError(
                f"everybody can send packets to {at.host}; choose a --token, which packets must contain"
            )
        return UdpLink(source, "127.0.0.1" if at.host == "localhost" else at.host, at.port, "" if is_local else token)
    return None
