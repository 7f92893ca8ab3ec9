"""LeRobot datasets, v2.1 and v3, that are read from files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, EpisodeHeader, Images
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.checks import matching_manifest
from simfoundry.data.formats.images import decode_image
from simfoundry.data.formats.lerobot.metadata_read import (
    MAX_ROWS,
    EpisodeFiles,
    read_episodes_v3,
    read_episodes_v21,
    read_features,
    read_json,
    read_statistics,
    read_tasks,
)
from simfoundry.data.formats.lerobot.schema import column_shape, column_values, is_color, is_video
from simfoundry.data.formats.video import decode_video
from simfoundry.errors import OutputError
from simfoundry.runtime.extras import need_extra

if TYPE_CHECKING:
    import pyarrow as pa


def codebase_version(folder: Path) -> str | None:
    """Return the version of the LeRobot dataset in a folder, or None if there is none."""
    path = folder / "meta" / "info.json"
    try:
        found = read_json(path) if path.is_file() else {}
    except OutputError:
        return None
    return str(found["codebase_version"]) if isinstance(found, dict) and "codebase_version" in found else None


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Convert the errors of invalid files to one that names the file."""
    try:
        yield
    except (
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        ArithmeticError,
        NotImplementedError,
        RecursionError,
    ) as error:
        cause = f"the key {error} is missing" if isinstance(error, KeyError) else error
        raise OutputError(f"{path} is not a valid part of a LeRobot dataset: {cause}") from None


def _splits(about: Mapping[str, Any], count: int) -> dict[str, tuple[int, int]]:
    """Return the splits in ``info.json``, or a single one if they do not contain each of ``count`` episodes once."""
    found = []
    for name, ends in about.items():
        first, end = str(ends).split(":")
        found.append((int(first), int(end), str(name)))
    found.sort()
    edges = [0, *(end for _, end, _ in found)]
    if [first for first, _, _ in found] != edges[:-1] or edges[-1] != count:
        return {"train": (0, count)}
    return {name: (first, end) for first, end, name in found}


def _rate(value: Any) -> float:
    rate = float(value)
    if not 0 < rate < np.inf:
        raise ValueError(f"its number of frames per second is {value}")
    return rate


class LeRobotDataset:
    """A LeRobot dataset of the version ``v2.1`` or ``v3.0``."""

    def __init__(self, folder: Path, version: str) -> None:
        need_extra("data", "LeRobot datasets")
        self._folder, self._is_v3 = folder, version == "v3.0"
        about = read_json(folder / "meta" / "info.json")
        with _reading(folder / "meta" / "info.json"):
            if str(about["codebase_version"]) != version:
                raise ValueError(f"its version is {about['codebase_version']!r}, not {version}")
            features = read_features(about)
            videos = [feature.name for feature in features if is_video(feature)]
        with _reading(folder / "meta"):
            tasks = read_tasks(folder, self._is_v3)
            episodes = (read_episodes_v3 if self._is_v3 else read_episodes_v21)(folder, about, videos)
            self._episodes = sorted(episodes, key=lambda one: one.index)
            self._first = np.cumsum([0, *(one.length for one in self._episodes)])
            if [one.index for one in self._episodes] != list(range(len(self._episodes))):
                raise ValueError("the indices of its episodes are not consecutive")
            if any(not one.tasks or one.tasks[0] not in tasks or one.length < 1 for one in self._episodes):
                raise ValueError("an episode has no frames, or an unknown instruction")
            own = self._describe(about, features, tasks)
        self._manifest = matching_manifest(folder, [one.length for one in self._episodes])
        self.info = own if self._manifest is None else self._manifest.info

    def _describe(
        self, about: Mapping[str, Any], features: tuple[DatasetFeature, ...], tasks: tuple[str, ...]
    ) -> DatasetInfo:
        return DatasetInfo(
            name=self._folder.name,
            fps=_rate(about["fps"]),
            robot_type=str(about.get("robot_type") or ""),
            features=features,
            action_space="",
            instructions=tasks,
            splits=_splits(about.get("splits", {}), len(self._episodes)),
            episodes=len(self._episodes),
            frames=sum(one.length for one in self._episodes),
        )

    @cached_property
    def statistics(self) -> Mapping[str, FeatureStatistics]:
        """The statistics that the dataset contains for each feature."""
        with _reading(self._folder / "meta"):
            return read_statistics(self._folder, self.info.features, self._is_v3)

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._episodes)

    def header(self, k: int) -> EpisodeHeader:
        """Return the description of the k-th episode, counted from 0."""
        if self._manifest is not None:
            return self._manifest.headers[k]
        one, text = self._episodes[k], self._episodes[k].tasks[0]
        split = next((name for name, (first, end) in self.info.splits.items() if first <= one.index < end), "train")
        number = self.info.instructions.index(text)
        return EpisodeHeader(one.index, int(self._first[k]), one.length, text, number, split)

    def episode(self, k: int) -> Episode:
        """Return the k-th episode, counted from 0.

        Raises:
            OutputError: If its files are missing or invalid.
        """
        one, header = self._episodes[k], self.header(k)
        path = self._folder / one.table
        with _reading(path):
            table = self._rows(path, one)
            arrays = {f.name: column_values(table[f.name], f.shape) for f in self.info.arrays}
            rewards = np.zeros(one.length, np.float32)
            rewards[-1] = 1.0
            if "next.reward" in table.column_names:
                rewards = column_values(table["next.reward"], ()).astype(np.float32)
            dones = np.arange(one.length) == one.length - 1
        images = _StoredImages(self._folder, one, self.info.images, table)
        return Episode(header, arrays, {}, images, rewards, dones, np.zeros((one.length, 0)))

    def _rows(self, path: Path, one: EpisodeFiles) -> pa.Table:
        """Read the rows of an episode."""
        import pyarrow.parquet as pq

        names = [f.name for f in self.info.features if not is_video(f)]
        try:
            present = pq.read_schema(path).names
            if pq.read_metadata(path).num_rows > MAX_ROWS:
                raise ValueError(f"it has more than {MAX_ROWS} rows")
            missing = [name for name in names if name not in present]
            if missing:
                raise ValueError(f"the column `{missing[0]}` is missing")
            names += [name for name in ("next.reward", "frame_index") if name in present and name not in names]
            table = pq.read_table(
                path,
                columns=names,
                filters=[("episode_index", "=", one.index)],
                partitioning=None,
                page_checksum_verification=True,
            )
        except FileNotFoundError:
            raise OutputError(f"{path} is missing") from None
        except OSError as error:
            raise OutputError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
        if table.num_rows != one.length:
            raise ValueError(f"it has {table.num_rows} rows for episode {one.index}, not {one.length}")
        if "frame_index" in names and table["frame_index"].to_pylist() != list(range(one.length)):
            raise ValueError(f"the frames of episode {one.index} are not in order")
        return table


class _StoredImages:
    """The images of an episode in videos and in its table."""

    def __init__(
        self, folder: Path, files: EpisodeFiles, features: tuple[DatasetFeature, ...], table: pa.Table
    ) -> None:
        self._folder, self._files, self._features, self._table = folder, files, features, table

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame. The images after the last action are unknown, so the last ones repeat."""
        sources = {feature.name: self._images(feature) for feature in self._features}
        last: Images = {}
        for _ in range(self._files.length):
            last = {name: next(images) for name, images in sources.items()}
            yield last
        if final:
            yield last

    def _images(self, feature: DatasetFeature) -> Iterator[NDArray[Any]]:
        if is_video(feature):
            yield from self._video(feature)
            return
        path = self._folder / self._files.table
        with _reading(path):
            if not is_color(feature):
                yield from column_values(self._table[feature.name], column_shape(feature)).reshape(-1, *feature.shape)
                return
            for one in self._table[feature.name]:
                yield decode_image(one["bytes"].as_py() or b"", feature.shape)

    def _video(self, feature: DatasetFeature) -> Iterator[NDArray[Any]]:
        from av.error import FFmpegError

        place, start = self._files.videos[feature.name]
        path, count = self._folder / place, 0
        try:
            with _reading(path):
                for image in decode_video(path, start, self._files.length, (feature.shape[0], feature.shape[1])):
                    yield image
                    count += 1
        except FFmpegError as error:
            raise OutputError(f"{path} cannot be decoded: {error.strerror}") from None
        if count != self._files.length:
            raise OutputError(f"{path} has {count} frames for episode {self._files.index}, not {self._files.length}")
