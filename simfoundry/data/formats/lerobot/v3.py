"""LeRobot v3.0, which current LeRobot reads: many episodes in each table and each video."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import StagedEpisode
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.lerobot.metadata import (
    CHUNK_SIZE,
    column_statistics,
    info_json,
    statistics_json,
    video_features,
    write_json,
)
from simfoundry.data.formats.lerobot.staging import TABLE, read_table, staged_video, write_table
from simfoundry.data.formats.lerobot.tables import write_episodes_table, write_tasks_table
from simfoundry.data.formats.lerobot.version import LeRobotVersion
from simfoundry.data.formats.video import exact_rate, join_videos

VERSION = "v3.0"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

# Largest sizes of files [MB], which LeRobot also uses. An episode is never divided.
DATA_MB, VIDEO_MB = 100, 200


@dataclass(frozen=True)
class _File:
    """A file with consecutive episodes, from ``first`` up to ``end``."""

    number: int
    first: int
    end: int

    @property
    def place(self) -> dict[str, int]:
        """The folder and the file in it."""
        return {"chunk_index": self.number // CHUNK_SIZE, "file_index": self.number % CHUNK_SIZE}


def _files(sizes: Sequence[int], limit: int) -> Iterator[_File]:
    """Divide episodes into files of at most ``limit`` bytes, given their sizes."""
    number, first, total = 0, 0, 0
    for k, size in enumerate(sizes):
        if k > first and total + size > limit:
            yield _File(number, first, k)
            number, first, total = number + 1, k, 0
        total += size
    yield _File(number, first, len(sizes))


class LeRobotV3(LeRobotVersion):
    """The format LeRobot v3.0."""

    version = VERSION

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Join the tables and the videos of the episodes, and write the metadata."""
        videos = video_features(info)
        rows = _join_tables(staged, out)
        for name in videos:
            for row, place in zip(rows, _join_videos(info, staged, name, out), strict=True):
                row |= {f"videos/{name}/{key}": value for key, value in place.items()}
        layout = {
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if videos else None,
        }
        write_json(out / "meta/info.json", info_json(info, VERSION, layout))
        write_tasks_table(info.instructions, out / "meta/tasks.parquet")
        columns, overall = column_statistics(staged)
        for row, one, own in zip(rows, staged, columns, strict=True):
            for name, values in statistics_json(info, {**one.statistics, **own}, True).items():
                row |= {f"stats/{name}/{key}": value for key, value in values.items()}
            row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        write_episodes_table(rows, out / EPISODES_PATH.format(chunk_index=0, file_index=0))
        write_json(out / "meta/stats.json", statistics_json(info, {**statistics, **overall}, True))


def _join_tables(staged: Sequence[StagedEpisode], out: Path) -> list[dict[str, Any]]:
    """Write the files in ``data/``, and return the description of each episode."""
    rows = list[dict[str, Any]]()
    for file in _files([(one.folder / TABLE).stat().st_size for one in staged], DATA_MB * 2**20):
        episodes = staged[file.first : file.end]
        write_table((read_table(one.folder / TABLE) for one in episodes), out / DATA_PATH.format(**file.place))
        rows += [
            {
                "episode_index": header.index,
                "tasks": [header.instruction],
                "length": header.length,
                **{f"data/{key}": value for key, value in file.place.items()},
                "dataset_from_index": header.first_frame,
                "dataset_to_index": header.first_frame + header.length,
            }
            for header in (one.header for one in episodes)
        ]
    return rows


def _join_videos(
    info: DatasetInfo, staged: Sequence[StagedEpisode], name: str, out: Path
) -> Iterator[dict[str, int | float]]:
    """Write the videos of a feature, and yield the file and the times [s] of each episode."""
    parts, rate = [staged_video(one.folder, name) for one in staged], exact_rate(info.fps)
    for file in _files([part.stat().st_size for part in parts], VIDEO_MB * 2**20):
        target = out / VIDEO_PATH.format(**file.place, video_key=name)
        target.parent.mkdir(parents=True, exist_ok=True)
        join_videos(parts[file.first : file.end], target)
        frames = 0
        for header in (one.header for one in staged[file.first : file.end]):
            times = float(frames / rate), float((frames + header.length) / rate)
            yield {**file.place, "from_timestamp": times[0], "to_timestamp": times[1]}
            frames += header.length


FORMAT = LeRobotV3()
