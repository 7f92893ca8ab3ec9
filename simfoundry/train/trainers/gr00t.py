"""The configuration of Isaac GR00T: a module that registers the modalities of a dataset as a new embodiment."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.signals import ActionKind
from simfoundry.train.trainers.configuration import BuiltDataset, Configuration, TrainerOptions

SCRIPT, DATA = "gr00t_config.py", "gr00t_config.json"

# The file of a LeRobot dataset that names the parts of states and actions for GR00T; a real one takes 2 kB.
MODALITIES, MOST_BYTES = "meta/modality.json", 2**20

MODELS = {"n1.6": "nvidia/GR00T-N1.6-3B", "n1.7": "nvidia/GR00T-N1.7-3B"}

# The number of actions in a chunk, as in GR00T's examples.
HORIZON = 16


def configure(dataset: BuiltDataset, options: TrainerOptions, out: Path) -> Configuration:
    """Return the configuration for a dataset with the profile ``gr00t``."""
    dataset.need_format(("lerobot-v2.1",), "GR00T", "gr00t")
    model = options.model or "n1.6"
    if model not in MODELS:
        raise SimfoundryError(f"GR00T `{model[:40]}` is not supported; choose {', '.join(MODELS)}")
    found = _modalities(dataset.folder)
    states, actions = list(found["state"]), list(found["action"])
    relative = {name for name in actions if _is_relative(dataset, name) and name in states}
    data = {
        "video": list(found["video"]),
        "state": states,
        "action": [{"key": name, "relative": name in relative} for name in actions],
        "language": [f"annotation.{name}" for name in found["annotation"]][:1],
        "horizon": HORIZON,
    }
    command = (
        "uv", "run", "python", "gr00t/experiment/launch_finetune.py",
        "--base-model-path", MODELS[model],
        "--dataset-path", str(dataset.folder),
        "--embodiment-tag", "NEW_EMBODIMENT",
        "--modality-config-path", str(out / SCRIPT),
        "--output-dir", str(out / "outputs"),
        "--max-steps", str(options.steps),
        "--global-batch-size", str(options.batch),
    )  # fmt: skip
    notes = ["Run the command in a checkout of Isaac-GR00T, which reads the dataset as LeRobot v2.1."]
    if relative:
        notes.append(f"{', '.join(sorted(relative))} become changes relative to the state at the start of a chunk.")
    return Configuration(
        files={
            SCRIPT: (files(__package__) / "gr00t_config.py.txt").read_text("utf-8"),
            DATA: json.dumps(data, indent=1, ensure_ascii=False) + "\n",
        },
        commands=(command,),
        notes=tuple(notes),
    )


def _modalities(folder: Path) -> dict[str, dict[str, Any]]:
    path = folder / MODALITIES
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError
        data = json.loads(path.read_bytes())
        found = {key: dict(data[key]) for key in ("state", "action", "video", "annotation")}
        if not all(found.values()):
            raise ValueError
    except FileNotFoundError:
        raise SimfoundryError(f"GR00T needs {path}; build the dataset with `--profile gr00t`") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise SimfoundryError(
            f"{path} must name states, actions, videos and annotations for GR00T; build the dataset with `--profile "
            "gr00t`, and with at least one camera"
        ) from None
    return found


def _is_relative(dataset: BuiltDataset, name: str) -> bool:
    """Return True for absolute positions of joints, which GR00T learns as changes relative to the state."""
    part = next((part for part in dataset.action.parts if part.name == name), None)
    return part is not None and part.meaning.partition(":")[0] == ActionKind.JOINT_POSITION
