"""Accept or reject proposed tasks.

All names in the goal must exist, the goal must require a change and be feasible, and the task must be new.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

# Maximum number of predicates in a goal.
MOST_PREDICATES = 16


@dataclass(frozen=True, eq=False)
class AcceptedTask:
    """A feasible task with its name and goal.

    ``state`` is a state at rest in which the goal holds, or None if the goal requires a hand to hold an object.
    """

    name: str
    goal: Any
    state: SceneState | None = None

    def covers(self, goal: Any, setting: TaskContext) -> bool:
        """Return True if completing this task also achieves another goal about the same objects."""
        same = set(objects_of(self.goal)) == set(objects_of(goal))
        return self.state is not None and same and setting.twin.judge(goal, self.state).value


def accept(
    task: TaskSpec | Any, setting: TaskContext, known: Sequence[AcceptedTask] = ()
) -> AcceptedTask | tuple[Reason, ...]:
    """Accept or reject a task or a bare goal.

    A task is also rejected if a ``known`` task has the same goal or ends in a state in which the task's goal also
    holds.

    Returns:
        The accepted task with a state in which its goal holds, or the reasons for rejection.
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
    """Return the names of known tasks that are always completed along with a new, stricter task, and the reasons.

    If, conversely, the new task is always completed along with a known task, :func:`accept` has already rejected it.
    """
    reason = Reason("duplicate", f"it is achieved whenever the stricter task `{new.name}` is")
    return [(other.name, reason) for other in known if new.covers(other.goal, setting)]


def misnamed(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return the reasons why the names or predicates in a goal are invalid.

    A name is invalid if it does not exist in the scene. A predicate is invalid if it is not allowed in goals.
    """
    every = [text for text, _ in texts(goal)]
    if not every or len(every) > MOST_PREDICATES:
        text = f"a goal must have 1 to {MOST_PREDICATES} predicates, but this one has {len(every)}"
        return (Reason("bad_goal", text, {"predicates": len(every)}),)
    return tuple({reason.text: reason for text in every for reason in _wrong(text, setting)}.values())


def _wrong(text: str, setting: TaskContext) -> Iterator[Reason]:
    """Yield the reasons why a predicate cannot be used in a goal."""
    try:
        call = parse_call(text)
    except ExpressionError as error:
        yield Reason("bad_goal", str(error))
        return
    if call.predicate not in (*ALLOWED, "Released"):
        allowed = ", ".join(ALLOWED)
        yield Reason("not_allowed", f"`{call.predicate}` is not allowed in a goal; allowed: {allowed}")
    yield from _unknown(call, setting)


def _unknown(call: Call, setting: TaskContext) -> Iterator[Reason]:
    objects, robots = {o.name: o for o in setting.twin.scene.objects}, {hand.name for hand in setting.hands}
    for name, kind in zip(call.args, call.kinds, strict=True):
        owner, _, part = name.partition(".")
        if kind == "number" or (kind in ("robot", "body") and owner in robots):
            continue
        what, there = ("robot", robots) if kind == "robot" else ("object", set(objects))
        if owner not in there:
            hint = nearest(owner, there) or "the scene has none"
            yield Reason("unknown_name", f"no {what} is called `{owner}`; {hint}")
        elif part:
            item = objects[owner]
            names = [*(link.name for link in item.links), *(joint.name for joint in item.joints)]
            if part not in names:
                yield Reason("unknown_name", f"`{owner}` has no part `{part}`; {nearest(part, names)}")
    if len(call.args) == 2 and call.args[0] == call.args[1]:
        yield Reason("bad_goal", f"{call} requires two different objects")


def unchanged(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return a reason if a goal requires no change because it already holds or consists only of negated predicates."""
    twin = setting.twin
    try:
        verdict = twin.judge(goal, twin.state)
    except PredicateError as error:
        return (Reason("impossible", str(error)),)
    if verdict.value:
        return (Reason("already_true", f"it already holds initially: {verdict.why}", {"margin": verdict.margin}),)
    if not any(call.predicate != "Released" for way in branches(goal) for call in way):
        return (Reason("no_change", "it only requires predicates to be false; at least one must become true"),)
    return ()


def unreached(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return a reason if there is an object in the goal that no hand can reach at its current pose."""
    there = {o.name for o in setting.twin.scene.objects} - {setting.twin.ground}
    for name in dict.fromkeys(a for text, _ in texts(goal) for a in parse_call(text).args):
        if name.partition(".")[0] in there:
            # Access to shelf levels from the sides was verified in the twin; an approach from above may be impossible.
            several = levels(setting, name, setting.twin.state)
            reach = setting.too_far if several else setting.cannot_reach
            if found := reach(name, *setting.bounds(name)):
                return found
    return ()


def impossible(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return the reasons why a goal is infeasible.

    The result is an empty tuple if a state was found in which the goal is true.
    """
    found = witness(setting, goal)
    return () if isinstance(found, Witness) else found
