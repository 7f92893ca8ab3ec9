"""Accept or reject proposed tasks.

All names in the goal must exist, the goal must require a change and be feasible, and the task must be new.
"""

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

# Maximum number of predicates in a goal.
MOST_PREDICATES = 16


@dataclass(frozen=True, eq=False)
class AcceptedTask:
    """A feasible task, identified by its name and goal.

    ``state`` is a state at rest in which the goal holds, or None if the goal requires a hand to hold an object.
    """

    name: str
    goal: Any
    state: SceneState | None = None

    def covers(self, goal: Any, setting: TaskContext) -> bool:
        """Return whether completing this task also achieves another goal about the same objects."""
        if self.state is None or set(objects_of(self.goal)) != set(objects_of(goal)):
            return False
        return setting.twin.judge(goal, self.state).value


def accept(
    task: TaskSpec | Any, setting: TaskContext, known: Sequence[AcceptedTask] = ()
) -> AcceptedTask | tuple[Reason, ...]:
    """Accept or reject a task or a bare goal.

    A task is also rejected if a ``known`` task has the same goal, or ends in a state in which this goal holds too.

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
    """Return the names of known tasks that are always completed along with a new, stricter task, with the reasons.

    The reverse case does not need to be handled here, because :func:`accept` rejects new tasks that are completed along
    with a known one.
    """
    return [
        (other.name, Reason("duplicate", f"it is achieved whenever the stricter task `{new.name}` is"))
        for other in known
        if new.covers(other.goal, setting)
    ]


def misnamed(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return reasons for names that do not exist in the scene, and for predicates that are unknown or not allowed."""
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
            hint = nearest(owner, there) or "the scene has none"
            found.append(Reason("unknown_name", f"no {what} is called `{owner}`; {hint}"))
        elif part:
            item = objects[owner]
            names = [*(link.name for link in item.links), *(joint.name for joint in item.joints)]
            if part not in names:
                found.append(Reason("unknown_name", f"`{owner}` has no part `{part}`; {nearest(part, names)}"))
    if len(call.args) == 2 and call.args[0] == call.args[1]:
        found.append(Reason("bad_goal", f"{call} requires two different objects"))
    return found


def unchanged(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return a reason if the goal requires no change, because it already holds or contains only negated predicates."""
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
    """Return a reason if no hand can reach an object in the goal at its current pose."""
    names = dict.fromkeys(a for text, _ in texts(goal) for a in parse_call(text).args)
    there = {o.name: o for o in setting.twin.scene.objects}
    found: list[Reason] = []
    for name in names:
        item = there.get(name.partition(".")[0])
        if item is not None and item.name != setting.twin.ground and not found:
            # Access to shelf levels from the sides was verified in the twin; an approach from above may be impossible.
            several = levels(setting, name, setting.twin.state)
            reach = setting.too_far if several else setting.cannot_reach
            found += reach(name, *setting.bounds(name))
    return tuple(found)


def impossible(goal: Any, setting: TaskContext) -> tuple[Reason, ...]:
    """Return the reasons why a goal is infeasible, or an empty tuple if a state was found in which it is true."""
    found = witness(setting, goal)
    return () if isinstance(found, Witness) else found
