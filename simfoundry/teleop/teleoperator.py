"""The policy that acts as a person commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Observation, Policy, RobotReading
from simfoundry.geometry.frames import Array
from simfoundry.teleop.commands import (
    Command,
    Control,
    ControlPress,
    GripperTarget,
    HandTarget,
    HandTwist,
    JointTargets,
    SwitchArm,
    TrackedPose,
)
from simfoundry.teleop.device import TeleopDevice
from simfoundry.teleop.motion import ArmMotion, arm_motion
from simfoundry.teleop.sources import EventSource, LiveSource
from simfoundry.teleop.stream import FoundEvent, InputEvent, LostEvent, PacketEvent, PressEvent

# Number of the latest reaction times that are kept: those of some minutes.
MAX_REACTIONS = 10_000

# Largest number of marks in an attempt; a task has a few sub-tasks.
MAX_MARKS = 1000


class AttemptEndedError(SimfoundryError):
    """Raised to end a rollout because the person has asked for something else.

    Attributes:
        control: The request.
    """

    def __init__(self, control: Control) -> None:
        super().__init__(f"the person asked to {control}")
        self.control = control


@dataclass
class TeleopStatus:
    """The state of an attempt, for people.

    Attributes:
        step: The number of actions.
        is_paused: Whether the person has paused it.
        lost: The reason why the device is lost, or an empty string.
        active: The robot that commands without a robot move.
        grippers: The target of each gripper, from 0 (open) to 1 (closed).
        marks: The number of the action at each mark.
        reactions: The times from the arrival of packets to the actions that they changed [s].
    """

    step: int = 0
    is_paused: bool = False
    lost: str = ""
    active: str = ""
    grippers: dict[str, float] = field(default_factory=dict)
    marks: list[int] = field(default_factory=list)
    reactions: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_REACTIONS))

    @property
    def is_waiting(self) -> bool:
        """True while no actions begin."""
        return self.is_paused or bool(self.lost)

    def reaction_ms(self) -> Mapping[str, float]:
        """Return the median, the 95th percentile and the longest time from a packet to its action [ms], if any."""
        times = 1000 * np.array(tuple(self.reactions))
        if not len(times):
            return {}
        found = {"median": np.median(times), "p95": np.percentile(times, 95), "max": times.max()}
        return {name: round(float(value), 1) for name, value in found.items()}


class Teleoperator(Policy):
    """A policy whose actions are the commands of a person.

    A rollout asks it for one action at a time. While the session is paused, it does not answer.

    Attributes:
        device: The device.
        source: The source of the events of the device.
        total_steps: The number of actions in all attempts.
        action_hz: The number of actions per second [Hz].
        status: The state of the attempt.
    """

    name = "teleop"

    def __init__(
        self,
        device: TeleopDevice,
        source: EventSource,
        robots: Iterable[str],
        control_hz: float,
        R_WO: Array,
        scale: float = 1.0,
        changed: Callable[[], object] = lambda: None,
    ) -> None:
        """Act as a device commands.

        Args:
            device: The device.
            source: The source of the events of the device.
            robots: The robots, in the order of the task.
            control_hz: The number of actions per second [Hz].
            R_WO: The rotation from the axes of the operator (forward, left, up) to those of the world.
            scale: Motion of the hand for each meter that a tracked controller moves.
            changed: Called when something has changed that people should see at once.
        """
        self.action_space, self.control_hz, self.action_hz = device.space, control_hz, control_hz
        self.device, self.source, self._changed = device, source, changed
        self._robots = tuple(robots)
        self._motions = {name: arm_motion(device.space, 1.0 / control_hz, R_WO, scale) for name in self._robots}
        self._arrivals: list[float] = []
        self._has_begun = False
        self.total_steps = 0
        self.status = TeleopStatus(active=self._robots[0])

    def motion(self, robot: str) -> ArmMotion:
        """Return the motion of a robot."""
        return self._motions[robot]

    def begin(self, start: int) -> None:
        """Prepare for an attempt at an initial state. Presses from before it have no effect."""
        status = self.status
        self._has_begun = False
        for event in self.source.begin(start):
            self._take_in(event, is_between=True)
        self._arrivals.clear()
        status.step, status.is_paused, status.marks = 0, False, []

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout. :meth:`begin` has prepared for it."""

    def infer(self, observation: Observation) -> Array:
        """Return the next action, when it is time for it.

        Raises:
            AttemptEndedError: If the person ends the attempt.
        """
        robots = observation.privileged().robots
        if not self._has_begun:
            self._begin_motions(robots)
        while True:
            batch = self.source.take(self.status.is_waiting)
            for event in batch.events:
                self._take_in(event)
            if batch.is_tick and not self.status.is_waiting:
                break
            self._arrivals.clear()  # a command waits for the end of a pause, which says nothing about the reaction
            if batch.is_last:
                raise AttemptEndedError(Control.QUIT)
        if isinstance(self.source, LiveSource):
            self.source.tick()
            now = self.source.now
            self.status.reactions.extend(now - time for time in self._arrivals)
        self._arrivals.clear()
        self.status.step += 1
        self.total_steps += 1
        values = [
            value
            for name, motion in self._motions.items()
            for value in (*motion.next(robots[name]), self.status.grippers[name])
        ]
        return np.array([values])

    def _begin_motions(self, robots: Mapping[str, RobotReading]) -> None:
        self._has_begun = True
        for name, motion in self._motions.items():
            motion.begin(robots[name])
            self.status.grippers[name] = float(round(robots[name].gripper))

    def controls(self, events: Iterable[InputEvent]) -> list[Control]:
        """Take in events between attempts, and return the controls among them."""
        found: list[Control] = []
        for event in events:
            found += self._take_in(event, is_between=True)
        return found

    def _take_in(self, event: InputEvent, is_between: bool = False) -> list[Control]:
        """Take in an event. Controls act at once during an attempt, and are returned between attempts."""
        commands: list[Command] = []
        match event:
            case PacketEvent(time, data):
                commands = self.device.feed(data, time)
                self._arrivals += [time] if commands else []
            case LostEvent(_, reason):
                self.status.lost = reason
                commands = self.device.release()
            case FoundEvent():
                self.status.lost = ""
            case PressEvent(_, control):
                commands = [ControlPress(control)]
        controls = [command.control for command in commands if isinstance(command, ControlPress)]
        for command in commands:
            self._apply(command)
        if not is_between:
            for control in controls:
                self._control(control)
        if controls or not isinstance(event, PacketEvent):
            self._changed()
        return controls

    def _control(self, control: Control) -> None:
        status = self.status
        match control:
            case Control.PAUSE:
                status.is_paused = not status.is_paused
            case Control.MARK:
                if len(status.marks) < MAX_MARKS:
                    status.marks.append(status.step)
            case Control.DISCARD | Control.RETRY | Control.QUIT:
                raise AttemptEndedError(control)
            case Control.SAVE:
                pass  # only what has succeeded can be saved

    def _apply(self, command: Command) -> None:
        status = self.status
        match command:
            case SwitchArm():
                self._motions[status.active].accept(HandTwist("", np.zeros(3), np.zeros(3)))
                place = self._robots.index(status.active) + 1
                status.active = self._robots[place % len(self._robots)]
            case GripperTarget(robot, value):
                name = robot or status.active
                if name in self._motions:
                    old = status.grippers.get(name, 0.0)
                    status.grippers[name] = value if value is not None else 0.0 if old > 0.5 else 1.0
            case HandTwist(robot) | HandTarget(robot) | TrackedPose(robot) | JointTargets(robot):
                name = robot or status.active
                if name in self._motions:
                    self._motions[name].accept(command)
