"""SimFoundry: one typed scene spec, many simulators.

Importing this package loads no simulator, no USD and no mesh library; each public name is imported on first use.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.api.build import Build as Build
    from simfoundry.api.entries import UnknownNameError as UnknownNameError
    from simfoundry.api.evaluation import Evaluation as Evaluation
    from simfoundry.api.scene_document import SceneDocument as SceneDocument
    from simfoundry.api.task_document import TaskDocument as TaskDocument
    from simfoundry.errors import SimfoundryError as SimfoundryError
    from simfoundry.spec.diagnostics import SpecError as SpecError

__version__ = "0.1.0"

_MODULES = {
    "Build": "api.build",
    "Evaluation": "api.evaluation",
    "SceneDocument": "api.scene_document",
    "SimfoundryError": "errors",
    "SpecError": "spec.diagnostics",
    "TaskDocument": "api.task_document",
    "UnknownNameError": "api.entries",
}
"""Module of each public class."""

__all__ = [
    "Build",
    "Evaluation",
    "SceneDocument",
    "SimfoundryError",
    "SpecError",
    "TaskDocument",
    "UnknownNameError",
    "__version__",
    "evaluate",
    "load",
    "load_task",
]


def load(path: str | Path) -> SceneDocument:
    """Load a scene: a document, or a USD, MJCF or URDF file, which is imported.

    Raises :class:`SpecError` with every finding if the document has errors.
    """
    from simfoundry.api.load import load_scene_document

    return load_scene_document(Path(path))


def load_task(path: str | Path) -> TaskDocument:
    """Load a task document; raises :class:`SpecError` with every finding if it has errors."""
    from simfoundry.api.task_document import TaskDocument

    return TaskDocument.load(path)


def evaluate(
    tasks: str | Path | Sequence[str | Path],
    policies: str | Sequence[str],
    *,
    out: str | Path = "build/eval",
    rollouts: int = 25,
    seed: int = 0,
    engine: str = "mujoco",
    video: bool = False,
    jobs: int = 1,
) -> Evaluation:
    """Evaluate policies on tasks, all from the same starts: ``evaluate("stack.task.yaml", "expert", rollouts=3)``.

    Policies are named as on the command line: ``random``, ``expert``, ``python:module:Class``,
    ``openpi:host:port?...``. Rollouts that are already in ``out`` are not repeated, so an interrupted run resumes.
    """
    from simfoundry.api.evaluation import evaluate_tasks

    return evaluate_tasks(
        [tasks] if isinstance(tasks, str | Path) else tasks,
        [policies] if isinstance(policies, str) else policies,
        out=out,
        rollouts=rollouts,
        seed=seed,
        engine=engine,
        video=video,
        jobs=jobs,
    )


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module `simfoundry` has no attribute `{name}`; it has {', '.join(__all__)}")
    value = getattr(import_module(f"simfoundry.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
