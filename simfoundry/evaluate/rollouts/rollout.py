"""One rollout: a policy acts in a task from a start until the goal has held or can no longer be reached.

Sub-tasks stay done once achieved, and the goal must hold for a while.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from simfoundry.evaluate.policies.base import (
    Image,
    ImageSize,
    InvalidAnswerError,
    Observation,
    Policy,
    PolicyError,
    action_size,
    checked_actions,
)
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.control import (
    Controller,
    check_cameras,
    physics_steps,
    pictures,
    readings,
)
from simfoundry.evaluate.task import Task, need_robots
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge, StateBatch
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import parse_call, texts
from simfoundry.worlds.base import World, WorldRobot

HOLD = 3
"""Number of consecutive control steps (0.2 s at 15 Hz) for which a goal must be true, so that passing through it does
not count.
"""


class Progress:
    """The progress of a task over successive states.

    A sub-task is done at the first state in which its goal holds, and stays done. If its goal already holds at the
    start, such as `Closed(drawer)` before the drawer is opened, it must first become false. The task is done once its
    goal has been true :data:`HOLD` times in a row.
    """

    def __init__(self, task: Task, judge: Judge, start: SceneState) -> None:
        self._task, self._judge = task, judge
        self._held = 0
        self._waiting = {name for name, step in task.subtasks.items() if judge(step.goal, start).value}
        self.done: dict[str, int | None] = dict.fromkeys(task.subtasks)

    def see(self, step: int, state: SceneState) -> bool:
        """Evaluate the state after control step ``step``, counted from 1; return whether the task is now done."""
        return self.see_all(step, [state]) is not None

    def see_all(self, step: int, states: Sequence[SceneState]) -> int | None:
        """Evaluate consecutive states, the first of them after ``step``; return the index of the one that ends the
        task, or None.

        All are evaluated in one batch, which costs hardly more than one; states after the end are ignored.
        """
        batch = StateBatch.of(self._task.scene, states)
        open_ = [name for name, done in self.done.items() if done is None]
        holds = self._judge.holds(
            {name: self._task.subtasks[name].goal for name in open_} | {"": self._task.goal}, batch
        )
        goal = holds[""]
        for k in range(len(states)):
            for name in open_:
                if not holds[name][k]:
                    self._waiting.discard(name)
                elif name not in self._waiting and self.done[name] is None:
                    self.done[name] = step + k
            self._held = self._held + 1 if goal[k] else 0
            if self._held >= HOLD:
                return k
        return None

    @property
    def subtasks(self) -> Mapping[str, int | None]:
        """Step at which each sub-task was done, counted from 1; None if it was not."""
        return dict(self.done)


FALLEN = 0.3
"""Distance [m] below the lowest point of the initial scene at which an object has fallen off: below a table's
height.
"""


class RolloutEnd(StrEnum):
    """The reason for the end of a rollout."""

    SUCCESS = "success"
    HORIZON = "horizon"
    FELL = "fell"
    DIVERGED = "diverged"
    INVALID = "invalid answer"
    """The policy answered with an error or with something other than actions: the rollout has failed."""
    NO_ANSWER = "no answer"
    """The policy could not be queried, or the connection was lost: the rollout has no result and counts as missing."""


@dataclass(frozen=True)
class Timings:
    """Durations of the parts of a rollout [s]."""

    total: float
    physics: float
    render: float
    policy: float
    judge: float


@dataclass(frozen=True)
class Video:
    """Images of a rollout to keep: from ``cameras``, after the first of every ``every`` control steps."""

    cameras: Mapping[str, ImageSize]
    every: int = 1


@dataclass(frozen=True, eq=False)
class Rollout:
    """The result of a rollout.

    ``steps`` control steps were executed; ``subtasks`` has the step at which each was done, counted from 1, or None.
    ``end`` is the reason for the end and ``reason`` the details of a failure. ``actions`` are those executed, shape
    (steps, numbers of an action); ``digest`` identifies the whole trajectory to the last bit. ``chunks`` is the number
    of queries to the policy; ``final`` is the last state; ``frames`` are by camera.
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
    digest: str
    chunks: int
    timings: Timings
    final: SceneState
    frames: Mapping[str, tuple[Image, ...]] = field(default_factory=lambda: MappingProxyType({}))


def rollout(
    task: Task,
    start: RolloutStart,
    policy: Policy,
    world: World,
    judge: Judge | None = None,
    video: Video | None = None,
) -> Rollout:
    """Run a policy from a start in a world of the task's scene.

    The policy is queried again after all actions of an answer were executed; images are rendered only for the policy
    and for ``video``. A given ``judge`` is reused across rollouts. A policy that answers with something other than
    actions has failed; one that does not answer leaves no result. Raises :class:`SimfoundryError` if robots or cameras
    are missing.
    """
    need_robots(task)
    check_cameras(task.scene, policy.cameras, f"policy `{policy.name}`")
    if video is not None:
        check_cameras(task.scene, video.cameras, "the video")
    run = _Run(task, start, policy, world, judge or Judge(task.scene), video)
    return run.result(*run.play())


class _Clock:
    """Accumulates the durations of the parts of a rollout."""

    def __init__(self) -> None:
        self.spent = dict.fromkeys(("physics", "render", "policy", "judge"), 0.0)
        self.begun = time.perf_counter()

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.spent[part] += time.perf_counter() - begun

    def timings(self) -> Timings:
        return Timings(total=time.perf_counter() - self.begun, **self.spent)


class _Run:
    """A rollout in progress."""

    def __init__(
        self, task: Task, start: RolloutStart, policy: Policy, world: World, judge: Judge, video: Video | None
    ) -> None:
        self.task, self.start, self.policy, self.world, self.video = task, start, policy, world, video
        self.clock = _Clock()
        with self.clock("physics"):
            world.reset(start.state)
            self.state = world.state()
        self.robots: dict[str, WorldRobot] = {name: world.robot(name) for name in task.robots}
        self.controller = Controller(self.robots, policy.action_space, task.control_hz)
        with self.clock("judge"):
            self.progress = Progress(task, judge, self.state)
        objects = task.scene.objects
        self.floor = min((float(world_bounds(o, o.X_WO)[0][2]) for o in objects), default=0.0) - FALLEN
        # Once a free object of the goal has fallen off the scene, the goal cannot be reached any more.
        named = {argument.partition(".")[0] for text, _ in texts(task.goal) for argument in parse_call(text).args}
        self.judged = [item.name for item in objects if item.name in named and not item.fixed]
        self.actions: list[Array] = []
        self.chunks = 0
        self.frames: dict[str, list[Image]] = {name: [] for name in (video.cameras if video is not None else ())}
        self.hash = hashlib.sha256()
        self._note()

    def play(self) -> tuple[RolloutEnd, str]:
        """Act until the end; return the reason for it, and the details of a failure."""
        try:
            with self.clock("policy"):
                self.policy.reset(self.task.instruction, self.start.seed + self.start.index)
            while len(self.actions) < self.task.horizon:
                ended = self._carry_out(self._ask()[: self.task.horizon - len(self.actions)])
                if ended is not None:
                    return ended
        except InvalidAnswerError as error:
            return RolloutEnd.INVALID, str(error)
        except PolicyError as error:
            return RolloutEnd.NO_ANSWER, str(error)
        return RolloutEnd.HORIZON, f"not done after {self.task.horizon} control steps"

    def _carry_out(self, actions: Array) -> tuple[RolloutEnd, str] | None:
        """Execute the actions of one answer, then evaluate their states; return the reason if the rollout ends, else
        None.

        The policy receives no observation before the last of them, so the states can be evaluated in one batch; actions
        executed after the goal had held are removed from the record.
        """
        first, states, ended = len(self.actions), list[SceneState](), None
        marks = []
        for action in actions:
            ended = self._act(action)
            if ended is not None and ended[0] is RolloutEnd.DIVERGED:
                break
            states.append(self.state)
            marks.append((self.hash.copy(), {name: len(frames) for name, frames in self.frames.items()}))
            if ended is not None:
                break
        with self.clock("judge"):
            last = self.progress.see_all(first + 1, states) if states else None
        if last is None:
            return ended
        self.actions = self.actions[: first + last + 1]
        self.state = states[last]
        self.hash, frames = marks[last]
        self.frames = {name: pictures[: frames[name]] for name, pictures in self.frames.items()}
        return RolloutEnd.SUCCESS, ""

    def _ask(self) -> Array:
        with self.clock("render"):
            images = pictures(self.world, self.policy.cameras)
        observation = Observation(
            time=len(self.actions) / self.task.control_hz,
            instruction=self.task.instruction,
            robots=readings(self.world, self.robots),
            images=images,
            state=self.state,
        )
        self.chunks += 1
        with self.clock("policy"):
            return checked_actions(self.policy.infer(observation), self.robots)

    def _act(self, action: Array) -> tuple[RolloutEnd, str] | None:
        """Execute one action; return the reason if the rollout ends."""
        step = len(self.actions)
        self.actions.append(action)
        with self.clock("physics"):
            self.controller.apply(action)
            self.world.step(physics_steps(step, self.task.control_hz, self.world.timestep))
            trouble = self.world.trouble()
            if trouble:
                return RolloutEnd.DIVERGED, trouble
            self.state = self.world.state()
        self._note()
        self._film()
        for name in self.judged:
            below = self.floor - float(self.state.poses[name].p[2])
            if below > 0:
                below += FALLEN
                return RolloutEnd.FELL, f"`{name}` fell to {below:.2f} m below the lowest point of the initial scene"
        return None

    def _note(self) -> None:
        """Add the exact state to the digest of the trajectory."""
        state = self.state
        numbers = [np.concatenate([pose.p, pose.q]) for pose in (*state.poses.values(), *state.motions.values())]
        robots = [[*robot.positions().values(), robot.gripper()] for robot in self.robots.values()]
        parts = [*numbers, np.array(list(state.joints.values())), *map(np.array, robots), *self.actions[-1:]]
        self.hash.update(np.concatenate(parts).tobytes())

    def _film(self) -> None:
        if self.video is not None and (len(self.actions) - 1) % self.video.every == 0:
            with self.clock("render"):
                for name, picture in pictures(self.world, self.video.cameras).items():
                    self.frames[name].append(picture)

    def result(self, end: RolloutEnd, reason: str) -> Rollout:
        """Collect the result of the rollout."""
        actions = np.array(self.actions).reshape(len(self.actions), action_size(self.robots))
        return Rollout(
            task=self.task.name,
            step=self.task.step,
            policy=self.policy.name,
            index=self.start.index,
            seed=self.start.seed,
            success=end is RolloutEnd.SUCCESS,
            steps=len(self.actions),
            subtasks=MappingProxyType(dict(self.progress.subtasks)),
            end=end,
            reason=reason,
            actions=actions,
            digest=self.hash.hexdigest()[:16],
            chunks=self.chunks,
            timings=self.clock.timings(),
            final=self.state,
            frames=MappingProxyType({name: tuple(frames) for name, frames in self.frames.items()}),
        )
