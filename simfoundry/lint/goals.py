"""Conditions that the goals of a task require."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from simfoundry.lint.certainty import StartJudge
from simfoundry.lint.lints import Subject
from simfoundry.lint.report import Path_
from simfoundry.spec.models.predicate import Call, parse_call, parts


def pending(subject: Subject) -> list[tuple[Call, Path_]]:
    """Predicates that must become true and do not hold at the start, each with the path of its goal."""
    task, judge = subject.task, StartJudge(subject.scene)
    goals: list[tuple[Any, Path_]] = [(task.goal, ("goal",))]
    goals += [(subtask.goal, ("subtasks", name, "goal")) for name, subtask in task.subtasks.items()]
    wanted = (found for goal, path in goals for found in _conjuncts(goal, path))
    return [(call, path) for call, path in wanted if judge.value(str(call)) is not True]


def _conjuncts(condition: Any, path: Path_) -> Iterator[tuple[Call, Path_]]:
    """Predicates that must all become true: those not below `any`, whose alternatives may hold, nor below `not`."""
    tag, below = parts(condition)
    if tag == "text":
        yield parse_call(condition), path
    elif tag == "all":
        for k, item in enumerate(below):
            yield from _conjuncts(item, (*path, tag, k))
