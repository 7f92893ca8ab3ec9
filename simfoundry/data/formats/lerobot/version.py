"""The part of the format that all versions of LeRobot share: the staging of episodes, and reading."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from simfoundry.data.dataset.episode import Episode
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import StagedEpisode, StoredDataset
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.lerobot.check import check_features, format_losses
from simfoundry.data.formats.lerobot.read import LeRobotDataset, codebase_version
from simfoundry.data.formats.lerobot.staging import stage_episode


class LeRobotVersion(ABC):
    """A version of LeRobot's format. Versions differ in how the files of a dataset are assembled.

    ``version`` is the ``codebase_version`` of its datasets.
    """

    version: ClassVar[str]

    def check(self, info: DatasetInfo) -> None:
        """Check that LeRobot can store a dataset."""
        check_features(info)

    def losses(self, info: DatasetInfo) -> Sequence[str]:
        """Return what LeRobot does not store, or changes."""
        return format_losses(info)

    def write_episode(self, info: DatasetInfo, episode: Episode, folder: Path) -> None:
        """Stage an episode."""
        stage_episode(info, episode, folder)

    @abstractmethod
    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Write the dataset from its staged episodes."""

    def recognizes(self, folder: Path) -> bool:
        """Return True if a folder contains a dataset in this version."""
        return codebase_version(folder) == self.version

    def read(self, folder: Path) -> StoredDataset:
        """Open a dataset."""
        return LeRobotDataset(folder, self.version)
