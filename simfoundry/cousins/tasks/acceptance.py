"""Acceptance of proposed tasks: names exist, the goal requires a change, it is feasible, and it is new."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.cousins.tasks.candidate_poses import branches, levels, meaning, objects_of
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.witness import ALLOWED, HELD, Witness, witness
from simfoundry.predicates import PredicateError
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.predicate import Call, ExpressionError, parse_call, texts
from simfoundry.spec.models.task import TaskSpec

MOST_PREDICATES = 16
"""Maximum number of predicates in a goal."""


@dataclass(frozen=True, eq=False)
class AcceptedTask:
    """A feasible task, by its name and goal.

    ``state`` is a state at rest in which the goal holds; None if that requires a hand to hold an object.
    """

    name: str
    goal: Any
    state: SceneState | None = None

    def covers(self, goal: Any, setting: TaskContext) -> bool:
        """Return whether reaching this goal also reaches another goal about the same objects."""
        if self.state is None or set(objects_of(self.goal)) != set(objects_of(goal)):
            return False
        return setting.twin.judge(goal, self.state).value


def accept(
    task: TaskSpec | Any, setting: TaskContext, known: Sequence[AcceptedTask] = ()
) -> AcceptedTask | tuple[Reason, ...]:
    """Return a task, or a goal alone, with a state in which it is achieved; or the reasons for refusing it.

    It is refused if one of the ``known`` tasks has the same goal, or ends in a state in which this one is achieved too.
    """
    name, goal = (task.name, task.goal) if isinstance(task, TaskSpec) else ("", task)
    if found := misnamed(goal, setting):
        return found
    for other in known:
        if meaning(other.goal) == meaning(goal):
            return (Reason("duplicate", f"it has the same goal as `{other.name}`"),)
    if found := unchanged(goal, setting):
        return found
    for other in known:
        if other.covers(goal, setting):
            return (Reason("duplicate", f"it is achieved whenever `{other.name}` is"),)
    shown = witness(setting, goal)
    if not isinstance(shown, Witness):
        return shown
    held = any(call.predicate in HELD for way in branches(goal) for call in way)
    return AcceptedTask(name, goal, None if held else shown.state)


def superseded(new: AcceptedTask, known: Sequence[AcceptedTask], setting: TaskContext) -> list[tuple[str, Reason]]:
    """Return the known tasks that a stricter new task achieves along the way, by name, each with the reason.

    The reverse cannot occur, because :func:`accept` has refused a new task that a known one achieves along the way.
    """
    return [
        (other.name, Reason("duplicate", f"it is achieved whenever the stricter task `{new.name}` is"))
        for other in known
        if new.covers(other.goal, setting)
    ]


def misnamed(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return reasons for names missing from the scene, and for predicates unknown or not allowed in goals."""
    found: list[Reason] = []
    every = [text for text, _ in texts(goal)]
    if not every or len(every) > MOST_PREDICATES:
        text = f"a goal must have 1 to {MOST_PREDICATES} predicates, but this one has {len(every)}"
        return (Reason("bad_goal", text, {"predicates": len(every)}),)
    for text in every:
        try:
            call = parse_call(text)
        except ExpressionError as error:
            hint = f"; {nearest(error.word, error.choices)}" if error.choices else ""
            found.append(Reason("bad_goal", f"{error}{hint}"))
            continue
        if call.predicate not in (*ALLOWED, "Released"):
            text = f"`{call.predicate}` is not allowed in a goal; allowed: {', '.join(ALLOWED)}"
            found.append(Reason("not_allowed", text))
        found += _unknown(call, setting)
    return tuple({reason.text: reason for reason in found}.values())


def _unknown(call: Call, setting: TaskContext) -> list[Reason]:
    scene = setting.twin.scene
    objects, robots = {o.name: o for o in scene.objects}, {hand.name for hand in setting.hands}
    found = []
    for name, kind in zip(call.args, call.kinds, strict=True):
        owner, _, part = name.partition(".")
        if kind == "number" or (kind in ("robot", "body") and owner in robots):
            continue
        there = robots if kind == "robot" else objects.keys()
        if owner not in there:
            what = "robot" if kind == "robot" else "object"
            found.append(Reason("unknown_name", f"no {what} is called `{owner}`; {nearest(owner, there) or 'none'}"))
        elif part:
            item = objects[owner]
            names = [*(link.name for link in item.links), *(joint.name for joint in item.joints)]
            if part not in names:
                found.append(Reason("unknown_name", f"`{owner}` has no part `{part}`; {nearest(part, names)}"))
    if len(call.args) == 2 and call.args[0] == call.args[1]:
        found.append(Reason("bad_goal", f"{call} needs two different objects"))
    return found


def unchanged(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return a reason if there is nothing to do: the goal holds at the start, or only asks that something not
    be true.
    """
    twin = setting.twin
    try:
        verdict = twin.judge(goal, twin.state)
    except PredicateError as error:
        return (Reason("impossible", str(error)),)
    if verdict.value:
        return (Reason("already_true", f"it is true at the start: {verdict.why}", {"margin": verdict.margin}),)
    if not any(call.predicate != "Released" for way in branches(goal) for call in way):
        return (Reason("no_change", "it only requires conditions to be false, and none to become true"),)
    return ()


def unreached(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return reasons for objects of a goal that no hand can reach at their poses."""
    names = dict.fromkeys(a for text, _ in texts(goal) for a in parse_call(text).args)
    there = {o.name: o for o in setting.twin.scene.objects}
    found: list[Reason] = []
    for name in names:
        item = there.get(name.partition(".")[0])
        if item is not None and item.name != setting.twin.ground and not found:
            # Reachable shelf levels and directions were verified in the twin; the top may be too high.
            several = levels(setting, name, setting.twin.state)
            reach = setting.too_far if several else setting.cannot_reach
            found += reach(name, *setting.bounds(name))
    return tuple(found)


def impossible(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return the reasons if no state is found in which a goal is true."""
    found = witness(setting, goal)
    return () if isinstance(found, Witness) else found
