"""The choice of a segment for each sub-goal of a task."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.augment.library import SegmentLibrary, check_robots, open_library
from simfoundry.augment.options import AugmentOptions, Selection
from simfoundry.augment.paths import ObstacleError, Present, SegmentPlan, plan_segment, transformed
from simfoundry.augment.segments import SourceSegment
from simfoundry.augment.subgoals import Subgoal, reference_pose, subgoals
from simfoundry.augment.transform import UP, Adaptation, ObjectFacts, adaptations
from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Pose
from simfoundry.predicates import Judge
from simfoundry.runtime.workers import report_progress
from simfoundry.scene.state import SceneState

# Maximum number of transformed segments to try for a sub-goal; all of ten demonstrations usually are fewer.
TRIES = 60

# Weight of a rotation of the reference against its displacement when demonstrations are compared [m/rad]: a hand at the
# rim of a bowl moves by about as much.
PER_RAD = 0.1


@dataclass(frozen=True, eq=False)
class ChosenSegment:
    """A segment that can be carried out, with its transforms and its commands."""

    segment: SourceSegment
    adaptation: Adaptation
    plan: SegmentPlan


class NoSegmentError(Exception):
    """An error raised if no segment can be carried out. ``kind`` is the most frequent reason."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class SegmentChooser:
    """Chooses segments of demonstrations for a task.

    Attributes:
        library: The segments.
        subgoals: The sub-goals of the task.
        teams: The robots that achieve each sub-goal.
    """

    def __init__(self, folder: Path, task: Task, options: AugmentOptions, judge: Judge) -> None:
        self.library: SegmentLibrary = open_library(folder, options.use)
        check_robots(self.library, task.scene, task.robots)
        self._task, self._options, self._facts = task, options, ObjectFacts(task.scene)
        self.subgoals = subgoals(task)
        found = [self.library.matching(one, self._facts) for one in self.subgoals]
        self._check_skills(folder, found, judge)
        self.teams = [self.library.segments[numbers[0]].robots if numbers else () for numbers in found]
        self._candidates = [
            [n for n in numbers if self.library.segments[n].robots == team]
            for numbers, team in zip(found, self.teams, strict=True)
        ]

    def _check_skills(self, folder: Path, found: list[list[int]], judge: Judge) -> None:
        """Check that there is a segment for each sub-goal that does not hold from the beginning.

        Raises:
            PolicyError: If there is none.
        """
        start = SceneState.initial(self._task.scene)
        for subgoal, numbers in zip(self.subgoals, found, strict=True):
            if not numbers and not subgoal.is_implied and not judge(subgoal.condition, start).value:
                raise PolicyError(
                    f"no demonstration in {folder} achieves anything like `{subgoal.call}`, which task "
                    f"`{self._task.name}` requires; record demonstrations of this skill"
                )

    def needs(self, k: int) -> set[int]:
        """Return the earlier sub-goals of other robots that must be achieved before a sub-goal is begun.

        They are those that the demonstration had achieved by then.
        """
        if k >= len(self.subgoals) or not self._candidates[k]:
            return set(range(k))
        segment = self.library.segments[self._candidates[k][0]]
        moments = {j: self.library.moment(segment.demonstration, self.subgoals[j]) for j in range(k)}
        return {j for j, moment in moments.items() if moment is not None and moment <= segment.first}

    def is_possible(self, k: int) -> bool:
        """Return True if there are segments for a sub-goal."""
        return bool(self._candidates[k])

    def chained(self, k: int, demonstration: int) -> set[int]:
        """Return the later sub-goals that must use the same demonstration as a sub-goal.

        They are those whose segments are joined to its segment, and the others on which these depend.
        """
        found, team = set[int](), set(self.teams[k])
        for j in range(k + 1, len(self.subgoals)):
            segments = [self.library.segments[n] for n in self._candidates[j]]
            segment = next((one for one in segments if one.demonstration == demonstration), None)
            if segment is not None and set(segment.robots) & team:
                if segment.is_joined:
                    found |= {j, *(i for i in range(k + 1, j) if set(self.teams[i]) & set(segment.robots))}
                    team |= set(segment.robots)
                else:
                    team -= set(segment.robots)
        return found

    def choose(
        self, k: int, state: SceneState, hands: Mapping[str, Pose], now: Present, used: Mapping[str, int],
        rng: np.random.Generator,
        only: int | None = None,
    ) -> ChosenSegment:  # fmt: skip
        """Return the first segment for a sub-goal that can be carried out.

        Args:
            k: The number of the sub-goal.
            state: The present state.
            hands: The present poses of the hands.
            now: The situation of the arms.
            used: The demonstration of the last segment of each robot.
            rng: The source of randomness.
            only: The demonstration to use, or None for any.

        Raises:
            NoSegmentError: If none can be carried out.
        """
        subgoal, tried = self.subgoals[k], Counter[str]()
        kinds = Counter[str]()
        for number, adaptation in self._ordered(k, state, hands, used, rng):
            segment = self.library.segments[number]
            if only is not None and segment.demonstration != only:
                continue
            report_progress(f"{subgoal.name}: trying demonstration {segment.demonstration}")
            try:
                plan = plan_segment(segment, adaptation, subgoal, now, self._options.bridge)
                return ChosenSegment(segment, adaptation, plan)
            except ObstacleError as error:
                kinds[str(error.kind)] += 1
                tried[str(error)] += 1
            if tried.total() >= TRIES:
                break
        reasons = ", ".join(f"{count} times {reason}" for reason, count in tried.most_common())
        kind = kinds.most_common(1)[0][0] if kinds else "no source"
        raise NoSegmentError(kind, f"no segment can be carried out: {reasons or 'none continues the last one'}")

    def _ordered(
        self, k: int, state: SceneState, hands: Mapping[str, Pose], used: Mapping[str, int], rng: np.random.Generator
    ) -> Iterator[tuple[int, Adaptation]]:
        """Yield the segments for a sub-goal with their transforms, in the order of the selection."""
        subgoal, found = self.subgoals[k], dict[int, list[Adaptation]]()
        numbers = [n for n in self._candidates[k] if _continues(self.library.segments[n], used)]

        def transforms(n: int) -> list[Adaptation]:
            if n not in found:
                one, facts = self.library.segments[n], self.library.facts[n]
                found[n] = adaptations(one, subgoal, state, self._facts, facts, hands)
            return found[n]

        match self._options.select:
            case Selection.RANDOM:
                numbers = [numbers[i] for i in rng.permutation(len(numbers))]
            case Selection.OBJECT:
                X_WR = reference_pose(self._task.scene, state, subgoal.reference)
                numbers.sort(key=lambda n: self._distance(n, X_WR, subgoal))
            case Selection.HAND:
                numbers.sort(key=lambda n: self._reach(n, transforms(n)[0], hands))
        for n in numbers:
            for adaptation in transforms(n):
                yield n, adaptation

    def _distance(self, number: int, X_WR: Pose, subgoal: Subgoal) -> float:
        """Return how far the reference of a segment is from its present pose [m]."""
        segment = self.library.segments[number]
        turned = (X_WR @ Pose.about(UP, turn) for turn in self._facts.rotations(subgoal.reference))
        angle = min(segment.X_WR.angle_to(pose) for pose in turned)
        return float(np.linalg.norm(segment.X_WR.p - X_WR.p)) + PER_RAD * angle

    def _reach(self, number: int, adaptation: Adaptation, hands: Mapping[str, Pose]) -> float:
        """Return how far the hands are from the start of a transformed segment [m]."""
        segment = self.library.segments[number]
        starts = {name: transformed(segment, name, adaptation.changes[name])[0] for name in segment.robots}
        return max(float(np.linalg.norm(hands[name].p - pose.p)) for name, pose in starts.items())


def _continues(segment: SourceSegment, used: Mapping[str, int]) -> bool:
    """Return True if a segment is not joined to the one before it, or if that one is of the same demonstration."""
    before = {used.get(name, segment.demonstration) for name in segment.robots}
    return not segment.is_joined or before == {segment.demonstration}
