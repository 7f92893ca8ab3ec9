"""The interface of file formats for datasets.

A format is registered once, in :data:`FORMATS` or by an installed package. Episodes are staged independently of each
other, so that they can be written in parallel and an interrupted build can be resumed. The files of a dataset are then
assembled by one process.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from simfoundry.data.dataset.episode import Episode, EpisodeHeader
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.plugin_formats import PluginFormat
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.runtime.plugins import Registry


@dataclass(frozen=True)
class StagedEpisode:
    """An episode whose files are staged.

    Attributes:
        header: The description of the episode.
        folder: The folder in which the format has staged its files. It must not be changed, because an interrupted
            build reads it again; link or copy the files instead.
        statistics: The statistics of each feature in this episode.
    """

    header: EpisodeHeader
    folder: Path
    statistics: Mapping[str, FeatureStatistics]


class StoredDataset(Protocol):
    """A dataset that is read from files. Values are read when they are needed."""

    @property
    def info(self) -> DatasetInfo:
        """The description. Datasets of others have no ``environment`` and no ``origin``."""

    @property
    def statistics(self) -> Mapping[str, FeatureStatistics]:
        """The statistics that the dataset contains for each feature; empty if the format has none."""

    def __len__(self) -> int:
        """Return the number of episodes."""

    def header(self, k: int) -> EpisodeHeader:
        """Return the description of the k-th episode, counted from 0."""

    def episode(self, k: int) -> Episode:
        """Return the k-th episode, counted from 0. Its images are decoded when they are read.

        Raises:
            OutputError: If its files are missing or invalid. The message names the file.
        """


@runtime_checkable
class DatasetFormat(Protocol):
    """A file format for datasets.

    A dataset is a folder. After :meth:`assemble`, the builder adds the file ``simfoundry.json`` to it, which
    :func:`~simfoundry.data.dataset.manifest.read_manifest` reads: the description of the dataset and of its episodes,
    which formats cannot express completely.
    """

    def check(self, info: DatasetInfo) -> None:
        """Check that the format can store a dataset.

        Raises:
            SimfoundryError: If it cannot, or if a package that it needs is not installed.
        """

    def losses(self, info: DatasetInfo) -> Sequence[str]:
        """Return what the format does not store, or changes, as whole sentences."""

    def write_episode(self, info: DatasetInfo, episode: Episode, folder: Path) -> None:
        """Write the files of one episode to an empty folder. Called in a worker process.

        Equal arguments give equal bytes.
        """

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Write a dataset from all of its staged episodes. Called once, in one process.

        Equal arguments give equal bytes.

        Args:
            info: The description of the dataset.
            staged: The episodes, in order.
            statistics: The statistics of each feature in the entire dataset.
            out: An empty folder, which is renamed to its final name afterward. Its files may not refer to its name.
        """

    def recognizes(self, folder: Path) -> bool:
        """Return True if a folder contains a dataset in this format, without reading all of it."""

    def read(self, folder: Path) -> StoredDataset:
        """Open a dataset, which may have been written by another program.

        Raises:
            OutputError: If the folder does not contain a valid dataset in this format.
        """


# Registry of formats by name; each format is imported when it is used.
FORMATS: Registry[DatasetFormat] = Registry(
    "simfoundry.dataset_formats",
    {
        "lerobot-v2.1": "simfoundry.data.formats.lerobot.v21:FORMAT",
        "lerobot-v3": "simfoundry.data.formats.lerobot.v3:FORMAT",
        "robomimic": "simfoundry.data.formats.robomimic:FORMAT",
        "rlds": "simfoundry.data.formats.rlds:FORMAT",
    },
    DatasetFormat,
)


def dataset_format(name: str) -> DatasetFormat:
    """Return the format called ``name``.

    Raises:
        UnknownExtensionError: If the name is unknown; the message lists the available names.
        PluginError: If the format cannot be loaded.
    """
    found = FORMATS.load(name)
    return found if FORMATS.plugin(name) is None else PluginFormat(found, lambda: FORMATS.running(name))
