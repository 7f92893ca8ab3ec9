"""Segments without free space between them: an arm without a gripper pushes a block."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.api.augmentation import augment_plan
from simfoundry.api.demonstrations import record_plan
from simfoundry.augment.library import open_library
from simfoundry.data import attempt as attempts
from simfoundry.data.record import record
from simfoundry.evaluate.entries import Contender
from tests.data.conftest import POLICY
from tests.evaluate.benches import write_bench


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    write_bench(tmp_path)
    (tmp_path / "pushing.py").write_text(POLICY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Contender, "is_foreign", False)
    yield tmp_path
    attempts.close()


@pytest.mark.slow  # 4 s
@pytest.mark.parametrize("hz", [15, 5])
def test_a_push_starts_at_the_block_and_ends_at_its_place(bench: Path, hz: int) -> None:
    record(record_plan([Path("push.task.yaml")], f"python:pushing.py:Push?hz={hz}", Path("demos"), 2))
    segments = open_library(bench / "demos").segments
    assert [(one.subgoal.name, one.subgoal.reference, one.is_joined) for one in segments[:2]] == [
        ("touch", "block", True),
        ("away", "", True),
    ]
    assert segments[1].begin == segments[0].last == segments[0].moment
    found = record(augment_plan(Path("demos"), (), Path("more"), 2, options={"noise": 0.001}))
    assert found.kept == 2 and found.attempts <= 4
    for demo in sf.demonstrations("more"):
        assert demo.action_hz == hz and {one["achieved"] for one in demo.origin["segments"][:1]} == {True}
        used = {one["demonstration"] for one in demo.origin["segments"]}
        assert len(used) == 1  # what is joined continues the same demonstration
        np.testing.assert_allclose(demo.states["objects"][-1][1][:2], [0.45, 0.0], atol=0.03)
