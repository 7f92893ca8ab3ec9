"""Demonstrations sampled at the frames of a dataset: observations, and the targets that the robots were given.

Frame k starts at the time k / ``hz``. Its observation is the state at that time, and its action is what the robots were
commanded until the next frame. The last frame ends with the demonstration, and may be shorter than the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simfoundry.data.attempt import ENGINE, state_arrays
from simfoundry.data.demonstrations import Demonstration
from simfoundry.evaluate.policies.base import RobotReading
from simfoundry.evaluate.rollouts.control import readings
from simfoundry.evaluate.rollouts.execution import Execution, check_rate
from simfoundry.evaluate.rollouts.rollout import Moment
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import Scene
from simfoundry.spec.models.signals import ActionKind, ActionSpace
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World

# Tolerance in the number of frames, so that rounding does not add one: 0.1 s at 30 Hz are 3.0000000000000004 frames.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A demonstration at the frames of a dataset. T is the number of frames.

    Attributes:
        hz: The number of frames per second [Hz].
        observations: The states at the start of each frame and after the last one, keyed as in
            :attr:`Demonstration.states`, float64; the first axis has T + 1 rows.
        targets: The joint targets of each robot [rad or m], shape (T + 1, joints): before the first action, and at the
            end of each frame.
        grippers: The target of each gripper at the end of each frame, from 0 (open) to 1 (closed), shape (T,).
        recorded: The recorded actions, if there is exactly one for each frame, shape (T, action size); else None.
        recorded_space: The action space of the demonstration.
        is_held: True if all targets were constant within each frame, so that ``targets`` contains all of them.
    """

    hz: float
    observations: Mapping[str, Array]
    targets: Mapping[str, Array]
    grippers: Mapping[str, Array]
    recorded: Array | None
    recorded_space: ActionSpace
    is_held: bool

    @property
    def length(self) -> int:
        """The number of frames T."""
        return len(self.observations["objects"]) - 1

    @property
    def robots(self) -> tuple[str, ...]:
        """The names of the robots that act, in the order of an action."""
        return tuple(self.targets)

    def readings(self, scene: Scene) -> list[dict[str, RobotReading]]:
        """Return the readings of the robots, as a policy would observe them, in T + 1 mappings keyed by robot."""
        bases = {name: scene.robot(name).X_WB.inverse() for name in self.robots}
        rows: list[dict[str, RobotReading]] = []
        for k in range(self.length + 1):
            found = {}
            for name, X_BW in bases.items():
                X_WH = Pose.of(self.observations[f"{name}/hand"][k, :3], self.observations[f"{name}/hand"][k, 3:])
                closed = float(self.observations[f"{name}/gripper"][k, 0])
                found[name] = RobotReading(self.observations[f"{name}/joints"][k], closed, X_WH, X_BW @ X_WH)
            rows.append(found)
        return rows


def frame_count(steps: int, control_hz: float, hz: float) -> int:
    """Return the number of frames of a demonstration of ``steps`` control steps, which is at least 1."""
    return max(1, math.ceil(steps * hz / control_hz - ROUNDING))


class TrajectorySampler:
    """Samples demonstrations of one task. Close it after use, or use it in a ``with`` statement.

    Recorded states and joint targets are used if they are those of the frames. Otherwise, the demonstration is replayed
    in a world, which is opened when it is first needed.
    """

    def __init__(self, task: Task) -> None:
        self.task = task

    @cached_property
    def world(self) -> World:
        """The world in which demonstrations are replayed."""
        return open_world(self.task.scene, ENGINE)

    def __enter__(self) -> TrajectorySampler:
        """Return the sampler."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the sampler."""
        self.close()

    def close(self) -> None:
        """Close the world."""
        if "world" in self.__dict__:
            self.__dict__.pop("world").close()

    def sample(self, demonstration: Demonstration, hz: float | None = None) -> Trajectory:
        """Return a demonstration at ``hz`` frames per second [Hz], by default the control frequency of the task.

        Raises:
            SimfoundryError: If the frequency is not positive, or exceeds :data:`MAX_RATE`.
        """
        hz = self.task.control_hz if hz is None else hz
        check_rate(hz, "a dataset")
        control_hz = self.task.control_hz
        space = demonstration.action_space
        is_stored = hz == control_hz == demonstration.action_hz and len(demonstration.actions) == demonstration.steps
        if is_stored and space == ActionSpace.JOINT_POSITION:
            return self._stored(demonstration)
        return self._replayed(demonstration, hz)

    def _stored(self, demonstration: Demonstration) -> Trajectory:
        """Return the trajectory of a demonstration whose actions are the joint targets of the frames."""
        states, actions = demonstration.states, demonstration.actions
        targets, grippers, start = {}, {}, 0
        for name in self.task.robots:
            end = start + states[f"{name}/joints"].shape[1]
            targets[name] = np.concatenate([states[f"{name}/joints"][:1], actions[:, start:end]])
            grippers[name] = np.clip(actions[:, end], 0.0, 1.0)
            start = end + 1
        space = demonstration.action_space
        return Trajectory(self.task.control_hz, states, targets, grippers, actions, space, is_held=True)

    def _replayed(self, demonstration: Demonstration, hz: float) -> Trajectory:
        task, space = self.task, demonstration.action_space
        frames = frame_count(demonstration.steps, task.control_hz, hz)
        recorder = _Recorder(self.world, demonstration, task, frames, hz)
        recorder.run()
        rate = hz / demonstration.action_hz
        has_one_each = rate == 1.0 and len(demonstration.actions) == frames
        is_held = space.kind is not ActionKind.JOINT_VELOCITY and rate >= 1 and abs(rate - round(rate)) < ROUNDING
        return Trajectory(
            hz=hz,
            observations=state_arrays(tuple(recorder.moments)),
            targets={name: np.array(rows) for name, rows in recorder.targets.items()},
            grippers={name: np.array(rows[1:]) for name, rows in recorder.grippers.items()},
            recorded=demonstration.actions if has_one_each else None,
            recorded_space=space,
            is_held=is_held,
        )


class _Recorder:
    """A replay that notes the state at the end of each frame, and the targets that were commanded until then.

    Physics steps are counted, so that frames may end within a control step without changing the trajectory. A target
    that takes effect later because of a latency belongs to the frame in which it was commanded.
    """

    def __init__(self, world: World, demonstration: Demonstration, task: Task, frames: int, hz: float) -> None:
        start = demonstration.start
        world.reset(start.state)
        self._world, self._actions = world, demonstration.actions
        rates, about = (task.control_hz, demonstration.action_hz), task.disturbances.action
        seed = start.seed, start.index
        self._execution = Execution(
            world, task.robots, demonstration.action_space, *rates, about, seed, step=self._step
        )
        ends = [round(k / (hz * world.timestep)) for k in range(1, frames)]
        ends.append(round(demonstration.steps / (task.control_hz * world.timestep)))
        self._ends, self._late_ends = ends, [end + self._execution.delay for end in ends]
        self._now = 0
        self.moments: list[Moment] = []
        self.targets: dict[str, list[list[float]]] = {name: [] for name in task.robots}
        self.grippers: dict[str, list[float]] = {name: [] for name in task.robots}

    def run(self) -> None:
        """Execute the actions until the last frame has ended, and its targets have taken effect."""
        self._note_state()
        self._note_targets()
        for action in self._actions:
            for _ in self._execution.act(action):
                pass
        self._execution.finish()

    def _step(self, n: int) -> None:
        last = self._now + n
        while self._now < last:
            marks = self._next(self._ends, len(self.moments)), self._next(self._late_ends, len(self._noted))
            until = min(last, *marks)
            self._world.step(until - self._now)
            self._now = until
            if until == marks[0]:
                self._note_state()
            if until == marks[1]:
                self._note_targets()

    @property
    def _noted(self) -> list[float]:
        return next(iter(self.grippers.values()))

    def _next(self, ends: list[int], noted: int) -> int:
        """Return the next physics step to note, or a step after all others."""
        return ends[noted - 1] if noted <= len(ends) else self._late_ends[-1] + self._now + 1

    def _note_state(self) -> None:
        self.moments.append((self._world.state(), readings(self._world, self._execution.controller.robots)))

    def _note_targets(self) -> None:
        controller = self._execution.controller
        for name, targets in controller.targets.items():
            self.targets[name].append(list(targets.values()))
            self.grippers[name].append(controller.grippers[name])
