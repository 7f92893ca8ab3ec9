"""A single rollout, in which a policy acts from an initial state until the goal has held or can no longer be reached.

A sub-task remains completed once its goal has held. The goal of the task must hold for several control steps.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from simfoundry.evaluate.actions import action_size, checked_actions
from simfoundry.evaluate.policies.base import (
    GaveUpError,
    Image,
    ImageSize,
    InvalidAnswerError,
    Observation,
    Policy,
    PolicyError,
    RobotReading,
)
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.clearance import Clearances
from simfoundry.evaluate.rollouts.clock import RolloutClock, Timings
from simfoundry.evaluate.rollouts.control import check_cameras, pictures, readings
from simfoundry.evaluate.rollouts.execution import Execution, check_rate
from simfoundry.evaluate.rollouts.sensors import Sensors
from simfoundry.evaluate.task import Task, need_robots
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge, StateBatch
from simfoundry.runtime.workers import report_progress
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import parse_call, texts
from simfoundry.spec.models.signals import ImageKind
from simfoundry.worlds.base import World

# Number of consecutive control steps (0.2 s at 15 Hz) for which the goal must be true, so that states in which it holds
# only momentarily do not count.
HOLD = 3


class Progress:
    """The progress of a task over successive states.

    A sub-task is completed at the first state in which its goal holds, and remains completed. If its goal already holds
    initially, such as `Closed(drawer)` before the drawer is opened, it must first become false. The task is completed
    once its goal has been true :data:`HOLD` times in a row.
    """

    def __init__(self, task: Task, judge: Judge, start: SceneState) -> None:
        self._task, self._judge, self._clearances = task, judge, Clearances(task.scene, judge)
        self._held = 0
        self._waiting = {name for name, step in task.subtasks.items() if judge(step.goal, start).value}
        # The control step at which each sub-task was completed, counted from 1, or None if it was not completed.
        self.subtasks: dict[str, int | None] = dict.fromkeys(task.subtasks)

    def see(self, step: int, state: SceneState) -> bool:
        """Evaluate the state after control step ``step``, counted from 1.

        Returns:
            True if the task is now completed.
        """
        return self.see_all(step, [state]) is not None

    def see_all(self, step: int, states: Sequence[SceneState]) -> int | None:
        """Evaluate consecutive states.

        All states are evaluated in one batch, which takes hardly longer than evaluating a single state. States after
        completion are ignored.

        Args:
            states: The states.
            step: The control step after which the first state was reached, counted from 1.

        Returns:
            The index of the state that completes the task, or None.
        """
        goals = {name: self._task.subtasks[name].goal for name, done in self.subtasks.items() if done is None}
        goals[""] = self._task.goal
        holds = {name: np.zeros(len(states), bool) for name in goals}
        if len(states) == 1:  # for many states, bounds would take longer than the batch
            goals = {name: goal for name, goal in goals.items() if not self._clearances.excludes(goal, states[0])}
        if goals:
            holds |= self._judge.holds(goals, StateBatch.of(self._task.scene, states))
        for k in range(len(states)):
            for name in holds.keys() - {""}:
                if not holds[name][k]:
                    self._waiting.discard(name)
                elif name not in self._waiting and self.subtasks[name] is None:
                    self.subtasks[name] = step + k
            self._held = self._held + 1 if holds[""][k] else 0
            if self._held >= HOLD:
                return k
        return None


# Distance [m] below the lowest point of the initial scene at which an object counts as fallen; it is less than the
# height of a table.
FALLEN = 0.3


class RolloutEnd(StrEnum):
    """The reason why a rollout ended."""

    SUCCESS = "success"
    HORIZON = "horizon"
    FELL = "fell"
    DIVERGED = "diverged"
    INVALID = "invalid answer"
    """The policy returned an error or something other than actions, so the rollout failed."""
    GAVE_UP = "gave up"
    """The policy stated that it cannot succeed, so the rollout failed."""
    NO_ANSWER = "no answer"
    """The policy could not be queried or the connection was lost, so the rollout has no result and counts as missing.
    """


@dataclass(frozen=True)
class Video:
    """The images to record during a rollout.

    One image is recorded from each camera in ``cameras`` every ``every`` control steps.
    """

    cameras: Mapping[str, ImageSize]
    every: int = 1


# A state with the readings of the robots.
Moment = tuple[SceneState, Mapping[str, RobotReading]]


@dataclass(frozen=True, eq=False)
class Rollout:
    """The result of a rollout.

    Attributes:
        success: True if the goal was reached.
        steps: The number of control steps that were executed.
        subtasks: The step at which each sub-task was completed, counted from 1, or None if it was not completed.
        end: The reason why the rollout ended.
        reason: The details of a failure.
        actions: The actions that were executed, shape (actions, action size). There is one per step, unless the policy
            has a different control frequency.
        action_hz: The number of actions per second [Hz].
        digest: A hash that identifies the trajectory exactly.
        chunks: The number of requests to the policy.
        timings: The time spent on each part of the rollout.
        final: The last state.
        frames: The recorded images, keyed by camera.
        trace: The state and the readings of the robots at the start and after each step, if requested.
    """

    task: str
    step: str
    policy: str
    index: int
    seed: int
    success: bool
    steps: int
    subtasks: Mapping[str, int | None]
    end: RolloutEnd
    reason: str
    actions: Array
    action_hz: float
    digest: str
    chunks: int
    timings: Timings
    final: SceneState
    frames: Mapping[str, tuple[Image, ...]] = field(default_factory=lambda: MappingProxyType({}))
    trace: tuple[Moment, ...] = ()


def rollout(
    task: Task,
    start: RolloutStart,
    policy: Policy,
    world: World,
    judge: Judge | None = None,
    video: Video | None = None,
    trace: bool = False,
    watch: Callable[[SceneState], object] | None = None,
) -> Rollout:
    """Run a policy from an initial state in a world with the task's scene.

    The policy is queried again after all actions in a response have been executed. Images are rendered only for the
    policy and for ``video``. If the policy returns something other than actions, the rollout fails. If the policy does
    not respond, the rollout has no result.

    Args:
        task: The task.
        start: The initial state.
        policy: The policy to run.
        world: A world with the scene of the task.
        judge: A judge to reuse across rollouts. By default, a new judge is created.
        video: The images to record.
        trace: Whether to record all states.
        watch: Function that receives the state at the start and after each step, as soon as it is reached.

    Raises:
        SimfoundryError: If robots or cameras are missing.
    """
    need_robots(task)
    video = video or Video({})
    check_cameras(task.scene, policy.cameras, f"policy `{policy.name}`")
    check_rate(policy.control_hz, f"policy `{policy.name}`")
    check_cameras(task.scene, video.cameras, "the video")
    run = _Run(task, start, policy, world, judge or Judge(task.scene), video, trace, watch)
    return run.result(*run.play())


class _Run:
    """A rollout in progress."""

    def __init__(
        self, task: Task, start: RolloutStart, policy: Policy, world: World, judge: Judge, video: Video, trace: bool,
        watch: Callable[[SceneState], object] | None,
    ) -> None:  # fmt: skip
        self.task, self.start, self.policy, self.world, self.video = task, start, policy, world, video
        self.watch = watch
        self.clock = RolloutClock()
        with self.clock("physics"):
            world.reset(start.state)
            self.state = world.state()
        about, seed = task.disturbances, (start.seed, start.index)
        space, rates = policy.action_space, (task.control_hz, policy.control_hz)
        self.execution = Execution(world, task.robots, space, *rates, about.action, seed)
        self.robots = self.execution.controller.robots
        self.sensors = Sensors(world, self.execution, policy.cameras, policy.image_kinds, about.observation, seed)
        with self.clock("judge"):
            self.progress = Progress(task, judge, self.state)
        objects = task.scene.objects
        self.floor = min((float(world_bounds(o, o.X_WO)[0][2]) for o in objects), default=0.0) - FALLEN
        # Once a free object in the goal has fallen off the scene, the goal can no longer be reached.
        named = {argument.partition(".")[0] for text, _ in texts(task.goal) for argument in parse_call(text).args}
        self.judged = [item.name for item in objects if item.name in named and not item.fixed]
        self.actions: list[Array] = []
        self.steps = self.chunks = 0
        self._unhashed = 0
        self.frames: dict[str, list[Image]] = {name: [] for name in video.cameras}
        self.hash = hashlib.sha256()
        self.trace: list[Moment] | None = [] if trace else None
        self._note()

    def play(self) -> tuple[RolloutEnd, str]:
        """Run until the rollout ends.

        Returns:
            The reason why the rollout ended and, for a failure, its details.
        """
        try:
            with self.clock("policy"):
                self.policy.reset(self.task.instruction, self.start.seed + self.start.index)
            while self.steps < self.task.horizon:
                ended = self._carry_out(self._ask())
                if ended is not None:
                    return ended
        except InvalidAnswerError as error:
            return RolloutEnd.INVALID, str(error)
        except GaveUpError as error:
            return RolloutEnd.GAVE_UP, str(error)
        except PolicyError as error:
            return RolloutEnd.NO_ANSWER, str(error)
        return RolloutEnd.HORIZON, f"not completed after {self.task.horizon} control steps"

    def _carry_out(self, actions: Array) -> tuple[RolloutEnd, str] | None:
        """Execute the actions in one response and evaluate the resulting states.

        The policy receives no observation until the last action has been executed, so the states can be evaluated in
        one batch. Actions that were executed after the goal had held are removed from the record.

        Returns:
            The reason why the rollout ended, along with details, or None if the rollout continues.
        """
        first, states, ended = self.steps, list[SceneState](), None
        marks = []
        for ended in self._control_steps(actions):
            if ended is not None and ended[0] is RolloutEnd.DIVERGED:
                break
            states.append(self.state)
            frames = {name: len(pictures) for name, pictures in self.frames.items()}
            marks.append((len(self.actions), self.hash.copy(), frames))
            if ended is not None or self.steps == self.task.horizon:
                break
        with self.clock("judge"):
            last = self.progress.see_all(first + 1, states) if states else None
        if last is None:
            return ended
        self.steps, self.state = first + last + 1, states[last]
        count, self.hash, frames = marks[last]
        self.actions = self.actions[:count]
        self.frames = {name: pictures[: frames[name]] for name, pictures in self.frames.items()}
        return RolloutEnd.SUCCESS, ""

    def _ask(self) -> Array:
        state = self.world.state() if self.execution.is_between_steps else self.state
        with self.clock("render" if self.policy.cameras else "physics"):
            sensed = self.sensors.observe(state)
        observation = Observation(
            time=len(self.actions) / self.execution.action_hz,
            instruction=self.task.instruction,
            robots=sensed.robots,
            images=sensed.images.get(ImageKind.COLOR, {}),
            depths=sensed.images.get(ImageKind.DEPTH, {}),
            masks=sensed.images.get(ImageKind.MASK, {}),
            state=state,
            sensed=sensed.state,
            true_robots=sensed.true_robots,
        )
        self.chunks += 1
        report_progress(f"step {self.steps} of {self.task.horizon}")  # restarts the time limit of a worker process
        with self.clock("policy"):
            actions = checked_actions(self.policy.infer(observation), self.robots, self.policy.action_space)
        self.sensors.skip(len(actions))
        return actions

    def _control_steps(self, actions: Array) -> Iterator[tuple[RolloutEnd, str] | None]:
        """Execute actions, and yield after each control step the reason if the rollout ends, otherwise None."""
        for action in actions:
            self.actions.append(action)
            steps = self.execution.act(action)
            while True:
                with self.clock("physics"):
                    if next(steps, None) is None:
                        break
                self.steps += 1
                yield self._observed()

    def _observed(self) -> tuple[RolloutEnd, str] | None:
        """Read the state at the end of a control step, and return the reason if the rollout ends, otherwise None."""
        with self.clock("physics"):
            trouble = self.world.trouble()
            if trouble:
                return RolloutEnd.DIVERGED, trouble
            self.state = self.world.state()
        self._note()
        self._film()
        for name in self.judged:
            below = self.floor - float(self.state.poses[name].p[2])
            if below > 0:
                text = f"`{name}` fell to {below + FALLEN:.2f} m below the lowest point of the initial scene"
                return RolloutEnd.FELL, text
        return None

    def _note(self) -> None:
        """Add the exact state to the digest of the trajectory."""
        state = self.state
        numbers = [np.concatenate([pose.p, pose.q]) for pose in (*state.poses.values(), *state.motions.values())]
        robots = [[*robot.positions().values(), robot.gripper()] for robot in self.robots.values()]
        new, self._unhashed = self.actions[self._unhashed :], len(self.actions)
        parts = [*numbers, np.array(list(state.joints.values())), *map(np.array, robots), *new]
        self.hash.update(np.concatenate(parts).tobytes())
        if self.trace is not None:
            self.trace.append((state, readings(self.world, self.robots)))
        if self.watch is not None:
            self.watch(state)

    def _film(self) -> None:
        if (self.steps - 1) % self.video.every == 0:
            with self.clock("render"):
                for name, picture in pictures(self.world, self.video.cameras).items():
                    self.frames[name].append(picture)

    def result(self, end: RolloutEnd, reason: str) -> Rollout:
        """Collect the result of the rollout."""
        size = action_size(self.robots, self.policy.action_space)
        return Rollout(
            task=self.task.name,
            step=self.task.step,
            policy=self.policy.name,
            index=self.start.index,
            seed=self.start.seed,
            success=end is RolloutEnd.SUCCESS,
            steps=self.steps,
            subtasks=self.progress.subtasks,
            end=end,
            reason=reason,
            actions=np.array(self.actions).reshape(len(self.actions), size),
            action_hz=self.execution.action_hz,
            digest=self.hash.hexdigest()[:16],
            chunks=self.chunks,
            timings=self.clock.timings(),
            final=self.state,
            frames=MappingProxyType({name: tuple(frames) for name, frames in self.frames.items()}),
            trace=tuple((self.trace or [])[: self.steps + 1]),
        )
