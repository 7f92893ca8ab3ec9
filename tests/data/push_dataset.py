"""A dataset of pushes, its plan and its document."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from simfoundry.data.dataset.plan import DatasetPlan, plan_dataset
from simfoundry.spec.models.dataset import DatasetSpec

FRONT = {"observation.images.front": {"camera": "front", "size": (32, 24)}}


def spec_of(demos: Path, **more: Any) -> DatasetSpec:
    sources = {"expert": {"demonstrations": str(demos)}}
    data = {"simfoundry": "dataset/1", "name": "push", "formats": ("plain",), "cameras": FRONT, "sources": sources}
    return DatasetSpec.model_validate(data | more)


SPLITS = {"train": {"until": 0.75}, "held_out": {"from": 0.75}}


def document_of(demos: Path, folder: Path) -> Path:
    """Write a document, in JSON, which is YAML."""
    sources = {"expert": {"demonstrations": str(demos)}}
    head = {"simfoundry": "dataset/1", "name": "push", "formats": ["plain"]}
    path = folder / "push.dataset.yaml"
    path.write_text(json.dumps({**head, "sources": sources, "cameras": FRONT, "splits": SPLITS}))
    return path


def plan_of(demos: Path, **more: Any) -> DatasetPlan:
    return plan_dataset(spec_of(demos, **more), demos.parent)
