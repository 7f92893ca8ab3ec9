"""The features of a LeRobot dataset: their description in ``info.json``, and their columns in Parquet.

The columns are those that LeRobot itself writes: a single number for the shape (1,), a list of fixed size for vectors,
nested lists for arrays such as depth images, and PNG data for color images. Videos have no column.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureKind
from simfoundry.data.formats.video import exact_rate
from simfoundry.spec.models.signals import ImageKind

if TYPE_CHECKING:
    import pyarrow as pa

# The columns that LeRobot adds to each dataset, followed by those in which datasets with rewards keep them.
DEFAULT_COLUMNS: Mapping[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
RESULT_COLUMNS: Mapping[str, str] = {"next.reward": "float32", "next.done": "bool"}


def is_video(feature: DatasetFeature) -> bool:
    """Return True if the images of a feature are encoded as a video, which only color images can be."""
    return feature.kind is FeatureKind.VIDEO and is_color(feature)


def is_color(feature: DatasetFeature) -> bool:
    """Return True for color images. Depth images and masks are arrays in LeRobot, because a video would change them."""
    return feature.is_image and feature.image is ImageKind.COLOR


def column_shape(feature: DatasetFeature) -> tuple[int, ...]:
    """Return the shape of one value in its column: depth images and masks have the shape (height, width)."""
    return feature.shape[:2] if feature.is_image and not is_color(feature) else feature.shape


def describe_features(info: DatasetInfo) -> dict[str, dict[str, Any]]:
    """Return the key ``features`` of ``info.json``."""
    found = {feature.name: _describe(feature, info.fps) for feature in info.features}
    for name, dtype in {**RESULT_COLUMNS, **DEFAULT_COLUMNS}.items():
        found[name] = {"dtype": dtype, "shape": [1], "names": None}
    return found


def _describe(feature: DatasetFeature, fps: float) -> dict[str, Any]:
    shape = list(column_shape(feature))
    if not is_color(feature):
        names = feature.names[: len(shape)] if feature.is_image else feature.names
        return {"dtype": feature.dtype, "shape": shape, "names": list(names)}
    kind = "video" if is_video(feature) else "image"
    about: dict[str, Any] = {"dtype": kind, "shape": shape, "names": list(feature.names)}
    if is_video(feature):
        about["info"] = {
            "video.height": shape[0],
            "video.width": shape[1],
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": plain_rate(fps),
            "video.channels": shape[2],
            "has_audio": False,
        }
    return about


def plain_rate(hz: float) -> int | float:
    """Return a rate in Hz, as an integer if it is one, because LeRobot 0.3 expects integers."""
    rate = exact_rate(hz)
    return rate.numerator if rate.denominator == 1 else float(rate)


def schema(info: DatasetInfo) -> pa.Schema:
    """Return the columns of the files in ``data/``.

    The metadata of Hugging Face tell readers which columns are images. They use the name ``Sequence`` for vectors,
    because versions of ``datasets`` before 4, such as that of openpi, do not know ``List``; later ones read both.
    """
    import pyarrow as pa

    fields, hints = [], {}
    for feature in info.features:
        if not is_video(feature):
            kind, hints[feature.name] = _column(feature)
            fields.append(pa.field(feature.name, kind))
    for name, dtype in {**RESULT_COLUMNS, **DEFAULT_COLUMNS}.items():
        fields.append(pa.field(name, _number(dtype)))
        hints[name] = {"dtype": dtype, "_type": "Value"}
    return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": hints}})})


def _column(feature: DatasetFeature) -> tuple[pa.DataType, dict[str, Any]]:
    """Return the type of a column, and its description by Hugging Face."""
    import pyarrow as pa

    if is_color(feature):
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())]), {"_type": "Image"}
    shape, value = column_shape(feature), {"dtype": feature.dtype, "_type": "Value"}
    number = _number(feature.dtype)
    if shape == (1,):
        return number, value
    if len(shape) == 1:
        return pa.list_(number, shape[0]), {"feature": value, "length": shape[0], "_type": "Sequence"}
    for _ in shape:
        number = pa.list_(number)
    return number, {"shape": list(shape), "dtype": feature.dtype, "_type": f"Array{len(shape)}D"}


def _number(dtype: str) -> pa.DataType:
    import pyarrow as pa

    return pa.from_numpy_dtype(np.dtype(dtype))


def array_column(values: NDArray[Any], kind: pa.DataType) -> pa.Array:
    """Return an array, whose first axis is time, as a column of the type ``kind``."""
    import pyarrow as pa

    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    if values.ndim == 1 or values.shape[1:] == (1,):
        return flat
    if values.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(flat, type=kind)
    for axis in range(values.ndim - 1, 0, -1):
        count = int(np.prod(values.shape[:axis]))
        offsets = np.arange(count + 1, dtype=np.int32) * values.shape[axis]
        flat = pa.ListArray.from_arrays(pa.array(offsets), flat)
    return flat


def image_column(images: Sequence[bytes], kind: pa.DataType) -> pa.Array:
    """Return encoded images as a column of the type ``kind``."""
    import pyarrow as pa

    return pa.array([{"bytes": data, "path": None} for data in images], kind)


def column_values(column: pa.ChunkedArray, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return a column as an array whose first axis is time.

    Raises:
        ValueError: If a value is missing, or has another shape.
    """
    import pyarrow as pa

    flat = column.combine_chunks()
    length = len(flat)
    while pa.types.is_nested(flat.type):
        if flat.null_count:
            raise ValueError("a value is missing")
        flat = flat.flatten()
    if flat.null_count or len(flat) != length * int(np.prod(shape)):
        raise ValueError(f"its values do not all have the shape {tuple(shape)}")
    return np.asarray(flat.to_numpy(zero_copy_only=False)).reshape(length, *shape)
