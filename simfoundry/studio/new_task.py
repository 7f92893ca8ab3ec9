"""Write a new task in the scene of a session."""

from __future__ import annotations

from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.editor.new import make
from simfoundry.studio.session import StudioSession


def start_task(session: StudioSession, name: str) -> Path:
    """Write a new task in the scene that is open, go on with it, and return its file.

    Raises:
        SimfoundryError: If the scene has not been saved, or if the task cannot be written.
    """
    with session.lock:
        if session.scene is None or session.scene.task is not None:
            raise SimfoundryError("a new task needs a scene; open the scene document")
        if session.is_modified:
            raise SimfoundryError("save the scene before you start a task in it")
        path = session.path.parent / f"{name}.task.yaml"
        made = make("task", path, name, session.path, None)  # which refuses names that are not valid
        if path.exists():
            raise SimfoundryError(f"{path.name} already exists; choose another name, or open it")
        write_atomically(path, made.text.encode())
    session.go_to(path)
    return path
