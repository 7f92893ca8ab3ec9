"""Registry of importers: the files that each supports, and the functions that read them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.frontends.draft import ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import read_xml
from simfoundry.runtime.plugins import Registry

if TYPE_CHECKING:
    from simfoundry.scene.model import Scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.spec.models.task import TaskSpec

ModelReader = Callable[[Path, ImportOptions], ModelDraft]
"""Function that reads a file as a draft; raises :class:`ImportRefusedError`."""

TaskReader = Callable[[Path, "SceneSpec", "Scene", Path, ImportOptions], "tuple[TaskSpec, ModelDraft]"]
"""Function that reads a task file for a scene, given as a document and lowered, to be written to a path."""


@dataclass(frozen=True)
class Importer:
    """Importer of a format: readers of models and tasks by file suffix.

    Formats that share a suffix are distinguished by ``xml_root``, the root element of their XML files, or by a function
    of the file, ``accepts``.
    """

    models: Mapping[str, ModelReader] = field(default_factory=dict)
    tasks: Mapping[str, TaskReader] = field(default_factory=dict)
    xml_root: str = ""
    accepts: Callable[[Path], bool] = lambda path: True


IMPORTERS: Registry[Importer] = Registry(
    "simfoundry.importers",
    {name: f"simfoundry.frontends.{name}:IMPORTER" for name in ("urdf", "mjcf", "usd", "omnigibson", "bddl")},
    Importer,
)
"""All importers by name; the first one that accepts a file reads it."""


def deferred(target: str) -> Callable[..., Any]:
    """Return a function that imports and calls ``module:function``, so that only the importer in use is loaded."""

    def call(*args: Any) -> Any:
        module, _, function = target.partition(":")
        return getattr(import_module(module), function)(*args)

    return call


def model_suffixes() -> tuple[str, ...]:
    """Return the suffixes of model files."""
    return tuple(dict.fromkeys(suffix for importer in IMPORTERS.load_all().values() for suffix in importer.models))


def task_readers() -> dict[str, TaskReader]:
    """Return the readers of tasks by suffix."""
    return {suffix: read for importer in IMPORTERS.load_all().values() for suffix, read in importer.tasks.items()}


def model_reader(path: Path) -> ModelReader:
    """Return the function that reads a model file; raises :class:`ImportRefusedError` if there is none."""
    suffix = path.suffix.lower()
    found = [importer for importer in IMPORTERS.load_all().values() if suffix in importer.models]
    if not found:
        known = f"these are: {', '.join(model_suffixes())}, and with --scene the tasks {', '.join(task_readers())}"
        raise ImportRefusedError(path, "files of this kind are not imported", hint=known)
    if suffix == ".xml":
        tag = read_xml(path).tag
        known = ", ".join(f"`<{importer.xml_root}>`" for importer in found)
        found = [importer for importer in found if importer.xml_root == tag]
        if not found:
            raise ImportRefusedError(path, f"its root is `<{tag}>`", hint=f"importers read files with the root {known}")
    return next(importer for importer in found if importer.accepts(path)).models[suffix]
