"""From what a task asks for to what hands do: one skill for each predicate that hands can bring about."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from simfoundry.spec.models.expressions import Call, Condition, parse_call, parts


class Skill(StrEnum):
    """What hands can do."""

    PICK = "pick"
    PUT_ON = "put on"
    PUT_IN = "put in"
    OPEN = "open"
    CLOSE = "close"


SKILLS = {
    "Grasped": Skill.PICK,
    "Lifted": Skill.PICK,
    "OnTop": Skill.PUT_ON,
    "Inside": Skill.PUT_IN,
    "Open": Skill.OPEN,
    "Closed": Skill.CLOSE,
}
"""What brings a predicate about. Those that are not here come with the others (Touching, Released, Upright) or are
where things happen to stand."""

PUTS = (Skill.PUT_ON, Skill.PUT_IN)


@dataclass(frozen=True)
class Step:
    """One thing to do: ``skill`` with the arguments of the predicate ``until`` that it is to bring about."""

    skill: Skill
    args: tuple[str, ...]
    until: str


class Asked(Protocol):
    """A sub-task, as far as it says what is asked."""

    @property
    def goal(self) -> Condition:
        """When it is done."""
        ...


def steps(goal: Condition, subtasks: Mapping[str, Asked]) -> tuple[Step, ...]:
    """What to do, in order: for each sub-task, and then for what the goal asks beyond them."""
    asked = [step for subtask in subtasks.values() for step in _of(subtask.goal)]
    asked += [step for step in _of(goal) if step not in asked]
    return tuple(step for k, step in enumerate(asked) if not _leads_to(step, asked[k + 1 :]))


def goal_steps(goal: Condition) -> tuple[Step, ...]:
    """What the goal itself asks for."""
    found = tuple(_of(goal))
    return tuple(step for step in found if not _leads_to(step, list(found)))


def _leads_to(step: Step, later: list[Step]) -> bool:
    """Whether a later step takes the thing up itself."""
    return step.skill is Skill.PICK and any(s.skill in PUTS and s.args[0] == step.args[0] for s in later)


def _of(condition: Condition) -> Iterator[Step]:
    kind, below = parts(condition)
    if kind == "text":
        call: Call = parse_call(str(condition))
        skill = SKILLS.get(call.predicate)
        if skill is not None:
            yield Step(skill, call.args, str(call))
    elif kind == "all":
        for item in below:
            yield from _of(item)
    elif kind == "any" and below:
        yield from _of(below[0])
