"""Task cousins without a model: what the scene's things afford, proved one by one, in an order that varies them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.tasks.accept import accept
from simfoundry.cousins.tasks.document import free_name, task_of
from simfoundry.cousins.tasks.ideas import Affordances, Idea, ideas
from simfoundry.cousins.tasks.meaning import Meaning, meaning
from simfoundry.cousins.tasks.setting import Setting
from simfoundry.spec.task import TaskSpec

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


def enumerate_tasks(
    setting: Setting,
    count: int | None = None,
    seed: int = 0,
    scene: str = "",
    objects: tuple[str, ...] = (),
    known: dict[Meaning, str] | None = None,
    progress: Progress = lambda accepted, seen: None,
) -> list[Proposal]:
    """Proposals until ``count`` are accepted, or all that there are; those that are not accepted say why.

    ``scene`` is the scene's file relative to the documents, ``objects`` those that a task may be about, ``known`` what
    there is already. The same setting and seed give the same proposals.
    """
    known = dict(known or {})
    note = f"task cousin of `{setting.twin.scene.name}`, from what its things afford"
    taken: set[str] = set(known.values())
    found: list[Proposal] = []
    accepted = 0
    for idea in ranked(setting, seed, objects):
        if accepted == count:
            break
        name = free_name(idea.name, taken)
        made = task_of(Idea(name, idea.goal, idea.steps, idea.odd), setting, scene or "scene.yaml", note)
        reasons = accept(made, setting, known)
        found.append(Proposal(name, " and ".join(idea.goal), made, reasons))
        if not reasons:
            accepted += 1
            taken.add(name)
            known[meaning(made.goal)] = name
        progress(accepted, len(found))
    return found


def ranked(setting: Setting, seed: int, objects: tuple[str, ...] = ()) -> Iterator[Idea]:
    """Ideas, the likely ones first, and of those that are alike the ones whose things were least used so far."""
    every = [idea for idea in ideas(setting, Affordances.of(setting)) if not objects or set(idea.about) <= set(objects)]
    rng = np.random.default_rng(seed)
    draw = {id(idea): float(v) for idea, v in zip(every, rng.random(len(every)), strict=True)}
    used: Counter[str] = Counter()
    for odd in sorted({idea.odd for idea in every}):
        left = [idea for idea in every if idea.odd == odd]
        while left:
            best = min(left, key=lambda idea: (_worn(idea, used), draw[id(idea)]))
            left.remove(best)
            used.update([*(f"thing {t}" for t in best.things), " ".join(best.about), *best.about])
            yield best


def _worn(idea: Idea, used: Counter[str]) -> tuple[int, int]:
    """How often the same things were used together, and each of them as it is used here."""
    return used[" ".join(idea.about)], sum(used[f"thing {t}"] for t in idea.things) + max(used[n] for n in idea.about)
