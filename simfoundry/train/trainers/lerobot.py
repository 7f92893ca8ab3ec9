"""The configuration of ``lerobot-train``, in the JSON form of its ``TrainPipelineConfig``."""

from __future__ import annotations

import json
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.train.trainers.configuration import BuiltDataset, Configuration, TrainerOptions

FILE = "lerobot_train.json"

# Policies of LeRobot that are trained from scratch, and those that start from weights on the Hub. Keys that only some
# policies have are not written, so that one form suits all versions from 0.3 on.
SCRATCH = ("act", "diffusion", "vqbet")
PRETRAINED = {"smolvla": "lerobot/smolvla_base", "pi0": "lerobot/pi0_base", "pi05": "lerobot/pi05_base"}


def configure(dataset: BuiltDataset, options: TrainerOptions, out: Path) -> Configuration:
    """Return the configuration for a dataset in the format ``lerobot-v3`` or ``lerobot-v2.1``."""
    dataset.need_format(("lerobot-v3", "lerobot-v2.1"), "LeRobot", "lerobot")
    model = options.model or SCRATCH[0]
    if model not in (*SCRATCH, *PRETRAINED):
        raise SimfoundryError(f"LeRobot's `{model[:40]}` is not supported; choose {', '.join((*SCRATCH, *PRETRAINED))}")
    data = {
        "dataset": {"repo_id": f"simfoundry/{options.name}", "root": str(dataset.folder)},
        # With pretrained weights, `--policy.path` states the policy.
        **({"policy": {"type": model, "push_to_hub": False}} if model in SCRATCH else {}),
        "output_dir": str(out / "outputs"),
        "job_name": options.name,
        "seed": options.seed,
        "batch_size": options.batch,
        "steps": options.steps,
    }
    path = ("--policy.push_to_hub=false", f"--policy.path={PRETRAINED[model]}") if model in PRETRAINED else ()
    command = ("lerobot-train", f"--config_path={out / FILE}", *path)
    version = "0.4 or newer" if dataset.manifest.format == "lerobot-v3" else "0.3"
    notes = (f"The dataset requires LeRobot {version}.",)
    return Configuration({FILE: json.dumps(data, indent=1, ensure_ascii=False) + "\n"}, (command,), notes=notes)
