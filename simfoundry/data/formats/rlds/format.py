"""The format RLDS, as TensorFlow Datasets stores it: ``NAME/1.0.0/`` with TFRecord files and two JSON files.

``tfds.builder_from_directory(OUT/NAME/1.0.0)`` and ``tfds.builder(NAME, data_dir=OUT)`` open it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from simfoundry.data.dataset.episode import Episode
from simfoundry.data.dataset.features import DatasetInfo, FeatureRole
from simfoundry.data.dataset.formats import StagedEpisode, StoredDataset
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.checks import checked_frames
from simfoundry.data.formats.images import encode_png
from simfoundry.data.formats.rlds.read import RldsDataset, version_folder
from simfoundry.data.formats.rlds.schema import INSTRUCTIONS, dataset_name, features_json, step_columns
from simfoundry.data.formats.rlds.tfrecord import Values, encode_example, record
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.files import write_file, writing_atomically
from simfoundry.spec.models.signals import ImageKind

_EPISODE, _VERSION = "episode.tfrecord", "1.0.0"

# Largest size of a file [bytes]. TensorFlow Datasets recommends 100 to 200 MB.
_SHARD_BYTES = 200 * 2**20


class RldsFormat:
    """The format RLDS, which TensorFlow Datasets reads."""

    def check(self, info: DatasetInfo) -> None:
        """Check that RLDS can store a dataset.

        Raises:
            SimfoundryError: If names collide, if there are no actions, or if a package is missing.
        """
        need_extra("data", "RLDS datasets")
        actions = [feature for feature in info.features if feature.role is FeatureRole.ACTION]
        if not actions:
            raise SimfoundryError("RLDS requires actions, but no feature is an action")
        if len({feature.dtype for feature in actions}) > 1 or any(len(feature.shape) != 1 for feature in actions):
            raise SimfoundryError("actions in RLDS must be vectors of one type")
        step_columns(info)

    def losses(self, info: DatasetInfo) -> Sequence[str]:
        """Return what RLDS does not store, or changes."""
        found = ["RLDS does not store statistics, the states of the simulation and MimicGen's data."]
        columns = {path: column for path, column in step_columns(info).items() if column.is_whole}
        renamed = [
            f"`{', '.join(f.name for f in column.features)}` as `{path}`"
            for path, column in columns.items()
            if [f.name for f in column.features] != [path]
        ]
        if renamed:
            found.append(f"Features have other names in RLDS: {', '.join(renamed)}.")
        return [*found, "RLDS does not store the frame rate, for which it has no key."]

    def write_episode(self, info: DatasetInfo, episode: Episode, folder: Path) -> None:
        """Stage an episode as a file with one record."""
        features = dict(_steps(info, episode)) | dict(_images(info, episode)) | dict(_metadata(info, episode))
        write_file(folder / _EPISODE, record(encode_example(features)))

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Join the records of the episodes to files, and write the metadata."""
        name, splits = dataset_name(info), []
        folder = out / name / _VERSION
        for split, (first, end) in info.splits.items():
            if first == end:
                continue
            paths = [one.folder / _EPISODE for one in staged[first:end]]
            shards = list(_shards(paths))
            for number, shard in enumerate(shards):
                target = folder / f"{name}-{split}.tfrecord-{number:05d}-of-{len(shards):05d}"
                with writing_atomically(target) as stream:
                    for path in shard:
                        stream.write(path.read_bytes())
            splits.append(
                {
                    "name": split,
                    "shardLengths": [str(len(shard)) for shard in shards],
                    "numBytes": str(sum(path.stat().st_size for path in paths)),
                    "filepathTemplate": "{DATASET}-{SPLIT}.{FILEFORMAT}-{SHARD_X_OF_Y}",
                }
            )
        about = {
            "name": name,
            "version": _VERSION,
            "releaseNotes": {_VERSION: "Written by SimFoundry."},
            "fileFormat": "tfrecord",
            "splits": splits,
        }
        for file, content in {"features.json": features_json(info), "dataset_info.json": about}.items():
            write_file(folder / file, (json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode())

    def recognizes(self, folder: Path) -> bool:
        """Return True if a folder contains a dataset of TensorFlow Datasets."""
        return version_folder(folder) is not None

    def read(self, folder: Path) -> StoredDataset:
        """Open a dataset."""
        return RldsDataset(folder)


def _steps(info: DatasetInfo, episode: Episode) -> Iterator[tuple[str, Values]]:
    """Yield the values of each step that are not images."""
    length, header = episode.header.length, episode.header
    for path, column in step_columns(info).items():
        if not column.features[0].is_image:
            values = [episode.arrays[feature.name].reshape(length, -1) for feature in column.features]
            whole = np.concatenate(values, axis=1)
            yield f"steps/{path}", (whole if column.is_whole else whole[:, column.start : column.stop]).reshape(-1)
    frames = np.arange(length)
    yield "steps/reward", episode.rewards.astype(np.float32)
    yield "steps/discount", np.ones(length, np.float32)
    yield "steps/is_first", (frames == 0).astype(np.int64)
    yield "steps/is_last", (frames == length - 1).astype(np.int64)
    yield "steps/is_terminal", ((frames == length - 1) & header.success).astype(np.int64)
    for key in INSTRUCTIONS:
        yield f"steps/{key}", [header.instruction.encode()] * length


def _images(info: DatasetInfo, episode: Episode) -> Iterator[tuple[str, Values]]:
    """Yield the encoded images of each camera: PNG if they are in color, else compressed numbers."""
    kept = {path: column.features[0] for path, column in step_columns(info).items() if column.features[0].is_image}
    encoded: dict[str, list[bytes]] = {path: [] for path in kept}
    for images in checked_frames(info, episode) if kept else ():
        for path, feature in kept.items():
            image = images[feature.name]
            is_color = feature.image is ImageKind.COLOR
            data = encode_png(image) if is_color else zlib.compress(np.ascontiguousarray(image).tobytes())
            encoded[path].append(data)
    yield from ((f"steps/{path}", listed) for path, listed in encoded.items())


def _metadata(info: DatasetInfo, episode: Episode) -> Iterator[tuple[str, Values]]:
    """Yield the values of the episode. openpi trains on episodes whose path contains ``success``, as in DROID."""
    header = episode.header
    folder = f"{dataset_name(info)}/{'success' if header.success else 'failure'}/{header.index:06d}"
    yield "episode_metadata/file_path", [f"{folder}/trajectory.h5".encode()]
    yield "episode_metadata/recording_folderpath", [f"{folder}/recordings".encode()]
    yield "episode_metadata/episode_index", np.array([header.index])
    yield "episode_metadata/success", np.array([int(header.success)])


def _shards(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Divide files into groups of at most :data:`_SHARD_BYTES`."""
    group, total = list[Path](), 0
    for path in paths:
        size = path.stat().st_size
        if group and total + size > _SHARD_BYTES:
            yield group
            group, total = [], 0
        group.append(path)
        total += size
    yield group


FORMAT = RldsFormat()
