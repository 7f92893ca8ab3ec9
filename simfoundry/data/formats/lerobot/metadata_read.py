"""Read the metadata of a LeRobot dataset, which anyone may have written: features, episodes, statistics."""

from __future__ import annotations

import json
import string
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.data.dataset.features import DatasetFeature, FeatureKind, FeatureRole
from simfoundry.data.dataset.statistics import QUANTILES, FeatureStatistics
from simfoundry.data.formats.lerobot.schema import DEFAULT_COLUMNS, RESULT_COLUMNS, is_color
from simfoundry.data.formats.lerobot.staging import read_table
from simfoundry.errors import OutputError
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ImageKind

# Largest file with metadata to read [bytes]. The statistics of 10 000 episodes take 50 MB.
MAX_BYTES = 2**28

# Largest number of rows of a table to read; files of 100 MB have at most a million.
MAX_ROWS = 10**7

# Largest value of a color channel; LeRobot keeps the statistics of images in the range from 0 to 1.
_WHITE = 255.0


@dataclass(frozen=True)
class EpisodeFiles:
    """An episode of a LeRobot dataset, and where its values are.

    Attributes:
        index: The index of the episode.
        length: The number of frames.
        tasks: Its instructions.
        table: The Parquet file with its rows, relative to the dataset.
        videos: The file of each video feature, and the index of the episode's first frame in it.
    """

    index: int
    length: int
    tasks: tuple[str, ...]
    table: Path
    videos: Mapping[str, tuple[Path, int]]


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        OutputError: If it is missing, too large or not JSON.
    """
    return _parse(path, _text(path))


def read_json_lines(path: Path) -> Iterator[Any]:
    """Yield the values of a file with one JSON value per line."""
    for line in _text(path).splitlines():
        if line.strip():
            yield _parse(path, line)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise OutputError(f"{path} is larger than {MAX_BYTES // 2**20} MiB")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise OutputError(f"{path} is missing") from None
    except UnicodeDecodeError:
        raise OutputError(f"{path} is not UTF-8 text") from None


def _parse(path: Path, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise OutputError(f"{path} is not valid JSON: {error}") from None


def read_features(about: Mapping[str, Any]) -> tuple[DatasetFeature, ...]:
    """Return the features in ``info.json``, except those without numbers and LeRobot's own."""
    own = {*DEFAULT_COLUMNS, *RESULT_COLUMNS}
    found = (_feature(name, one) for name, one in about["features"].items() if name not in own)
    return tuple(feature for feature in found if feature is not None)


def _feature(name: str, about: Mapping[str, Any]) -> DatasetFeature | None:
    dtype, shape = str(about["dtype"]), tuple(map(int, about["shape"])) or (1,)
    if any(size < 1 for size in shape):
        raise ValueError(f"the feature `{name}` has the shape {shape}")
    role = FeatureRole.ACTION if name.startswith("action") else FeatureRole.OBSERVATION
    if dtype in ("video", "image"):
        if len(shape) != 3:
            raise ValueError(
                f"the image feature `{name}` has the shape {shape}, which is not (height, width, channels)"
            )
        if shape[0] == 3 and shape[2] != 3:  # some datasets list the channels first, although the images do not
            shape = (*shape[1:], shape[0])
        names, kind = ("height", "width", "channels"), FeatureKind(dtype)
        return DatasetFeature(name, role, kind, "uint8", shape, names, image=ImageKind.COLOR)
    if np.dtype(_numpy_name(dtype)).kind not in "fiub":
        return None
    return DatasetFeature(name, role, FeatureKind.ARRAY, dtype, shape, _names(name, about.get("names"), shape))


def _numpy_name(dtype: str) -> str:
    return dtype if dtype.rstrip("0123456789") in ("float", "int", "uint", "bool") else "str"


def _names(name: str, names: Any, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Return a name for each value of a vector. LeRobot keeps them in a list, or in a mapping of lists."""
    if isinstance(names, dict):
        names = [one for listed in names.values() for one in (listed if isinstance(listed, list) else [listed])]
    if isinstance(names, list) and len(names) == int(np.prod(shape)):
        return tuple(map(str, names))
    return tuple(f"{name.rpartition('.')[2]}_{k}" for k in range(shape[0])) if len(shape) == 1 else ()


def file_path(pattern: str, **values: Any) -> Path:
    """Return a path for one of the patterns in ``info.json``.

    Raises:
        ValueError: If the pattern contains anything but these values, or leaves the folder of the dataset.
    """
    for _, field, _, _ in string.Formatter().parse(pattern):
        if field is not None and field not in values:
            raise ValueError(f"the path {pattern!r} contains the unknown field {field!r}")
    path = Path(pattern.format(**values))
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"the path {str(path)!r} is outside the dataset")
    return path


def read_episodes_v21(folder: Path, about: Mapping[str, Any], videos: list[str]) -> Iterator[EpisodeFiles]:
    """Yield the episodes of LeRobot v2.1."""
    for row in read_json_lines(folder / "meta/episodes.jsonl"):
        index = int(row["episode_index"])
        place = {"episode_chunk": index // int(about["chunks_size"]), "episode_index": index}
        yield EpisodeFiles(
            index,
            int(row["length"]),
            tuple(map(str, row["tasks"])),
            file_path(about["data_path"], **place),
            {name: (file_path(about["video_path"], **place, video_key=name), 0) for name in videos},
        )


def read_episodes_v3(folder: Path, about: Mapping[str, Any], videos: list[str]) -> Iterator[EpisodeFiles]:
    """Yield the episodes of LeRobot v3."""
    files = sorted((folder / "meta/episodes").glob("*/*.parquet"))
    if not files:
        raise OutputError(f"{folder / 'meta/episodes'} contains no Parquet file")
    places = [("data", "data_path"), *((f"videos/{name}", "video_path") for name in videos)]
    columns = ["episode_index", "length", "tasks", *(f"{place}/{k}_index" for place, _ in places for k in _PLACE)]
    columns += [f"videos/{name}/from_timestamp" for name in videos]
    for file in files:
        for row in read_table(file, columns).to_pylist():
            paths = [
                file_path(
                    about[pattern],
                    video_key=place.removeprefix("videos/"),
                    **{f"{k}_index": int(row[f"{place}/{k}_index"]) for k in _PLACE},
                )
                for place, pattern in places
            ]
            starts = [round(float(row[f"videos/{name}/from_timestamp"]) * float(about["fps"])) for name in videos]
            yield EpisodeFiles(
                int(row["episode_index"]),
                int(row["length"]),
                tuple(map(str, row["tasks"])),
                paths[0],
                dict(zip(videos, zip(paths[1:], starts, strict=True), strict=True)),
            )


_PLACE = ("chunk", "file")


def read_tasks(folder: Path, is_v3: bool) -> tuple[str, ...]:
    """Return the instructions in the order of their indices."""
    if is_v3:
        table = read_table(folder / "meta/tasks.parquet")
        texts = next((name for name in table.column_names if name != "task_index"), None)
        if texts is None:
            raise ValueError("meta/tasks.parquet contains no instructions")
        pairs = zip(table["task_index"].to_pylist(), table[texts].to_pylist(), strict=True)
    else:
        rows = list(read_json_lines(folder / "meta/tasks.jsonl"))
        pairs = zip([row["task_index"] for row in rows], [row["task"] for row in rows], strict=True)
    tasks = {int(index): str(text) for index, text in pairs}
    if sorted(tasks) != list(range(len(tasks))):
        raise ValueError("the indices of the instructions are not consecutive")
    return tuple(tasks[index] for index in range(len(tasks)))


def read_statistics(folder: Path, features: tuple[DatasetFeature, ...], is_v3: bool) -> Mapping[str, FeatureStatistics]:
    """Return the statistics of each feature that has some, those of images in the range from 0 to 255."""
    if is_v3:
        data = read_json(folder / "meta/stats.json")
        return {f.name: _statistics(f, data[f.name]) for f in features if f.name in data}
    rows = [row["stats"] for row in read_json_lines(folder / "meta/episodes_stats.jsonl")]
    return {
        f.name: _pooled([_statistics(f, row[f.name]) for row in rows])
        for f in features
        if rows and all(f.name in row for row in rows)
    }


def _statistics(feature: DatasetFeature, data: Mapping[str, Any]) -> FeatureStatistics:
    scale = _WHITE if is_color(feature) else 1.0
    shape = feature.shape[-1:] if feature.is_image else feature.shape
    values = {key: _reshaped(value, shape) * scale for key, value in data.items() if key != "count"}
    quantiles = {key: values[key] for key in QUANTILES if key in values}
    count = int(np.max(data["count"]))
    return FeatureStatistics(values["min"], values["max"], values["mean"], values["std"], count, quantiles)


def _reshaped(value: Any, shape: tuple[int, ...]) -> Array:
    """Return a statistic in the shape of its feature. One value can stand for all pixels of a depth image."""
    found = np.array(value, dtype=np.float64)
    return found.reshape(shape) if found.size == int(np.prod(shape)) else np.broadcast_to(found, shape)


def _pooled(parts: list[FeatureStatistics]) -> FeatureStatistics:
    """Return the statistics of all frames from those of each episode. Quantiles cannot be joined."""
    counts = np.array([part.count for part in parts], dtype=np.float64)
    weights = counts / counts.sum()
    means = np.stack([part.mean for part in parts])
    mean = np.tensordot(weights, means, 1)
    squares = np.stack([part.std**2 for part in parts]) + (means - mean) ** 2
    low, high = np.min([part.min for part in parts], axis=0), np.max([part.max for part in parts], axis=0)
    return FeatureStatistics(low, high, mean, np.sqrt(np.tensordot(weights, squares, 1)), int(counts.sum()), {})
