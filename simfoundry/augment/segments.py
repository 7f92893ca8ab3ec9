"""Segments of recorded demonstrations: one for each sub-goal, with the motion of the hands relative to its reference.

A segment starts where the hand leaves free space to achieve the sub-goal, and ends where it has returned to free space
afterwards: the approach, the grasp and the lift belong to the grasp. The motion between two segments is not kept,
because it depends on where the objects stood. If the hand does not reach free space between two sub-goals, as in
pushing, the second segment is joined to the first. The last segment of each hand ends with the demonstration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.augment.subgoals import Subgoal, reference_pose, required_calls, subgoals
from simfoundry.data.action_conversion import ActionConverter
from simfoundry.data.demonstrations import Demonstration
from simfoundry.data.trajectory import Trajectory, TrajectorySampler, frame_count
from simfoundry.evaluate.expert.motion import PlanningScene
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array, Pose
from simfoundry.predicates import Judge, StateBatch
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.worlds.robot_state import mjcf_rows

# Clearance [m] of a hand, and of the object in it, from everything else in free space: the range of the planner's
# distance queries.
FREE = 0.03

# Largest change of a gripper command in one action that does not count as opening, as a fraction of the finger travel.
OPENED = 0.02


@dataclass(frozen=True, eq=False)
class HandMotion:
    """The commands to one robot in a segment. K is the number of actions in the lead-in and the segment.

    Attributes:
        targets: The target pose X_WT of the hand at the end of each action, K poses.
        grippers: The gripper command of each action, from 0 (open) to 1 (closed), shape (K,).
        start: The pose of the hand before the first action.
        joints: The joint targets at the start of the segment proper [rad or m], shape (n,).
        X_HO: The pose of the held object in the hand at the start of the segment proper, or None.
    """

    targets: tuple[Pose, ...]
    grippers: Array
    start: Pose
    joints: Array
    X_HO: Pose | None = None


@dataclass(frozen=True, eq=False)
class SourceSegment:
    """A part of a demonstration that achieves a sub-goal.

    Attributes:
        subgoal: The sub-goal.
        demonstration: The index of the demonstration in its recording.
        scene: The scene of the demonstration.
        begin: The action at which the lead-in begins, which is where the previous segment of the robots ends.
        first: The action at which the segment proper begins.
        last: The action after the last one.
        moment: The number of actions after which the sub-goal first holds.
        is_joined: True if the hands do not reach free space before the segment.
        motions: The commands from ``begin`` to ``last``, keyed by robot.
        X_WR: The pose of the reference when the lead-in begins.
        X_WO: The pose of the held object when the segment proper begins, or None.
    """

    subgoal: Subgoal
    demonstration: int
    scene: Scene
    begin: int
    first: int
    last: int
    moment: int
    is_joined: bool
    motions: Mapping[str, HandMotion]
    X_WR: Pose
    X_WO: Pose | None = None

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that achieve the sub-goal together."""
        return tuple(self.motions)

    @property
    def lead(self) -> int:
        """The number of actions of the lead-in."""
        return self.first - self.begin

    def opening(self, robot: str) -> int | None:
        """Return the position in a motion at which the gripper starts to open, or None if it does not."""
        opens = np.flatnonzero(np.diff(self.motions[robot].grippers) < -OPENED) + 1
        return next((int(k) for k in opens if k > self.lead), None)


@dataclass(frozen=True)
class _Span:
    """The sub-goal with the number ``k``, the robots that achieve it, and the state in which it first holds."""

    k: int
    robots: tuple[str, ...]
    moment: int


class SegmentReader:
    """Reads the segments of demonstrations of one task."""

    def __init__(self, task: Task, sampler: TrajectorySampler) -> None:
        self._task, self._sampler = task, sampler
        self._judge, self._cell = Judge(task.scene), PlanningScene(task.scene)
        self._converter = ActionConverter(sampler, ActionSpace.JOINT_POSITION)
        self._subgoals, self._goal = subgoals(task), required_calls(task.goal)
        self._rows = {name: mjcf_rows(task.scene.robot(name)) for name in task.robots}

    def read(self, demonstration: Demonstration) -> list[SourceSegment]:
        """Return the segments of a demonstration, in the order of the sub-goals. Those that were not achieved lack."""
        trajectory = self._sampler.sample(demonstration, demonstration.action_hz)
        states = self._states(trajectory)
        spans = self._spans(demonstration, trajectory, states)
        poses = self._converter.hand_targets(trajectory)
        borders = self._borders(trajectory, states, spans)
        return [
            self._segment(demonstration, trajectory, states, poses, *found)
            for found in zip(spans, *borders, strict=True)
        ]

    def _states(self, trajectory: Trajectory) -> list[SceneState]:
        """Return the state at the start of each action and after the last one, with estimated speeds."""
        initial = SceneState.initial(self._task.scene)
        seen = trajectory.observations
        moved = np.linalg.norm(np.diff(seen["objects"][:, :, :3], axis=0, prepend=seen["objects"][:1, :, :3]), axis=2)
        found = []
        for t in range(trajectory.length + 1):
            poses = {n: _pose(row) for n, row in zip(initial.poses, seen["objects"][t], strict=True)}
            motions = {n: _pose(row) for n, row in zip(initial.motions, seen["motions"][t], strict=True)}
            robots = {
                name: dict(zip((row.joint for row in rows), seen[f"{name}/model"][t].tolist(), strict=True))
                for name, rows in self._rows.items()
            }
            speeds = dict(zip(initial.poses, (moved[t] * trajectory.hz).tolist(), strict=True))
            joints = dict(zip(initial.joints, seen["joints"][t].tolist(), strict=True))
            found.append(SceneState.of(poses, joints, motions, robots, speeds))
        return found

    def _spans(self, demonstration: Demonstration, trajectory: Trajectory, states: Sequence[SceneState]) -> list[_Span]:
        """Return the sub-goals that were achieved, with the moments at which they became true."""
        batch = StateBatch.of(self._task.scene, states)
        holds = self._judge.holds({str(k): one.condition for k, one in enumerate(self._subgoals)}, batch)
        found: list[_Span] = []
        for k, subgoal in enumerate(self._subgoals):
            candidates = self._robots(subgoal, batch, found)
            before = max((one.moment for one in found if set(one.robots) & set(candidates)), default=0)
            moment = self._recorded(subgoal, demonstration, trajectory.hz) or _first_time(holds[str(k)], before)
            if moment is None and subgoal.call in self._goal:
                moment = trajectory.length  # the goal holds at the end, even if objects were still moving before
            if moment is not None and moment > before:
                found.append(_Span(k, self._acting(subgoal, candidates, trajectory, states, moment), moment))
        return found

    def _recorded(self, subgoal: Subgoal, demonstration: Demonstration, hz: float) -> int | None:
        """Return the moment at which the recording noted a sub-task as completed, or None."""
        step = demonstration.subtasks.get(subgoal.name)
        return None if step is None else frame_count(step, self._task.control_hz, hz)

    def _robots(self, subgoal: Subgoal, batch: StateBatch, found: Sequence[_Span]) -> tuple[str, ...]:
        """Return the robots that may achieve a sub-goal: those that it names, or those that hold its object."""
        if subgoal.robots or len(self._task.robots) == 1:
            return subgoal.robots or self._task.robots
        if subgoal.held:
            grasps = [one for one in found if self._subgoals[one.k].reference == subgoal.held]
            holding = {name for one in grasps for name in one.robots}
            return tuple(name for name in self._task.robots if name in holding) or self._task.robots
        return self._task.robots

    def _acting(
        self,
        subgoal: Subgoal,
        robots: tuple[str, ...],
        trajectory: Trajectory,
        states: Sequence[SceneState],
        moment: int,
    ) -> tuple[str, ...]:
        """Return the robots that achieve a sub-goal: all that are known to, or else the one that is closest."""
        if subgoal.robots or subgoal.held or len(robots) == 1:
            return robots
        target = reference_pose(self._task.scene, states[moment], subgoal.reference).p
        off = {name: np.linalg.norm(trajectory.observations[f"{name}/hand"][moment, :3] - target) for name in robots}
        return (min(robots, key=lambda name: float(off[name])),)

    def _borders(
        self, trajectory: Trajectory, states: Sequence[SceneState], spans: Sequence[_Span]
    ) -> tuple[list[int], list[int], list[int], list[bool]]:
        """Return for each span where its lead-in begins, where it begins, where it ends, and whether it is joined."""
        begins, firsts, joined = [], [], []
        ends: dict[int, list[int]] = {}
        for number, span in enumerate(spans):
            previous = self._previous(spans, number)
            start = max((spans[k].moment for k in previous), default=0)
            places = np.flatnonzero(self._free(trajectory, states, span, start))
            begin, first = (start + int(places[0]), start + int(places[-1])) if len(places) else (start, start)
            for k in previous:
                ends.setdefault(k, []).append(begin)
            begins.append(begin)
            firsts.append(first)
            joined.append(not len(places))
        lasts = [max(ends.get(k, [trajectory.length])) for k in range(len(spans))]
        return begins, firsts, lasts, joined

    @staticmethod
    def _previous(spans: Sequence[_Span], number: int) -> list[int]:
        """Return the last span of each robot of a span before it."""
        found = set()
        for robot in spans[number].robots:
            mine = [k for k in range(number) if robot in spans[k].robots]
            found |= set(mine[-1:])
        return sorted(found)

    def _free(self, trajectory: Trajectory, states: Sequence[SceneState], span: _Span, start: int) -> NDArray[np.bool_]:
        """Return in which states from ``start`` to the moment of a span its hands are in free space.

        Both the hands and the targets ahead of which they lag must be.
        """
        held, scene = self._subgoals[span.k].held, self._cell
        seen = trajectory.observations
        found = []
        for t in range(start, span.moment):
            grippers = {name: float(seen[f"{name}/gripper"][t, 0]) for name in self._task.robots}
            scene.sync(states[t], {name: seen[f"{name}/joints"][t] for name in grippers}, grippers)
            is_free = scene.hands_are_free(span.robots, held, FREE)
            if is_free:
                for name in span.robots:
                    scene.pose(name, trajectory.targets[name][t], grippers[name])
                if held:
                    scene.put(held, self._carried(trajectory, states[t], span.robots[0], held, t))
                is_free = scene.hands_are_free(span.robots, held, FREE)
            found.append(is_free)
        return np.array(found, bool)

    def _carried(self, trajectory: Trajectory, state: SceneState, robot: str, held: str, t: int) -> Pose:
        """Return where a held object would be if the hand were at its target."""
        X_WH = _pose(trajectory.observations[f"{robot}/hand"][t])
        return self._converter.hand(robot, trajectory.targets[robot][t]) @ X_WH.inverse() @ state.poses[held]

    def _segment(
        self, demonstration: Demonstration, trajectory: Trajectory, states: Sequence[SceneState],
        poses: Mapping[str, Sequence[Pose]], span: _Span, begin: int, first: int, last: int, is_joined: bool,
    ) -> SourceSegment:  # fmt: skip
        subgoal, scene = self._subgoals[span.k], self._task.scene
        X_WO = states[first].poses[subgoal.held] if subgoal.held else None
        motions = {}
        for name in span.robots:
            rows = trajectory.observations[f"{name}/hand"]
            motions[name] = HandMotion(
                targets=tuple(poses[name][begin + 1 : last + 1]),
                grippers=trajectory.grippers[name][begin:last],
                start=poses[name][begin],
                joints=trajectory.targets[name][first],
                X_HO=None if X_WO is None else _pose(rows[first]).inverse() @ X_WO,
            )
        X_WR = reference_pose(scene, states[begin], subgoal.reference)
        return SourceSegment(
            subgoal, demonstration.index, scene, begin, first, last, span.moment, is_joined, motions, X_WR, X_WO
        )


def _pose(row: Array) -> Pose:
    return Pose.of(row[:3], row[3:])


def _first_time(holds: NDArray[np.bool_], start: int) -> int | None:
    """Return the first state after ``start`` in which a condition holds, or None.

    If it holds at ``start``, it must become false before, as in a rollout.
    """
    false = np.flatnonzero(~holds[start:])
    if not len(false):
        return None
    true = np.flatnonzero(holds[start + int(false[0]) :])
    return start + int(false[0]) + int(true[0]) if len(true) else None
