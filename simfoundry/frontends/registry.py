"""A registry of importers, with the file types that they support and the functions that read these files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.frontends.draft import ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError, refusing_faults
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
    return tuple(dict.fromkeys(suffix for importer in IMPORTERS.load_all()[0].values() for suffix in importer.models))


def task_readers() -> dict[str, TaskReader]:
    """Return all task readers, keyed by file suffix."""
    importers = IMPORTERS.load_all()[0].items()
    return {kind: IMPORTERS.running(name)(read) for name, found in importers for kind, read in found.tasks.items()}


def model_reader(path: Path) -> ModelReader:
    """Return the function that reads a model file.

    Raises:
        ImportRefusedError: If no importer accepts the file.
    """
    suffix = path.suffix.lower()
    importers, errors = IMPORTERS.load_all()
    found = {name: importer for name, importer in importers.items() if suffix in importer.models}
    tag = read_xml(path).tag if suffix == ".xml" else None
    for name, importer in found.items():
        running = refusing_faults(path, IMPORTERS.plugin(name))
        if (tag is None or importer.xml_root in ("", tag)) and running(importer.accepts)(path):
            return running(importer.models[suffix])
    roots = ", ".join(f"`<{importer.xml_root}>`" for importer in found.values() if importer.xml_root)
    message = "unsupported file type" if tag is None else f"unsupported root element `<{tag}>`"
    tasks = ", ".join(task_readers())
    known = f"supported file types: {', '.join(model_suffixes())}, and for tasks (with --scene) {tasks}"
    known = known if tag is None else f"supported root elements: {roots}"
    raise ImportRefusedError(path, message, hint="; ".join([known, *map(str, errors.values())]))
