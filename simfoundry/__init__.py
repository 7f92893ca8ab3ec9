"""SimFoundry: one typed scene spec, many simulators.

Importing this package does not load any simulator, USD, or mesh library. Each public name is imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.api.augmentation import augment_demonstrations as augment_demonstrations
    from simfoundry.api.build import Build as Build
    from simfoundry.api.datasets import build_dataset as build_dataset
    from simfoundry.api.datasets import dataset as dataset
    from simfoundry.api.demonstrations import demonstrations as demonstrations
    from simfoundry.api.demonstrations import record as record
    from simfoundry.api.entries import UnknownNameError as UnknownNameError
    from simfoundry.api.evaluation import Evaluation as Evaluation
    from simfoundry.api.evaluation import evaluate as evaluate
    from simfoundry.api.scenes import SceneDocument as SceneDocument
    from simfoundry.api.scenes import load as load
    from simfoundry.api.tasks import TaskDocument as TaskDocument
    from simfoundry.api.tasks import load_task as load_task
    from simfoundry.api.teleoperation import teleoperate as teleoperate
    from simfoundry.api.training import Trained as Trained
    from simfoundry.api.training import train_policy as train_policy
    from simfoundry.errors import SimfoundryError as SimfoundryError
    from simfoundry.spec.diagnostics import SpecError as SpecError

__version__ = "0.1.0"

# The module that defines each public name.
_MODULES = {
    "Build": "api.build",
    "Evaluation": "api.evaluation",
    "SceneDocument": "api.scenes",
    "SimfoundryError": "errors",
    "SpecError": "spec.diagnostics",
    "TaskDocument": "api.tasks",
    "Trained": "api.training",
    "UnknownNameError": "api.entries",
    "augment_demonstrations": "api.augmentation",
    "build_dataset": "api.datasets",
    "dataset": "api.datasets",
    "demonstrations": "api.demonstrations",
    "evaluate": "api.evaluation",
    "load": "api.scenes",
    "load_task": "api.tasks",
    "record": "api.demonstrations",
    "teleoperate": "api.teleoperation",
    "train_policy": "api.training",
}

__all__ = [*_MODULES, "__version__"]

# Importing the subpackage `evaluate` for the first time binds it in this module, which would hide the function.
import_module("simfoundry.evaluate")
del globals()["evaluate"]


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module `simfoundry` has no attribute `{name}`; it has {', '.join(__all__)}")
    value = getattr(import_module(f"simfoundry.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
