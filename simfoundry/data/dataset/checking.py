"""Check the files of a dataset: counts, shapes, ranges, images, statistics, and splits that share demonstrations."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, EpisodeHeader
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureKind
from simfoundry.data.dataset.formats import StoredDataset
from simfoundry.data.dataset.manifest import read_manifest
from simfoundry.data.dataset.reading import open_dataset
from simfoundry.data.dataset.statistics import FeatureStatistics, PixelCounts, sampled_frames
from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.signals import HAND_READINGS, RotationForm

# Relative and absolute tolerance of statistics: formats store them in single precision or as decimal text.
RTOL, ATOL = 1e-4, 1e-5

# Tolerance of the mean and the standard deviation of images: a video changes pixels by a few of 256 levels. Extreme
# values are not compared, because a single pixel determines them.
PIXEL_LEVELS = 4.0

# Tolerance of values between -1 and 1, and of the length of quaternions, in single precision.
SLACK = 1e-3

# Maximum number of problems to report; a dataset with more of them is broken as a whole.
MAX_PROBLEMS = 100


@dataclass(frozen=True)
class DatasetProblem:
    """A problem of a dataset.

    Attributes:
        text: A whole sentence for the user.
        episode: The index of the episode, or None if the problem is one of the entire dataset.
        feature: The name of the feature, or an empty string.
    """

    text: str
    episode: int | None = None
    feature: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the problem as plain data."""
        return {"text": self.text, "episode": self.episode, "feature": self.feature}


def check_stored(
    folder: Path, with_images: bool = True, checked: Callable[[int, int], object] = lambda done, count: None
) -> list[DatasetProblem]:
    """Check a dataset.

    Args:
        folder: The folder of the dataset.
        with_images: Whether to decode all images.
        checked: Callback that receives the number of checked episodes and their total number.

    Raises:
        SimfoundryError: If the folder does not contain a dataset.
    """
    stored = open_dataset(folder)[1]
    found: list[DatasetProblem] = []
    for problem in _problems(stored, folder, with_images, checked):
        found.append(problem)
        if len(found) >= MAX_PROBLEMS:
            break
    return found


def _problems(
    stored: StoredDataset, folder: Path, with_images: bool, checked: Callable[[int, int], object]
) -> Iterator[DatasetProblem]:
    info, count = stored.info, len(stored)
    headers = [stored.header(k) for k in range(count)]
    yield from _count_problems(info, headers)
    yield from _split_problems(info, headers)
    rows: dict[str, list[NDArray[Any]]] = {feature.name: [] for feature in info.arrays}
    pixels: dict[str, PixelCounts] = {}
    seen: dict[str, int] = {}
    for k, header in enumerate(headers):
        try:
            episode = stored.episode(k)
            yield from _episode_problems(info, header, episode)
            for name, values in episode.arrays.items():
                if name in rows:
                    rows[name].append(values)
            yield from _repetitions(header, episode, seen)
            if with_images and info.images:
                yield from _image_problems(info, header, episode, pixels)
        except (SimfoundryError, OSError) as error:
            yield DatasetProblem(f"episode {k} cannot be read: {error}", k)
        checked(k + 1, count)
    yield from _statistics_problems(stored, folder, rows, pixels)


def _count_problems(info: DatasetInfo, headers: list[EpisodeHeader]) -> Iterator[DatasetProblem]:
    if info.episodes != len(headers):
        yield DatasetProblem(f"the description states {info.episodes} episodes, but there are {len(headers)}")
    frames = sum(header.length for header in headers)
    if info.frames != frames:
        yield DatasetProblem(f"the description states {info.frames} frames, but the episodes have {frames}")
    first = 0
    for k, header in enumerate(headers):
        if (header.index, header.first_frame) != (k, first):
            place = f"index {header.index}, first frame {header.first_frame}"
            yield DatasetProblem(f"episode {k} has {place}; expected {k} and {first}", k)
        first += header.length
        if not header.instruction.strip():
            yield DatasetProblem(f"episode {k} has no instruction", k)
        if header.length < 1:
            yield DatasetProblem(f"episode {k} has no frames", k)


def _split_problems(info: DatasetInfo, headers: list[EpisodeHeader]) -> Iterator[DatasetProblem]:
    covered = 0
    for name, (first, end) in sorted(info.splits.items(), key=lambda split: split[1]):
        if first != covered or end > len(headers):
            yield DatasetProblem(f"split `{name}` has the episodes {first} to {end - 1}; expected {covered} first")
        covered = end
    if info.splits and covered != len(headers):
        yield DatasetProblem(f"the splits cover {covered} of {len(headers)} episodes")
    places: dict[str, str] = {}
    for header in headers:
        trajectory = str(header.source.get("trajectory", ""))
        if trajectory and places.setdefault(trajectory, header.split) != header.split:
            other = places[trajectory]
            text = f"episode {header.index} in `{header.split}` shows a demonstration that is in `{other}` as well"
            yield DatasetProblem(text, header.index)


def _episode_problems(info: DatasetInfo, header: EpisodeHeader, episode: Episode) -> Iterator[DatasetProblem]:
    k = header.index
    for feature in info.arrays:
        values = episode.arrays.get(feature.name)
        if values is None:
            yield DatasetProblem(f"episode {k} lacks `{feature.name}`", k, feature.name)
            continue
        wanted = (header.length, *feature.shape)
        if values.shape != wanted:
            text = f"`{feature.name}` of episode {k} has shape {values.shape}; expected {wanted}"
            yield DatasetProblem(text, k, feature.name)
        elif values.dtype != np.dtype(feature.dtype):
            text = f"`{feature.name}` of episode {k} has type {values.dtype}; expected {feature.dtype}"
            yield DatasetProblem(text, k, feature.name)
        elif values.dtype.kind == "f" and not np.isfinite(values).all():
            frame = int(np.argwhere(~np.isfinite(values))[0][0])
            text = f"`{feature.name}` of episode {k} is not finite in frame {frame}"
            yield DatasetProblem(text, k, feature.name)
        else:
            yield from _range_problems(feature, values, k)
    if len(episode.dones) != header.length or (header.length and not bool(episode.dones[-1])):
        yield DatasetProblem(f"episode {k} does not end with its last frame", k)
    elif episode.dones[:-1].any():
        yield DatasetProblem(f"episode {k} ends before its last frame", k)


def _range_problems(feature: DatasetFeature, values: NDArray[Any], k: int) -> Iterator[DatasetProblem]:
    """Yield a problem for parts of an array that are out of the range that their meaning implies."""
    for part in feature.parts:
        columns = values[:, part.start : part.stop]
        if "normalized" in part.meaning.split(":") and np.abs(columns).max(initial=0.0) > 1 + SLACK:
            text = f"`{part.name}` in `{feature.name}` of episode {k} is not between -1 and 1"
            yield DatasetProblem(text, k, feature.name)
        start = _quaternions(part.meaning)
        if start is None:
            continue
        for column in range(start, columns.shape[1], 7):
            lengths = np.linalg.norm(columns[:, column : column + 4], axis=1)
            if np.abs(lengths - 1).max(initial=0.0) > SLACK:
                text = f"`{part.name}` in `{feature.name}` of episode {k} contains a quaternion that is not of length 1"
                yield DatasetProblem(text, k, feature.name)
                break


def _quaternions(meaning: str) -> int | None:
    """Return the column of the first quaternion in poses of seven numbers, or None if there are none."""
    if meaning == "objects":
        return 3
    return 3 if meaning in HAND_READINGS and HAND_READINGS[meaning][1] is RotationForm.QUAT_WXYZ else None


def _repetitions(header: EpisodeHeader, episode: Episode, seen: dict[str, int]) -> Iterator[DatasetProblem]:
    """Yield a problem if an earlier episode has the same arrays and shows the same pictures."""
    hasher = hashlib.sha256(str(header.source.get("pictures", "")).encode())
    for name in sorted(episode.arrays):
        hasher.update(np.ascontiguousarray(episode.arrays[name]).tobytes())
    other = seen.setdefault(hasher.hexdigest(), header.index)
    if other != header.index:
        yield DatasetProblem(f"episodes {other} and {header.index} are the same", header.index)


def _image_problems(
    info: DatasetInfo, header: EpisodeHeader, episode: Episode, pixels: dict[str, PixelCounts]
) -> Iterator[DatasetProblem]:
    """Decode all images of an episode, and count the pixels of those that were sampled for the statistics."""
    k, chosen, count = header.index, sampled_frames(header.length), 0
    first: Mapping[str, NDArray[Any]] = {}
    still = {feature.name for feature in info.images}
    wrong: set[str] = set()
    for t, images in enumerate(episode.frames()):
        count += 1
        first = first or images
        for feature in info.images:
            image = images.get(feature.name)
            if image is None or image.shape != feature.shape or image.dtype != np.dtype(feature.dtype):
                wrong.add(feature.name)
                continue
            if feature.name in still and not np.array_equal(image, first[feature.name]):
                still.discard(feature.name)
            if t in chosen:
                new = PixelCounts.of([image])
                pixels[feature.name] = pixels[feature.name] + new if feature.name in pixels else new
    if count != header.length:
        yield DatasetProblem(f"episode {k} has {count} images for {header.length} frames", k)
    for name in sorted(wrong):
        text = f"images of `{name}` in episode {k} do not have shape {info.feature(name).shape}"
        yield DatasetProblem(text, k, name)
    for name in sorted(still - wrong):
        if count > 1:
            yield DatasetProblem(f"all images of `{name}` in episode {k} are the same", k, name)


def _statistics_problems(
    stored: StoredDataset, folder: Path, rows: Mapping[str, list[NDArray[Any]]], pixels: Mapping[str, PixelCounts]
) -> Iterator[DatasetProblem]:
    """Compare the statistics in the files, and those in the manifest, with those of the values."""
    info, manifest = stored.info, read_manifest(folder)
    places = {"the dataset": stored.statistics, **({"simfoundry.json": manifest.statistics} if manifest else {})}
    for place, statistics in places.items():
        for feature in info.features:
            given = statistics.get(feature.name)
            if given is None:
                continue
            if feature.is_image:
                counted = pixels.get(feature.name)
                if counted is not None and _pixels_differ(given, counted.statistics(), feature):
                    text = f"the statistics of `{feature.name}` in {place} are not those of its images"
                    yield DatasetProblem(text, feature=feature.name)
            elif rows[feature.name]:
                key = _first_difference(given, FeatureStatistics.of(np.concatenate(rows[feature.name])))
                if key:
                    text = f"`{key}` of `{feature.name}` in the statistics of {place} is not that of its values"
                    yield DatasetProblem(text, feature=feature.name)


def _first_difference(given: FeatureStatistics, own: FeatureStatistics) -> str:
    if given.count != own.count:
        return "count"
    pairs = {key: (getattr(given, key), getattr(own, key)) for key in ("min", "max", "mean", "std")}
    pairs |= {key: (value, own.quantiles[key]) for key, value in given.quantiles.items() if key in own.quantiles}
    for key, (a, b) in pairs.items():
        if np.shape(a) != np.shape(b) or not np.allclose(a, b, rtol=RTOL, atol=ATOL):
            return key
    return ""


def _pixels_differ(given: FeatureStatistics, own: FeatureStatistics, feature: DatasetFeature) -> bool:
    exact = feature.kind is FeatureKind.IMAGE and feature.dtype == "uint8"
    tolerance = 1e-3 if exact else PIXEL_LEVELS
    pairs = ((given.mean, own.mean), (given.std, own.std))
    return any(np.shape(a) != np.shape(b) or np.abs(a - b).max() > tolerance for a, b in pairs)
