"""SF405: goals that are true at the start, so that every policy succeeds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from simfoundry.lint.certainty import StartJudge
from simfoundry.lint.draft import drafted
from simfoundry.lint.lints import Lint, Subject
from simfoundry.lint.report import Path_, warning
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.predicate import Effect, parse_call, texts

INDEPENDENT = (Effect.NONE, Effect.JOINT, Effect.GRASP)
"""Effects of predicates that do not depend on the poses that a reset samples."""


def goals_true_at_start(subject: Subject) -> Iterator[Diagnostic]:
    """Find a goal that holds at the start, and steps whose goals hold when they run alone or first."""
    task, judge = subject.task, StartJudge(subject.scene)
    if _is_true(subject, task.goal, judge):
        yield _finding(subject, ("goal",), "the goal is true at the start", judge.explanation(task.goal))
    scene = subject.loaded.used(task.scene)
    for k, (name, subtask) in enumerate(task.subtasks.items()):
        if subtask.start is None and k > 0:
            continue
        assert scene is not None
        own = judge if subtask.start is None else StartJudge(drafted(scene, [task.start, subtask.start]))
        if _is_true(subject, subtask.goal, own):
            message = f"the step `{name}` is done at its start"
            yield _finding(subject, ("subtasks", name, "goal"), message, own.explanation(subtask.goal))


def _is_true(subject: Subject, goal: Any, judge: StartJudge) -> bool:
    """Return True if a goal certainly holds for all poses that a reset may sample."""
    calls = [parse_call(text) for text, _ in texts(goal)]
    placed = {arg.partition(".")[0] for c in calls if c.declaration.effect not in INDEPENDENT for arg in c.args}
    return not (placed & subject.task.reset.objects.keys()) and judge.value(goal) is True


def _finding(subject: Subject, path: Path_, message: str, why: str) -> Diagnostic:
    hint = "require a condition that the robot must bring about, or change the start"
    return warning(subject.loaded, "SF405", path, f"{message}: {why}" if why else message, hint)


LINT = Lint("SF405", ("task/1",), goals_true_at_start)
