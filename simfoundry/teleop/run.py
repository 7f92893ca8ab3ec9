"""Run sessions: in real time with a device, or again from a recorded stream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from simfoundry.data.attempt import OpenTask, close, open_task
from simfoundry.data.plan import RecordPlan
from simfoundry.data.record import recording_folder
from simfoundry.data.store import AttemptStore
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import need_robots
from simfoundry.runtime.extras import need_extra
from simfoundry.teleop.device import TeleopDevice
from simfoundry.teleop.session import SilentView, TeleopContender, TeleopSession, TeleopSummary, check_valid
from simfoundry.teleop.settings import (
    TeleopSettings,
    create_device,
    joint_counts,
    operator_rotation,
    parse_options,
)
from simfoundry.teleop.sources import EventSource, LiveSource, ReplaySource
from simfoundry.teleop.stream import StreamHeader, read_stream
from simfoundry.teleop.teleoperator import Teleoperator

# Largest number of demonstrations of a session, and the number of attempts after which a session of a person ends: more
# than anybody makes.
MAX_COUNT = 100_000
MAX_ATTEMPTS = 10 * MAX_COUNT


@dataclass(frozen=True)
class TeleopReport:
    """The results of a session, and how well it went.

    Attributes:
        device: The name of the device.
        action_hz: The number of actions per second [Hz].
        summary: The attempts.
        steps: The number of actions.
        late: The number of actions that began late, or 0 for a replay.
        refused: The number of refused packets, by reason.
        dropped: The number of packets that were dropped in floods.
        reaction_ms: The median, the 95th percentile and the longest time from the arrival of a packet to its action
            [ms], if measured.
    """

    device: str
    action_hz: float
    summary: TeleopSummary
    steps: int
    late: int
    refused: Mapping[str, int]
    dropped: int
    reaction_ms: Mapping[str, float]


def teleop_plan(document: Path, out: Path, count: int, seed: int) -> RecordPlan:
    """Return the plan of a recording by a person."""
    return RecordPlan(out, (document.resolve(),), TeleopContender(), count, MAX_ATTEMPTS, seed)


@contextmanager
def opened_session(plan: RecordPlan) -> Iterator[tuple[OpenTask, AttemptStore]]:
    """Open the task and the folder of a plan for the time of a session."""
    with ExitStack() as stack:
        stack.callback(close)
        opened = open_task(plan.documents[0])
        need_robots(opened.task)
        stack.enter_context(recording_folder(plan.folder))
        yield opened, AttemptStore(plan)


def create_teleoperator(
    opened: OpenTask,
    settings: TeleopSettings,
    source: Callable[[TeleopDevice], EventSource],
    changed: Callable[[], object] = lambda: None,
) -> Teleoperator:
    """Return the policy of a session.

    Args:
        opened: The task.
        settings: The settings of the session.
        source: Function that returns the source of the events of the device.
        changed: Called when something has changed that people should see at once.
    """
    task = opened.task
    device = create_device(settings.device, settings.options, joint_counts(task, opened.world))
    if device.space.of_hand:
        need_extra("expert", f"the device `{device.name}`, which moves hands,")
    R_WO = operator_rotation(task, settings.options.yaw_deg)
    return Teleoperator(device, source(device), task.robots, settings.control_hz, R_WO, settings.options.scale, changed)


def replay_session(document: Path, stream: Path, out: Path, count: int = MAX_COUNT) -> TeleopReport:
    """Run a session again from its stream, as fast as possible.

    Raises:
        SimfoundryError: If the stream is not valid, or if it belongs to another task.
    """
    header, events = read_stream(stream)
    settings = TeleopSettings(header.device, header.control_hz, header.seed, parse_options(header.options))
    with opened_session(teleop_plan(document, out, count, header.seed)) as (opened, store):
        if header.task != opened.task.name:
            raise SimfoundryError(f"{stream} was recorded for the task `{header.task}`, not for `{opened.task.name}`")
        teleoperator = create_teleoperator(
            opened, settings, lambda device: ReplaySource(events, settings.control_hz, device.silence_s)
        )
        source = teleoperator.source
        assert isinstance(source, ReplaySource)
        session = TeleopSession(store.plan, opened, teleoperator, source, SilentView())
        summary = session.run(store, until=lambda: source.is_exhausted)
        check_valid(teleoperator)
    return session_report(teleoperator, summary)


def session_report(teleoperator: Teleoperator, summary: TeleopSummary) -> TeleopReport:
    """Return the report of a session that has ended."""
    device, source = teleoperator.device, teleoperator.source
    refused = Counter(device.refused)
    late = dropped = 0
    if isinstance(source, LiveSource):
        refused += source.refused
        late, dropped = source.pace.late, source.dropped
    reaction = teleoperator.status.reaction_ms()
    steps, hz = teleoperator.total_steps, teleoperator.action_hz
    return TeleopReport(device.name, hz, summary, steps, late, dict(sorted(refused.items())), dropped, reaction)


def stream_header(task: str, settings: TeleopSettings) -> StreamHeader:
    """Return the header of a stream of a session."""
    options = settings.options.model_dump(mode="json", exclude_none=True)
    return StreamHeader(settings.device, task, settings.seed, settings.control_hz, options)
