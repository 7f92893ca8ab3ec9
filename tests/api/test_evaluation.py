"""``sf.evaluate``: the function stays a function, and wrong arguments are refused before anything runs."""

from __future__ import annotations

import pickle
import pkgutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.evaluate.policies.base import PolicyError
from tests.evaluate.benches import write_bench


@pytest.fixture
def task(tmp_path: Path) -> Path:
    return write_bench(tmp_path)


def test_an_evaluation_can_follow_another(task: Path, tmp_path: Path) -> None:
    first, second = (sf.evaluate(task, "random", out=tmp_path / "ev", rollouts=1) for _ in range(2))
    assert first.results == second.results and len(second.records) == 1


@pytest.mark.parametrize(
    "statement",
    [
        "import simfoundry.evaluate.run",
        "from simfoundry.evaluate import run",
        "import simfoundry as sf; sf.evaluate; import simfoundry.evaluate.run as run; run.jobs",
        "import simfoundry.evaluate.resets.starts as starts; starts.starts",
        "import simfoundry.evaluate.run; simfoundry.evaluate.run.jobs",
    ],
)
def test_a_public_name_wins_over_the_subpackage_of_that_name(statement: str) -> None:
    code = f"{statement}\nfrom simfoundry import evaluate; import simfoundry as sf\nassert evaluate is sf.evaluate\n"
    code += "print(evaluate.__module__, type(evaluate).__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("simfoundry.api.evaluation function\n", "")


def test_no_public_name_is_a_module() -> None:
    for module in pkgutil.iter_modules(sf.__path__, "simfoundry."):
        if module.ispkg:
            __import__(module.name)
    assert not [name for name in sf.__all__ if isinstance(getattr(sf, name), ModuleType)]
    assert pickle.loads(pickle.dumps(sf.evaluate)) is sf.evaluate


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"rollouts": 0}, "`rollouts` must be between 1 and 10000, not 0"),
        ({"rollouts": -1}, "`rollouts` must be between 1"),
        ({"seed": -1}, "`seed` must be between 0"),
        ({"jobs": -3}, "`jobs` must be between 1 and 256, not -3"),
        ({"rollouts": "3"}, "`rollouts` must be a whole number, not '3'"),
        ({"seed": 0.5}, "`seed` must be a whole number, not 0.5"),
        ({"rollouts": True}, "`rollouts` must be a whole number, not True"),
        ({"tasks": []}, "no task is specified"),
        ({"policies": []}, "no policy is specified"),
    ],
)
def test_an_option_out_of_range_is_refused(task: Path, tmp_path: Path, wrong: dict[str, Any], words: str) -> None:
    arguments: dict[str, Any] = {"tasks": task, "policies": "random", "out": tmp_path / "ev"} | wrong
    with pytest.raises(sf.SimfoundryError, match=words):
        sf.evaluate(**arguments)
    assert not (tmp_path / "ev").exists()


def test_a_recording_without_actions_is_refused_before_the_first_rollout(task: Path, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=r"none\.npz does not contain recorded actions: No such file"):
        sf.evaluate(task, f"replay:{tmp_path / 'none.npz'}", out=tmp_path / "ev")
    np.save(tmp_path / "flat.npy", np.zeros(3))
    with pytest.raises(PolicyError, match="actions have shape"):
        sf.evaluate(task, f"replay:{tmp_path / 'flat.npy'}", out=tmp_path / "ev")
