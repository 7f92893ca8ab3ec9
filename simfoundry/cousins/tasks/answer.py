"""What a vision-language model proposes: typed, or as the text that the paper's prompt asks for; never trusted.

Names and predicates are data here: what becomes of them is decided by :mod:`simfoundry.cousins.tasks.accept`.
"""

from __future__ import annotations

import re
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simfoundry.spec.yaml.text import YamlError, parse

MOST_TASKS = 200
MOST_TEXT = 100_000
"""Letters of an answer that are read."""

_MARK = re.compile(r"^\s*-{3,}[^\n]*$|^\s*```[^\n]*$", re.MULTILINE)
"""Between tasks: `--- Task 2`; and the fences that models like to put around YAML."""


class Asked(BaseModel):
    """A predicate of a goal: a state of a group, or of a group and another."""

    model_config = ConfigDict(extra="ignore")

    state: str = Field(max_length=40, description="One of the allowed states.")
    group: str = Field(max_length=130, description="The object, or `object.part`.")
    other_group: str | None = Field(None, max_length=130, description="The other object, for binary states.")
    value: bool = Field(True, description="False where it must not hold.")
    state_kwargs: dict[str, Any] | None = Field(None, description="Not used; null.")


class Told(BaseModel):
    """A proposed task."""

    model_config = ConfigDict(extra="ignore")

    task_name: str = Field(min_length=1, max_length=100, description="Short snake_case name.")
    instruction: str = Field("", max_length=400, description="What the robot is told, in plain words.")
    goal_predicates_all: list[Asked] = Field([], max_length=16, description="All must be true for success.")
    goal_predicates_any: list[Asked] | None = Field(None, max_length=16, description="Any suffices; else null.")
    semantic_group_mapping: dict[str, list[str]] = Field(
        {}, max_length=32, description="Only where groups are not the objects' own names."
    )


class Answer(BaseModel):
    """The proposed tasks."""

    tasks: list[Told] = Field(max_length=MOST_TASKS)


class Unread(BaseModel):
    """A part of an answer that is no task, and why."""

    name: str
    why: str


def read(text: str) -> list[Told | Unread]:
    """The tasks of an answer in the paper's format: YAML blocks, a line `--- Task n` before each."""
    found: list[Told | Unread] = []
    blocks = [block for block in _MARK.split(text[:MOST_TEXT]) if block.strip()]
    for block in blocks[:MOST_TASKS]:
        label = f"part {len(found) + 1} of the answer"
        try:
            data = parse(block, label).data
        except YamlError as error:
            found.append(Unread(name=label, why=f"it is no YAML: {error}"))
            continue
        if not isinstance(data, dict):
            if "task_name" in block:
                found.append(Unread(name=label, why="it is no mapping with the key `task_name`"))
            continue  # words between tasks
        try:
            found.append(Told.model_validate(data))
        except ValidationError as error:
            first = error.errors()[0]
            at = ".".join(str(part) for part in first["loc"])
            name = data.get("task_name")
            found.append(Unread(name=name[:64] if isinstance(name, str) else label, why=f"`{at}`: {first['msg']}"))
    return found


def goal_of(told: Told) -> tuple[Any, str]:
    """The goal of a proposed task as a condition, and what is wrong with its groups; that is empty where nothing is."""
    names, wrong = {}, ""
    for group, members in told.semantic_group_mapping.items():
        if len(members) != 1:
            wrong = wrong or f"the group `{group[:40]}` stands for {len(members)} objects, and must for one"
        else:
            names[group] = members[0]
    terms = [_term(asked, names) for asked in told.goal_predicates_all]
    if told.goal_predicates_any:
        terms.append({"any": tuple(_term(asked, names) for asked in told.goal_predicates_any)})
    if any(asked.state_kwargs for asked in (*told.goal_predicates_all, *(told.goal_predicates_any or []))):
        wrong = wrong or "`state_kwargs` mean nothing here"
    return {"all": tuple(terms)}, wrong


def _term(asked: Asked, names: dict[str, str]) -> Any:
    groups = [asked.group, *([asked.other_group] if asked.other_group else [])]
    text = f"{asked.state}({', '.join(names.get(group, group) for group in groups)})"
    return text if asked.value else {"not": text}
