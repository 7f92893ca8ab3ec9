"""The metadata that LeRobot v2.1 and v3 share: ``info.json``, and statistics in the shapes that LeRobot expects."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo
from simfoundry.data.dataset.formats import StagedEpisode
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.lerobot.schema import (
    DEFAULT_COLUMNS,
    RESULT_COLUMNS,
    column_shape,
    describe_features,
    is_color,
    is_video,
    plain_rate,
)
from simfoundry.data.formats.lerobot.staging import TABLE, read_table
from simfoundry.geometry.frames import Array
from simfoundry.runtime.files import write_file

# The number of files in a folder, which LeRobot also uses.
CHUNK_SIZE = 1000

# The largest value of a color channel. LeRobot keeps the statistics of images in the range from 0 to 1.
_WHITE = 255.0

_BASIC = ("min", "max", "mean", "std")


def info_json(info: DatasetInfo, version: str, layout: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of ``info.json``. ``layout`` contains the keys that only one version has."""
    return {
        "codebase_version": version,
        "robot_type": info.robot_type,
        "total_episodes": info.episodes,
        "total_frames": info.frames,
        "total_tasks": len(info.instructions),
        "chunks_size": CHUNK_SIZE,
        **layout,
        "fps": plain_rate(info.fps),
        "splits": {name: f"{first}:{end}" for name, (first, end) in info.splits.items()},
        "features": describe_features(info),
    }


def video_features(info: DatasetInfo) -> list[str]:
    """Return the names of the features that are encoded as videos."""
    return [feature.name for feature in info.features if is_video(feature)]


def column_statistics(staged: Sequence[StagedEpisode]) -> tuple[list[dict[str, FeatureStatistics]], dict[str, Any]]:
    """Return the statistics of the columns that are not features, for each episode and for all of them."""
    names = [*RESULT_COLUMNS, *DEFAULT_COLUMNS]
    tables = [read_table(one.folder / TABLE, names) for one in staged]
    values = {name: [np.asarray(table[name])[:, None] for table in tables] for name in names}
    episodes = [{name: FeatureStatistics.of(values[name][k]) for name in names} for k in range(len(staged))]
    return episodes, {name: FeatureStatistics.of(np.concatenate(values[name])) for name in names}


def statistics_json(
    info: DatasetInfo, statistics: Mapping[str, FeatureStatistics], quantiles: bool
) -> dict[str, dict[str, Any]]:
    """Return statistics as LeRobot stores them.

    Those of color images have the shape (3, 1, 1) and the range from 0 to 1. LeRobot refuses any other shape if the
    name of a feature contains ``image``, so that such depth images and masks have no statistics.
    """
    features, found = {feature.name: feature for feature in info.features}, {}
    for name, one in statistics.items():
        feature = features.get(name)
        if feature is None or not feature.is_image or is_color(feature) or "image" not in name:
            values = {key: getattr(one, key) for key in _BASIC} | (dict(one.quantiles) if quantiles else {})
            shaped: dict[str, Any] = {key: _shaped(feature, value) for key, value in values.items()}
            found[name] = {**shaped, "count": [one.count]}
    return found


def _shaped(feature: DatasetFeature | None, values: Array) -> Any:
    """Return statistics as nested lists, with an axis for each axis of the images that they cover."""
    if feature is None or not feature.is_image:
        return values.tolist()
    if is_color(feature):
        return (values / _WHITE).reshape(-1, 1, 1).tolist()
    return values.reshape((1,) * len(column_shape(feature))).tolist()


def write_json(path: Path, data: object) -> None:
    """Write a JSON file of a dataset."""
    write_file(path, (json.dumps(data, indent=4, ensure_ascii=False) + "\n").encode())


def write_json_lines(path: Path, rows: Sequence[object]) -> None:
    """Write a file with one JSON value per line."""
    write_file(path, "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode())
