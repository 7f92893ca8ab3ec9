"""Robomimic datasets that are read from files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.data.dataset.episode import Episode, EpisodeHeader, GenerationData, Images
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureKind, FeatureRole
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.checks import matching_manifest
from simfoundry.errors import OutputError
from simfoundry.runtime.extras import need_extra
from simfoundry.spec.models.signals import ImageKind

if TYPE_CHECKING:
    import h5py

# The name of the file in a dataset that SimFoundry writes. A folder with one other HDF5 file is read as well.
DATASET = "dataset.hdf5"

# The usual names of splits, among other filter keys such as `20_percent`.
_SPLITS = ("train", "valid", "validation", "test", "held_out")

# Largest array of an episode to read [bytes]; the images of an episode are read one by one.
MAX_BYTES = 2**30

_SIGNATURE = b"\x89HDF\r\n\x1a\n"

# The number of frames per second of datasets that do not state it: the rate of robosuite, for which robomimic was made.
_DEFAULT_HZ = 20.0


def dataset_file(folder: Path) -> Path | None:
    """Return the HDF5 file in a folder, or None if there is none, or more than one."""
    if (folder / DATASET).is_file():
        return folder / DATASET
    files = sorted(folder.glob("*.hdf5"))
    return files[0] if len(files) == 1 else None


def is_robomimic(folder: Path) -> bool:
    """Return True if a folder contains an HDF5 file with demonstrations."""
    path = dataset_file(folder)
    if path is None or path.open("rb").read(len(_SIGNATURE)) != _SIGNATURE:
        return False
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "data" in file and "env_args" in file["data"].attrs
    except OSError:
        return False


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a file, and convert the errors of invalid ones to one that names it."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except FileNotFoundError:
        raise OutputError(f"{path} is missing") from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError) as error:
        raise OutputError(f"{path} is not a valid robomimic dataset: {str(error).strip(chr(34))}") from None


class RobomimicDataset:
    """A dataset of robomimic or MimicGen."""

    def __init__(self, folder: Path) -> None:
        need_extra("data", "robomimic datasets")
        path = dataset_file(folder)
        if path is None:
            raise OutputError(f"{folder} does not contain exactly one HDF5 file")
        self._path = path
        with _opened(path) as file:
            data = file["data"]
            self._demos = sorted((name for name in data if name.startswith("demo_")), key=lambda name: int(name[5:]))
            if not self._demos:
                raise ValueError("it contains no demonstrations")
            self._lengths = [len(data[name]["actions"]) for name in self._demos]
            self._first = np.cumsum([0, *self._lengths])
            self._texts = [str(data[name].attrs.get("instruction", "")) for name in self._demos]
            self._split_of = self._splits(file)
            own = self._describe(folder, data)
        self._manifest = matching_manifest(folder, self._lengths)
        self.info = own if self._manifest is None else self._manifest.info

    def _splits(self, file: h5py.File) -> dict[str, str]:
        """Return the split of each demonstration. If it has several filter keys, those with usual names come first."""
        found: dict[str, str] = {}
        masks = file.get("mask", {})
        for name in sorted(masks, key=lambda name: name not in _SPLITS):
            for demo in _load(masks[name]):
                found.setdefault(demo.decode(), name)
        return found

    def _describe(self, folder: Path, data: h5py.Group) -> DatasetInfo:
        environment = json.loads(data.attrs["env_args"])
        kwargs = environment.get("env_kwargs") or {}
        first = data[self._demos[0]]
        features = [_feature(name, FeatureRole.OBSERVATION, first["obs"][name]) for name in first["obs"]]
        features.append(_feature("actions", FeatureRole.ACTION, first["actions"]))
        splits = [self._split_of.get(name, "train") for name in self._demos]
        bounds: dict[str, tuple[int, int]] = {}
        for k, name in enumerate(splits):
            bounds[name] = bounds.get(name, (k, k))[0], k + 1
        is_divided = sum(end - start for start, end in bounds.values()) == len(splits)
        return DatasetInfo(
            name=folder.name,
            fps=float(kwargs.get("control_freq") or _DEFAULT_HZ),
            robot_type=str(kwargs.get("robots") or ""),
            features=tuple(features),
            action_space=str(kwargs.get("action_space") or ""),
            instructions=tuple(dict.fromkeys(self._texts)),
            splits=bounds if is_divided else {"train": (0, len(splits))},
            episodes=len(self._demos),
            frames=sum(self._lengths),
        )

    @property
    def statistics(self) -> Mapping[str, FeatureStatistics]:
        """The statistics, which robomimic does not store."""
        return {}

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._demos)

    def header(self, k: int) -> EpisodeHeader:
        """Return the description of the k-th episode, counted from 0."""
        if self._manifest is not None:
            return self._manifest.headers[k]
        text, split = self._texts[k], self._split_of.get(self._demos[k], "train")
        number = self._numbers.get(text, 0)
        return EpisodeHeader(k, int(self._first[k]), self._lengths[k], text, number, split)

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {text: number for number, text in enumerate(self.info.instructions)}

    def episode(self, k: int) -> Episode:
        """Return the k-th episode, counted from 0.

        Raises:
            OutputError: If the file is invalid.
        """
        header, name = self.header(k), self._demos[k]
        with _opened(self._path) as file:
            group, arrays, final, column = file["data"][name], {}, {}, 0
            actions = _load(group["actions"])
            for feature in self.info.arrays:
                if feature.role is FeatureRole.ACTION:
                    size = int(np.prod(feature.shape))
                    arrays[feature.name] = actions[:, column : column + size].reshape(-1, *feature.shape)
                    column += size
                else:
                    arrays[feature.name] = _load(group["obs"][feature.name])
                    if "next_obs" in group:
                        final[feature.name] = group["next_obs"][feature.name][-1]
                if arrays[feature.name].shape != (header.length, *feature.shape):
                    raise ValueError(f"`{feature.name}` of {name} has the shape {arrays[feature.name].shape}")
            ones = np.arange(header.length) == header.length - 1
            rewards = _load(group["rewards"]) if "rewards" in group else ones
            dones = _load(group["dones"]) if "dones" in group else ones
            states = _load(group["states"]) if "states" in group else np.zeros((header.length, 0))
            generation = _generation(group["datagen_info"], self.info) if "datagen_info" in group else None
        images = _StoredImages(self._path, name, header.length, self.info.images)
        return Episode(
            header, arrays, final, images, rewards.astype(np.float32), dones.astype(bool), states, generation
        )


def _feature(name: str, role: FeatureRole, values: h5py.Dataset) -> DatasetFeature:
    """Return a feature of a dataset of others: arrays of the shape (time, height, width, 3) in uint8 are images."""
    shape, dtype = tuple(map(int, values.shape[1:])) or (1,), values.dtype.name
    if len(shape) == 3 and shape[2] in (1, 3) and dtype in ("uint8", "float32"):
        image = ImageKind.COLOR if shape[2] == 3 else ImageKind.DEPTH
        axes = ("height", "width", "channels")
        return DatasetFeature(name, role, FeatureKind.IMAGE, dtype, shape, axes, image=image)
    names = tuple(f"{name}_{k}" for k in range(shape[0])) if len(shape) == 1 else ()
    return DatasetFeature(name, role, FeatureKind.ARRAY, dtype, shape, names)


def _load(values: h5py.Dataset) -> Any:
    """Read an array. Its size is compared first, because a small file can contain a huge one."""
    if values.nbytes > MAX_BYTES:
        raise ValueError(f"{values.name} is larger than {MAX_BYTES // 2**20} MiB")
    return values[:]


def _generation(group: h5py.Group, info: DatasetInfo) -> GenerationData:
    robots = list(info.environment.get("robots", {})) or ["robot"]

    def hands(name: str) -> dict[str, Any]:
        import h5py

        if isinstance(group[name], h5py.Dataset):
            return {robots[0]: _load(group[name])}
        return {robot: _load(group[name][robot]) for robot in group[name]}

    def named(name: str) -> dict[str, Any]:
        return {key: _load(group[name][key]) for key in group[name]} if name in group else {}

    signals = {key: values.astype(np.int64) for key, values in named("subtask_term_signals").items()}
    return GenerationData(
        hands("eef_pose"), hands("target_pose"), hands("gripper_action"), named("object_poses"), signals
    )


class _StoredImages:
    """The images of an episode, read when they are needed."""

    def __init__(self, path: Path, demo: str, length: int, features: tuple[DatasetFeature, ...]) -> None:
        self._path, self._demo, self._length, self._features = path, demo, length, features

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame. Without ``next_obs``, the last ones stand for those after the last action."""
        if not self._features:
            yield from ({} for _ in range(self._length + final))
            return
        with _opened(self._path) as file:
            group = file["data"][self._demo]
            names = [feature.name for feature in self._features]
            for t in range(self._length):
                yield {name: group["obs"][name][t] for name in names}
            if final:
                after = group["next_obs"] if "next_obs" in group else group["obs"]
                yield {name: after[name][-1] for name in names}
