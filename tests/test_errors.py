"""Errors cross the borders of processes, for example in a ``ProcessPoolExecutor``."""

from __future__ import annotations

import pickle
import re
from importlib import import_module
from pathlib import Path

import pytest

import simfoundry
from simfoundry.assets.errors import MeshError
from simfoundry.capture.frame import CaptureError
from simfoundry.cousins.recipe.candidate import ImpossibleError
from simfoundry.errors import PicklableError, SimfoundryError
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import FileError
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.targets.build import TargetsError


def error_classes() -> list[type[Exception]]:
    """Return every error class of the package that is raised with its message alone or with more."""
    folder = Path(simfoundry.__file__).parent
    for path in folder.rglob("*.py"):
        if re.search(r"^class \w+\((\w+, )*(SimfoundryError|PicklableError|\w+Error)\b", path.read_text(), re.M):
            import_module(".".join(path.relative_to(folder.parent).with_suffix("").parts).removesuffix(".__init__"))
    found, todo = list[type[Exception]](), [PicklableError]
    while todo:
        found += (below := todo.pop().__subclasses__())
        todo += below
    return [kind for kind in found if kind.__module__.startswith("simfoundry.")]


def test_every_error_can_be_pickled() -> None:
    kinds = error_classes()
    assert {SimfoundryError, SpecError} < {*kinds} and len(kinds) > 30
    for kind in kinds:
        error = kind.__new__(kind, "the message")
        vars(error)["hint"] = "a hint"
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), vars(again)) == (kind, "the message", {"hint": "a hint"})


@pytest.mark.parametrize(
    "error",
    [
        SpecError([Diagnostic("SF104", Severity.ERROR, "too large", "a.scene.yaml", 1, 2)]),
        YamlError("SF002", "a tab", 1, 2, "remove it"),
        FileError("SF203", "no such file", "write it"),
        MeshError("SF410", "the mesh is open"),
        CaptureError("SF500", "no depth", "record it"),
        ImpossibleError(()),
        ImportRefusedError("a.xml", "no bodies", 3, "add one"),
        TargetsError([], {"usd": "it has no name"}),
    ],
)
def test_an_error_keeps_its_message_and_parts(error: Exception) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))
