"""The expert as a policy: it is given the task, sees the truth, and answers with actions as any other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from simfoundry.evaluate.expert.handling import pick, put
from simfoundry.evaluate.expert.joints import lead
from simfoundry.evaluate.expert.places import PlaceAt, places
from simfoundry.evaluate.expert.plan import Skill, Step, goal_steps, steps
from simfoundry.evaluate.expert.worker import FailedError, Script, Worker
from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, Observation
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge, StateBatch
from simfoundry.runtime.extras import need_extra

CHUNK = 3
"""Actions in an answer: a fifth of a second at 15 Hz, so that a lost grasp is seen soon."""

ATTEMPTS = 4
"""How often a step is tried before the next is."""

PAUSE = 1.0
"""How long it waits after a failure before it looks again [s]."""


class Expert:
    """A :class:`~simfoundry.evaluate.policies.base.Policy` that is scripted. It needs MuJoCo and mink to plan."""

    def __init__(self, task: Task, judge: Judge | None = None) -> None:
        need_extra("expert", "the scripted expert")
        self._task = task
        self._judge = judge or Judge(task.scene)
        self._worker = Worker(task.scene, task.robots, task.control_hz)
        self._script: Script | None = None
        self.log: list[str] = []

    @property
    def name(self) -> str:
        """What reports call it."""
        return "expert"

    @property
    def action_space(self) -> ActionSpace:
        """What the arm's numbers mean."""
        return ActionSpace.JOINT_POSITION

    @property
    def cameras(self) -> Mapping[str, ImageSize]:
        """None: it sees the truth."""
        return MappingProxyType({})

    def reset(self, instruction: str, seed: int) -> None:
        """Begin a rollout."""
        self._worker.begin(seed)
        self._script = None
        self.log = []

    def infer(self, observation: Observation) -> Array:
        """The next actions, shape (3, numbers of an action)."""
        self._worker.look(observation)
        if self._script is None:
            self._script = self._work()
        rows = []
        for _ in range(CHUNK):
            next(self._script)
            rows.append(self._worker.command())
        return np.array(rows)

    def close(self) -> None:
        """Nothing to let go of."""

    def _work(self) -> Script:
        """Every step of the task, then what of the goal does not hold, and then stillness."""
        for step in steps(self._task.goal, self._task.subtasks):
            yield from self._achieve(step)
        for _ in range(ATTEMPTS):
            for step in goal_steps(self._task.goal):
                yield from self._achieve(step)
        while True:
            yield

    def _achieve(self, step: Step) -> Script:
        for _ in range(ATTEMPTS):
            if self._judge(step.until, self._worker.now.state).value:
                return
            try:
                yield from self._do(step)
            except FailedError as error:
                self.log.append(f"{step.until}: {error}")
                yield from self._recover()
        self.log.append(f"{step.until}: given up")

    def _do(self, step: Step) -> Script:
        worker = self._worker
        robot = self._task.robots[0]
        match step.skill:
            case Skill.PICK:
                yield from pick(worker, robot, step.args[0], None)
            case Skill.OPEN | Skill.CLOSE:
                yield from lead(worker, robot, step.args[0], step.skill is Skill.OPEN)
            case Skill.PUT_ON | Skill.PUT_IN:
                thing, target = step.args
                inside = step.skill is Skill.PUT_IN
                found = self._good(step, places(worker.scene, worker.now.state, thing, target, inside))
                if not found:
                    raise FailedError(f"there is no place for {thing} at {target}")
                if robot not in worker.held:
                    yield from pick(worker, robot, thing, found)
                yield from put(worker, robot, found)

    def _good(self, step: Step, found: list[PlaceAt]) -> list[PlaceAt]:
        """The places at which the step would be done."""
        state, thing = self._worker.now.state, step.args[0]
        apart = replace(state, robots=MappingProxyType({}), speeds=MappingProxyType({}))
        states = [replace(apart, poses={**state.poses, thing: place.X_WO}) for place in found]
        if not states:
            return []
        holds, _ = self._judge.batch(step.until, StateBatch.of(self._task.scene, states))
        return [place for place, good in zip(found, holds, strict=True) if good]

    def _recover(self) -> Script:
        """Let go, and back to where the arm began; then a look at what has come to rest."""
        worker = self._worker
        for robot, reach in worker.reaches.items():
            worker.held.pop(robot, None)
            yield from worker.grip(robot, 0.0)
            worker.sync()
            way = reach.way(worker.q[robot], reach.arm.home, 0.0)
            yield from worker.follow(robot, way or [worker.q[robot], reach.arm.home])
        yield from worker.wait(PAUSE)
