"""The scripted expert policy, which performs the manipulation skills that make the predicates of a task true."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simfoundry.evaluate.expert.candidates import PlaceAt, places
from simfoundry.evaluate.expert.handles import lead
from simfoundry.evaluate.expert.skills import pick, put
from simfoundry.evaluate.expert.two_hands import carry
from simfoundry.evaluate.expert.worker import ExpertWorker, FailedError, Script
from simfoundry.evaluate.policies.base import Observation, Policy
from simfoundry.evaluate.task import SubtaskGoal, Task
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge, StateBatch
from simfoundry.runtime.extras import need_extra
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, Condition, parse_call, parts
from simfoundry.spec.models.signals import ActionSpace


class Skill(StrEnum):
    """The manipulation skills of the expert."""

    PICK = "pick"
    PUT_ON = "put on"
    PUT_IN = "put in"
    OPEN = "open"
    CLOSE = "close"


# The skill that makes each predicate true. Other predicates become true as a side effect (Touching, Released, Upright),
# or depend on where objects happen to be.
SKILLS = {
    "Grasped": Skill.PICK,
    "Lifted": Skill.PICK,
    "OnTop": Skill.PUT_ON,
    "Inside": Skill.PUT_IN,
    "Open": Skill.OPEN,
    "Closed": Skill.CLOSE,
}

PUTS = (Skill.PUT_ON, Skill.PUT_IN)


@dataclass(frozen=True)
class ExpertStep:
    """A single step of the expert.

    ``args`` are the arguments of the predicate ``until``, which the ``skill`` makes true.
    """

    skill: Skill
    args: tuple[str, ...]
    until: str


def steps(goal: Condition, subtasks: Mapping[str, SubtaskGoal]) -> tuple[ExpertStep, ...]:
    """Return the expert's steps for each sub-task in order, followed by the steps for the remainder of the goal."""
    asked = [step for subtask in subtasks.values() for step in _of(subtask.goal)]
    asked += [step for step in _of(goal) if step not in asked]
    return tuple(step for k, step in enumerate(asked) if not _leads_to(step, asked[k + 1 :]))


def goal_steps(goal: Condition) -> tuple[ExpertStep, ...]:
    """Return the expert's steps for the goal itself."""
    found = list(_of(goal))
    return tuple(step for step in found if not _leads_to(step, found))


def _leads_to(step: ExpertStep, later: list[ExpertStep]) -> bool:
    """Return True if a later step picks up the same object anyway."""
    return step.skill is Skill.PICK and any(s.skill in PUTS and s.args[0] == step.args[0] for s in later)


def _of(condition: Condition) -> Iterator[ExpertStep]:
    kind, below = parts(condition)
    if kind == "text":
        call: Call = parse_call(str(condition))
        if call.predicate in SKILLS:
            yield ExpertStep(SKILLS[call.predicate], call.args, str(call))
    for item in {"all": below, "any": below[:1]}.get(kind, ()):
        yield from _of(item)


def hands_on(task: Task, thing: str) -> tuple[str, ...]:
    """Return the robots that must grasp an object at some point in a task, in the order of their names in the task."""
    calls = [step.args for goal in task.subtasks.values() for step in _of(goal.goal) if step.skill is Skill.PICK]
    return tuple(robot for robot in task.robots if (thing, robot) in calls)


# Number of actions per response, which take a fifth of a second at 15 Hz, so that a lost grasp is noticed quickly.
CHUNK = 3

# Maximum number of attempts per step.
ATTEMPTS = 4

# Time to wait after a failure before the next observation [s].
PAUSE = 1.0


class ExpertPolicy(Policy):
    """A scripted policy that plans with MuJoCo and mink.

    The policy has access to the true state, without the noise and latency of observations, and does not use cameras.
    The noise and latency of actions act on it like on any other policy. With ``noise`` [rad or m], it also wobbles on
    its way through free space, so that rollouts differ in more than their initial states.
    """

    name = "expert"
    action_space = ActionSpace.JOINT_POSITION

    def __init__(self, task: Task, judge: Judge | None = None, noise: float = 0.0) -> None:
        need_extra("expert", "the scripted expert")
        self._task = task
        self._judge = judge or Judge(task.scene)
        self._worker = ExpertWorker(task.scene, task.robots, task.control_hz, noise)
        self._script: Script | None = None
        self.log: list[str] = []

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout."""
        self._worker.begin(seed)
        self._script = None
        self.log = []

    def infer(self, observation: Observation) -> Array:
        """Return the next actions, as an array of shape (3, action size)."""
        self._worker.look(observation.privileged())
        if self._script is None:
            self._script = self._work()
        rows = []
        for _ in range(CHUNK):
            next(self._script)
            rows.append(self._worker.command())
        return np.array(rows)

    def _work(self) -> Script:
        """Execute every step of the task, then the steps for unmet parts of the goal. After that, hold still."""
        for step in steps(self._task.goal, self._task.subtasks):
            yield from self._achieve(step)
        for _ in range(ATTEMPTS):
            for step in goal_steps(self._task.goal):
                yield from self._achieve(step)
        while True:
            yield

    def _achieve(self, step: ExpertStep) -> Script:
        for _ in range(ATTEMPTS):
            if self._judge(step.until, self._worker.now.state).value:
                return
            try:
                yield from self._do(step)
            except FailedError as error:
                self.log.append(f"{step.until}: {error}")
                yield from self._recover()
        self.log.append(f"{step.until}: gave up")

    def _do(self, step: ExpertStep) -> Script:
        worker, robot = self._worker, self._task.robots[0]
        hands = hands_on(self._task, step.args[0])
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
                    raise FailedError(f"could not find a place for {thing} {'in' if inside else 'on'} {target}")
                if len(hands) == 2:
                    yield from carry(worker, hands, thing, found)
                    return
                if robot not in worker.held:
                    yield from pick(worker, robot, thing, found)
                yield from put(worker, robot, found, inside)

    def _good(self, step: ExpertStep, found: list[PlaceAt]) -> list[PlaceAt]:
        """Return the placements that would complete the step."""
        now, thing = self._worker.now.state, step.args[0]
        states = [SceneState({**now.poses, thing: place.X_WO}, now.joints, now.motions) for place in found]
        if not states:
            return []
        holds, _ = self._judge.batch(step.until, StateBatch.of(self._task.scene, states))
        return [place for place, good in zip(found, holds, strict=True) if good]

    def _recover(self) -> Script:
        """Release any held object, return the arm to its home configuration, and wait until all objects are at rest."""
        worker = self._worker
        for robot, planner in worker.planners.items():
            worker.held.pop(robot, None)
            yield from worker.grip(robot, 0.0)
            worker.sync()
            way = planner.way(worker.q[robot], planner.arm.home, 0.0)
            yield from worker.follow(robot, way or [worker.q[robot], planner.arm.home])
        yield from worker.wait(PAUSE)
