"""A registry of importers, with the file types that they support and the functions that read these files."""

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

# A function that reads a model file into a draft; raises :class:`ImportRefusedError`.
ModelReader = Callable[[Path, ImportOptions], ModelDraft]

# A function that reads a task file.
#
# Its arguments are the task file, the scene document, the lowered scene, the path to which the task will be written,
# and the options.
TaskReader = Callable[[Path, "SceneSpec", "Scene", Path, ImportOptions], "tuple[TaskSpec, ModelDraft]"]


@dataclass(frozen=True)
class Importer:
    """An importer for one format, with its model readers and task readers keyed by file suffix.

    Formats that share a suffix are distinguished by ``xml_root``, the name of their root element in XML files, or by
    ``accepts``, a function that examines the file.
    """

    models: Mapping[str, ModelReader] = field(default_factory=dict)
    tasks: Mapping[str, TaskReader] = field(default_factory=dict)
    xml_root: str = ""
    accepts: Callable[[Path], bool] = lambda path: True


# All importers by name; the first one that accepts a file reads it.
IMPORTERS: Registry[Importer] = Registry(
    "simfoundry.importers",
    {name: f"simfoundry.frontends.{name}:IMPORTER" for name in ("urdf", "mjcf", "usd", "omnigibson", "bddl")},
    Importer,
)


def deferred(target: str) -> Callable[..., Any]:
    """Return a function that imports and calls ``module:function``, so that importers are loaded only when needed."""

    def call(*args: Any) -> Any:
        module, _, function = target.partition(":")
        return getattr(import_module(module), function)(*args)

    return call


def model_suffixes() -> tuple[str, ...]:
    """Return the file suffixes of all supported model files."""
    return tuple(dict.fromkeys(suffix for importer in IMPORTERS.load_all().values() for suffix in importer.models))


def task_readers() -> dict[str, TaskReader]:
    """Return all task readers, keyed by file suffix."""
    return {suffix: read for importer in IMPORTERS.load_all().values() for suffix, read in importer.tasks.items()}


def model_reader(path: Path) -> ModelReader:
    """Return the function that reads a model file.

    Raises:
        ImportRefusedError: If no importer accepts the file.
    """
    suffix = path.suffix.lower()
    found = [importer for importer in IMPORTERS.load_all().values() if suffix in importer.models]
    if not found:
        tasks = ", ".join(task_readers())
        known = f"supported file types: {', '.join(model_suffixes())}, and for tasks (with --scene) {tasks}"
        raise ImportRefusedError(path, "unsupported file type", hint=known)
    if suffix == ".xml":
        tag = read_xml(path).tag
        known = ", ".join(f"`<{importer.xml_root}>`" for importer in found)
        found = [importer for importer in found if importer.xml_root == tag]
        if not found:
            message = f"unsupported root element `<{tag}>`"
            raise ImportRefusedError(path, message, hint=f"supported root elements: {known}")
    return next(importer for importer in found if importer.accepts(path)).models[suffix]
