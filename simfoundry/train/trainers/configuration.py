"""Configurations of trainers: what they need to know of a dataset, and the files and commands that they get.

Names of users are data in JSON files and arguments of commands. No text of a dataset becomes code.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name

from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureRole
from simfoundry.data.dataset.manifest import DatasetManifest, read_manifest
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.signals import ActionSpace


@dataclass(frozen=True)
class TrainerOptions:
    """The options that all trainers share.

    Attributes:
        name: The name of the training, from letters, digits and ``_``.
        model: The model to train, in the words of the trainer; empty for its default.
        steps: The number of optimization steps.
        batch: The number of examples in a step.
        seed: The seed.
    """

    name: str
    model: str = ""
    steps: int = 20_000
    batch: int = 32
    seed: int = 0


@dataclass(frozen=True)
class Configuration:
    """The configuration of a training.

    Attributes:
        files: The files to write, keyed by name.
        commands: The commands to run in the environment of the trainer, in order.
        environment: The environment variables of the commands.
        notes: Whole sentences on what the user should know.
    """

    files: Mapping[str, str]
    commands: tuple[tuple[str, ...], ...]
    environment: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def shell_lines(self) -> list[str]:
        """Return the commands as lines for a shell."""
        before = "".join(f"{name}={shlex.quote(value)} " for name, value in self.environment.items())
        return [before + shlex.join(command) for command in self.commands]


@dataclass(frozen=True, eq=False)
class BuiltDataset:
    """A dataset on disk."""

    folder: Path
    manifest: DatasetManifest

    @property
    def info(self) -> DatasetInfo:
        """The description of the dataset."""
        return self.manifest.info

    @property
    def action_space(self) -> ActionSpace:
        """The meaning of the actions."""
        return ActionSpace.parse(self.info.action_space)

    @property
    def action(self) -> DatasetFeature:
        """The feature with the actions.

        Raises:
            SimfoundryError: If there is not exactly one.
        """
        found = [feature for feature in self.info.features if feature.role is FeatureRole.ACTION]
        if len(found) != 1:
            names = ", ".join(feature.name for feature in found) or "none"
            raise SimfoundryError(f"{self.folder} must have one feature with actions to be trained on; it has {names}")
        return found[0]

    def need_format(self, formats: tuple[str, ...], trainer: str, profile: str) -> None:
        """Check that the dataset has a format that a trainer reads.

        Raises:
            SimfoundryError: If it has another format. The message states how to build the right one.
        """
        if self.manifest.format not in formats:
            raise SimfoundryError(
                f"{trainer} does not read {self.manifest.format}; build the dataset with `simfoundry dataset build "
                f"--format {formats[0]} --profile {profile}`"
            )


# Maximum length of the name of a training, which becomes the name of folders.
MAX_NAME = 64

# Function that returns the configuration of a trainer for a dataset, with the folder that the files are written to.
Configure = Callable[[BuiltDataset, TrainerOptions, Path], Configuration]

# The trainers, by name.
TRAINERS = {
    "lerobot": "simfoundry.train.trainers.lerobot:configure",
    "openpi": "simfoundry.train.trainers.openpi:configure",
    "gr00t": "simfoundry.train.trainers.gr00t:configure",
}


def read_built(folder: Path) -> BuiltDataset:
    """Open a dataset that ``simfoundry dataset build`` wrote.

    Raises:
        SimfoundryError: If the folder does not contain one.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        raise SimfoundryError(f"{folder} is not a dataset that `simfoundry dataset build` wrote")
    return BuiltDataset(folder.absolute(), manifest)


def training_name(text: str) -> str:
    """Return a name from lowercase letters, digits and ``_`` for a training.

    Raises:
        SimfoundryError: If the text contains no letter or digit.
    """
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:MAX_NAME]
    if not name:
        raise SimfoundryError(f"`{text[:40]}` is not a name for a training; use letters and digits, with --name")
    return name


def configure(dataset: BuiltDataset, trainer: str, options: TrainerOptions, out: Path) -> Configuration:
    """Return the configuration of a trainer.

    Raises:
        SimfoundryError: If the trainer is unknown, or cannot train on the dataset.
    """
    if trainer not in TRAINERS:
        raise SimfoundryError(f"no trainer is called `{trainer[:40]}`; {nearest(trainer, TRAINERS)}")
    function: Configure = resolve_name(TRAINERS[trainer])
    return function(dataset, options, out.absolute())
