"""A task that is edited in place, and evaluated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simfoundry.api.document import Document
from simfoundry.api.entries import Entry, Field, Members
from simfoundry.api.scene_document import Origin, SceneDocument, Text, Values
from simfoundry.spec import task

Goal = Field[Any, str | Values]


class SubtaskEntry(Entry):
    """A step of a task: its goal, its instruction, and how it starts on its own."""

    _model = task.Subtask
    goal = Goal()
    instruction = Text()
    start = Field[task.Start | None, task.Start | Values | None]()


class TaskDocument(Document):
    """A task document: ``task.horizon = 300``, then ``task.save()``."""

    _model, _kind = task.TaskSpec, "task/1"

    name = Field[str, str]()
    description = Text()
    scene = Field[str, str]()
    instruction = Field[str, str]()
    robots = Field[tuple[str, ...] | None, Sequence[str] | None]()
    goal = Goal()
    start = Field[task.Start, task.Start | Values | None]()
    reset = Field[task.Reset, task.Reset | Values | None]()
    control_hz = Field[float, float | None]()
    horizon = Field[int, int | None]()
    allow = Field[Mapping[str, object], Values | None]()
    origin = Origin()

    @property
    def subtasks(self) -> Members[SubtaskEntry]:
        """The steps by name, in order."""
        return Members(self, ("subtasks",), SubtaskEntry)

    def load_scene(self) -> SceneDocument:
        """Load the scene that the task is for."""
        return SceneDocument.load(self._checked().file(self.scene))
