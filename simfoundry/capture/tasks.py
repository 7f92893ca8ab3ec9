"""Tasks that a reconstructed scene affords, written beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.findings import FEW_TASKS, CaptureFinding
from simfoundry.capture.outputs.output_folder import TASK, PreviousOutput
from simfoundry.capture.reconstruct import Progress
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import write_file
from simfoundry.spec.diagnostics import SpecError

FEW_HINT = "`simfoundry propose SCENE --rejected` lists the reasons; ask for fewer, or capture more objects"


@dataclass(frozen=True)
class SceneTasks:
    """Tasks in a scene.

    Attributes:
        documents: The task documents, by file name.
        instructions: Instruction of each task, by the name of the task.
        problems: Reasons why there are not more of them, such as that a model did not answer.
    """

    documents: Mapping[str, bytes]
    instructions: Mapping[str, str]
    problems: tuple[str, ...] = ()


@dataclass(frozen=True)
class TaskRequest:
    """A request for tasks: their number, and a function that finds them.

    ``find`` gets the scene document, in whose folder the tasks will be, their number, and the image as PNG data.
    """

    count: int
    find: Callable[[Path, int, bytes], SceneTasks]


@dataclass(frozen=True)
class WrittenTasks:
    """Tasks that were written.

    Attributes:
        instructions: Instruction of each task, by the name of the task, or None if no tasks were requested.
        edited: The files that contain a person's edits.
        findings: A finding if there are fewer tasks than requested.
    """

    instructions: Mapping[str, str] | None = None
    edited: tuple[str, ...] = ()
    findings: tuple[CaptureFinding, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """Return the tasks as an entry of the report, which is empty if no tasks were requested."""
        return {} if self.instructions is None else {"tasks": dict(self.instructions)}


def write_tasks(
    request: TaskRequest | None,
    scene_file: Path,
    color: NDArray[np.uint8],
    previous: PreviousOutput,
    progress: Progress,
) -> WrittenTasks:
    """Write tasks in the scene ``scene_file`` beside it. Those that a person edited are kept.

    ``color`` is the RGB image of the scene, shape (h, w, 3).
    """
    if request is None:
        return WrittenTasks()
    from simfoundry.render.montage import png_bytes

    progress("tasks", 0.97)
    try:
        found = request.find(scene_file, request.count, png_bytes(color))
    except (SimfoundryError, SpecError) as error:
        found = SceneTasks({}, {}, (" ".join(str(error).split()),))
    for name, content in found.documents.items():
        write_file(scene_file.parent / name, content)
    changed = [path for path in (*previous.kept, *previous.edited) if path.endswith(TASK)]
    edited = tuple(path for path in dict.fromkeys(changed) if (previous.folder / path).is_file())
    for path in edited:
        write_file(scene_file.parent / path, (previous.folder / path).read_bytes())
    return WrittenTasks(found.instructions, edited, _shortage(found, request.count))


def _shortage(found: SceneTasks, count: int) -> tuple[CaptureFinding, ...]:
    """Return a finding if there are fewer tasks than requested, or if a model that was asked for them failed."""
    if len(found.documents) >= count and not found.problems:
        return ()
    message = f"{len(found.documents)} of {count} requested tasks were found"
    return (CaptureFinding(FEW_TASKS, "; ".join((message, *found.problems)), FEW_HINT),)
