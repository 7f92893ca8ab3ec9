"""Training: the same bytes whatever happens on the way, and a policy that has learned the task."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import simfoundry as sf
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.train.fit import CHECKPOINT, POINTS, FitOptions
from simfoundry.train.job import JOB, LOSSES, TrainPlan, read_losses, request_digest, train, train_in_workers
from simfoundry.train.policy_files import ABOUT, WEIGHTS

SMALL = FitOptions(steps=400, batch=64, chunk=8, width=96, blocks=2, shift=0.001, turn=0.005)

# A training that writes a checkpoint at each point of the loss curve, and kills itself after 250 steps.
KILLED = """\
import os, signal, sys
from pathlib import Path
from simfoundry.train import fit
from simfoundry.train.job import train
from tests.train.test_fit import plan_of

fit.CHECKPOINT_S = 0.0


def report(text, share):
    if text.startswith("step 250 "):
        os.kill(os.getpid(), signal.SIGKILL)


train(plan_of(Path(sys.argv[1]), Path(sys.argv[2])), report)
"""


def plan_of(folder: Path, demos: Path, options: FitOptions = SMALL) -> TrainPlan:
    return TrainPlan(folder, (demos,), options)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def trained(demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "policy"
    assert train(plan_of(folder, demos)).is_new
    return folder


def test_the_policy_pushes_the_block_from_starts_it_has_not_seen(trained: Path, bench: Path, tmp_path: Path) -> None:
    found = sf.evaluate(bench, [f"baseline:{trained}", "random"], out=tmp_path / "a", rollouts=6, seed=5)
    assert found.success["push", "baseline"] >= 0.5 and found.success["push", "random"] < 0.2
    again = sf.evaluate(bench, f"baseline:{trained}", out=tmp_path / "b", rollouts=6, seed=5)
    digests = [[r["trajectory"] for r in e.records if r["policy"] == "baseline"] for e in (found, again)]
    assert digests[0] == digests[1] and len(set(digests[0])) == 6


def test_a_finished_training_is_described_and_not_repeated(trained: Path, demos: Path) -> None:
    before = bytes_of(trained)
    assert set(before) == {ABOUT, WEIGHTS, JOB, LOSSES}
    about = json.loads(before[ABOUT])
    assert about["objects"] == ["block"] and about["training"]["demonstrations"] == 12 and about["hz"] == 15
    assert about["training"]["steps"] == 400 and about["training"]["tasks"] == ["push"]
    losses = read_losses(trained)
    assert len(losses) == POINTS and losses[-1].train < 0.7 * losses[0].train
    assert losses[-1].validation is not None and losses[0].validation is not None
    assert losses[-1].validation < losses[0].validation
    assert not train(plan_of(trained, demos)).is_new and bytes_of(trained) == before


def test_a_training_that_is_killed_goes_on_to_the_same_bytes(trained: Path, demos: Path, tmp_path: Path) -> None:
    folder = tmp_path / "policy"
    killed = subprocess.run([sys.executable, "-c", KILLED, str(folder), str(demos)], check=False)
    assert killed.returncode == -9 and set(bytes_of(folder)) == {JOB, CHECKPOINT}
    damaged = tmp_path / "damaged"
    shutil.copytree(folder, damaged)
    (damaged / CHECKPOINT).write_bytes((damaged / CHECKPOINT).read_bytes()[:-100])
    with pytest.raises(OutputError, match="is not a checkpoint of this training; remove it"):
        train(plan_of(damaged, demos))
    seen: list[str] = []
    train(plan_of(folder, demos), lambda text, share: seen.append(text))
    steps = [text.split(",")[0] for text in seen if text.startswith("step ")]
    assert steps[0] == "step 249 of 400" and len(steps) == 152  # the checkpoint was written after step 248
    assert bytes_of(folder) == bytes_of(trained)


def test_trainings_in_several_processes_give_the_same_bytes(trained: Path, demos: Path, tmp_path: Path) -> None:
    plans = {f"seed {k}": plan_of(tmp_path / str(k), demos, replace(SMALL, seed=k)) for k in (0, 1)}
    found = train_in_workers(plans, 2)
    assert [one.spec.training.seed for one in found.values()] == [0, 1]
    assert bytes_of(tmp_path / "0") == bytes_of(trained)
    assert (tmp_path / "1" / WEIGHTS).read_bytes() != (trained / WEIGHTS).read_bytes()


def test_a_folder_keeps_its_training(trained: Path, demos: Path) -> None:
    other = plan_of(trained, demos, replace(SMALL, seed=3))
    with pytest.raises(OutputError, match="was trained from other demonstrations or with other options; choose"):
        train(other)
    assert request_digest(other) != request_digest(plan_of(trained, demos))


def test_a_folder_with_other_files_is_refused(demos: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"contains other files, such as notes\.txt"):
        train(plan_of(tmp_path, demos))


def test_too_few_demonstrations_are_reported(demos: Path, tmp_path: Path) -> None:
    with pytest.raises(SimfoundryError, match="training needs 13 demonstrations, but there are 12"):
        train(replace(plan_of(tmp_path, demos), count=13))


def test_the_time_budget_limits_the_steps(demos: Path, tmp_path: Path) -> None:
    options = replace(SMALL, steps=1_000_000)
    found = train(replace(plan_of(tmp_path, demos, options), minutes=0.02))
    assert 20 <= found.spec.training.steps < 10_000
