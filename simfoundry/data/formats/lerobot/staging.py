"""The staged files of one episode, which LeRobot v2.1 and v3 share: its table, and one video for each camera."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, EpisodeHeader
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.formats.checks import checked_frames
from simfoundry.data.formats.images import encode_png
from simfoundry.data.formats.lerobot.schema import array_column, column_shape, image_column, is_color, is_video, schema
from simfoundry.data.formats.video import VideoWriter
from simfoundry.errors import OutputError
from simfoundry.runtime.files import naming

if TYPE_CHECKING:
    import pyarrow as pa

TABLE = "episode.parquet"


def staged_video(folder: Path, feature: str) -> Path:
    """Return the place of the staged video of a feature."""
    return folder / f"{feature}.mp4"


def stage_episode(info: DatasetInfo, episode: Episode, folder: Path) -> None:
    """Write the table and the videos of an episode to a folder. All images are read in one pass."""
    encoded: dict[str, list[bytes]] = {f.name: [] for f in info.images if is_color(f) and not is_video(f)}
    stacked: dict[str, list[NDArray[Any]]] = {f.name: [] for f in info.images if not is_color(f)}
    with ExitStack() as stack:
        videos = {
            feature.name: stack.enter_context(VideoWriter(staged_video(folder, feature.name), info.fps))
            for feature in info.images
            if is_video(feature)
        }
        for images in checked_frames(info, episode):
            for name, video in videos.items():
                video.add(images[name])
            for name, listed in encoded.items():
                listed.append(encode_png(images[name]))
            for name, arrays in stacked.items():
                arrays.append(images[name].copy())
    write_table([_table(info, episode, encoded, stacked)], folder / TABLE)


def _table(
    info: DatasetInfo, episode: Episode, encoded: dict[str, list[bytes]], stacked: dict[str, list[NDArray[Any]]]
) -> pa.Table:
    import pyarrow as pa

    columns, kinds = dict[str, pa.Array](), schema(info)
    for feature in info.features:
        kind = None if is_video(feature) else kinds.field(feature.name).type
        if feature.name in encoded:
            columns[feature.name] = image_column(encoded[feature.name], kind)
        elif feature.name in stacked:
            shape = (episode.header.length, *column_shape(feature))
            columns[feature.name] = array_column(np.stack(stacked[feature.name]).reshape(shape), kind)
        elif kind is not None:
            columns[feature.name] = array_column(episode.arrays[feature.name].astype(feature.dtype, copy=False), kind)
    counted = {"next.reward": episode.rewards, "next.done": episode.dones, **default_values(info, episode.header)}
    columns |= {name: array_column(values, kinds.field(name).type) for name, values in counted.items()}
    return pa.table(columns, schema=kinds)


def default_values(info: DatasetInfo, header: EpisodeHeader) -> dict[str, NDArray[Any]]:
    """Return the columns that LeRobot adds to each dataset, for one episode."""
    frames = np.arange(header.length)
    return {
        "timestamp": (frames / info.fps).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(header.length, header.index),
        "index": header.first_frame + frames,
        "task_index": np.full(header.length, header.task_index),
    }


def write_table(tables: Iterable[pa.Table], path: Path) -> None:
    """Write tables with the same columns as one Parquet file, in which each table is a row group."""
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path), ExitStack() as stack:
        writer = None
        for table in tables:
            if writer is None:
                writer = stack.enter_context(
                    pq.ParquetWriter(path, table.schema, compression="zstd", write_page_checksum=True)
                )
            writer.write_table(table, row_group_size=max(1, len(table)))


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read the columns of a Parquet file.

    Raises:
        OutputError: If it is missing, not a Parquet file, or lacks a column.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            missing = [name for name in columns or () if name not in file.schema_arrow.names]
            if missing:
                raise OutputError(f"{path} lacks the column `{missing[0]}`")
            return file.read(columns)
    except FileNotFoundError:
        raise OutputError(f"{path} is missing") from None
    except (pa.ArrowInvalid, OSError) as error:
        raise OutputError(f"{path} is not a valid Parquet file: {' '.join(str(error).split())[:200]}") from None


def place_file(source: Path, target: Path) -> None:
    """Link a staged file to its place in a dataset, or copy it if the file system has no links."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        with naming(target):
            shutil.copyfile(source, target)
