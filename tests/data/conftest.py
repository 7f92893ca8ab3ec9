"""Demonstrations of a task that needs no robot's model from elsewhere, which the tests of this folder share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from simfoundry.api.demonstrations import record_plan
from simfoundry.data import attempt as attempts
from simfoundry.data.dataset.build import build_dataset
from simfoundry.data.plan import RecordSummary
from simfoundry.data.record import record
from simfoundry.evaluate.entries import Contender
from tests.conftest import REPOSITORY
from tests.data.push_dataset import SPLITS, plan_of
from tests.evaluate.benches import write_bench
from tests.foreign_package import write_package

POLICY = """\
import os

import numpy as np


class Push:
    \"\"\"Pushes the block out, too little from every `miss`-th start.\"\"\"

    action_space = "joint_position"

    def __init__(self, miss=0, hz=0, bad=""):
        self.miss, self.bad = miss, bad
        self.control_hz = hz or None

    def reset(self, instruction, seed):
        self.reach = 0.05 if self.miss and seed % self.miss == 0 else 0.205

    def infer(self, observation):
        now = float(observation.robots["arm"].joints[1])
        x, y, _ = observation.state.poses["block"].p
        hz = self.control_hz or 15.0
        reach = np.minimum(now + 0.12 / hz * np.arange(1, 9), self.reach)
        chunk = np.column_stack([np.full(8, np.arctan2(y, x)), reach, np.zeros(8)])
        if self.bad == "exit":
            os._exit(7)
        return chunk * np.nan if self.bad == "nan" else chunk
"""


def write_push(folder: Path) -> Path:
    """Write a task in which a block is pushed, and the policy `pushing.py:Push` beside it."""
    (folder / "pushing.py").write_text(POLICY)
    return write_bench(folder)


def recorded(task: Path, policy: str, out: Path, count: int) -> RecordSummary:
    """Record demonstrations of a policy in the folder of the task, in this process, which is faster."""
    before = Path.cwd()
    os.chdir(task.parent)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Contender, "is_foreign", False)
            return record(record_plan([Path(task.name)], policy, out, count))
    finally:
        os.chdir(before)
        attempts.close()


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_push(tmp_path_factory.mktemp("record"))


@pytest.fixture(scope="session")
def demos(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four demonstrations of a policy that fails from every third start."""
    out = tmp_path_factory.mktemp("demos") / "demos"
    summary = recorded(bench, "python:pushing.py:Push?miss=3", out, 4)
    assert (summary.kept, set(summary.failures)) == (4, {"horizon"})
    return out


@pytest.fixture
def plain(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the plain format of these tests, in this process and in those that it starts."""
    site = write_plain(tmp_path_factory.mktemp("site"))
    monkeypatch.syspath_prepend(site)
    monkeypatch.setenv("PYTHONPATH", f"{site}{os.pathsep}{REPOSITORY}")


def write_plain(site: Path) -> Path:
    """Write the metadata of the plain format as if it were installed in a folder, and return the folder."""
    entries = {"simfoundry.dataset_formats": {"plain": "tests.data.plain_format:FORMAT"}}
    write_package(site, "plain-format", entries, {})
    return site


@pytest.fixture(scope="session")
def built(demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of the demonstrations."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(write_plain(tmp_path_factory.mktemp("site")))
        out = tmp_path_factory.mktemp("built") / "push"
        build_dataset(plan_of(demos, splits=SPLITS), out)
    return out
