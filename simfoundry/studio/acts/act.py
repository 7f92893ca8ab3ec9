"""The contract of acts: what a person does, as data, from which the edits of documents follow."""

from __future__ import annotations

import os
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.edit_data import DataEdits
from simfoundry.spec.names.rename import name_problem
from simfoundry.studio.reading import StudioScene


class ActError(SimfoundryError):
    """Raised if an act is not possible. The message is a whole sentence for the person who tried."""


@dataclass(frozen=True)
class ActEdits:
    """The edits that an act makes.

    Attributes:
        values: Values by path, by document (resolved path).
        texts: Whole new texts, by document (resolved path).
        notes: Whole sentences about what the act did not change, although a person may expect it.
    """

    values: Mapping[Path, DataEdits] = field(default_factory=dict)
    texts: Mapping[Path, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class Act(Protocol):
    """An act in the studio. It must not depend on anything but its fields and the scene."""

    @property
    def label(self) -> str:
        """Return a short description, such as ``move mug``."""

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits.

        Raises:
            ActError: If the act is not possible in the scene.
        """


def scene_edits(scene: StudioScene, edits: DataEdits) -> ActEdits:
    """Return edits of the scene document."""
    return ActEdits({resolved_path(scene.loaded.path): edits})


def task_edits(scene: StudioScene, edits: DataEdits) -> ActEdits:
    """Return edits of the task document.

    Raises:
        ActError: If a scene was opened, and not a task.
    """
    if scene.task is None:
        raise ActError("this needs a task; open the task document instead of its scene")
    return ActEdits({resolved_path(scene.root.path): edits})


def resolved_path(path: Path) -> Path:
    """Return the path by which a session knows a document."""
    return Path(os.path.realpath(path))


def require_object(scene: StudioScene, name: str) -> None:
    """Ensure that the scene has an object.

    Raises:
        ActError: If there is no such object.
    """
    if name not in scene.objects:
        raise ActError(f"the scene has no object `{name}`")


def require_new_name(name: str, kind: str, taken: Container[str]) -> None:
    """Ensure that something new of a kind, such as a camera, can have a name, by the rule for renames.

    Raises:
        ActError: If it cannot, or if the name is taken.
    """
    if problem := name_problem(name):
        raise ActError(f"`{name}` cannot be the name of a new {kind}: {problem}")
    if name in taken:
        raise ActError(f"the name `{name}` already exists; choose another name for the new {kind}")
