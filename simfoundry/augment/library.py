"""The segments of a folder of demonstrations, and the choice of those that can achieve a sub-goal."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from simfoundry.augment.segments import SegmentReader, SourceSegment
from simfoundry.augment.subgoals import Subgoal, same_subgoal
from simfoundry.augment.transform import ObjectFacts
from simfoundry.data.demonstrations import DemonstrationSet, read_demonstrations
from simfoundry.data.trajectory import TrajectorySampler
from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.runtime.workers import report_progress
from simfoundry.scene.model import Scene
from simfoundry.spec.models.signals import ActionSpace

# Number of recordings whose segments stay in memory; a task of a recording needs one.
KEPT = 2

# Penalty of a segment that achieves another predicate with the same effect, such as `Inside` for `OnTop`, added to the
# difference of the objects' sizes as a natural logarithm.
OTHER_PREDICATE = 1.0


@dataclass(frozen=True, eq=False)
class SegmentLibrary:
    """The segments of a folder of demonstrations.

    Attributes:
        segments: The segments, in the order of the demonstrations.
        facts: The objects in the scene of each segment, in the same order.
        space: The action space of the demonstrations.
        hz: The number of actions per second [Hz].
        robots: The kind of each robot, keyed by name.
    """

    segments: tuple[SourceSegment, ...]
    facts: tuple[ObjectFacts, ...]
    space: ActionSpace
    hz: float
    robots: dict[str, str]

    def matching(self, subgoal: Subgoal, facts: ObjectFacts) -> list[int]:
        """Return the positions of the segments that can achieve a sub-goal.

        If there are segments about the same objects, these are returned. Otherwise, those of the most similar skill
        are: with the same predicate or at least the same effect, and with objects of the most similar size.
        """
        same = [k for k, one in enumerate(self.segments) if same_subgoal(one.subgoal, subgoal)]
        if same:
            return same
        costs = {k: self._difference(k, subgoal, facts) for k in range(len(self.segments))}
        least = min((cost for cost in costs.values() if cost is not None), default=None)
        return [k for k, cost in costs.items() if cost is not None and least is not None and cost <= least + 1e-9]

    def _difference(self, k: int, subgoal: Subgoal, facts: ObjectFacts) -> float | None:
        """Return how much the skill of a segment differs from a sub-goal, or None if it is another one."""
        mine = self.segments[k].subgoal
        if mine.call.declaration.effect is not subgoal.call.declaration.effect or bool(mine.held) != bool(subgoal.held):
            return None
        pairs = [(mine.reference, subgoal.reference), (mine.held, subgoal.held)]
        if any(("." in a) != ("." in b) or bool(a) != bool(b) for a, b in pairs):
            return None
        cost = 0.0 if mine.call.predicate == subgoal.call.predicate else OTHER_PREDICATE
        for a, b in pairs:
            if a and "." not in a:
                sizes = [np.sort(np.maximum(f.box(n)[1], 1e-6)) for f, n in ((self.facts[k], a), (facts, b))]
                cost += float(np.abs(np.log(sizes[0] / sizes[1])).sum())
        return cost

    def moment(self, demonstration: int, subgoal: Subgoal) -> int | None:
        """Return the number of actions after which a demonstration achieved a sub-goal, or None if it did not."""
        found = (s for s in self.segments if s.demonstration == demonstration and same_subgoal(s.subgoal, subgoal))
        return next((segment.moment for segment in found), None)


def library_digest(folder: Path, use: int = 0) -> str:
    """Return a digest of the demonstrations in a folder, or of the first ``use`` of them.

    Raises:
        PolicyError: If the folder does not contain them.
    """
    found = _read(folder, use)
    learned = hashlib.sha256()
    for k, head in enumerate(found.heads[: use or None]):
        learned.update(f"{found.facts(k)['starts']} {head['trajectory']}\n".encode())
    return learned.hexdigest()[:16]


def open_library(folder: Path, use: int = 0) -> SegmentLibrary:
    """Read the segments of the demonstrations in a folder, or of the first ``use`` of them.

    Raises:
        PolicyError: If the folder does not contain them.
        SimfoundryError: If they cannot be read.
    """
    return _opened(folder.resolve(), use, library_digest(folder, use))


@lru_cache(maxsize=KEPT)
def _opened(folder: Path, use: int, _: str) -> SegmentLibrary:
    found = _read(folder, use)
    heads = found.heads[: use or None]
    spaces = {str(head["action_space"]) for head in heads}, {float(head["action_hz"]) for head in heads}
    if any(len(one) > 1 for one in spaces):
        raise PolicyError(f"the demonstrations in {folder} have different kinds or rates of actions")
    segments: list[SourceSegment] = []
    facts: list[ObjectFacts] = []
    for turn in range(len(found.tasks)):
        mine = [k for k, head in enumerate(heads) if int(head["index"]) % len(found.tasks) == turn]
        parts = _segments(found, mine) if mine else []
        segments += parts
        facts += [ObjectFacts(parts[0].scene)] * len(parts) if parts else []
    if not segments:
        raise PolicyError(
            f"the demonstrations in {folder} cannot be divided: no sub-goal of their tasks becomes true in them; add "
            "sub-tasks to the tasks, and record again"
        )
    (space,), (hz,) = spaces
    robots = {name: str(kind) for one in found.tasks for name, kind in one["robots"].items()}
    return SegmentLibrary(tuple(segments), tuple(facts), ActionSpace.parse(space), hz, robots)


def _segments(found: DemonstrationSet, positions: Sequence[int]) -> list[SourceSegment]:
    """Return the segments of the demonstrations of one task."""
    task = found.task_of(found[positions[0]])
    parts: list[SourceSegment] = []
    with TrajectorySampler(task) as sampler:
        reader = SegmentReader(task, sampler)
        for number, k in enumerate(positions):
            report_progress(f"dividing demonstration {number + 1} of {len(positions)}")
            parts += reader.read(found[k])
    return parts


def _read(folder: Path, use: int) -> DemonstrationSet:
    from simfoundry.errors import SimfoundryError

    try:
        found = read_demonstrations(folder)
    except SimfoundryError as error:
        raise PolicyError(str(error)) from None
    if len(found) < max(use, 1):
        needed = f"only {len(found)} demonstrations, not {use}" if found else "no demonstrations"
        raise PolicyError(f"{folder} contains {needed}; record more first")
    return found


def check_robots(library: SegmentLibrary, scene: Scene, robots: Sequence[str]) -> None:
    """Check that a task has the robots of the demonstrations.

    Raises:
        PolicyError: If a robot is missing or of another kind.
    """
    for name in robots:
        kind = scene.robot(name).kind
        if library.robots.get(name) != kind:
            known = ", ".join(f"`{n}` ({k})" for n, k in library.robots.items())
            raise PolicyError(
                f"the demonstrations were recorded with {known}, not with `{name}` ({kind}); choose tasks with the "
                "same robots"
            )
