"""The bench, its starts and its world, made once: see :mod:`tests.evaluate.benches`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.evaluate.resets.starts import RolloutStart, starts
from simfoundry.evaluate.task import Task, load_task
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.evaluate.benches import write_bench


@pytest.fixture(scope="session")
def push_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="session")
def push(push_file: Path) -> Task:
    return load_task(push_file)


@pytest.fixture(scope="session")
def push_starts(push: Task) -> tuple[RolloutStart, ...]:
    return starts(push, 25)


@pytest.fixture(scope="session")
def push_world(push: Task) -> Iterator[MujocoWorld]:
    with MujocoWorld(push.scene) as world:
        yield world
