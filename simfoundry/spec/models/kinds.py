"""The kinds of document, each loaded when it is first needed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.spec.models.base import DocumentSpec

KINDS = ("scene/1", "task/1", "asset/1", "capture/1", "cousins/1", "policy/1")
"""Kind and version, as the first key of a document says."""


def suffix(kind: str) -> str:
    """How the file of a kind ends: ``.scene.yaml``."""
    return f".{kind.partition('/')[0]}.yaml"


def is_document(path: Path) -> bool:
    """Whether a file is called like a document."""
    return path.name == "capture.yaml" or path.name.endswith(tuple(map(suffix, KINDS)))


def model_of(kind: str) -> type[DocumentSpec]:
    """The model of a kind of document."""
    match kind:
        case "scene/1":
            from simfoundry.spec.models.scene import SceneSpec

            return SceneSpec
        case "task/1":
            from simfoundry.spec.models.task import TaskSpec

            return TaskSpec
        case "asset/1":
            from simfoundry.spec.models.asset import AssetSpec

            return AssetSpec
        case "capture/1":
            from simfoundry.spec.models.capture import CaptureSpec

            return CaptureSpec
        case "cousins/1":
            from simfoundry.spec.models.cousins import CousinsSpec

            return CousinsSpec
        case "policy/1":
            from simfoundry.spec.models.policy import PolicySpec

            return PolicySpec
    raise KeyError(kind)
