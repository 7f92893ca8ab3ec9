"""The environments of the readers. Their packages contradict each other, and those of SimFoundry."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

_LEROBOT = (
    *("huggingface_hub", "jsonlines", "einops", "draccus", "imageio", "pandas", "termcolor", "deepdiff", "packaging"),
    *("accelerate", "safetensors"),
)
_TORCH = ("torch==2.13.0", "torchvision==0.28.0")


@dataclass(frozen=True)
class Environment:
    """An environment with a reader.

    Attributes:
        format: The format that it reads.
        script: The script that loads a dataset.
        python: The version of Python.
        packages: The packages to install.
        alone: The packages to install without what they declare to need.
    """

    format: str
    script: str
    python: str
    packages: tuple[str, ...]
    alone: tuple[str, ...] = ()


ENVIRONMENTS = {
    "lerobot-0.3": Environment(
        "lerobot-v2.1",
        "lerobot_reader",
        "python3.11",
        (*_TORCH, "numpy<2.3", "datasets<=3.6", "av<16", *_LEROBOT),
        ("lerobot==0.3.3", "torchcodec==0.11.1"),
    ),
    "lerobot-0.4": Environment(
        "lerobot-v3",
        "lerobot_reader",
        "python3.11",
        (*_TORCH, "numpy<2.4", "datasets<4.2", "av<16", *_LEROBOT),
        ("lerobot==0.4.4", "torchcodec==0.11.1"),
    ),
    # Its torch is the build for CUDA, because PyPI has no other for Python 3.12.
    "lerobot-0.6": Environment(
        "lerobot-v3",
        "lerobot_reader",
        "python3.12",
        (*_TORCH, "numpy", "datasets<5", "av<16", "gymnasium", "opencv-python-headless", *_LEROBOT),
        ("lerobot==0.6.1", "torchcodec==0.14.0"),
    ),
    "robomimic-0.3": Environment(
        "robomimic",
        "robomimic_reader",
        "python3.11",
        (
            *_TORCH,
            "numpy",
            "h5py",
            "six",
            "tensorboard",
            "tensorboardX",
            "imageio",
            "matplotlib",
            "psutil",
            "tqdm",
            "termcolor",
        ),
        ("robomimic==0.3.0",),
    ),
    "tfds": Environment("rlds", "rlds_reader", "python3.11", ("tensorflow-cpu", "tensorflow-datasets")),
}


def python_of(environments: Path, name: str) -> Path:
    """Return the interpreter of an environment."""
    return environments / name / "bin" / "python"


def create(folder: Path, environment: Environment) -> None:
    """Make an environment if it does not exist."""
    if folder.exists():
        return
    subprocess.run([environment.python, "-m", "venv", str(folder)], check=True)
    install = [str(folder / "bin/python"), "-m", "pip", "install", "--quiet"]
    subprocess.run([*install, *environment.packages], check=True)
    if environment.alone:
        subprocess.run([*install, "--no-deps", *environment.alone], check=True)
