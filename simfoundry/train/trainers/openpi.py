"""The configuration of openpi: a script that registers a ``TrainConfig`` and then runs one of openpi's own scripts."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.signals import ActionKind
from simfoundry.train.trainers.configuration import BuiltDataset, Configuration, TrainerOptions

SCRIPT, DATA = "openpi_config.py", "openpi_config.json"

# The features of `LeRobotDROIDDataConfig`, with the number of values of arrays, or None for images.
FEATURES = {
    "exterior_image_1_left": None,
    "exterior_image_2_left": None,
    "wrist_image_left": None,
    "joint_position": 7,
    "gripper_position": 1,
    "actions": 8,
}

# The models, with the weights from which they start. Their horizon of 16 actions is that of `pi05_droid_finetune`.
MODELS = {
    "pi05": "gs://openpi-assets/checkpoints/pi05_droid",
    "pi0": "gs://openpi-assets/checkpoints/pi0_droid",
}
HORIZON = 16


def configure(dataset: BuiltDataset, options: TrainerOptions, out: Path) -> Configuration:
    """Return the configuration for a dataset with the profile ``openpi-droid``."""
    dataset.need_format(("lerobot-v2.1",), "openpi", "openpi-droid")
    sizes = {f.name: None if f.is_image else f.shape[0] for f in dataset.info.features}
    wrong = [name for name, size in FEATURES.items() if name not in sizes or sizes[name] != size]
    if wrong:
        raise SimfoundryError(
            f"openpi's DROID models need {', '.join(wrong)} as in DROID, which {dataset.folder} does not have; build "
            "the dataset with `--profile openpi-droid`"
        )
    model = options.model or "pi05"
    if model not in MODELS:
        raise SimfoundryError(f"openpi's `{model[:40]}` is not supported; choose {', '.join(MODELS)}")
    space = dataset.action_space
    if space.kind not in (ActionKind.JOINT_POSITION, ActionKind.JOINT_VELOCITY):
        raise SimfoundryError(
            f"openpi's DROID models act with joint positions or joint velocities, not with `{space}`; set "
            "`action_space` of the dataset"
        )
    is_position = space.kind is ActionKind.JOINT_POSITION
    # The statistics of DROID belong to velocities from -1 to 1; those of other actions are computed.
    reuses = str(space) == "joint_velocity:normalized"
    data = {
        "name": options.name,
        "repo_id": dataset.folder.name,
        "pi05": model == "pi05",
        "action_horizon": HORIZON,
        "delta_joints": 7 if is_position else 0,
        "weights": f"{MODELS[model]}/params",
        "assets": {"assets_dir": f"{MODELS[model]}/assets", "asset_id": "droid"} if reuses else None,
        "steps": options.steps,
        "batch": options.batch,
        "seed": options.seed,
    }
    run = ("uv", "run", str(out / SCRIPT))
    statistics = (*run, "scripts/compute_norm_stats.py", "--config-name", options.name)
    training = (*run, "scripts/train.py", options.name, f"--exp-name={options.name}")
    notes = ["Run the commands in a checkout of openpi, which reads the dataset as LeRobot v2.1."]
    if is_position:
        notes.append(
            "Joint positions become changes relative to the state at the start of a chunk; the gripper does not."
        )
    if reuses:
        notes.append("The normalization is that of DROID, as openpi advises for fine-tuning with joint velocities.")
    return Configuration(
        files={
            SCRIPT: (files(__package__) / "openpi_config.py.txt").read_text("utf-8"),
            DATA: json.dumps(data, indent=1, ensure_ascii=False) + "\n",
        },
        commands=(training,) if reuses else (statistics, training),
        environment={"HF_LEROBOT_HOME": str(dataset.folder.parent)},
        notes=tuple(notes),
    )
