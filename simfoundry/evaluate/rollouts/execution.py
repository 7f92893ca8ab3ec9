"""The execution of actions in a world, with the latency and the noise of the robots."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import accumulate, count
from typing import NamedTuple, Protocol

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.rollouts.control import Controller
from simfoundry.evaluate.rollouts.noise import ActionNoise, NoiseSeed
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.disturbances import ActionDisturbances
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.worlds.base import World

# Maximum number of actions per second [Hz]; a physics step usually takes 2 ms.
MAX_RATE = 1000.0


def physics_steps(step: int, control_hz: float, timestep: float) -> int:
    """Return the number of physics steps in a control step, which is at least 1.

    The end of each control step, rather than its length, is rounded to a physics step, so that rounding errors do not
    accumulate. For example, at 15 Hz and 2 ms per physics step, control steps consist of 33, 34, 33, ... physics steps.
    After 10 s, there have been exactly 150 control steps.

    Args:
        step: The index of the control step, counted from 0.
        control_hz: The control frequency [Hz].
        timestep: The duration of a physics step [s].
    """
    period = 1.0 / (control_hz * timestep)
    return max(1, round((step + 1) * period) - round(step * period))


def check_rate(control_hz: float | None, who: str) -> None:
    """Check the control frequency of a policy, or do nothing if it is None.

    Raises:
        SimfoundryError: If the frequency is not a number between 0 and :data:`MAX_RATE` [Hz].
    """
    if control_hz is None:
        return
    if isinstance(control_hz, bool) or not isinstance(control_hz, int | float) or not 0 < control_hz <= MAX_RATE:
        raise SimfoundryError(
            f"{who} has `control_hz` {control_hz!r}; it must be the number of actions per second, at most {MAX_RATE:g}"
        )


class DelayedSensor(Protocol):
    """A sensor that must be read while an action is executed."""

    @property
    def due(self) -> int | None:
        """The physics step at which the sensor must be read next, or None if it is read on demand."""

    def read(self, now: int) -> None:
        """Read the sensor at the physics step ``now``."""


class _Command(NamedTuple):
    """An action that takes effect at the physics step ``start`` and lasts ``length`` steps."""

    start: int
    length: int
    action: Array


class Execution:
    """The execution of actions in a world, at a frequency that may differ from the task's.

    Action ``k`` starts at the time k / ``action_hz`` and lasts until the next action starts; control step ``j`` of the
    task ends at (j + 1) / ``control_hz``. Both times are rounded to physics steps, without accumulating errors. A slow
    policy's action therefore lasts for several control steps, and a fast policy acts several times in a control step.

    With a latency, each action takes effect later by this time, also rounded to physics steps. Until the first action
    takes effect, the robots hold their positions.

    Attributes:
        actions: The number of actions that have started.
        steps: The number of control steps that have ended.
        now: The number of physics steps since the start.
        delay: The latency of actions, in physics steps.
        captures: Sensors with latency, which are read during actions.
    """

    def __init__(
        self,
        world: World,
        robots: Iterable[str],
        space: ActionSpace,
        control_hz: float,
        action_hz: float | None = None,
        disturbances: ActionDisturbances | None = None,
        seed: NoiseSeed = (0, 0),
        step: Callable[[int], object] | None = None,
    ) -> None:
        """Prepare to execute actions.

        Args:
            world: The world.
            robots: The names of the robots, in the order of an action.
            space: The meaning of the numbers in an action.
            control_hz: The number of control steps of the task per second [Hz].
            action_hz: The number of actions per second [Hz]; by default, one in each control step.
            disturbances: The latency and noise of actions; none by default.
            seed: The seed of the noise.
            step: Function that advances the world by a number of physics steps; by default, ``world.step``.
        """
        self._world, self._control_hz = world, control_hz
        self._step = step or world.step
        self.action_hz = control_hz if action_hz is None else float(action_hz)
        about = disturbances or ActionDisturbances()
        noise = ActionNoise(about, seed) if about.joint_noise or about.gripper_noise else None
        self.controller = Controller(world, robots, space, self.action_hz, noise)
        self.actions = self.steps = self.now = 0
        self.captures: tuple[DelayedSensor, ...] = ()
        self.delay = round(about.latency / world.timestep)
        self._waiting: deque[_Command] = deque()
        self._current: _Command | None = None
        self._step_end = physics_steps(0, control_hz, world.timestep)
        lengths = (physics_steps(k, self.action_hz, world.timestep) for k in count())
        self._next_starts = accumulate(lengths, initial=0)
        self._starts: list[int] = []

    @property
    def is_between_steps(self) -> bool:
        """True if the last action ended within a control step."""
        return self._step_end - self.now < physics_steps(self.steps, self._control_hz, self._world.timestep)

    def start_of(self, action: int) -> int:
        """Return the physics step at which an action starts, before its latency."""
        while len(self._starts) <= action:
            self._starts.append(next(self._next_starts))
        return self._starts[action]

    def act(self, action: Array) -> Iterator[int]:
        """Execute an action, and yield the number of ended control steps whenever a control step has ended.

        If the caller stops iterating, the rest of the action is not executed.
        """
        start, end = self.start_of(self.actions), self.start_of(self.actions + 1)
        self.actions += 1
        self._waiting.append(_Command(start + self.delay, end - start, action))
        yield from self._until(end)

    def _until(self, end: int) -> Iterator[int]:
        """Advance to a physics step, and yield the number of ended control steps whenever a control step has ended."""
        while self.now < end:
            if self._waiting and self._waiting[0].start == self.now:
                self._current = self._waiting.popleft()
                self.controller.begin(self._current.action)
            until = min(end, self._step_end, self._waiting[0].start if self._waiting else end)
            if self._current is not None:
                self.controller.move((until - self.now) / self._current.length)
            self._advance(until)
            if self.now == self._step_end:
                self.steps += 1
                self._step_end += physics_steps(self.steps, self._control_hz, self._world.timestep)
                yield self.steps

    def finish(self) -> None:
        """Advance the world by the latency, until the last action has taken effect for its whole duration."""
        for _ in self._until(self.now + self.delay):
            pass

    def _advance(self, until: int) -> None:
        """Advance the physics to a step, and read the sensors that are due before it."""
        while self.now < until:
            for sensor in self.captures:
                sensor.read(self.now)
            due = [sensor.due for sensor in self.captures]
            stop = min([until, *(step for step in due if step is not None)])
            self._step(stop - self.now)
            self.now = stop
