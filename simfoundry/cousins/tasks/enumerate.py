"""Task cousins without a model: what the scene's things afford, proved one by one, in an order that varies them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.tasks.accept import AcceptedTask, accept, superseded
from simfoundry.cousins.tasks.document import free_name, task_of
from simfoundry.cousins.tasks.ideas import Affordances, Idea, ideas
from simfoundry.cousins.tasks.meaning import goal_words
from simfoundry.cousins.tasks.setting import Setting
from simfoundry.spec.models.task import TaskSpec

Progress = Callable[[int, int], None]
"""Told how many are accepted and how many were looked at."""


@dataclass(frozen=True)
class Proposal:
    """A proposed task; ``reasons`` why it is not accepted, none where it is. ``task`` is None where none can be made.

    ``goal`` is what it asks for, as text.
    """

    name: str
    goal: str
    task: TaskSpec | None
    reasons: tuple[Reason, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons


class Proposals:
    """What is proposed for a setting, ``found`` in order, of which no two accepted ones end in the same state."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.found: list[Proposal] = []
        self.accepted: list[AcceptedTask] = []

    @property
    def names(self) -> set[str]:
        """Those of the accepted tasks."""
        return {task.name for task in self.accepted}

    def add(self, name: str, goal: str, made: TaskSpec) -> None:
        """Propose a task; where it is accepted, those that are done along the way are not any more."""
        new = accept(made, self.setting, self.accepted)
        if isinstance(new, tuple):
            self.found.append(Proposal(name, goal, made, new))
            return
        less = dict(superseded(new, self.accepted, self.setting))
        self.found = [
            replace(p, reasons=(less[p.name],)) if p.accepted and p.name in less else p for p in self.found
        ] + [Proposal(name, goal, made)]
        self.accepted = [task for task in self.accepted if task.name not in less] + [new]


def enumerate_tasks(
    setting: Setting,
    count: int | None = None,
    seed: int = 0,
    scene: str = "",
    objects: tuple[str, ...] = (),
    progress: Progress = lambda accepted, seen: None,
) -> list[Proposal]:
    """Proposals until ``count`` are accepted, or all that there are; those that are not accepted say why.

    ``scene`` is the scene's file relative to the documents, ``objects`` those that a task may be about. The same
    setting and seed give the same proposals.
    """
    note = f"task cousin of `{setting.twin.scene.name}`, from what its things afford"
    proposed = Proposals(setting)
    for idea in ranked(setting, seed, objects):
        if len(proposed.accepted) == count:
            break
        name = free_name(idea.name, proposed.names)
        made = task_of(Idea(name, idea.goal, idea.steps, idea.odd), setting, scene or "scene.yaml", note)
        proposed.add(name, goal_words({"all": idea.goal}), made)
        progress(len(proposed.accepted), len(proposed.found))
    return proposed.found


def ranked(setting: Setting, seed: int, objects: tuple[str, ...] = ()) -> Iterator[Idea]:
    """Ideas, the likely ones first, and of those that are alike the ones whose things were least used so far."""
    every = [idea for idea in ideas(setting, Affordances.of(setting)) if not objects or set(idea.about) <= set(objects)]
    rng = np.random.default_rng(seed)
    groups = dict.fromkeys(idea.about for idea in every)
    draw = dict(zip(groups, rng.random(len(groups)).tolist(), strict=True))  # of the same objects in the ideas' order
    used: Counter[str] = Counter()
    for odd in sorted({idea.odd for idea in every}):
        left = [idea for idea in every if idea.odd == odd]
        while left:
            best = min(left, key=lambda idea: (_worn(idea, used), draw[idea.about]))
            left.remove(best)
            used.update([*(f"thing {t}" for t in best.things), " ".join(best.about), *best.about])
            yield best


def _worn(idea: Idea, used: Counter[str]) -> tuple[int, int]:
    """How often the same things were used together, and each of them as it is used here."""
    return used[" ".join(idea.about)], sum(used[f"thing {t}"] for t in idea.things) + max(used[n] for n in idea.about)
