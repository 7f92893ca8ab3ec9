"""Configurations of trainers: what they contain, and that no text of a dataset becomes code."""

from __future__ import annotations

import ast
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from simfoundry.data.dataset.episode import EpisodeHeader
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureKind, FeaturePart, FeatureRole
from simfoundry.data.dataset.manifest import DatasetManifest, write_manifest
from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.signals import ImageKind
from simfoundry.train.trainers.configuration import TRAINERS, TrainerOptions, configure, read_built, training_name
from tests.cli.command import run

pytestmark = pytest.mark.needs_nothing

OPTIONS = TrainerOptions("cups")
EVIL = '"); import os; os.system("touch pwned"); ("'


def image(name: str) -> DatasetFeature:
    names = ("height", "width", "channels")
    observation = FeatureRole.OBSERVATION
    return DatasetFeature(
        name, observation, FeatureKind.IMAGE, "uint8", (180, 320, 3), names, (), name, ImageKind.COLOR
    )


def array(name: str, size: int, role: FeatureRole = FeatureRole.OBSERVATION, *parts: FeaturePart) -> DatasetFeature:
    return DatasetFeature(name, role, FeatureKind.ARRAY, "float32", (size,), tuple(map(str, range(size))), parts)


def dataset(folder: Path, form: str, space: str, features: tuple[DatasetFeature, ...], name: str = "cups") -> Path:
    info = DatasetInfo(name, 15.0, "franka_robotiq", features, space, (EVIL,), {"train": (0, 1)}, 1, 3)
    header = EpisodeHeader(0, 0, 3, EVIL, 0, "train", 1.0, True, {}, {})
    folder.mkdir(parents=True)
    write_manifest(folder, DatasetManifest(form, "0", info, [header], {}))
    return folder


def droid(folder: Path, space: str, **more: Any) -> Path:
    images = tuple(map(image, ("exterior_image_1_left", "exterior_image_2_left", "wrist_image_left")))
    state = array("joint_position", 7), array("gripper_position", 1)
    return dataset(folder, "lerobot-v2.1", space, (*images, *state, array("actions", 8, FeatureRole.ACTION)), **more)


def gr00t(folder: Path, space: str) -> Path:
    parts = FeaturePart("joint_position", 0, 7, "rad", space), FeaturePart("gripper_position", 7, 8, "", "gripper")
    state, action = array("observation.state", 8), array("action", 8, FeatureRole.ACTION, *parts)
    dataset(folder, "lerobot-v2.1", space, (image("observation.images.front"), state, action))
    each = {"joint_position": {"start": 0, "end": 7}, "gripper_position": {"start": 7, "end": 8}}
    video = {"front": {"original_key": "observation.images.front"}}
    language = {"human.task_description": {"original_key": "task_index"}}
    (folder / "meta").mkdir()
    modality = {"state": each, "action": each, "video": video, "annotation": language}
    (folder / "meta/modality.json").write_text(json.dumps(modality))
    return folder


def test_lerobot_gets_its_own_json(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "a b", "lerobot-v3", "joint_position", (array("action", 8, FeatureRole.ACTION),))
    found = configure(read_built(folder), "lerobot", replace(OPTIONS, steps=7, batch=3, seed=5), tmp_path / "out")
    (text,) = found.files.values()
    assert json.loads(text) == {
        "dataset": {"repo_id": "simfoundry/cups", "root": str(folder)},
        "policy": {"type": "act", "push_to_hub": False},
        "output_dir": str(tmp_path / "out/outputs"),
        "job_name": "cups",
        "seed": 5,
        "batch_size": 3,
        "steps": 7,
    }
    assert found.commands == (("lerobot-train", f"--config_path={tmp_path}/out/lerobot_train.json"),)
    pretrained = configure(read_built(folder), "lerobot", replace(OPTIONS, model="smolvla"), tmp_path)
    assert "--policy.path=lerobot/smolvla_base" in pretrained.commands[0]
    assert "policy" not in json.loads(next(iter(pretrained.files.values())))


@pytest.mark.parametrize(("space", "delta", "reuses"), [
    ("joint_position", 7, False), ("joint_velocity", 0, False), ("joint_velocity:normalized", 0, True),
])  # fmt: skip
def test_openpi_gets_what_the_actions_need(tmp_path: Path, space: str, delta: int, reuses: bool) -> None:
    folder = droid(tmp_path / "sets/it's mine", space)
    found = configure(read_built(folder), "openpi", OPTIONS, tmp_path / "out")
    data = json.loads(found.files["openpi_config.json"])
    assert (data["delta_joints"], data["repo_id"], data["name"]) == (delta, "it's mine", "cups")
    assert (data["assets"] is not None) is reuses
    assert len(found.commands) == 2 - reuses and found.environment == {"HF_LEROBOT_HOME": str(folder.parent)}
    for line, command in zip(found.shell_lines(), found.commands, strict=True):
        assert shlex.split(line)[1:] == list(command)


def test_gr00t_learns_joints_relative_to_the_state(tmp_path: Path) -> None:
    for space, relative in (("joint_position", True), ("joint_delta", False)):
        found = configure(read_built(gr00t(tmp_path / space, space)), "gr00t", OPTIONS, tmp_path / "out")
        data = json.loads(found.files["gr00t_config.json"])
        actions = [{"key": "joint_position", "relative": relative}, {"key": "gripper_position", "relative": False}]
        assert data["action"] == actions and data["video"] == ["front"]
        assert data["language"] == ["annotation.human.task_description"]


def test_scripts_are_the_same_for_every_dataset(tmp_path: Path) -> None:
    """Only JSON contains names, so nothing that a dataset contains is executed."""
    for trainer, make in (("openpi", droid), ("gr00t", gr00t)):
        plain = configure(read_built(make(tmp_path / trainer, "joint_position")), trainer, OPTIONS, tmp_path)
        folder = make(tmp_path / f"{trainer}{EVIL.replace('/', '')}", "joint_position")
        evil = configure(read_built(folder), trainer, replace(OPTIONS, name=training_name(EVIL)), tmp_path)
        (script,) = [name for name in plain.files if name.endswith(".py")]
        assert plain.files[script] == evil.files[script]
        ast.parse(plain.files[script])
        assert json.loads(evil.files[script.removesuffix(".py") + ".json"])


@pytest.mark.parametrize(("trainer", "message"), [
    ("lerobot", "LeRobot does not read robomimic; build .* with `simfoundry dataset build --format lerobot-v3"),
    ("openpi", "--format lerobot-v2.1 --profile openpi-droid"),
    ("gr00t", "--format lerobot-v2.1 --profile gr00t"),
    ("lerobott", "no trainer is called `lerobott`"),
])  # fmt: skip
def test_other_datasets_are_refused(tmp_path: Path, trainer: str, message: str) -> None:
    built = read_built(
        dataset(tmp_path / "d", "robomimic", "joint_position", (array("actions", 8, FeatureRole.ACTION),))
    )
    with pytest.raises(SimfoundryError, match=message):
        configure(built, trainer, OPTIONS, tmp_path)


def test_what_droid_models_cannot_do_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SimfoundryError, match="joint velocities, not with `hand_delta`"):
        configure(read_built(droid(tmp_path / "hand", "hand_delta")), "openpi", OPTIONS, tmp_path)
    action = array("action", 8, FeatureRole.ACTION)
    with pytest.raises(SimfoundryError, match=r"need exterior_image_1_left, .* as in DROID"):
        bare = dataset(tmp_path / "bare", "lerobot-v2.1", "joint_position", (action,))
        configure(read_built(bare), "openpi", OPTIONS, tmp_path)
    with pytest.raises(SimfoundryError, match=r"GR00T needs .*modality\.json"):
        configure(read_built(bare), "gr00t", OPTIONS, tmp_path)
    for text in ("{", "[]", '{"state": 3}', '{"state": {}, "action": {}, "video": {}, "annotation": {}}'):
        (bare / "meta").mkdir(exist_ok=True)
        (bare / "meta/modality.json").write_text(text)
        with pytest.raises(SimfoundryError, match="must name states, actions, videos"):
            configure(read_built(bare), "gr00t", OPTIONS, tmp_path)


def test_the_command_writes_files_and_prints_how_to_start(tmp_path: Path) -> None:
    folder, out = droid(tmp_path / "sets/cups", "joint_position", name="My cups"), tmp_path / "out"
    done = run("configure", folder, "--for", "openpi", "-o", out)
    assert done.code == 0 and done.out.splitlines()[1].endswith("scripts/train.py my_cups --exp-name=my_cups")
    assert {path.name for path in out.iterdir()} == {"openpi_config.py", "openpi_config.json"}
    assert run("configure", folder, "--for", "openpi", "-o", out).code == 0  # the same files again
    changed = run("configure", folder, "--for", "openpi", "-o", out, "--steps", "9", "--json")
    assert changed.code == 2 and "--force" in changed.json["error"]
    assert run("configure", folder, "--for", "openpi", "-o", out, "--steps", "9", "--force").code == 0
    wrong = run("configure", tmp_path / "sets", "--for", "openpi")
    assert wrong.code == 2 and wrong.one_line("is not a dataset that `simfoundry dataset build` wrote")
    assert run("configure", folder, "--for", "lerobot", "--name", "!!", "-o", out).one_line(
        "is not a name for a training"
    )
    assert set(TRAINERS) == {"lerobot", "openpi", "gr00t"}
