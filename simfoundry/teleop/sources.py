"""Sources of events: a device in real time, or a recorded stream as fast as the computer can."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Condition

from simfoundry.errors import SimfoundryError
from simfoundry.teleop.commands import Control
from simfoundry.teleop.device import TeleopDevice
from simfoundry.teleop.stream import (
    TIME_DECIMALS,
    FoundEvent,
    InputEvent,
    LostEvent,
    PacketEvent,
    PressEvent,
    StartEvent,
    StreamEvent,
    StreamWriter,
    TickEvent,
)

# Largest number of events that wait for the next action. Devices send at most 1000 per second, which makes 100 at an
# action rate of 10 Hz; more are a flood, of which the oldest are dropped and counted.
MAX_WAITING = 1000

# Interval at which a paused session looks for events [s]; shorter than people notice.
PAUSED_LOOK_S = 0.05


@dataclass(frozen=True)
class EventBatch:
    """Events that arrived.

    Attributes:
        events: The events.
        is_tick: Whether an action begins after them.
        is_last: Whether a recorded session ended with them.
    """

    events: tuple[InputEvent, ...]
    is_tick: bool
    is_last: bool = False


class EventSource(ABC):
    """A source of events for a session."""

    @abstractmethod
    def begin(self, start: int) -> tuple[InputEvent, ...]:
        """Begin an attempt at an initial state, and return the events that arrived since the last one."""

    @abstractmethod
    def take(self, is_paused: bool) -> EventBatch:
        """Return the next events: those until the next action begins, or any events while the session is paused."""

    @abstractmethod
    def decide(self) -> tuple[InputEvent, ...] | None:
        """Return the next events after the end of an attempt, or None if there will never be any."""


@dataclass
class Pace:
    """The pace of a session.

    Attributes:
        steps: The number of actions.
        late: The number of actions that began late, because those before them took too long.
    """

    steps: int = 0
    late: int = 0


class LiveSource(EventSource):
    """The events of a device, which other threads put in, and the pace of real time.

    Attributes:
        dropped: The number of events that were dropped in floods.
        refused: The number of packets that links refused, by reason.
        pace: The number of actions and of late ones.
    """

    def __init__(self, device: TeleopDevice, control_hz: float, writer: StreamWriter | None = None) -> None:
        self._device, self._period, self._writer = device, 1.0 / control_hz, writer
        self._waiting: deque[InputEvent] = deque(maxlen=MAX_WAITING)
        self._changed = Condition()
        self._origin = time.monotonic()
        self._next: float | None = None
        self._lost, self._is_silent = "", False
        self._alive_since = self._looked = 0.0
        self.dropped = 0
        self.refused: Counter[str] = Counter()
        self.pace = Pace()

    @property
    def now(self) -> float:
        """The time since the start of the session [s]."""
        return round(time.monotonic() - self._origin, TIME_DECIMALS)

    # -- from any thread ----------------------------------------------------------------------------------------------

    def packet(self, data: bytes) -> None:
        """Put in data that arrived from the device."""
        with self._changed:
            self._put(PacketEvent(self.now, data))

    def refuse(self, reason: str) -> None:
        """Count a packet that is not even put in. Reasons must come from the program, so there are only a few."""
        with self._changed:
            self.refused[reason] += 1

    def press(self, control: Control) -> None:
        """Put in the press of a control on the page."""
        with self._changed:
            self._put(PressEvent(self.now, control))

    def lost(self, reason: str) -> None:
        """State that the device is lost."""
        with self._changed:
            if self._lost != reason:
                self._lost = reason
                self._put(LostEvent(self.now, reason))

    def found(self) -> None:
        """State that the device is connected."""
        with self._changed:
            if self._lost:
                self._lost, self._alive_since = "", self.now
                self._put(FoundEvent(self.now))

    def _put(self, event: InputEvent) -> None:
        """Add an event, with the lock held, so that events are in the order of their times."""
        self.dropped += len(self._waiting) == MAX_WAITING
        self._waiting.append(event)
        self._changed.notify()

    # -- from the thread of the session -------------------------------------------------------------------------------

    def begin(self, start: int) -> tuple[InputEvent, ...]:
        """Begin an attempt. The next action begins at once."""
        events = self._drain()
        self._write(StartEvent(self.now, start))
        self._next, self._alive_since = None, self.now
        return events

    def take(self, is_paused: bool) -> EventBatch:
        """Wait for the next action, or for events while the session is paused."""
        if is_paused:
            self._next = None
            with self._changed:
                if not self._waiting:
                    self._changed.wait(PAUSED_LOOK_S)
            return EventBatch((*self._drain(), *self._silence()), False)
        now = time.monotonic()
        due = now if self._next is None else self._next
        if now < due:
            time.sleep(due - now)
        events = (*self._drain(), *self._silence())
        if not any(isinstance(event, LostEvent) for event in events):
            self._pace_on(due)
        return EventBatch(events, True)

    def _pace_on(self, due: float) -> None:
        """Count an action that was due at a time, and schedule the next one."""
        now = time.monotonic()
        is_late = now - due > self._period
        self.pace.steps += 1
        self.pace.late += is_late
        self._next = (now if is_late else due) + self._period

    def tick(self) -> None:
        """Record that an action begins."""
        self._write(TickEvent(self.now))

    def decide(self) -> tuple[InputEvent, ...]:
        """Wait for events after the end of an attempt."""
        return self.take(is_paused=True).events

    def _silence(self) -> tuple[InputEvent, ...]:
        """Return the event that a device has become silent, or that it is back."""
        longest, heard = self._device.silence_s, self._device.heard_at
        looked, self._looked = self._looked, self.now
        if self._lost:
            return ()
        # Packets that arrived before the last look have been parsed by now.
        is_silent = longest is not None and (heard is None or looked - max(heard, self._alive_since) > longest)
        if is_silent == self._is_silent:
            return ()
        self._is_silent = is_silent
        event: InputEvent = FoundEvent(self.now)
        if is_silent:
            refusal = self._device.last_refusal
            cause = f"; its last packet was refused: {refusal}" if refusal else ""
            silence = "has not sent a valid packet yet" if heard is None else f"has been silent for {longest:g} s"
            event = LostEvent(self.now, f"the {self._device.title} {silence}{cause}")
        self._write(event)
        return (event,)

    def _drain(self) -> tuple[InputEvent, ...]:
        with self._changed:
            events = tuple(self._waiting)
            self._waiting.clear()
        for event in events:
            self._write(event)
        return events

    def _write(self, event: StreamEvent) -> None:
        if self._writer is not None:
            self._writer.write(event)


class ReplaySource(EventSource):
    """The events of a recorded stream."""

    def __init__(self, events: Sequence[StreamEvent], control_hz: float, silence_s: float | None) -> None:
        """Replay events.

        Args:
            events: The events. If there are ticks among them, they decide when actions begin; otherwise, times do.
            control_hz: The number of actions per second [Hz].
            silence_s: The time after which a silent device pauses the session [s], or None.
        """
        self._is_ticked = any(isinstance(event, TickEvent) for event in events)
        self._events = deque(events if self._is_ticked else sorted(events, key=lambda event: event.time))
        self._period, self._silence_s = 1.0 / control_hz, silence_s
        self._time: float | None = None

    @property
    def is_exhausted(self) -> bool:
        """True after the last event."""
        return not self._events

    def begin(self, start: int) -> tuple[InputEvent, ...]:
        """Go on with the next attempt of the stream.

        Raises:
            SimfoundryError: If that attempt began at another initial state.
        """
        self._time = None
        if not any(isinstance(event, StartEvent) for event in self._events):
            return ()
        events = self._until_start()
        found = self._events.popleft()
        if isinstance(found, StartEvent) and found.start != start:
            raise SimfoundryError(
                f"the stream was recorded at initial state {found.start}, but the next one here is {start}; replay it "
                "into a new folder, with the seed of the session"
            )
        return events

    def take(self, is_paused: bool) -> EventBatch:
        """Return the events until the next action."""
        if self._is_ticked:
            return self._until_tick()
        if is_paused:
            event = self._events.popleft() if self._events else None
            self._time = None
            return EventBatch((event,) if isinstance(event, InputEvent) else (), False, event is None)
        return EventBatch(self._due(), True)

    def _until_start(self) -> tuple[InputEvent, ...]:
        """Remove and return the events before the next attempt."""
        found: list[InputEvent] = []
        while self._events and not isinstance(self._events[0], StartEvent):
            event = self._events.popleft()
            if isinstance(event, InputEvent):
                found.append(event)
        return tuple(found)

    def _until_tick(self) -> EventBatch:
        """Remove and return the events before the next action of the same attempt."""
        found: list[InputEvent] = []
        while self._events and not isinstance(self._events[0], StartEvent):
            event = self._events.popleft()
            if isinstance(event, TickEvent):
                return EventBatch(tuple(found), True)
            if isinstance(event, InputEvent):
                found.append(event)
        return EventBatch(tuple(found), False, True)

    def _due(self) -> tuple[InputEvent, ...]:
        """Return the events until the next action by their times. Silence, in which a session pauses, takes no time."""
        if not self._events:
            return ()
        self._time = self._events[0].time if self._time is None else self._time + self._period
        found: list[InputEvent] = []
        if self._silence_s is not None and self._events[0].time - self._time > self._silence_s:
            lost = LostEvent(self._time, f"the device has been silent for {self._silence_s:g} s")
            self._time = self._events[0].time
            found += [lost, FoundEvent(self._time)]
        while self._events and self._events[0].time <= self._time:
            event = self._events.popleft()
            if isinstance(event, InputEvent):
                found.append(event)
        return tuple(found)

    def decide(self) -> tuple[InputEvent, ...] | None:
        """Return the next event."""
        while self._events and not isinstance(self._events[0], StartEvent):
            event = self._events.popleft()
            if isinstance(event, InputEvent):
                return (event,)
        return None
