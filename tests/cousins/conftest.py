"""Twins that tests of cousins share."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.cousins.layout.twin import Twin
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY

TABLE = """\
simfoundry: scene/1
name: table
viewpoint: eye
materials: {wood: {density: 600, friction: 0.5}}
objects:
  table: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  post: {shape: {box: [0.1, 0.1, 0.1]}, material: wood, pose: {xyz: [0, 0, 0.05]}}
  brick: {shape: {box: [0.08, 0.04, 0.03]}, material: wood, pose: {xyz: [0.2, 0.2, 0.015]}}
  chip: {shape: {box: [0.03, 0.03, 0.01]}, material: wood, pose: {xyz: [0.2, 0.2, 0.035]}}
  can: {shape: {cylinder: {radius: 0.03, height: 0.1}}, material: wood, pose: {xyz: [-0.2, 0.22, 0.05]}}
cameras:
  eye: {size: [640, 480], fx: 400, fy: 400, pose: {xyz: [-0.9, 0, 0.7], look_at: [0, 0, 0]}}
relations: [OnTop(post, table), OnTop(chip, brick), OnTop(can, table)]
"""
"""A table seen from -x: away is +x, left is +y. The chip rides on the brick."""


def twin_of(text: str, folder: Path) -> Twin:
    """The twin of a scene given as text."""
    path = folder / "twin.scene.yaml"
    path.write_text(text)
    return Twin.of(lower(load(path)))


@pytest.fixture(scope="session")
def table(tmp_path_factory: pytest.TempPathFactory) -> Twin:
    """A table with boxes and a can."""
    return twin_of(TABLE, tmp_path_factory.mktemp("table"))


@pytest.fixture(scope="session")
def cup_in_bowl() -> Twin:
    """The paper's Cup in Bowl, with its goal."""
    return Twin.load(REPOSITORY / "specs" / "tasks" / "cup_in_bowl.task.yaml")
