"""The features of an RLDS dataset, and ``features.json``, in which TensorFlow Datasets looks them up."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureRole
from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.signals import ImageKind

_FEATURES = "tensorflow_datasets.core.features"

# The keys of a step that are texts. DROID has three phrasings of each instruction, and openpi draws one of them.
INSTRUCTIONS = ("language_instruction", "language_instruction_2", "language_instruction_3")

# The other keys of a step, which RLDS defines, with the type of each.
STEP_SCALARS: Mapping[str, str] = {
    "reward": "float32",
    "discount": "float32",
    "is_first": "bool",
    "is_last": "bool",
    "is_terminal": "bool",
}


# The values of an episode as a whole, with the type of each; the texts have an empty type.
EPISODE_VALUES: Mapping[str, str] = {
    "file_path": "",
    "recording_folderpath": "",
    "episode_index": "int64",
    "success": "bool",
}


@dataclass(frozen=True)
class RldsColumn:
    """A value of each step: features side by side, or the part of them from ``start`` to ``stop``."""

    features: tuple[DatasetFeature, ...]
    start: int = 0
    stop: int | None = None

    @property
    def is_whole(self) -> bool:
        """True if the column contains all values of its features."""
        return self.start == 0 and self.stop is None

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one value."""
        if len(self.features) == 1 and self.is_whole:
            return self.features[0].shape
        size = sum(feature.shape[0] for feature in self.features)
        return ((size if self.stop is None else self.stop) - self.start,)


def dataset_name(info: DatasetInfo) -> str:
    """Return the name of a dataset in the form that TensorFlow Datasets accepts: lower case, digits, underscores."""
    name = re.sub(r"[^a-z0-9]+", "_", info.name.lower()).strip("_")
    return name if name[:1].isalpha() else f"dataset_{name}".rstrip("_")


def step_columns(info: DatasetInfo) -> dict[str, RldsColumn]:
    """Return the values of each step by path.

    A feature with a slash in its name, such as ``action_dict/joint_position``, has this path. Other observations are in
    ``observation``, where ``observation.images.front`` is called ``front``, as in other RLDS datasets. Other actions
    are side by side in ``action``, and their quantities in ``action_dict``, unless features have these paths.

    Raises:
        SimfoundryError: If two features have the same path, or the path of something else.
    """
    found: dict[str, RldsColumn] = {}
    flat = tuple(f for f in info.arrays if f.role is FeatureRole.ACTION and "/" not in f.name)
    for feature in info.features:
        if feature not in flat:
            _add(found, _path(feature), RldsColumn((feature,)))
    if flat:
        _add(found, "action", RldsColumn(flat))
    if flat and not any(path.startswith("action_dict/") for path in found):
        start = 0
        for feature in flat:
            for part in feature.parts:
                name = part.name if f"action_dict/{part.name}" not in found else f"{_key(feature.name)}_{part.name}"
                _add(found, f"action_dict/{name}", RldsColumn(flat, start + part.start, start + part.stop))
            start += feature.shape[0]
    return found


def _path(feature: DatasetFeature) -> str:
    return feature.name if "/" in feature.name else f"observation/{_key(feature.name)}"


def _key(name: str) -> str:
    return name.removeprefix("observation.").removeprefix("images.").replace(".", "_")


def _add(found: dict[str, RldsColumn], path: str, column: RldsColumn) -> None:
    name = column.features[0].name
    if path in found:
        other = found[path].features[0].name
        raise SimfoundryError(f"`{other}` and `{name}` would both be called `{path}` in RLDS; rename one of them")
    taken = next((p for p in (*found, *STEP_SCALARS, *INSTRUCTIONS) if _overlap(p, path)), None)
    if taken is not None or not re.fullmatch(r"[\w.]+(/[\w.]+)*", path):
        reason = "is not a valid path" if taken is None else f"overlaps with `{taken}`"
        raise SimfoundryError(f"`{path}`, the path of `{name}` in RLDS, {reason}; rename the feature")
    found[path] = column


def _overlap(one: str, other: str) -> bool:
    """Return True if two paths are equal, or if one of them is a group that contains the other."""
    return one == other or one.startswith(f"{other}/") or other.startswith(f"{one}/")


def features_json(info: DatasetInfo) -> dict[str, Any]:
    """Return the content of ``features.json``."""
    steps: dict[str, Any] = {}
    for path, column in step_columns(info).items():
        group = steps
        *groups, name = path.split("/")
        for one in groups:
            group = group.setdefault(one, _mapping({}))["featuresDict"]["features"]
        group[name] = _column(column)
    steps |= {key: _tensor((), dtype) for key, dtype in STEP_SCALARS.items()}
    steps |= {key: _text() for key in INSTRUCTIONS}
    sequence = {"feature": _mapping(steps), "length": "-1"}
    episode = {key: _tensor((), dtype) if dtype else _text() for key, dtype in EPISODE_VALUES.items()}
    return _mapping(
        {
            "steps": {"pythonClassName": f"{_FEATURES}.dataset_feature.Dataset", "sequence": sequence},
            "episode_metadata": _mapping(episode),
        }
    )


def _column(column: RldsColumn) -> dict[str, Any]:
    feature = column.features[0]
    if feature.image is ImageKind.COLOR:
        image = {"shape": _shape(column.shape), "dtype": feature.dtype, "encodingFormat": "png"}
        return {"pythonClassName": f"{_FEATURES}.image_feature.Image", "image": image}
    return _tensor(column.shape, feature.dtype, "zlib" if feature.is_image else "none")


def _mapping(features: Mapping[str, Any]) -> dict[str, Any]:
    return {"pythonClassName": f"{_FEATURES}.features_dict.FeaturesDict", "featuresDict": {"features": dict(features)}}


def _tensor(shape: tuple[int, ...], dtype: str, encoding: str = "none") -> dict[str, Any]:
    kind = "tensor_feature.Tensor" if shape else "scalar.Scalar"
    tensor = {"shape": _shape(shape), "dtype": dtype, "encoding": encoding}
    return {"pythonClassName": f"{_FEATURES}.{kind}", "tensor": tensor}


def _text() -> dict[str, Any]:
    return {"pythonClassName": f"{_FEATURES}.text_feature.Text", "text": {}}


def _shape(shape: Iterable[int]) -> dict[str, Any]:
    dimensions = [str(size) for size in shape]
    return {"dimensions": dimensions} if dimensions else {}
