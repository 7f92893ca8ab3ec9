"""Set the properties of a task: its instruction and its horizon."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.models.types import field_adapter
from simfoundry.studio.acts.act import ActEdits, ActError, task_edits
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class SetTask:
    """Set values of the task document by key, such as ``{"instruction": "Lift the mug."}``."""

    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"set {', '.join(self.values)}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the task."""
        for key, value in self.values.items():
            if key not in ("instruction", "horizon", "control_hz", "description"):
                raise ActError(f"`{key}` of a task cannot be set here")
            try:
                field_adapter(TaskSpec, key).validate_python(value, strict=True)
            except ValidationError as error:
                raise ActError(f"`{key}`: {error.errors()[0]['msg']}") from None
        return task_edits(scene, {(key,): value for key, value in self.values.items()})
