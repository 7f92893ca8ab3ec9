"""Lints SF202, SF405 and SF406: conditions that need a cavity, goals that are already true, and broken relations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from simfoundry.lint.draft import StartJudge
from simfoundry.lint.lints import Lint, Path_, Subject, warning
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.predicate import Call, Effect, parse_call, parts, texts


def pending(subject: Subject) -> list[tuple[Call, Path_]]:
    """Return the predicates that must become true but do not hold initially, each with the path of its goal."""
    judge = StartJudge(subject.scene)
    wanted = (found for goal, path in goals(subject) for found in _conjuncts(goal, path))
    return [(call, path) for call, path in wanted if judge.value(str(call)) is not True]


def goals(subject: Subject) -> list[tuple[Any, Path_]]:
    """Return the goals of a task and of its steps, each with its path."""
    found: list[tuple[Any, Path_]] = [(subject.task.goal, ("goal",))]
    return found + [(subtask.goal, ("subtasks", name, "goal")) for name, subtask in subject.task.subtasks.items()]


def _conjuncts(condition: Any, path: Path_) -> Iterator[tuple[Call, Path_]]:
    """Yield the predicates that must all become true. Predicates inside `any` or `not` are not included."""
    tag, below = parts(condition)
    if tag == "text":
        yield parse_call(condition), path
    elif tag == "all":
        for k, item in enumerate(below):
            yield from _conjuncts(item, (*path, tag, k))


# Effects of predicates whose values do not depend on the object poses sampled at a reset.
INDEPENDENT = (Effect.NONE, Effect.JOINT, Effect.GRASP)


def goals_true_at_start(subject: Subject) -> Iterator[Diagnostic]:
    """Find goals that already hold initially, including the goals of steps that run first or on their own."""
    task, judge = subject.task, StartJudge(subject.scene)
    if _is_true(subject, task.goal, judge):
        yield _goal_finding(subject, ("goal",), "the goal is already true at the start", judge.explanation(task.goal))
    for k, (name, subtask) in enumerate(task.subtasks.items()):
        if subtask.start is None and k > 0:
            continue
        if subtask.start is not None and name not in subject.steps:  # its start is invalid
            continue
        own = judge if subtask.start is None else StartJudge(subject.steps[name])
        if _is_true(subject, subtask.goal, own):
            message = f"the `{name}` step is already complete when it starts"
            yield _goal_finding(subject, ("subtasks", name, "goal"), message, own.explanation(subtask.goal))


def _is_true(subject: Subject, goal: Any, judge: StartJudge) -> bool:
    """Return True if a goal is certain to hold for all object poses that a reset may sample."""
    calls = [parse_call(text) for text, _ in texts(goal)]
    placed = {arg.partition(".")[0] for c in calls if c.declaration.effect not in INDEPENDENT for arg in c.args}
    return not (placed & subject.task.reset.objects.keys()) and judge.value(goal) is True


def _goal_finding(subject: Subject, path: Path_, message: str, why: str) -> Diagnostic:
    hint = "require a condition that the robot must bring about, or change the initial state"
    return warning(subject.loaded, "SF405", path, f"{message}: {why}" if why else message, hint)


TRUE_AT_START = Lint("SF405", ("task/1",), goals_true_at_start)


def broken_relations(subject: Subject) -> Iterator[Diagnostic]:
    """Find relations that are certain not to hold.

    Relations that involve a robot are skipped, because a robot may initially be holding an object.
    """
    judge = StartJudge(subject.scene)
    for k, text in enumerate(subject.scene.spec.relations):
        call = parse_call(text)
        subject.checkpoint()
        if call.declaration.before_motion is None and judge.value(text) is False:
            names = tuple(arg.partition(".")[0] for arg in call.args)
            message = f"`{call}` does not hold: {judge.explanation(text)}"
            hint = "correct the poses, or remove the relation"
            yield warning(subject.loaded, "SF406", ("relations", k), message, hint, names)


BROKEN_RELATION = Lint("SF406", ("scene/1",), broken_relations)


def without_cavity(subject: Subject) -> Iterator[Diagnostic]:
    """Find goals that put something inside an object that has no cavity. Rollouts refuse to evaluate them."""
    judge, document = StartJudge(subject.scene), subject.loaded
    hint = "use `OnTop`, or model the cavity with a lathe, a mesh with `collision: decompose`, or parts"
    for goal, path in goals(subject):
        for text, below in texts(goal):
            if wrong := judge.missing_cavity(parse_call(text)):
                yield document.finding("SF202", (*path, *below), wrong, hint)


NO_CAVITY = Lint("SF202", ("task/1",), without_cavity)
