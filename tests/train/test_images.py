"""Images as inputs: points are found where they are, and a policy learns from and acts by what its camera sees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import load_task
from simfoundry.render.gl import Engine, choose_engine
from simfoundry.train.job import train
from simfoundry.train.policy import BaselinePolicy
from simfoundry.train.situations import input_layout
from tests.train.test_fit import SMALL, plan_of

drawn = pytest.mark.skipif(choose_engine() is Engine.RAYCAST, reason="no GL driver")


def test_the_expected_place_of_a_spot_is_where_it_is() -> None:
    import torch

    from simfoundry.train.network import _expected_places

    maps = torch.zeros(1, 2, 5, 9)
    maps[0, 0, 1, 6] = maps[0, 1, 4, 0] = 50.0
    found = _expected_places(maps)[0].numpy()
    np.testing.assert_allclose(found, [0.5, -1.0, -0.5, 1.0], atol=1e-5)  # x of both points, then y


def test_images_replace_true_poses(bench: Path) -> None:
    task = load_task(bench)
    layout = input_layout([task], ["front"], 32)
    assert (layout.objects, layout.joints, layout.width, layout.height) == ((), (), 32, 24)
    assert layout.size == 10  # the hand and the gripper
    with pytest.raises(SimfoundryError, match="same proportions, but front has 32 x 24, top has 32 x 32 pixels"):
        input_layout([task], ["front", "top"], 32)
    with pytest.raises(SimfoundryError, match="the training requests camera `side`"):
        input_layout([task], ["side"], 32)


@drawn
def test_a_policy_learns_from_what_its_camera_sees(demos: Path, bench: Path, tmp_path: Path) -> None:
    options = replace(SMALL, steps=60, batch=32)
    plan = replace(plan_of(tmp_path / "policy", demos, options), cameras=("top",), image_width=24)
    found = train(plan)
    assert found.spec.cameras == ("top",) and found.spec.image_size == (24, 24)
    assert found.losses[-1].train < found.losses[0].train
    policy = BaselinePolicy(tmp_path / "policy", load_task(bench))
    assert {name: (size.width, size.height) for name, size in policy.cameras.items()} == {"top": (24, 24)}
    runs = [sf.evaluate(bench, f"baseline:{tmp_path / 'policy'}", out=tmp_path / name, rollouts=2) for name in "ab"]
    first, second = ([(r["end"], r["trajectory"]) for r in run.records] for run in runs)
    assert first == second and all(end in ("success", "horizon") for end, _ in first)
