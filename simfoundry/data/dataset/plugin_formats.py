"""Dataset formats of installed packages: their exceptions become errors that name the package and the line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.data.dataset.episode import Episode, EpisodeHeader
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.statistics import FeatureStatistics

if TYPE_CHECKING:
    from simfoundry.data.dataset.formats import DatasetFormat, StagedEpisode, StoredDataset

# Returns the context in which the code of a package runs.
Running = Callable[[], AbstractContextManager[None]]


class PluginFormat:
    """A format whose methods run in the context ``running``."""

    def __init__(self, form: DatasetFormat, running: Running) -> None:
        self._form, self._running = form, running

    def check(self, info: DatasetInfo) -> None:
        """Check that the format can store a dataset."""
        with self._running():
            self._form.check(info)

    def losses(self, info: DatasetInfo) -> Sequence[str]:
        """Return what the format does not store, or changes."""
        with self._running():
            return [str(text) for text in self._form.losses(info)]

    def write_episode(self, info: DatasetInfo, episode: Episode, folder: Path) -> None:
        """Write the files of one episode."""
        with self._running():
            self._form.write_episode(info, episode, folder)

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Write a dataset from all of its staged episodes."""
        with self._running():
            self._form.assemble(info, staged, statistics, out)

    def recognizes(self, folder: Path) -> bool:
        """Return True if a folder contains a dataset in this format."""
        with self._running():
            return bool(self._form.recognizes(folder))

    def read(self, folder: Path) -> StoredDataset:
        """Open a dataset."""
        with self._running():
            return _PluginDataset(self._form.read(folder), self._running)


class _PluginDataset:
    """A dataset whose methods run in the context ``running``."""

    def __init__(self, dataset: StoredDataset, running: Running) -> None:
        self._dataset, self._running = dataset, running

    @property
    def info(self) -> DatasetInfo:
        """The description."""
        with self._running():
            return self._dataset.info

    @property
    def statistics(self) -> Mapping[str, FeatureStatistics]:
        """The statistics of each feature."""
        with self._running():
            return self._dataset.statistics

    def __len__(self) -> int:
        """Return the number of episodes."""
        with self._running():
            return len(self._dataset)

    def header(self, k: int) -> EpisodeHeader:
        """Return the description of the k-th episode."""
        with self._running():
            return self._dataset.header(k)

    def episode(self, k: int) -> Episode:
        """Return the k-th episode."""
        with self._running():
            return self._dataset.episode(k)
