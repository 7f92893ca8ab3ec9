"""Document kinds, whose models are imported on first use."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.spec.models.base import DocumentSpec

# Document kinds with versions, as written in the first key of a document.
KINDS = ("scene/1", "task/1", "asset/1", "capture/1", "cousins/1", "policy/1", "dataset/1")


def suffix(kind: str) -> str:
    """Return the file name suffix for a document kind, such as ``.scene.yaml``."""
    return f".{kind.partition('/')[0]}.yaml"


def is_document(path: Path) -> bool:
    """Return True if the file name has a document suffix, such as ``.scene.yaml``."""
    return path.name == "capture.yaml" or path.name.endswith(tuple(map(suffix, KINDS)))


def model_of(kind: str) -> type[DocumentSpec]:
    """Return the model class for a document kind, such as ``SceneSpec`` for ``scene/1``."""
    if kind not in KINDS:
        raise KeyError(kind)
    name = kind.partition("/")[0]
    model: type[DocumentSpec] = getattr(import_module(f"simfoundry.spec.models.{name}"), f"{name.capitalize()}Spec")
    return model
