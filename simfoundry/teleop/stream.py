"""Streams: everything that enters a session, in its order, as lines of JSON.

The first line is the header. Each further line is an event with its time ``t`` since the start of the session [s]:

==========  ===========================================================================================
key         event
==========  ===========================================================================================
``text``    a packet of the device that is text
``hex``     any other packet, in hexadecimal digits
``lost``    the device is lost, for the stated reason
``found``   the device is back
``press``   a control was pressed on the page, such as ``save``
``start``   an attempt begins at this initial state
``tick``    the next action begins
==========  ===========================================================================================

Recorded streams contain ticks, so that a replay gives each packet to the same action as the session did. Streams
without ticks are replayed by time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.teleop.commands import Control

FORMAT = "teleop_stream/1"

# Largest size of a stream to read [bytes]; a SpaceMouse fills it in three hours, and it takes half a minute to read.
MAX_STREAM_BYTES = 2**28

# Largest line of a stream [bytes]: a packet in hexadecimal digits, and what is around it.
MAX_LINE = 2**14

# Fewest and most actions per second [Hz]. People react within 0.2 s, and devices send at most 1000 packets per second.
# An action takes at least one physics step, which is 2 ms, and 5 ms in coarse scenes.
MIN_HZ, MAX_HZ = 1.0, 200.0

# Largest seed of initial states, as on the command line.
MAX_SEED = 2**31

# Number of decimals of times: microseconds, which keep the order of packets and replay exactly.
TIME_DECIMALS = 6


@dataclass(frozen=True)
class PacketEvent:
    """Data that arrived from the device."""

    time: float
    data: bytes


@dataclass(frozen=True)
class LostEvent:
    """The loss of the device, with its reason."""

    time: float
    reason: str


@dataclass(frozen=True)
class FoundEvent:
    """The return of a device that was lost."""

    time: float


@dataclass(frozen=True)
class PressEvent:
    """A press of a control on the page."""

    time: float
    control: Control


@dataclass(frozen=True)
class StartEvent:
    """The start of an attempt, with the index of its initial state."""

    time: float
    start: int


@dataclass(frozen=True)
class TickEvent:
    """The start of an action."""

    time: float


InputEvent = PacketEvent | LostEvent | FoundEvent | PressEvent
StreamEvent = InputEvent | StartEvent | TickEvent


@dataclass(frozen=True)
class StreamHeader:
    """The facts about a stream that a replay needs.

    Attributes:
        device: The name of the device.
        task: The name of the task.
        seed: The seed of the initial states.
        control_hz: The number of actions per second [Hz].
        options: The options of the device, such as its speed.
    """

    device: str
    task: str
    seed: int
    control_hz: float
    options: Mapping[str, Any]


def event_line(event: StreamEvent) -> str:
    """Return the line of an event."""
    found: dict[str, Any] = {"t": round(event.time, TIME_DECIMALS)}
    match event:
        case PacketEvent(_, data):
            text = data.decode("ascii", errors="replace")
            found |= {"text": text} if text.isprintable() and "\ufffd" not in text else {"hex": data.hex()}
        case LostEvent(_, reason):
            found["lost"] = reason
        case FoundEvent():
            found["found"] = True
        case PressEvent(_, control):
            found["press"] = str(control)
        case StartEvent(_, start):
            found["start"] = start
        case TickEvent():
            found["tick"] = True
    return json.dumps(found)


def parse_event(line: str) -> StreamEvent:
    """Return the event in a line.

    Raises:
        ValueError: If the line is not an event.
    """
    found = json.loads(line)
    if not isinstance(found, dict) or len(found) != 2:
        raise ValueError("it is not an event with a time")
    time = found.pop("t", None)
    if isinstance(time, bool) or not isinstance(time, int | float) or not 0 <= time <= 1e9 or not math.isfinite(time):
        raise ValueError("`t` is not a time in seconds")
    ((key, value),) = found.items()
    match key, value:
        case "text", str():
            return PacketEvent(time, value.encode())
        case "hex", str():
            return PacketEvent(time, bytes.fromhex(value))
        case "lost", str():
            return LostEvent(time, value)
        case "found", True:
            return FoundEvent(time)
        case "press", str():
            return PressEvent(time, Control(value))
        case "start", int() if not isinstance(value, bool) and value >= 0:
            return StartEvent(time, value)
        case "tick", True:
            return TickEvent(time)
    raise ValueError(f"`{str(key)[:20]}` is not an event, or has no valid value")


def read_stream(path: Path) -> tuple[StreamHeader, list[StreamEvent]]:
    """Read a stream. An incomplete last line, which a killed session leaves, is ignored.

    Raises:
        SimfoundryError: If the file is not a stream.
    """
    try:
        if path.stat().st_size > MAX_STREAM_BYTES:
            raise ValueError(f"it is larger than {MAX_STREAM_BYTES // 2**20} MiB")
        lines = path.read_text(encoding="utf-8").split("\n")
        header = _header(lines[0])
        events = list(_events(lines[1:]))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SimfoundryError(f"{path} is not a stream of `simfoundry teleop --record-stream`: {reason}") from None
    return header, events


def _header(line: str) -> StreamHeader:
    found = json.loads(line) if len(line) <= MAX_LINE else None
    if not isinstance(found, dict) or found.get("simfoundry") != FORMAT:
        raise ValueError(f"its first line does not state the format {FORMAT}")
    match found:
        case {"device": str(device), "task": str(task), "seed": int(seed), "control_hz": hz, "options": dict(options)}:
            is_rate = isinstance(hz, int | float) and not isinstance(hz, bool) and MIN_HZ <= hz <= MAX_HZ
            if is_rate and not isinstance(seed, bool) and 0 <= seed <= MAX_SEED:
                return StreamHeader(device, task, seed, float(hz), options)
    raise ValueError("its first line does not state the device, the task, the seed, the frequency and the options")


def _events(lines: list[str]) -> Iterator[StreamEvent]:
    last = 0.0  # packets are in order; what the session adds can be later than a packet that it takes in after that
    for k, line in enumerate(lines[:-1]):
        try:
            if len(line) > MAX_LINE:
                raise ValueError(f"it is longer than {MAX_LINE} characters")
            event = parse_event(line)
            if isinstance(event, PacketEvent) and event.time < last:
                raise ValueError("its time is before that of the packet above")
        except (ValueError, RecursionError) as error:
            raise ValueError(f"line {k + 2} is not valid: {error}") from None
        last = event.time if isinstance(event, PacketEvent) else last
        yield event


class StreamWriter:
    """A stream that is written while a session runs, so that a crash loses at most the last moments."""

    def __init__(self, path: Path, header: StreamHeader) -> None:
        """Create the file.

        Raises:
            OutputError: If it exists.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file: IO[str] = path.open("x", encoding="utf-8", buffering=2**16)
        except FileExistsError:
            raise OutputError(f"{path} exists; choose another name for the stream") from None
        facts = {**asdict(header), "options": dict(header.options)}
        self._file.write(json.dumps({"simfoundry": FORMAT, **facts}) + "\n")

    def write(self, event: StreamEvent) -> None:
        """Add an event."""
        self._file.write(event_line(event) + "\n")
        if isinstance(event, StartEvent | PressEvent | LostEvent):
            self._file.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()


def write_stream(path: Path, header: StreamHeader, events: list[StreamEvent]) -> None:
    """Write a whole stream, such as one that was made without a device."""
    with StreamWriter(path, header) as writer:
        for event in events:
            writer.write(event)
