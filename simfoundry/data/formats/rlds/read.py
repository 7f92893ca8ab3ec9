"""Datasets in the format RLDS that are read from files, with images in PNG or JPEG, and tensors."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, EpisodeHeader, Images
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureKind, FeatureRole
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.checks import matching_manifest
from simfoundry.data.formats.images import decode_image
from simfoundry.data.formats.rlds.schema import RldsColumn, step_columns
from simfoundry.data.formats.rlds.tfrecord import (
    RecordPlace,
    Values,
    count_values,
    decode_values,
    example_features,
    find_records,
    read_record,
    record_data,
)
from simfoundry.errors import OutputError
from simfoundry.runtime.extras import need_extra
from simfoundry.spec.models.signals import ImageKind

# Largest JSON file to read [bytes]; real ones take a few kilobytes.
_MAX_BYTES = 2**24

# The frame rate of datasets that do not state it, which RLDS cannot: that of DROID [Hz].
_DEFAULT_HZ = 15.0

_OBSERVATION, _ACTION, _TEXT = "steps/observation/", "steps/action", "steps/language_instruction"


def version_folder(folder: Path) -> Path | None:
    """Return the folder with the files of a dataset: the folder itself, ``VERSION/`` or ``NAME/VERSION/`` in it."""
    for pattern in ("features.json", "*/features.json", "*/*/features.json"):
        found = [path.parent for path in sorted(folder.glob(pattern)) if (path.parent / "dataset_info.json").is_file()]
        if found:
            return found[-1]
    return None


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Convert the errors of invalid files to one that names the file."""
    try:
        yield
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, zlib.error) as error:
        cause = f"{error} is missing" if isinstance(error, KeyError) else error
        raise OutputError(f"{path} is not a valid part of an RLDS dataset: {cause}") from None


def _json(path: Path) -> Any:
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"it is larger than {_MAX_BYTES // 2**20} MiB")
    return json.loads(path.read_text(encoding="utf-8"))


class RldsDataset:
    """A dataset of TensorFlow Datasets with steps, observations and actions."""

    def __init__(self, folder: Path) -> None:
        need_extra("data", "RLDS datasets")
        found = version_folder(folder)
        if found is None:
            raise OutputError(f"{folder} does not contain features.json and dataset_info.json of RLDS")
        self._folder = found
        with _reading(found / "features.json"):
            self._columns = dict(_flatten(_json(found / "features.json")))
            features = dict(_features(self._columns))
        with _reading(found / "dataset_info.json"):
            about = _json(found / "dataset_info.json")
            self._splits, self._records = dict[str, tuple[int, int]](), list[RecordPlace]()
            for split in about["splits"]:
                self._add_split(str(about["name"]), str(split["name"]), split)
        with _reading(found):
            self._lengths, self._texts = [], []
            for place in self._records:
                values = example_features(record_data(place))
                self._lengths.append(count_values(values["steps/is_first"]))
                texts = decode_values(values[_TEXT]) if _TEXT in values else []
                self._texts.append(texts[0].decode() if isinstance(texts, list) and texts else "")
        self._first = np.cumsum([0, *self._lengths])
        self._manifest = matching_manifest(folder, self._lengths)
        self.info = DatasetInfo(
            name=str(about["name"]),
            fps=_DEFAULT_HZ,
            robot_type="",
            features=tuple(features.values()),
            action_space="",
            instructions=tuple(dict.fromkeys(self._texts)),
            splits=self._splits,
            episodes=len(self._records),
            frames=sum(self._lengths),
        )
        self._places = {path: RldsColumn((feature,)) for path, feature in features.items()}
        if self._manifest is not None:
            self.info = self._manifest.info
            self._places = {f"steps/{path}": column for path, column in step_columns(self.info).items()}
        self._numbers = {text: number for number, text in enumerate(self.info.instructions)}

    def _add_split(self, name: str, split: str, about: Mapping[str, Any]) -> None:
        """Find the records of a split."""
        lengths, first = [int(one) for one in about["shardLengths"]], len(self._records)
        if not re.fullmatch(r"[\w-]+", name) or not re.fullmatch(r"\w+", split):
            raise ValueError(f"{name!r} or {split!r} is not a valid name")
        for number, length in enumerate(lengths):
            path = self._folder / f"{name}-{split}.tfrecord-{number:05d}-of-{len(lengths):05d}"
            if not path.is_file():
                raise OutputError(f"{path} is missing")
            records = list(find_records(path))
            if len(records) != length:
                raise OutputError(f"{path} contains {len(records)} episodes, not {length}")
            self._records += records
        self._splits[split] = first, len(self._records)

    @property
    def statistics(self) -> Mapping[str, FeatureStatistics]:
        """The statistics, which RLDS does not store."""
        return {}

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._records)

    def header(self, k: int) -> EpisodeHeader:
        """Return the description of the k-th episode, counted from 0."""
        if self._manifest is not None:
            return self._manifest.headers[k]
        split = next(name for name, (first, end) in self._splits.items() if first <= k < end)
        text, length = self._texts[k], self._lengths[k]
        return EpisodeHeader(k, int(self._first[k]), length, text, self._numbers.get(text, 0), split)

    def episode(self, k: int) -> Episode:
        """Return the k-th episode, counted from 0.

        Raises:
            OutputError: If its record is damaged.
        """
        place, header = self._records[k], self.header(k)
        with _reading(place.path):
            values = example_features(read_record(place))
            arrays = dict[str, NDArray[Any]]()
            for path, column in self._places.items():
                if column.is_whole and not column.features[0].is_image:
                    joined, start = self._numbers_of(values, path, header.length), 0
                    for feature in column.features:
                        stop = start + feature.shape[0] if len(column.features) > 1 else None
                        arrays[feature.name] = joined[:, start:stop].reshape(-1, *feature.shape)
                        start = stop or 0
            ends = np.arange(header.length) == header.length - 1
            rewards = ends.astype(np.float32)
            if "steps/reward" in values:
                rewards = np.asarray(decode_values(values["steps/reward"]), np.float32)
        shown = {path: column.features[0] for path, column in self._places.items() if column.features[0].is_image}
        images = _StoredImages(place.path, values, header.length, shown)
        return Episode(header, arrays, {}, images, rewards, ends, np.zeros((header.length, 0)))

    def _numbers_of(self, values: Mapping[str, memoryview], key: str, length: int) -> NDArray[Any]:
        """Return the numbers of a column, with the type and shape in ``features.json``."""
        shape, dtype = _shape(self._columns[key]["tensor"]), str(self._columns[key]["tensor"]["dtype"])
        encoding, found = self._columns[key]["tensor"].get("encoding", "none"), decode_values(values[key])
        return _tensors(found, encoding, (length, *(shape or (1,))), dtype)


def _tensors(found: Values, encoding: str, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """Return the numbers of a column of tensors, in the shape with the number of steps first."""
    if isinstance(found, list):
        raw = [_unzip(one, shape[1:], dtype) if encoding == "zlib" else one for one in found]
        return np.frombuffer(b"".join(raw), dtype).reshape(shape)
    return found.astype(dtype, copy=False).reshape(shape)


def _unzip(data: bytes, shape: tuple[int, ...], dtype: str) -> bytes:
    """Decompress a tensor, which may not be larger than its shape allows."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return zlib.decompressobj().decompress(data, size)


def _flatten(about: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the path and the description of each feature that has values."""
    if "featuresDict" in about:
        for name, one in about["featuresDict"]["features"].items():
            yield from _flatten(one, f"{path}/{name}" if path else str(name))
    elif "sequence" in about:
        yield from _flatten(about["sequence"]["feature"], path)
    else:
        yield path, about


def _shape(about: Mapping[str, Any]) -> tuple[int, ...]:
    found = tuple(int(one) for one in about.get("shape", {}).get("dimensions", ()))
    if any(size < 1 for size in found):
        raise ValueError(f"it has values of the shape {found}, in which a size is unknown")
    return found


def _features(columns: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, DatasetFeature]]:
    """Yield the observations and the actions by path."""
    for path, about in columns.items():
        is_action = path == _ACTION
        if not is_action and not path.startswith(_OBSERVATION):
            continue
        name = "action" if is_action else path.removeprefix(_OBSERVATION)
        role = FeatureRole.ACTION if is_action else FeatureRole.OBSERVATION
        if "image" in about:
            shape, axes = _shape(about["image"]), ("height", "width", "channels")
            yield path, DatasetFeature(name, role, FeatureKind.IMAGE, "uint8", shape, axes, image=ImageKind.COLOR)
        elif "tensor" in about and re.fullmatch(r"(float|u?int)(8|16|32|64)|bool", str(about["tensor"]["dtype"])):
            shape = _shape(about["tensor"]) or (1,)
            names = tuple(f"{name}_{k}" for k in range(shape[0])) if len(shape) == 1 else ()
            yield path, DatasetFeature(name, role, FeatureKind.ARRAY, str(about["tensor"]["dtype"]), shape, names)


class _StoredImages:
    """The images of an episode, decoded when they are read."""

    def __init__(
        self, path: Path, values: Mapping[str, memoryview], length: int, features: Mapping[str, DatasetFeature]
    ) -> None:
        self._path, self._values, self._length, self._features = path, values, length, features

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame. The images after the last action are unknown, so the last ones repeat."""
        with _reading(self._path):
            encoded = {path: self._encoded(path) for path in self._features}
        last: Images = {}
        for t in range(self._length):
            with _reading(self._path):
                last = {f.name: _decoded(encoded[path][t], f) for path, f in self._features.items()}
            yield last
        if final:
            yield last

    def _encoded(self, path: str) -> list[bytes]:
        found = decode_values(self._values[path])
        if not isinstance(found, list) or len(found) != self._length:
            raise ValueError(f"`{path}` does not have one image for each step")
        return found


def _decoded(data: bytes, feature: DatasetFeature) -> NDArray[Any]:
    if feature.image is ImageKind.COLOR:
        return decode_image(data, feature.shape)
    values = np.frombuffer(_unzip(data, feature.shape, feature.dtype), feature.dtype)
    return values.reshape(feature.shape)
