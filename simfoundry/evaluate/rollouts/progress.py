"""Task progress: sub-tasks stay done once achieved, and the goal must hold for a while."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from simfoundry.evaluate.tasks.task import Task
from simfoundry.predicates import Judge, StateBatch
from simfoundry.scene.state import SceneState

HOLD = 3
"""Number of consecutive control steps (0.2 s at 15 Hz) for which a goal must be true, so that passing through it does
not count.
"""


class Progress:
    """The progress of a task over successive states.

    A sub-task is done at the first state in which its goal holds, and stays done. If its goal already holds at the
    start, such as `Closed(drawer)` before the drawer is opened, it must first become false. The task is done once its
    goal has been true :data:`HOLD` times in a row.
    """

    def __init__(self, task: Task, judge: Judge, start: SceneState) -> None:
        self._task, self._judge = task, judge
        self._held = 0
        self._waiting = {name for name, step in task.subtasks.items() if judge(step.goal, start).value}
        self.done: dict[str, int | None] = dict.fromkeys(task.subtasks)

    def see(self, step: int, state: SceneState) -> bool:
        """Evaluate the state after control step ``step``, counted from 1; return whether the task is now done."""
        return self.see_all(step, [state]) is not None

    def see_all(self, step: int, states: Sequence[SceneState]) -> int | None:
        """Evaluate consecutive states, the first of them after ``step``; return the index of the one that ends the
        task, or None.

        All are evaluated in one batch, which costs hardly more than one; states after the end are ignored.
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
        """Step at which each sub-task was done, counted from 1; None if it was not."""
        return dict(self.done)
