"""Derive task ideas from a scene's affordances: cavities, level surfaces, movable joints, and graspable objects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from simfoundry.cousins.layout.supports import supports_of
from simfoundry.cousins.tasks.candidate_poses import across, cavities, is_free, objects_of
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.predicates import PredicateError
from simfoundry.spec.models.predicate import Call, parts

# Maximum number of objects to gather at one target.
TOGETHER = 3

# Maximum fraction of a target's area that several objects may occupy together.
ROOM = 0.9


# Minimum depth and width of a container's cavity [m].
HOLLOW = (0.025, 0.04)

# Minimum width of a support [m].
BROAD = 0.1


@dataclass(frozen=True)
class IdeaStep:
    """A step of a task.

    ``words`` is the instruction for the step. ``thing`` is the object to move, or an empty string if the step moves a
    joint.
    """

    name: str
    goal: Any
    words: str
    thing: str = ""


@dataclass(frozen=True)
class Idea:
    """A task that may be feasible.

    Attributes:
        name: Name of the task.
        goal: Conditions that must all hold.
        steps: Steps in order.
        odd: Rank in the order of proposals: 0 for tasks with one step, which are proposed first, and 1 for all others.
    """

    name: str
    goal: tuple[Any, ...]
    steps: tuple[IdeaStep, ...]
    odd: int = 0

    @property
    def things(self) -> tuple[str, ...]:
        """The names of the objects that the steps move."""
        return tuple(dict.fromkeys(step.thing for step in self.steps if step.thing))

    @property
    def about(self) -> tuple[str, ...]:
        """The names of the objects and robots in the goal."""
        return objects_of({"all": self.goal})


@dataclass(frozen=True)
class Affordances:
    """The objects in a scene, grouped by affordance.

    Attributes:
        things: Names of graspable objects.
        containers: Objects or parts with a cavity, as ``object`` or ``object.part``.
        supports: Objects or parts with a level surface, as ``object`` or ``object.part``.
        joints: Joints that can be opened, as ``object.joint``.
        topped: Supports with a cavity below their top, such as cabinets, for which `OnTop` does not imply `Inside`.
    """

    things: tuple[str, ...]
    containers: tuple[str, ...]
    supports: tuple[str, ...]
    joints: tuple[str, ...]
    topped: tuple[str, ...] = ()

    @classmethod
    def of(cls, setting: TaskContext) -> Affordances:
        """Determine the affordances of a scene's objects from their collision geometry."""
        present = (o for o in setting.twin.scene.objects if o.name not in setting.twin.absent)
        names = [o.name for o in present if any(link.colliders for link in o.links)]
        raised = [n for n in names if n != setting.twin.ground]
        parts = {n: [f"{n}.{j.child}" for j in setting.joints(n)] for n in names}
        hollow = [t for n in raised for t in (n, *parts[n]) if _hollow(setting, t)]
        boards = {n: _boards(setting, n) for n in raised}
        # Drawers and named shelf boards are listed instead of the cabinet or shelf that they belong to.
        own = [t for t in hollow if not ("." not in t and (boards[t] or any(p in hollow for p in parts[t])))]
        level = [t for n in raised for t in boards[n] or [n] * _level(setting, n, hollow)]
        return cls(
            tuple(n for n in names if not setting.cannot_take(n)),
            tuple(own),
            tuple(level),
            tuple(f"{n}.{j.name}" for n in names for j in setting.joints(n)),
            tuple(n for n in level if any(t.partition(".")[0] == n for t in hollow) and _has_top(setting, n)),
        )


def _hollow(setting: TaskContext, name: str) -> bool:
    """Return True if an object has a usable cavity.

    A usable cavity is deep enough, wide enough, and free at its center.
    """
    try:
        found = cavities(setting, name)
    except PredicateError:
        return False
    large = [(link, hole) for link, hole in found if hole.deep >= HOLLOW[0] and across(hole) >= HOLLOW[1]]
    return any(is_free(setting, name.partition(".")[0], link, hole.middle) for link, hole in large)


def _level(setting: TaskContext, name: str, hollow: list[str]) -> bool:
    """Return True if an object has a level top or floor and is wide enough to support other objects."""
    low, high = setting.bounds(name)
    level = name in hollow or setting.twin[name].support(None) is not None
    return level and float((high - low)[:2].min()) >= BROAD


def _boards(setting: TaskContext, name: str) -> list[str]:
    """Return the static links of an object that have a wide level surface.

    The result is empty if there are fewer than two such links.
    """
    own = setting.twin[name]
    levels = {k: supports_of(name, own.placed, [k]) for k in own.still_links} if len(own.still_links) > 1 else {}
    broad = [k for k in levels if any(np.subtract(*level.bounds[::-1]).min() >= BROAD for level in levels[k])]
    return [f"{name}.{own.item.links[k].name}" for k in broad] if len(broad) > 1 else []


def _has_top(setting: TaskContext, name: str) -> bool:
    """Return True if the highest level surface of an object is a top rather than a floor.

    A top is in the upper half of the object.
    """
    levels = setting.twin[name].levels
    low, high = setting.bounds(name)
    return bool(levels) and levels[-1].height > float(low[2] + high[2]) / 2


def ideas(setting: TaskContext, there: Affordances) -> Iterator[Idea]:
    """Yield all candidate tasks without verifying them."""
    for thing in there.things:
        ways = [*product(["Inside"], there.containers), *product(["OnTop"], there.supports)]
        for word, target in ways:
            stays = word == "OnTop" and setting.twin.carried.get(thing) == (target,)
            if target.partition(".")[0] != thing and not stays and _fits(setting, (thing,), target):
                yield _placed(setting, thing, word, target, there)
    for step in (_moved(joint, word) for joint, word in product(there.joints, ("Open", "Closed"))):
        yield Idea(step.name, (step.goal,), (step,))
    yield from _stacks(setting, there)
    yield from _gathered(setting, there)


def _placed(setting: TaskContext, thing: str, word: str, target: str, there: Affordances) -> Idea:
    """Return the idea of putting an object into or onto a target.

    If the target is a drawer, it is opened first and closed afterward.
    """
    step = _on_top(thing, target) if word == "OnTop" and target in there.topped else _step(thing, word, target)
    joint = next((j for j in there.joints if word == "Inside" and _lid(setting, j, target)), None)
    if joint is None or setting.twin.judge(f"Open({joint})", setting.twin.state).value:
        return Idea(step.name, parts(step.goal)[1], (step,))
    steps = (_moved(joint, "Open"), step, _moved(joint, "Closed"))
    return Idea(f"store_{step.name}", (step.goal, steps[2].goal), steps, 1)


def _lid(setting: TaskContext, joint: str, target: str) -> bool:
    """Return True if a joint moves the target part or, if the target is an object, any of its parts."""
    owner, _, part = target.partition(".")
    if not part:
        return joint.partition(".")[0] == owner
    return joint in {f"{owner}.{j.name}" for j in setting.joints(owner) if j.child == part}


def _stacks(setting: TaskContext, there: Affordances) -> Iterator[Idea]:
    """Yield ideas for stacking objects, such as a cup in a bowl on a plate.

    A stack consists of a support, a container on it, and the largest object that fits into the container.
    """
    for below, middle in product(there.supports, there.containers):
        if middle == below or middle not in there.things or not _fits(setting, (middle,), below):
            continue
        tops = [t for t in there.things if t not in (below, middle) and _fits(setting, (t,), middle)]
        if tops:
            # The largest object is the one whose bounding box has the largest minimum face area.
            sizes = {t: np.sort(np.subtract(*setting.bounds(t)[::-1])) for t in tops}
            top = max(tops, key=lambda t: (float(np.prod(sizes[t][:2])), t))
            steps = (_step(middle, "OnTop", below), _step(top, "Inside", middle))
            yield Idea(f"stack_{top}_{middle}_{below}", tuple(s.goal for s in steps), steps, 1)


def _gathered(setting: TaskContext, there: Affordances) -> Iterator[Idea]:
    """Yield ideas for gathering similar objects in a container or on a support.

    All objects whose names end with the same word are gathered.
    """
    for word, group in _kinds(there):
        for target in dict.fromkeys((*there.containers, *there.supports)):
            if target.partition(".")[0] in group or not _fits(setting, group, target):
                continue
            relation, side = ("Inside", "in") if target in there.containers else ("OnTop", "on")
            steps = tuple(_step(thing, relation, target) for thing in group)
            yield Idea(f"all_{word}s_{side}_{_short(target)}", tuple(s.goal for s in steps), steps, 1)


def _kinds(there: Affordances) -> Iterator[tuple[str, tuple[str, ...]]]:
    words: dict[str, list[str]] = {}
    for name in there.things:
        last = [part for part in name.split("_") if not part.isdigit()][-1]
        words.setdefault(last, []).append(name)
    for word, names in words.items():
        if 2 <= len(names) <= TOGETHER:
            yield word, tuple(names)


def _fits(setting: TaskContext, things: tuple[str, ...], target: str) -> bool:
    """Return True if objects are small enough for a target.

    Only bounding boxes are compared.
    """
    room, *sizes = (np.subtract(*setting.bounds(name)[::-1]) for name in (target, *things))
    if len(sizes) == 1:
        return bool((np.sort(sizes[0])[:2] <= np.sort(room[:2])).all())
    return sum(float(np.prod(size[:2])) for size in sizes) <= ROOM * float(np.prod(np.sort(room[:2])))


def _step(thing: str, word: str, target: str) -> IdeaStep:
    side, preposition = ("in", "inside") if word == "Inside" else ("on", "on")
    words = f"put the {_said(thing)} {preposition} the {_said(target)}"
    return IdeaStep(f"{thing}_{side}_{_short(target)}", f"{word}({thing}, {target})", words, thing)


def _on_top(thing: str, target: str) -> IdeaStep:
    """Return the step of putting an object on top of a target rather than into the cavity below its top."""
    goal = {"all": (f"OnTop({thing}, {target})", {"not": f"Inside({thing}, {target})"})}
    words = f"put the {_said(thing)} on top of the {_said(target)}"
    return IdeaStep(f"{thing}_on_top_of_{_short(target)}", goal, words, thing)


def _moved(joint: str, word: str) -> IdeaStep:
    verb = "open" if word == "Open" else "close"
    return IdeaStep(f"{verb}_{_short(joint)}", f"{word}({joint})", f"{verb} the {_said(joint)}")


# Phrases for predicates in instructions.
WORDS = {
    "NextTo": "next to", "LeftOf": "left of", "RightOf": "right of", "InFrontOf": "in front of", "Behind": "behind",
    "Touching": "against", "Above": "above", "Under": "under", "OnTop": "on", "Inside": "in",
}  # fmt: skip


def step_of(call: Call) -> IdeaStep:
    """Return the step that makes a predicate true."""
    thing = call.args[0]
    if call.predicate in ("Inside", "OnTop"):
        return _step(thing, call.predicate, call.args[1])
    if call.predicate in ("Open", "Closed"):
        return _moved(thing, call.predicate)
    others = [_short(a) for a in call.args[1:2] if call.kinds[1] == "thing"]
    verb = {"Lifted": "lift", "Grasped": "take", "Upright": "stand up"}.get(call.predicate, "move")
    words = f"{verb} the {_said(thing)}"
    if call.predicate in WORDS:
        words = f"put the {_said(thing)} {WORDS[call.predicate]} the {_said(call.args[1])}"
    return IdeaStep("_".join([_short(thing), call.predicate.lower(), *others]), str(call), words, thing)


def _short(name: str) -> str:
    return name.replace(".", "_")


def _said(name: str) -> str:
    """Convert a name to plain words.

    For example, ``cabinet.drawer`` becomes `drawer of the cabinet`.
    """
    owner, _, part = name.partition(".")
    words = owner.replace("_", " ")
    return f"{part.replace('_', ' ')} of the {words}" if part else words
