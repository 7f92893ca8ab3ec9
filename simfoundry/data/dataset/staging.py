"""Staged episodes: the files of one episode, its arrays, and the numbers of pixels of its images.

An episode is written to a hidden folder, which is renamed when it is complete. Whatever has its final name is complete.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, FrameSource, Images
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import dataset_format
from simfoundry.data.dataset.statistics import FeatureStatistics, PixelCounts, sampled_frames
from simfoundry.runtime.files import naming

ARRAYS, PIXELS = "arrays.npz", "pixels.npz"


def episode_folder(staging: Path, index: int) -> Path:
    """Return the folder of a staged episode."""
    return staging / "episodes" / f"{index:06d}"


def clear_unfinished(staging: Path) -> None:
    """Remove what killed processes left of unfinished episodes."""
    for left in (staging / "episodes").glob(".*"):
        shutil.rmtree(left)


def write_staged(episode: Episode, info: DatasetInfo, formats: Sequence[str], staging: Path) -> None:
    """Write the files of an episode in each format, its arrays, and the numbers of pixels of its images."""
    place = episode_folder(staging, episode.header.index)
    place.parent.mkdir(parents=True, exist_ok=True)
    unfinished = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
    counted = _CountedFrames(episode.images, info, episode.header.length)
    try:
        for name in formats:
            folder = unfinished / name
            folder.mkdir(parents=True)
            dataset_format(name).write_episode(info, replace(episode, images=counted), folder)
        _save(unfinished / ARRAYS, [episode.arrays[feature.name] for feature in info.arrays])
        counts = counted.counts()
        _save(unfinished / PIXELS, [counts[feature.name].counts for feature in info.images])
        _rename(unfinished, place)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


def _rename(unfinished: Path, place: Path) -> None:
    """Give an episode its final name, unless a process of a lost node, which was repeated, has staged it meanwhile."""
    try:
        unfinished.chmod(0o755)
        unfinished.rename(place)
    except OSError:
        if not place.is_dir():
            raise
        shutil.rmtree(unfinished)


class _CountedFrames:
    """Images whose pixels are counted while they are read for the first time."""

    def __init__(self, source: FrameSource, info: DatasetInfo, length: int) -> None:
        self._source, self._info, self._length = source, info, length
        self._counts: dict[str, PixelCounts] | None = None

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame, as the source does."""
        if self._counts is not None:
            yield from self._source.frames(final)
            return
        chosen, found = sampled_frames(self._length), dict[str, PixelCounts]()
        for k, images in enumerate(self._source.frames(final)):
            if k in chosen:
                for feature in self._info.images:
                    new = PixelCounts.of([images[feature.name]])
                    found[feature.name] = found[feature.name] + new if feature.name in found else new
            yield images
        self._counts = found

    def counts(self) -> Mapping[str, PixelCounts]:
        """Return the numbers of pixels, keyed by feature."""
        if self._counts is None:
            for _ in self.frames():
                pass
        return self._counts or {}


def _save(path: Path, arrays: Sequence[NDArray[Any]]) -> None:
    with naming(path), path.open("wb") as stream:
        np.savez(stream, **{f"a{k}": array for k, array in enumerate(arrays)})  # type: ignore[arg-type]


def _load(path: Path, count: int) -> list[NDArray[Any]]:
    with np.load(path, allow_pickle=False) as stored:
        return [stored[f"a{k}"] for k in range(count)]


def staged_arrays(place: Path, info: DatasetInfo) -> dict[str, NDArray[Any]]:
    """Return the arrays of a staged episode, keyed by feature."""
    names = [feature.name for feature in info.arrays]
    return dict(zip(names, _load(place / ARRAYS, len(names)), strict=True))


def staged_pixels(place: Path, info: DatasetInfo) -> dict[str, PixelCounts]:
    """Return the numbers of pixels in the images of a staged episode, keyed by feature."""
    rows = next(iter(staged_arrays(place, info).values()))
    frames = len(sampled_frames(len(rows)))
    found = _load(place / PIXELS, len(info.images))
    return {f.name: PixelCounts.stored(c, f.dtype, frames) for f, c in zip(info.images, found, strict=True)}


def episode_statistics(place: Path, info: DatasetInfo) -> dict[str, FeatureStatistics]:
    """Return the statistics of a staged episode, keyed by feature."""
    return dataset_statistics([place], info)


def dataset_statistics(places: Sequence[Path], info: DatasetInfo) -> dict[str, FeatureStatistics]:
    """Return the statistics of staged episodes together, keyed by feature."""
    rows: dict[str, list[NDArray[Any]]] = {feature.name: [] for feature in info.arrays}
    pixels: dict[str, PixelCounts] = {}
    for place in places:
        for name, values in staged_arrays(place, info).items():
            rows[name].append(values)
        for name, counts in staged_pixels(place, info).items():
            pixels[name] = pixels[name] + counts if name in pixels else counts
    found = {name: FeatureStatistics.of(np.concatenate(values)) for name, values in rows.items()}
    return found | {name: counts.statistics() for name, counts in pixels.items()}
