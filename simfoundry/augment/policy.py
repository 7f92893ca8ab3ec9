"""The policy that follows segments of demonstrations, and thereby generates new demonstrations."""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from simfoundry.augment.actions import CommandConverter
from simfoundry.augment.choice import PER_RAD, ChosenSegment, NoSegmentError, SegmentChooser
from simfoundry.augment.library import library_digest
from simfoundry.augment.options import AugmentOptions
from simfoundry.augment.paths import JUMP, ArmTargets, ObstacleError, Present, corrected, in_step, last_shift
from simfoundry.augment.transform import Adaptation, FrameChange
from simfoundry.evaluate.expert.motion import ArmPlanner, Held, PlanningScene
from simfoundry.evaluate.policies.base import GaveUpError, Observation, Policy
from simfoundry.evaluate.policies.checkpoint import Options, PolicyLoader
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.predicates import Judge
from simfoundry.robots.arm import Arm, Jaws, jaws
from simfoundry.runtime.extras import need_extra
from simfoundry.spec.models.predicate import Condition, Effect

# Time for which a sub-goal is waited for at the end of its segment, and the goal at the end of the last one [s]:
# objects that were dropped come to rest within it.
WAIT_S, WAIT_GOAL_S = 1.0, 3.0

# Number of actions between two looks while waiting.
LOOK = 3

# Motion of an object in the hand since a segment was planned beyond which the segment is adapted again [m].
SLIP = 0.003

# Distance by which the hands go on after the last segment [m], enough for fingers to leave an object.
FARTHEST = 0.1

# Fingers of a robot without a gripper, whose hand is only moved.
NO_FINGERS = Jaws(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1))

# The motion toward a sub-goal; each ``yield`` ends an action, and is True if the next one requires an observation.
Script = Generator[bool, None, None]


class AugmentPolicy(Policy):
    """A policy that achieves the sub-goals of a task one after another by segments of demonstrations.

    For each sub-goal, it chooses a segment, adapts it to the present state, and follows it. It has access to the true
    state, and gives up as soon as a sub-goal cannot be achieved. Robots that do not depend on each other move at the
    same time; those that achieve a sub-goal together move in step.
    """

    name = "augment"

    def __init__(self, folder: Path, task: Task, options: AugmentOptions) -> None:
        need_extra("expert", "augmentation")
        self._task, self._options, self._judge = task, options, Judge(task.scene)
        self._chooser = SegmentChooser(folder, task, options, self._judge)
        self._teams = [*map(set, self._chooser.teams), set(task.robots)]
        self._cell = PlanningScene(task.scene)
        self._arms = {name: Arm(task.scene.robot(name)) for name in task.robots}
        self.action_space, self._hz = self._chooser.library.space, self._chooser.library.hz
        self.control_hz = self._hz
        self._converter = CommandConverter(task, self._arms, self.action_space, self._hz)
        self._now: Observation
        self.reset("", 0)

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout."""
        self._rng = np.random.default_rng(seed)
        self._planners = {
            name: ArmPlanner(self._cell, arm, jaws(arm.robot) or NO_FINGERS, self._rng)
            for name, arm in self._arms.items()
        }
        self._q: dict[str, Array] = {}
        self._shares: dict[str, float] = {}
        self._held: dict[str, Held] = {}
        self._changes: dict[str, FrameChange] = {}
        self._used: dict[str, int] = {}  # the demonstration of the last segment of each robot
        self._chained: dict[int, int] = {}  # the demonstration that a sub-goal must use
        self._retreats: dict[str, Array] = {}  # the last motion of each hand [m per action]
        count = len(self._chooser.subgoals)
        self._scripts: dict[int, Script] = {k: self._work(k) for k in range(count)} | {count: self._finish()}
        self._is_stale = False
        self._segments: list[dict[str, Any]] = []
        self.origin = {"segments": self._segments}

    def infer(self, observation: Observation) -> Array:
        """Return the actions up to the next decision, as an array of shape (actions, action size)."""
        self._now, self._is_stale = observation.privileged(), False
        if not self._q:
            for name in self._arms:
                reading = self._now.robots[name]
                self._q[name], self._shares[name] = np.array(reading.joints), reading.gripper
            self._converter.begin(self._q)
        rows: list[Array] = []
        is_deciding = False
        while not is_deciding:
            is_deciding = self._advance()
            rows.append(self._command())
            self._is_stale = True
        return np.array(rows)

    def _advance(self) -> bool:
        """Advance all scripts that can run by one action, and return True if the next one requires an observation."""
        is_deciding, busy = False, set[str]()
        for k in sorted(self._scripts):
            if not self._teams[k] & busy and not self._chooser.needs(k) & self._scripts.keys():
                try:
                    is_deciding |= next(self._scripts[k])
                except StopIteration:
                    del self._scripts[k]
                    continue
            busy |= self._teams[k]
        return is_deciding

    def _command(self) -> Array:
        """Return the action for the present targets, with noise if requested."""
        q = self._q
        if self._options.noise:
            q = {name: one + self._rng.normal(0.0, self._options.noise, len(one)) for name, one in q.items()}
        return self._converter.action(q, self._shares)

    def _work(self, k: int) -> Script:
        """Achieve a sub-goal, or give up."""
        subgoal = self._chooser.subgoals[k]
        if not self._chooser.is_possible(k):
            return
        if self._is_stale:
            yield True
        chosen = self._choose(k)
        segment = chosen.segment
        note = {"subgoal": subgoal.name, "demonstration": segment.demonstration, "robots": list(segment.robots)}
        self._segments.append({**note, "achieved": False})
        number = len(self._segments) - 1
        yield from self._execute(chosen.plan.bridges)
        adaptation, targets = self._corrected(k, chosen)
        yield from self._execute(targets)
        self._retreats = {name: last_shift(segment, name, adaptation.changes[name]) for name in segment.robots}
        if subgoal.lasts:
            where = f"{subgoal.name}, as in demonstration {segment.demonstration}"
            yield from self._wait(subgoal.condition, WAIT_S, f"{subgoal.name}: not achieved", where)
        self._note_end(k, chosen, adaptation)
        self._segments[number]["achieved"] = True

    def _choose(self, k: int) -> ChosenSegment:
        hands = {name: self._now.robots[name].X_WH for name in self._arms}
        now, only = self._present(), self._chained.get(k)
        try:
            chosen = self._chooser.choose(k, self._now.state, hands, now, self._used, self._rng, only)
        except NoSegmentError as error:
            name = self._chooser.subgoals[k].name
            self._give_up(f"{name}: {error.kind}", f"{name}: {error}")
        source = chosen.segment.demonstration
        self._chained |= dict.fromkeys(self._chooser.chained(k, source), source)
        return chosen

    def _give_up(self, kind: str, text: str) -> NoReturn:
        """Note the kind of a failure, and give up."""
        self.origin = {**self.origin, "failure": kind}
        raise GaveUpError(text)

    def _execute(self, plans: Mapping[str, ArmTargets]) -> Script:
        """Send the commands of several robots, action by action, and observe the result."""
        commands = in_step(plans)
        for number, one in enumerate(commands):
            for name, (q, share) in one.items():
                self._q[name], self._shares[name] = q, share
            yield number == len(commands) - 1

    def _corrected(self, k: int, chosen: ChosenSegment) -> tuple[Adaptation, Mapping[str, ArmTargets]]:
        """Return the transforms and commands of a segment after its object may have slipped in the hand.

        Raises:
            GaveUpError: If the object was lost.
        """
        segment, adaptation, targets = chosen.segment, chosen.adaptation, chosen.plan.targets
        subgoal, robot = self._chooser.subgoals[k], segment.robots[0]
        held = self._held.get(robot)
        if len(segment.robots) > 1 or held is None or subgoal.held != held.name:
            return adaptation, targets
        if not self._judge(f"Grasped({held.name})", self._now.state).value:
            text = f"{subgoal.name}: `{held.name}` slipped out of the hand of `{robot}` on the way"
            self._give_up(f"{subgoal.name}: lost on the way", text)
        now, change = self._present(), adaptation.changes[robot]
        slip = held.X_HO @ now.held[robot].X_HO.inverse()
        if float(np.linalg.norm(slip.p)) < SLIP and slip.angle_to(IDENTITY) < SLIP / PER_RAD:
            return adaptation, targets
        again = Adaptation({robot: FrameChange(change.left, change.right @ slip)}, adaptation.cost)
        try:
            return again, {robot: corrected(segment, again, subgoal, now, robot)}
        except ObstacleError:
            return adaptation, targets

    def _finish(self) -> Script:
        """Let the hands go on as they moved last until the rollout ends, or give up if the goal does not become true.

        A demonstration ends as soon as its goal holds, when the hand may just have left the object.
        """
        yield True
        going = {name: shift * LOOK for name, shift in self._retreats.items() if shift.any()}
        verdict = self._judge(self._task.goal, self._now.state)
        for k in range(round(WAIT_GOAL_S * self._hz / LOOK)):
            verdict = self._judge(self._task.goal, self._now.state)
            if not verdict.value:
                near = {name: shift for name, shift in going.items() if k * np.linalg.norm(shift) < FARTHEST}
                going = {name: shift for name, shift in near.items() if self._shift(name, shift)}
            for step in range(LOOK):
                yield step == LOOK - 1
        self._give_up("goal: not achieved", f"all segments are done, but {verdict.why}")

    def _shift(self, robot: str, shift: Array) -> bool:
        """Move the target of a hand by a distance [m], and return True if the arm can do so."""
        arm = self._arms[robot]
        X_WH = arm.hand(self._q[robot])
        q = arm.solve(Pose.of(X_WH.p + shift, X_WH.q), self._q[robot])
        if q is None or np.abs(q - self._q[robot]).max() > LOOK * JUMP:
            return False
        self._q[robot] = q
        return True

    def _wait(self, condition: Condition, seconds: float, kind: str, where: str) -> Script:
        """Hold still until a condition holds.

        Raises:
            GaveUpError: If it does not hold in time.
        """
        for _ in range(1 + round(seconds * self._hz / LOOK)):
            verdict = self._judge(condition, self._now.state)
            if verdict.value:
                return
            for step in range(LOOK):
                yield step == LOOK - 1
        self._give_up(kind, f"{where}: {verdict.why}")

    def _note_end(self, k: int, chosen: ChosenSegment, adaptation: Adaptation) -> None:
        """Note what the hands hold after a segment."""
        subgoal, segment = self._chooser.subgoals[k], chosen.segment
        for name in segment.robots:
            self._changes[name], self._used[name] = adaptation.changes[name], segment.demonstration
            if subgoal.call.declaration.effect is Effect.GRASP:
                self._held[name] = self._present_held(name, subgoal.call.args[0])
            elif subgoal.held and segment.opening(name) is not None:
                self._held.pop(name, None)

    def _present(self) -> Present:
        """Return the present situation, to which the planning scene is set."""
        grippers = {name: self._now.robots[name].gripper for name in self._arms}
        self._cell.sync(self._now.state, self._q, grippers)
        held = {name: self._present_held(name, one.name) for name, one in self._held.items()}
        return Present(self._planners, self._q, grippers, self._shares, held, self._changes, self._hz)

    def _present_held(self, robot: str, name: str) -> Held:
        """Return an object in a hand with its present pose."""
        return Held(name, self._now.robots[robot].X_WH.inverse() @ self._now.state.poses[name])


def _open(folder: Path, task: Task, options: Options) -> Policy:
    return AugmentPolicy(folder, task, AugmentOptions.parse(options))


def _digest(folder: Path, options: Options) -> str:
    parsed = AugmentOptions.parse(options)
    text = f"{library_digest(folder, parsed.use)} {parsed.query}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


AUGMENT = PolicyLoader(open=_open, digest=_digest)
