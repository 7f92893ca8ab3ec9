"""Problems of stored datasets, each of which is found."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.data.dataset.build import build_dataset
from simfoundry.data.dataset.checking import check_stored
from simfoundry.data.dataset.reading import open_dataset
from simfoundry.errors import OutputError
from simfoundry.render.gl import Engine, choose_engine
from tests.cli.command import run
from tests.data.push_dataset import plan_of

pytestmark = [
    pytest.mark.usefixtures("plain"),
    pytest.mark.skipif(choose_engine() is Engine.RAYCAST, reason="no GL driver"),
]


def test_a_sound_dataset_has_no_problems(built: Path) -> None:
    assert check_stored(built) == []
    done = run("dataset", "check", built)
    assert (done.code, done.out) == (0, f"{built}: no problems\n")


def _edit(folder: Path, name: str, change: Any) -> None:
    path = folder / name
    with np.load(path) as stored:
        arrays = {key: stored[key].copy() for key in stored.files}
    change(arrays)
    with path.open("wb") as stream:
        np.savez(stream, **arrays)


def _not_finite(arrays: dict[str, Any]) -> None:
    arrays["action"][3, 1] = np.nan


def _shifted(arrays: dict[str, Any]) -> None:
    arrays["action"] += 1


def _short(arrays: dict[str, Any]) -> None:
    arrays["action"] = arrays["action"][:-1]


def _still(arrays: dict[str, Any]) -> None:
    arrays["image:observation.images.front"][:] = arrays["image:observation.images.front"][0]


def _early(arrays: dict[str, Any]) -> None:
    arrays["dones"][4] = True


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_not_finite, "`action` of episode 1 is not finite in frame 3"),
        (_shifted, "`max` of `action` in the statistics of the dataset is not that of its values"),
        (_short, "`action` of episode 1 has shape"),
        (_still, "all images of `observation.images.front` in episode 1 are the same"),
        (_early, "episode 1 ends before its last frame"),
    ],
)
def test_damaged_episodes_are_found(built: Path, tmp_path: Path, change: Any, words: str) -> None:
    copy = Path(shutil.copytree(built, tmp_path / "copy"))
    _edit(copy, "000001.npz", change)
    assert any(words in problem.text for problem in check_stored(copy)), check_stored(copy)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"frames": ', '"frames": 1', "frames, but the episodes have"),
        ('"split": "held_out"', '"split": "test"', ""),
        ('"instruction": "Push the block away."', '"instruction": " "', "episode 0 has no instruction"),
        ('"held_out": [\n    3,', '"held_out": [\n    2,', "split `held_out` has the episodes 2 to 3"),
    ],
)
def test_damaged_manifests_are_found(built: Path, tmp_path: Path, old: str, new: str, words: str) -> None:
    copy = Path(shutil.copytree(built, tmp_path / "copy"))
    text = (copy / "simfoundry.json").read_text()
    assert old in text
    (copy / "simfoundry.json").write_text(text.replace(old, new, 1 if "instr" not in old else -1))
    found = check_stored(copy)
    assert any(words in problem.text for problem in found) if words else found == []


def test_repetitions_and_leaks_are_found(demos: Path, tmp_path: Path) -> None:
    where = {"demonstrations": str(demos), "count": 1}
    build_dataset(plan_of(demos, sources={"a": where, "b": where | {"split": "test"}}), tmp_path / "out")
    texts = [problem.text for problem in check_stored(tmp_path / "out")]
    assert texts == [
        "episode 1 in `test` shows a demonstration that is in `train` as well",
        "episodes 0 and 1 are the same",
    ]
    done = run("dataset", "check", tmp_path / "out", "--no-images", "--json")
    assert done.code == 1 and [p["text"] for p in done.json["problems"]] == texts


@pytest.mark.parametrize("text", ["", "[]", '{"simfoundry": 1}', '{"simfoundry": "dataset-manifest/1"}'])
def test_manifests_of_others_are_refused(built: Path, tmp_path: Path, text: str) -> None:
    copy = Path(shutil.copytree(built, tmp_path / "copy"))
    (copy / "simfoundry.json").write_text(text)
    with pytest.raises(OutputError, match="is not a valid manifest"):
        open_dataset(copy)
