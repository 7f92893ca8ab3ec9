"""Whether a task is done: conditions judged on states, steps that stay done, and a goal that has to hold for a while."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from simfoundry.evaluate.task import Task
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState

if TYPE_CHECKING:
    from simfoundry.predicates import Judge

HOLD = 3
"""So many control steps in a row (0.2 s at 15 Hz) a goal must be true: what falls through a bowl's rim has not ended."""


def judge_of(scene: Scene) -> Judge:
    """The judge of a scene."""
    from simfoundry.predicates import Judge

    return Judge(scene)


class Progress:
    """What of a task is done as its states go by.

    A step is done at the first state in which its goal holds, and stays done; where it holds at the start already, as
    `Closed(drawer)` does before the drawer was opened, it must have been false in between. The whole is done once its
    goal has been true :data:`HOLD` times in a row.
    """

    def __init__(self, task: Task, judge: Judge, start: SceneState) -> None:
        self._task, self._judge = task, judge
        self._held = 0
        self._waiting = {name for name, step in task.subtasks.items() if judge(step.goal, start).value}
        self.done: dict[str, int | None] = dict.fromkeys(task.subtasks)

    def see(self, step: int, state: SceneState) -> bool:
        """Judge the state after control step ``step``, counted from 1; whether the task is done with it."""
        for name, subtask in self._task.subtasks.items():
            if self.done[name] is None:
                holds = bool(self._judge(subtask.goal, state).value)
                if holds and name not in self._waiting:
                    self.done[name] = step
                elif not holds:
                    self._waiting.discard(name)
        self._held = self._held + 1 if self._judge(self._task.goal, state).value else 0
        return self._held >= HOLD

    @property
    def subtasks(self) -> Mapping[str, int | None]:
        """The step at which each sub-task was done, counted from 1; None where it was not."""
        return dict(self.done)
