"""Enumerate tasks for a scene, accept or reject them, and write them as documents.

Each document contains an instruction, a goal, steps and start regions.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.cousins.tasks.acceptance import AcceptedTask, accept, superseded
from simfoundry.cousins.tasks.candidate_poses import branches, goal_words
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.ideas import Affordances, Idea, ideas
from simfoundry.lint.lints import lint
from simfoundry.runtime.files import ensure_replaceable, write_atomically
from simfoundry.spec.load import load
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.models.task import Reset, ResetRegion, Subtask, TaskSpec
from simfoundry.spec.yaml.write import to_yaml

# Control steps allowed per task step: 30 s at 15 Hz, as in the paper's tasks.
MINUTE_PART = 450

# Maximum length of a name.
NAME = 64

# Maximum and minimum half extent of an object's start region [m]. An object with less free space gets no region.
REGION, LEAST = 0.02, 0.005


def task(
    name: str, setting: TaskContext, scene: str, instruction: str, goal: Any, steps: dict[str, Subtask], note: str
) -> TaskSpec:
    """Assemble a task document.

    Args:
        name: Name of the task.
        setting: Context of the task.
        scene: Path to the scene, as written in the document.
        instruction: Instruction for a policy.
        goal: The goal.
        steps: Subtasks by name.
        note: Origin of the task, which is truncated to 200 characters.
    """
    about = dict.fromkeys(a.partition(".")[0] for way in branches(goal) for call in way for a in call.args)
    count = max(1, sum(1 for step in steps if not step.startswith(("touch_", "pick_up_"))))
    document = {"simfoundry": "task/1", "name": name, "scene": scene, "instruction": instruction, "goal": goal}
    document |= {"subtasks": steps, "reset": Reset(objects=regions(setting, tuple(about)))}
    document |= {"horizon": MINUTE_PART * count, "origin": Origin(note=note[:200])}
    return TaskSpec.model_validate(document)


def subtasks(idea: Idea, setting: TaskContext) -> dict[str, Subtask]:
    """Return the subtasks of an idea: touching, picking up and placing each object, and opening and closing joints."""
    found: dict[str, Subtask] = {}
    for step in idea.steps:
        if step.thing:
            found |= taking(step.thing, setting)
        found[step.name[:NAME]] = Subtask(goal=step.goal, instruction=_sentence(step.words))
    return found


def taking(thing: str, setting: TaskContext) -> dict[str, Subtask]:
    """Return the subtasks for grasping an object, which are to touch it and then to pick it up.

    The result is empty if the scene has no hand.
    """
    hands = [hand.name for hand in setting.hands]
    if not hands:
        return {}
    touch = [f"Touching({hand}, {thing})" for hand in hands]
    any_of: Any = {"any": tuple(touch)} if len(touch) > 1 else touch[0]
    return {
        f"touch_{thing}"[:NAME]: Subtask.model_validate({"goal": any_of}),
        f"pick_up_{thing}"[:NAME]: Subtask(goal=f"Grasped({thing})"),
    }


def regions(setting: TaskContext, names: tuple[str, ...]) -> dict[str, ResetRegion]:
    """Return a start region for each named object that stands directly on the ground object.

    The region is a square around the object's position in which the object stays clear of all other objects.
    """
    twin = setting.twin
    found: dict[str, ResetRegion] = {}
    hulls_of = {o.name: setting.bounds(o.name) for o in twin.scene.objects if o.name != twin.ground}
    for name in names:
        if twin.carried.get(name) != (twin.ground,):
            continue
        low, high = hulls_of[name]
        others = [box for n, box in hulls_of.items() if n != name and name not in twin.carried.get(n, ())]
        # The gap between two boxes is the larger of their gaps along the two horizontal axes.
        gaps = [float(np.maximum(low - other[1], other[0] - high)[:2].max()) for other in others]
        half = min([REGION, *(gap / 2 - 0.002 for gap in gaps)])
        if half >= LEAST:
            half = np.floor(half * 1000) / 1000
            x, y = np.round(twin.state.poses[name].p[:2], 3).tolist()
            ends = [(round(v - half, 3), round(v + half, 3)) for v in (x, y)]
            found[name] = ResetRegion(x=ends[0], y=ends[1])
    return found


def instruction_of(idea: Idea) -> str:
    """Return the instruction for a policy.

    The instruction lists the steps in plain words.
    """
    words = [step.words for step in idea.steps]
    if len(idea.steps) == 1 and idea.steps[0].thing:
        thing = idea.things[0].replace("_", " ")
        where = words[0].removeprefix(f"put the {thing} ")
        return f"Pick up the {thing}, then put it {where}."
    return _sentence(", then ".join(words))


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def free_name(wanted: str, taken: set[str]) -> str:
    """Convert the requested name to a valid name, and append a number if that name is already taken."""
    plain = re.sub(r"[^a-z0-9_]+", "_", wanted.lower()).strip("_")[:NAME] or "task"
    plain = plain if plain[0].isalpha() else f"task_{plain}"[:NAME]
    names = chain((plain,), (f"{plain[: NAME - 4]}_{k}" for k in count(2)))
    return next(name for name in names if name not in taken)


# Callback that receives the numbers of accepted and examined proposals.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Proposal:
    """A proposed task.

    Attributes:
        name: Name of the task.
        goal: The goal as text.
        task: The task document, or None if the proposal is so flawed that no document can be written.
        reasons: Reasons for rejection, empty if the task was accepted.
    """

    name: str
    goal: str
    task: TaskSpec | None
    reasons: tuple[Reason, ...] = ()

    @property
    def accepted(self) -> bool:
        """True if the task was accepted."""
        return not self.reasons


class Proposals:
    """The proposals for a scene. Completing one accepted task never completes another accepted task.

    ``found`` lists all proposals in order.
    """

    def __init__(self, setting: TaskContext) -> None:
        self.setting = setting
        self.found: list[Proposal] = []
        self.accepted: list[AcceptedTask] = []

    def add(self, name: str, goal: str, made: TaskSpec) -> None:
        """Propose a task. If it is accepted, reject all earlier tasks that it always completes as well."""
        new = accept(made, self.setting, self.accepted)
        if isinstance(new, tuple):
            self.found.append(Proposal(name, goal, made, new))
            return
        less = dict(superseded(new, self.accepted, self.setting))
        known = (replace(p, reasons=(less[p.name],)) if p.accepted and p.name in less else p for p in self.found)
        self.found = [*known, Proposal(name, goal, made)]
        self.accepted = [task for task in self.accepted if task.name not in less] + [new]


def enumerate_tasks(
    setting: TaskContext,
    count: int | None = None,
    seed: int = 0,
    scene: str = "",
    objects: tuple[str, ...] = (),
    progress: Progress = lambda accepted, seen: None,
) -> list[Proposal]:
    """Propose tasks until enough have been accepted or no ideas remain.

    Args:
        setting: Context of the tasks.
        count: Number of tasks to accept, or None to examine all ideas.
        seed: Seed for the random number generator. The same context and seed produce the same proposals.
        scene: Path by which the documents refer to the scene.
        objects: Names of the objects that tasks may involve, or an empty collection to allow all objects.
        progress: Callback that is called after each proposal.

    Returns:
        All proposals. Rejected proposals include the reasons.
    """
    note = f"task cousin of `{setting.twin.scene.name}`, from the affordances of its objects"
    proposed = Proposals(setting)
    for idea in ranked(setting, seed, objects):
        if len(proposed.accepted) == count:
            break
        name = free_name(idea.name, {accepted.name for accepted in proposed.accepted})
        every = (*idea.goal, *(f"Released({thing})" for thing in idea.things))
        goal: Any = {"all": every} if len(every) > 1 else every[0]
        steps = subtasks(idea, setting)
        made = task(name, setting, scene or "scene.yaml", instruction_of(idea), goal, steps, note)
        proposed.add(name, goal_words({"all": idea.goal}), made)
        progress(len(proposed.accepted), len(proposed.found))
    return proposed.found


def ranked(setting: TaskContext, seed: int, objects: tuple[str, ...] = ()) -> Iterator[Idea]:
    """Yield ideas in order of increasing complexity.

    Among equally simple ideas, those with the least used objects come first.
    """
    every = [idea for idea in ideas(setting, Affordances.of(setting)) if not objects or set(idea.about) <= set(objects)]
    rng = np.random.default_rng(seed)
    groups = dict.fromkeys(idea.about for idea in every)
    # Ideas about the same objects share a random number, which preserves their order.
    draw = dict(zip(groups, rng.random(len(groups)).tolist(), strict=True))
    used: Counter[str] = Counter()
    for odd in sorted({idea.odd for idea in every}):
        left = [idea for idea in every if idea.odd == odd]
        while left:
            best = min(left, key=lambda idea: (_worn(idea, used), draw[idea.about]))
            left.remove(best)
            used.update([*(f"thing {t}" for t in best.things), " ".join(best.about), *best.about])
            yield best


def _worn(idea: Idea, used: Counter[str]) -> tuple[int, int]:
    """Return the number of times that an idea's objects have been used before.

    The first number counts ideas with the same combination of objects. The second number counts the uses of the
    individual objects.
    """
    return used[" ".join(idea.about)], sum(used[f"thing {t}"] for t in idea.things) + max(used[n] for n in idea.about)


def scene_reference(scene: Path, out: Path) -> str:
    """Return the path to a scene as it is written in a document in ``out``."""
    return Path(os.path.relpath(scene.resolve(), out.resolve())).as_posix()


def checked(proposals: Sequence[Proposal], out: Path) -> list[Proposal]:
    """Run ``simfoundry check`` on the accepted proposals, and reject those with findings.

    For this purpose, the proposals are treated as documents in ``out``.
    """
    found = []
    for proposal in proposals:
        if proposal.accepted and proposal.task is not None:
            file = file_of(proposal, out)
            loaded = load(file, text=to_yaml(proposal.task))
            wrong = loaded.findings or [d for d in lint(loaded) if d.file == str(file)]
            proposal = replace(proposal, reasons=tuple(Reason("check", f"{d.code}: {d.message}") for d in wrong[:3]))
        found.append(proposal)
    return found


def file_of(proposal: Proposal, out: Path) -> Path:
    """Return the path of a proposal's document."""
    return out / f"{proposal.name}.task.yaml"


def write(proposals: Sequence[Proposal], out: Path, force: bool = False) -> list[Path]:
    """Write the accepted tasks and return their paths in order.

    Raises:
        OutputError: If a file exists with different content and ``force`` is not set; no task is written then.
    """
    accepted = ((proposal, proposal.task) for proposal in proposals if proposal.accepted)
    files = {file_of(proposal, out): to_yaml(task).encode() for proposal, task in accepted if task is not None}
    for file, content in files.items():
        ensure_replaceable(file, force=force, content=content)
    for file, content in files.items():
        write_atomically(file, content)
    return list(files)


def to_json(proposal: Proposal, out: Path) -> dict[str, Any]:
    """Return a proposal as plain data for JSON output."""
    task = proposal.task
    return {
        "name": proposal.name,
        "goal": proposal.goal,
        "accepted": proposal.accepted,
        "instruction": task.instruction if task is not None else None,
        "file": str(file_of(proposal, out)) if proposal.accepted else None,
        "reasons": [reason.to_json() for reason in proposal.reasons],
    }
