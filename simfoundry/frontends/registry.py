"""Registry of frontends: the files that each supports, and the function that reads a file into a draft."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.frontends.draft import DEFAULTS, ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import read_xml

if TYPE_CHECKING:
    from simfoundry.scene.model import Scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.spec.models.task import TaskSpec

TaskReader = Callable[["Path", "SceneSpec", "Scene", "Path", ImportOptions], "tuple[TaskSpec, ModelDraft]"]
"""Function that reads a task file for a scene, given as a document and lowered, for writing to a path."""


@dataclass(frozen=True)
class Frontend:
    """Model format: its ``suffixes``, its reader, and a test to distinguish formats with the same suffix.

    ``reader`` is the name of a function in a module that is imported on first use. The test is either the XML root
    element, ``root_tag``, or a function of the file, ``accepts``.
    """

    name: str
    suffixes: tuple[str, ...]
    reader: str
    root_tag: str | None = None
    accepts: Callable[[Path], bool] = lambda path: True

    def read(self, path: Path, options: ImportOptions = DEFAULTS) -> ModelDraft:
        """Read a file; raises :class:`ImportRefusedError`."""
        draft: ModelDraft = _function(self.reader)(path, options)
        return draft


def _function(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(f"simfoundry.frontends.{module}"), function)
    return found


def is_poses(path: Path) -> bool:
    """Return True if a JSON file contains the poses of URDFs."""
    return bool(_function("urdf.folder:is_poses")(path))


FRONTENDS = (
    Frontend("URDF", (".urdf",), "urdf.reader:read_urdf"),
    Frontend("URDF", (".xml",), "urdf.reader:read_urdf", root_tag="robot"),
    Frontend("MJCF", (".xml",), "mjcf.reader:read_mjcf", root_tag="mujoco"),
    Frontend("USD", (".usd", ".usda", ".usdc", ".usdz"), "usd.reader:read_usd"),
    Frontend("poses.json", (".json",), "urdf.folder:read_poses", accepts=is_poses),
    Frontend("OmniGibson", (".json",), "omnigibson.scene:read_omnigibson"),
)

TASK_FRONTENDS: dict[str, TaskReader] = {
    ".yaml": lambda *args: _function("omnigibson.task:read_task")(*args),
    ".yml": lambda *args: _function("omnigibson.task:read_task")(*args),
    ".bddl": lambda *args: _function("bddl.task:read_bddl_task")(*args),
}
"""Readers of tasks by suffix."""

SUFFIXES = tuple(dict.fromkeys(suffix for frontend in FRONTENDS for suffix in frontend.suffixes))
"""Suffixes of models."""


def frontend_of(path: Path) -> Frontend:
    """Return the frontend of a file; raises :class:`ImportRefusedError` if there is none."""
    found = [frontend for frontend in FRONTENDS if path.suffix.lower() in frontend.suffixes]
    if not found:
        hint = f"these are: {', '.join(SUFFIXES)}, and with --scene the tasks {', '.join(TASK_FRONTENDS)}"
        raise ImportRefusedError(path, "files of this kind are not imported", hint=hint)
    if any(frontend.root_tag for frontend in found):
        tag = read_xml(path).tag
        found = [frontend for frontend in found if frontend.root_tag == tag]
        if not found:
            raise ImportRefusedError(path, f"its root is `<{tag}>`", hint="URDF has `<robot>`, MJCF `<mujoco>`")
    return next(frontend for frontend in found if frontend.accepts(path))
