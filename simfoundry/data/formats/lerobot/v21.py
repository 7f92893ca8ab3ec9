"""LeRobot v2.1, which openpi and GR00T read: one table and one video for each camera per episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import StagedEpisode
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.lerobot.gr00t import gr00t_statistics, modality
from simfoundry.data.formats.lerobot.metadata import (
    CHUNK_SIZE,
    column_statistics,
    info_json,
    statistics_json,
    video_features,
    write_json,
    write_json_lines,
)
from simfoundry.data.formats.lerobot.staging import TABLE, place_file, staged_video
from simfoundry.data.formats.lerobot.version import LeRobotVersion

VERSION = "v2.1"
DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"


class LeRobotV21(LeRobotVersion):
    """The format LeRobot v2.1, with the additional files that GR00T reads."""

    version = VERSION

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Link the files of the episodes to their places, and write the metadata."""
        videos, meta = video_features(info), out / "meta"
        for one in staged:
            place = {"episode_chunk": one.header.index // CHUNK_SIZE, "episode_index": one.header.index}
            place_file(one.folder / TABLE, out / DATA_PATH.format(**place))
            for name in videos:
                place_file(staged_video(one.folder, name), out / VIDEO_PATH.format(**place, video_key=name))
        layout = {
            "total_videos": len(videos) * len(staged),
            "total_chunks": -(-len(staged) // CHUNK_SIZE),
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if videos else None,
        }
        write_json(meta / "info.json", info_json(info, VERSION, layout))
        tasks = [{"task_index": k, "task": text} for k, text in enumerate(info.instructions)]
        write_json_lines(meta / "tasks.jsonl", tasks)
        headers = [one.header for one in staged]
        episodes = [{"episode_index": h.index, "tasks": [h.instruction], "length": h.length} for h in headers]
        write_json_lines(meta / "episodes.jsonl", episodes)
        columns, overall = column_statistics(staged)
        rows = [
            {"episode_index": one.header.index, "stats": statistics_json(info, {**one.statistics, **own}, False)}
            for one, own in zip(staged, columns, strict=True)
        ]
        write_json_lines(meta / "episodes_stats.jsonl", rows)
        write_json(meta / "modality.json", modality(info))
        write_json(meta / "stats.json", gr00t_statistics(info, {**statistics, **overall}))


FORMAT = LeRobotV21()
