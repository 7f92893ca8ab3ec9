"""Progress of a task: conditions judged on states, steps that stay done, a goal that has to hold for a while."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from simfoundry.evaluate.tasks.task import Task
from simfoundry.predicates import Judge, StateBatch
from simfoundry.scene.state import SceneState

HOLD = 3
"""So many control steps in a row (0.2 s at 15 Hz) a goal must be true: what only passes through has not arrived."""


class Progress:
    """The progress of a task from state to state.

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
        return self.see_all(step, [state]) is not None

    def see_all(self, step: int, states: Sequence[SceneState]) -> int | None:
        """Judge states one after another, the first of them after ``step``; which of them ends the task, if one does.

        All are judged at once, which costs hardly more than one; what comes after the end is not seen.
        """
        batch = StateBatch.of(self._task.scene, states)
        open_ = [name for name, done in self.done.items() if done is None]
        holds = self._judge.holds(
            {name: self._task.subtasks[name].goal for name in open_} | {"": self._task.goal}, batch
        )
        goal = holds[""]
        for k in range(len(states)):
            for name in open_:
                if not holds[name][k]:
                    self._waiting.discard(name)
                elif name not in self._waiting and self.done[name] is None:
                    self.done[name] = step + k
            self._held = self._held + 1 if goal[k] else 0
            if self._held >= HOLD:
                return k
        return None

    @property
    def subtasks(self) -> Mapping[str, int | None]:
        """The step at which each sub-task was done, counted from 1; None where it was not."""
        return dict(self.done)
