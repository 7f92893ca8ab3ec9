"""Tasks that can be edited in place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from simfoundry.api.document import EditableDocument
from simfoundry.api.entries import DocumentEntry, ValueField, section
from simfoundry.api.scenes import Origin, SceneDocument, Text, Values
from simfoundry.spec.models import task
from simfoundry.spec.models.disturbances import Disturbances

Goal = ValueField[Any, str | Values]


class SubtaskEntry(DocumentEntry):
    """A step of a task, with a goal, an instruction, and optionally its own initial state."""

    _model = task.Subtask
    goal = Goal()
    instruction = Text()
    start = ValueField[task.Start | None, task.Start | Values | None]()


class TaskDocument(EditableDocument):
    """A task document that can be edited in place: ``task.horizon = 300``, then ``task.save()``."""

    _model, _kind = task.TaskSpec, "task/1"

    name = ValueField[str, str]()
    description = Text()
    scene = ValueField[str, str]()
    instruction = ValueField[str, str]()
    robots = ValueField[tuple[str, ...] | None, Sequence[str] | None]()
    goal = Goal()
    start = ValueField[task.Start, task.Start | Values | None]()
    reset = ValueField[task.Reset, task.Reset | Values | None]()
    control_hz = ValueField[float, float | None]()
    horizon = ValueField[int, int | None]()
    disturbances = ValueField[Disturbances, Disturbances | Values | None]()
    allow = ValueField[Mapping[str, object], Values | None]()
    origin = Origin()
    subtasks = section(SubtaskEntry)

    def load_scene(self) -> SceneDocument:
        """Load the scene in which the task takes place."""
        return SceneDocument.load(self._checked().file(self.scene))


def load_task(path: str | Path) -> TaskDocument:
    """Load a task document.

    Raises:
        SpecError: If the document has errors; the exception contains every finding.
    """
    return TaskDocument.load(path)
