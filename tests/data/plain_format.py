"""A dataset format for tests: one NumPy archive for each episode."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.data.dataset.episode import Episode, EpisodeHeader
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import StagedEpisode
from simfoundry.data.dataset.manifest import read_manifest
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.errors import OutputError
from simfoundry.runtime.files import naming


class _Stored:
    """The images of a stored episode."""

    def __init__(self, images: Mapping[str, np.ndarray[Any, Any]], length: int) -> None:
        self._images, self._length = images, length

    def frames(self, final: bool = False) -> Any:
        for k in range(self._length + final):
            yield {name: values[k] for name, values in self._images.items()}


class _Dataset:
    def __init__(self, folder: Path) -> None:
        manifest = read_manifest(folder)
        if manifest is None:
            raise OutputError(f"{folder} is not a plain dataset")
        self._folder, self._manifest = folder, manifest

    @property
    def info(self) -> DatasetInfo:
        return self._manifest.info

    @property
    def statistics(self) -> Mapping[str, FeatureStatistics]:
        return self._manifest.statistics

    def __len__(self) -> int:
        return self.info.episodes

    def header(self, k: int) -> EpisodeHeader:
        return self._manifest.headers[k]

    def episode(self, k: int) -> Episode:
        with np.load(self._folder / f"{k:06d}.npz") as stored:
            found = {name.replace("|", "/"): stored[name] for name in stored.files}
        images = {f.name: found[f"image:{f.name}"] for f in self.info.images}
        return Episode(
            header=self.header(k),
            arrays={f.name: found[f.name] for f in self.info.arrays},
            final={f.name: found[f"final:{f.name}"] for f in self.info.arrays if f"final:{f.name}" in found},
            images=_Stored(images, len(found["dones"])),
            rewards=found["rewards"],
            dones=found["dones"],
            states=found["states"],
        )


class PlainFormat:
    """Every episode in an archive, and an index."""

    def check(self, info: DatasetInfo) -> None:
        """Accept every dataset."""

    def losses(self, info: DatasetInfo) -> Sequence[str]:
        """Return one loss."""
        return ("Sub-tasks are not stored.",)

    def write_episode(self, info: DatasetInfo, episode: Episode, folder: Path) -> None:
        """Write an archive. The variable `PLAIN_FAULT` simulates a full disk."""
        frames = list(episode.frames(final=True))
        images = {f"image:{f.name}": np.array([images[f.name] for images in frames]) for f in info.images}
        final = {f"final:{name}": value for name, value in episode.final.items()}
        more = {"rewards": episode.rewards, "dones": episode.dones, "states": episode.states}
        path = folder / "episode.npz"
        with naming(path), path.open("wb") as stream:
            if os.environ.get("PLAIN_FAULT") == str(episode.header.index):
                raise OSError(28, "No space left on device")
            everything: dict[str, Any] = {**episode.arrays, **final, **images, **more}
            np.savez(stream, **{name.replace("/", "|"): value for name, value in everything.items()})

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Link the archives, and write an index."""
        for one in staged:
            os.link(one.folder / "episode.npz", out / f"{one.header.index:06d}.npz")
        index = {name: [s.min.tolist(), s.max.tolist(), s.count] for name, s in statistics.items()}
        (out / "index.json").write_text(json.dumps(index))

    def recognizes(self, folder: Path) -> bool:
        """Return True if there is an index."""
        return (folder / "index.json").is_file()

    def read(self, folder: Path) -> _Dataset:
        """Open a dataset."""
        return _Dataset(folder)


FORMAT = PlainFormat()
