"""An accepted idea as a task document: instruction, goal, steps, and where its things may start."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from simfoundry.cousins.tasks.ideas import Idea
from simfoundry.cousins.tasks.meaning import branches
from simfoundry.cousins.tasks.setting import Setting
from simfoundry.spec.models.base import Origin
from simfoundry.spec.models.task import Reset, ResetRegion, Subtask, TaskSpec

MINUTE_PART = 450
"""Control steps for one step of a task: 30 s at 15 Hz, as the paper's tasks have."""

NAME = 64
"""Letters of a name at most."""

REGION, LEAST = 0.02, 0.005
"""Half the side of the region in which a thing starts [m]; where its neighbours leave less than the least, none."""


def task_of(idea: Idea, setting: Setting, scene: str, note: str) -> TaskSpec:
    """The document of an idea; ``scene`` is the scene's file relative to it, ``note`` says where it comes from."""
    released = [f"Released({thing})" for thing in idea.things]
    goal: Any = {"all": (*idea.goal, *released)} if len(idea.goal) + len(released) > 1 else idea.goal[0]
    return task(idea.name, setting, scene, instruction_of(idea), goal, subtasks(idea, setting), note)


def task(
    name: str, setting: Setting, scene: str, instruction: str, goal: Any, steps: dict[str, Subtask], note: str
) -> TaskSpec:
    """A task document from its parts, which are sound."""
    about = dict.fromkeys(a.partition(".")[0] for way in branches(goal) for call in way for a in call.args)
    count = max(1, sum(1 for step in steps if not step.startswith(("touch_", "pick_up_"))))
    return TaskSpec.model_validate(
        {
            "simfoundry": "task/1",
            "name": name,
            "scene": scene,
            "instruction": instruction,
            "goal": goal,
            "subtasks": steps,
            "reset": Reset(objects=regions(setting, tuple(about))),
            "horizon": MINUTE_PART * count,
            "origin": Origin(note=note[:200]),
        }
    )


def subtasks(idea: Idea, setting: Setting) -> dict[str, Subtask]:
    """Touch, pick up and place each thing; open and close what is to be opened and closed."""
    found: dict[str, Subtask] = {}
    for step in idea.steps:
        if step.thing:
            found |= taking(step.thing, setting)
        found[step.name[:NAME]] = Subtask(goal=step.goal, instruction=_sentence(step.words))
    return found


def taking(thing: str, setting: Setting) -> dict[str, Subtask]:
    """The steps to take a thing: touch it, and hold it."""
    hands = [hand.name for hand in setting.hands]
    if not hands:
        return {}
    touch = [f"Touching({hand}, {thing})" for hand in hands]
    any_of: Any = {"any": tuple(touch)} if len(touch) > 1 else touch[0]
    return {
        f"touch_{thing}"[:NAME]: Subtask.model_validate({"goal": any_of}),
        f"pick_up_{thing}"[:NAME]: Subtask(goal=f"Grasped({thing})"),
    }


def regions(setting: Setting, names: tuple[str, ...]) -> dict[str, ResetRegion]:
    """Where the free things of a task that stand on the ground may start: about where they are, clear of all others."""
    twin = setting.twin
    found: dict[str, ResetRegion] = {}
    hulls_of = {o.name: setting.bounds(o.name) for o in twin.scene.objects if o.name != twin.ground}
    for name in names:
        if twin.carried.get(name) != (twin.ground,):
            continue
        low, high = hulls_of[name]
        gaps = [
            _gap(low, high, *box)
            for other, box in hulls_of.items()
            if other != name and name not in twin.carried.get(other, ())
        ]
        half = min([REGION, *(gap / 2 - 0.002 for gap in gaps)])
        if half >= LEAST:
            half = np.floor(half * 1000) / 1000
            x, y = np.round(twin.state.poses[name].p[:2], 3).tolist()
            ends = [(round(v - half, 3), round(v + half, 3)) for v in (x, y)]
            found[name] = ResetRegion(x=ends[0], y=ends[1])
    return found


def _gap(low: Any, high: Any, other_low: Any, other_high: Any) -> float:
    """How far two boxes are apart along the ground, in the direction in which they are farthest [m]."""
    apart = np.maximum(low[:2] - other_high[:2], other_low[:2] - high[:2])
    return float(apart.max())


def instruction_of(idea: Idea) -> str:
    """What a policy is told: the steps in plain words."""
    words = [step.words for step in idea.steps]
    if len(idea.steps) == 1 and idea.steps[0].thing:
        thing = idea.things[0].replace("_", " ")
        where = words[0].removeprefix(f"put the {thing} ")
        return f"Pick up the {thing}, then put it {where}."
    return _sentence(", then ".join(words))


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def free_name(wanted: str, taken: set[str]) -> str:
    """A valid name that is not taken: the wanted one, or with a number behind it."""
    plain = re.sub(r"[^a-z0-9_]+", "_", wanted.lower()).strip("_")[:NAME] or "task"
    plain = plain if plain[0].isalpha() else f"task_{plain}"[:NAME]
    name, k = plain, 2
    while name in taken:
        name, k = f"{plain[: NAME - 4]}_{k}", k + 1
    return name
