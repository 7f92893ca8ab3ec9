"""Stored policies: what is damaged, foreign or dangerous is refused with one sentence."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path
from typing import Any

import pytest

from simfoundry.evaluate.entries import parse_policy
from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.evaluate.policies.checkpoint import CheckpointChoice
from simfoundry.evaluate.task import load_task
from simfoundry.train.job import train
from simfoundry.train.policy_files import ABOUT, WEIGHTS, baseline_digest, read_about, read_baseline
from tests.cli.command import run
from tests.train.test_fit import SMALL, plan_of


@pytest.fixture(scope="module")
def stored(demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from dataclasses import replace

    folder = tmp_path_factory.mktemp("stored") / "policy"
    train(plan_of(folder, demos, replace(SMALL, steps=20)))
    return folder


@pytest.fixture
def policy(stored: Path, tmp_path: Path) -> Path:
    shutil.copytree(stored, tmp_path / "policy")
    return tmp_path / "policy"


def edit(policy: Path, **changes: Any) -> None:
    about = json.loads((policy / ABOUT).read_text())
    (policy / ABOUT).write_text(json.dumps(about | changes))


def test_the_digest_covers_weights_and_description(policy: Path) -> None:
    choice = parse_policy(f"baseline:{policy}")
    assert isinstance(choice, CheckpointChoice)
    before = choice.digest
    data = bytearray((policy / WEIGHTS).read_bytes())
    data[-1] ^= 1
    (policy / WEIGHTS).write_bytes(data)
    changed = choice.digest
    edit(policy, executed=4)
    assert len({before, changed, choice.digest}) == 3


def test_pickled_weights_are_never_loaded(policy: Path, tmp_path: Path) -> None:
    class Touch:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "executed",)

    (policy / WEIGHTS).write_bytes(pickle.dumps({"network.first.weight": Touch()}))
    with pytest.raises(PolicyError, match=r"weights\.safetensors is not a file of tensors"):
        read_baseline(policy)
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(("changes", "message"), [
    ({"width": 97}, r"does not match baseline\.json: tensor `[a-z.0-9]+` has shape"),
    ({"width": 10**9}, r"`width`: Input should be less than or equal to 4096"),
    ({"blocks": 3}, r"does not match baseline\.json: it has the tensors"),
    ({"executed": 9}, "`executed` exceeds `chunk`"),
    ({"objects": ["block", "dish"]}, r"does not match baseline\.json"),
    ({"code": "import os"}, "`code`: Extra inputs are not permitted"),
    ({"hz": float("nan")}, "`hz`"),
    ({"robots": []}, "`robots`"),
])  # fmt: skip
def test_a_wrong_description_is_refused(policy: Path, changes: dict[str, Any], message: str) -> None:
    edit(policy, **changes)
    with pytest.raises(PolicyError, match=message):
        read_baseline(policy)


@pytest.mark.parametrize("text", ["", "[1", "[]", "[" * 100_000, '{"simfoundry": "baseline/2"}'])
def test_other_files_are_not_descriptions(policy: Path, text: str) -> None:
    (policy / ABOUT).write_text(text)
    with pytest.raises(PolicyError, match="is not a description of a baseline"):
        read_about(policy)


def test_missing_files_are_named(policy: Path) -> None:
    (policy / WEIGHTS).unlink()
    with pytest.raises(PolicyError, match=r"does not contain a trained baseline: weights\.safetensors is missing"):
        baseline_digest(policy)
    with pytest.raises(PolicyError, match="`baseline` requires the folder of a trained policy"):
        parse_policy("baseline:")


def test_weights_that_are_not_finite_are_refused(policy: Path) -> None:
    import torch
    from safetensors.torch import load, save

    tensors = load((policy / WEIGHTS).read_bytes())
    for name in ("network.last.bias", "inputs.scale"):
        damaged = {**tensors, name: torch.full_like(tensors[name], torch.nan)}
        (policy / WEIGHTS).write_bytes(save(damaged))
        with pytest.raises(PolicyError, match="finite"):
            read_baseline(policy)


def test_a_task_without_the_objects_is_refused(policy: Path, bench: Path) -> None:
    edit(policy, objects=["crate"])
    choice = parse_policy(f"baseline:{policy}")
    assert isinstance(choice, CheckpointChoice)
    with pytest.raises(Exception, match=r"was trained with object `crate`, which task `push` does not have"):
        choice.create(load_task(bench))


def test_eval_reports_a_broken_policy_in_one_line(policy: Path, bench: Path, tmp_path: Path) -> None:
    (policy / WEIGHTS).write_bytes(b"nothing")
    done = run("eval", bench, "-p", f"baseline:{policy}", "-n", "1", "-o", tmp_path / "eval", "--no-video")
    assert done.code == 1 and done.one_line("is not a file of tensors") and "Traceback" not in done.err
