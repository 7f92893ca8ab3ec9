"""Whether a proposed task is one: its names exist, its goal is a change, it can be done, and it is new."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.tasks.meaning import Meaning, branches, meaning
from simfoundry.cousins.tasks.setting import Setting, numbers
from simfoundry.cousins.tasks.witness import ALLOWED, Witness, witness
from simfoundry.predicates import PredicateError
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.expressions import Call, ExpressionError, parse_call, texts
from simfoundry.spec.task import TaskSpec

MOST_PREDICATES = 16
"""A goal of more predicates is not tried."""


def accept(task: TaskSpec | Any, setting: Setting, known: Mapping[Meaning, str] | None = None) -> tuple[Reason, ...]:
    """Why a task, or a goal alone, is not accepted, each reason with its numbers; none where it is.

    ``known`` are the tasks that there are, by what they mean.
    """
    goal = task.goal if isinstance(task, TaskSpec) else task
    found = misnamed(goal, setting)
    if found:
        return found
    same = (known or {}).get(meaning(goal))
    if same is not None:
        return (Reason("duplicate", f"its goal is that of `{same}`"),)
    return unchanged(goal, setting) or impossible(goal, setting)


def misnamed(goal: Any, setting: Setting) -> tuple[Reason, ...]:
    """Names that the scene does not have, and predicates that are not known or not allowed in a goal."""
    found: list[Reason] = []
    every = [text for text, _ in texts(goal)]
    if not every or len(every) > MOST_PREDICATES:
        text = f"a goal has 1 to {MOST_PREDICATES} predicates, not {len(every)}"
        return (Reason("bad_goal", text, numbers(predicates=len(every))),)
    for text in every:
        try:
            call = parse_call(text)
        except ExpressionError as error:
            hint = f"; {nearest(error.word, error.choices)}" if error.choices else ""
            found.append(Reason("bad_goal", f"{error}{hint}"))
            continue
        if call.predicate not in (*ALLOWED, "Released"):
            found.append(
                Reason("not_allowed", f"`{call.predicate}` may not be asked for; allowed: {', '.join(ALLOWED)}")
            )
        found += _unknown(call, setting)
    return tuple({reason.text: reason for reason in found}.values())


def _unknown(call: Call, setting: Setting) -> list[Reason]:
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
        found.append(Reason("bad_goal", f"{call} is about one thing only"))
    return found


def unchanged(goal: Any, setting: Setting) -> tuple[Reason, ...]:
    """Whether there is nothing to do: the goal holds at the start, or asks for nothing to come true."""
    twin = setting.twin
    try:
        verdict = twin.judge(goal, twin.state)
    except PredicateError as error:
        return (Reason("impossible", str(error)),)
    if verdict.value:
        return (Reason("already_true", f"it is true at the start: {verdict.why}", numbers(margin=verdict.margin)),)
    if not any(call.predicate != "Released" for way in branches(goal) for call in way):
        return (Reason("no_change", "it asks for nothing to come true, only that something is not"),)
    return ()


def unreached(goal: Any, setting: Setting) -> tuple[Reason, ...]:
    """Things of a goal that no hand gets to where they are."""
    names = dict.fromkeys(a for text, _ in texts(goal) for a in parse_call(text).args)
    there = {o.name: o for o in setting.twin.scene.objects}
    found: list[Reason] = []
    for name in names:
        item = there.get(name.partition(".")[0])
        if item is not None and item.name != setting.twin.ground and not found:
            found += setting.cannot_reach(name, *setting.bounds(name))
    return tuple(found)


def impossible(goal: Any, setting: Setting) -> tuple[Reason, ...]:
    """Why no state is found in which a goal is true."""
    found = witness(setting, goal)
    return () if isinstance(found, Witness) else found
