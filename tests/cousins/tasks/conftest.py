"""Scenes that the tests of task cousins share."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.enumeration import Proposal, enumerate_tasks
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: bench
materials: {wood: {density: 600, friction: 0.5}, lead: {density: 11000, friction: 0.5}}
objects:
  desk: {fixed: true, shape: {box: [1.6, 1.4, 0.04]}, material: wood, pose: {xyz: [0.6, 0, -0.02]}}
  bowl: {asset: bowl.asset.yaml, place: {on: desk, xy: [0.5, 0]}}
  cabinet: {asset: cabinet.asset.yaml, place: {on: desk, xy: [0.45, 0.37]}}
  ball: {asset: tennis_ball.asset.yaml, place: {on: desk, xy: [0.4, -0.2]}}
  block: {shape: {box: [0.03, 0.03, 0.03]}, material: wood, pose: {xyz: [0.33, 0.12, 0.015]}}
  wide: {shape: {box: [0.12, 0.12, 0.12]}, material: wood, pose: {xyz: [0.5, -0.4, 0.06]}}
  heavy: {shape: {box: [0.07, 0.07, 0.07]}, material: lead, pose: {xyz: [0.4, -0.5, 0.035]}}
  far: {shape: {box: [0.03, 0.03, 0.03]}, material: wood, pose: {xyz: [1.2, 0, 0.015]}}
robots: {arm: {model: franka_robotiq}}
relations: [OnTop(bowl, desk)]
"""


def let_roll(ball: Path) -> None:
    """Take its resistance from a ball: what rolls off wherever it is not held is what these tests need."""
    ball.write_text("".join(line for line in ball.open() if "_friction: " not in line))


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    for name in ("bowl", "cabinet", "tennis_ball"):
        shutil.copy(REPOSITORY / "specs" / "assets" / f"{name}.asset.yaml", folder)
    let_roll(folder / "tennis_ball.asset.yaml")
    file = folder / "bench.scene.yaml"
    file.write_text(SCENE)
    return file


@pytest.fixture(scope="session")
def setting(bench: Path) -> TaskContext:
    return TaskContext.load(bench)


@pytest.fixture(scope="session")
def proposals(setting: TaskContext) -> list[Proposal]:
    return enumerate_tasks(setting, scene="bench.scene.yaml")
