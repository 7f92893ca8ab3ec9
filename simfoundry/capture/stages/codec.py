"""Results of stages as plain files: JSON for structure, PNG for images and NumPy files for arrays."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.cad.explain import CadSegmentation
from simfoundry.capture.cad.match import ModelMatch
from simfoundry.capture.candidates import JointedObject, ShapeChoice
from simfoundry.capture.findings import CaptureFinding
from simfoundry.capture.frame import Frame, Segmentation, SupportLevel, SupportRival, SupportSurface
from simfoundry.capture.removal import ClearedImage
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.fit_handle import FittedHandle
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Mesh, Sphere
from simfoundry.scene.state import SceneState
from simfoundry.worlds.settle import ObjectSettle, SettleResult

# The file with the structure of a result; all other files are named in it.
VALUE = "value.json"

# Data types that results consist of. Others cannot be written, so that reading a result never imports anything.
TYPES: dict[str, type[Any]] = {
    each.__name__: each
    for each in (
        *(Box, Capsule, Cone, Cylinder, Ellipsoid, Mesh, Sphere, Pose),
        *(Frame, SupportSurface, SupportRival, SupportLevel, Segmentation, ClearedImage, FittedShape, CaptureFinding),
        *(SettleResult, ObjectSettle, SceneState, ShapeChoice, JointedObject),
        *(CadSegmentation, ModelMatch, FittedHandle),
    )
}

# Largest array that is written into the JSON file, where people can read it: a pose, a size, a matrix.
INLINE_MAX = 64


def encode(value: Any) -> dict[str, bytes]:
    """Return the files that represent a result. Equal results have equal files.

    Raises:
        TypeError: The result contains a type that is not in :data:`TYPES`.
    """
    writer = _Writer()
    tree = writer.tree(value, "")
    return {**writer.files, VALUE: (json.dumps(tree, indent=1) + "\n").encode()}


def decode(files: Mapping[str, bytes]) -> Any:
    """Return the result that files represent.

    Raises:
        ValueError, KeyError, TypeError: The files are damaged, or were written by another version.
    """
    return _value(json.loads(files[VALUE]), files)


def digest_of(value: Any) -> str:
    """Return a SHA-256 digest of a value that stages exchange.

    Raises:
        TypeError: The value contains a type that is not in :data:`TYPES`.
    """
    h = hashlib.sha256()
    _feed(h, value)
    return h.hexdigest()


def _feed(h: hashlib._Hash, value: Any) -> None:
    """Add a value to a digest, each part with its type and its length, so that different values have different bytes.

    Arrays are added as they are: compressing them as in :func:`encode` takes a hundred times as long.
    """
    match value:
        case None | bool() | int() | float() | str():
            text = json.dumps(value).encode()
            h.update(b"t%d\0" % len(text) + text)
        case np.generic():
            _feed(h, value.item())
        case bytes():
            h.update(b"b%d\0" % len(value))
            h.update(value)
        case np.ndarray():
            h.update(f"a{value.dtype.str}{value.shape}\0".encode())
            h.update(np.ascontiguousarray(value).data)
        case tuple() | list():
            h.update(b"l%d\0" % len(value))
            for item in value:
                _feed(h, item)
        case Mapping():
            h.update(b"m%d\0" % len(value))
            for item in value.items():
                _feed(h, item)
        case _:
            name = type(value).__name__
            if TYPES.get(name) is not type(value):
                raise TypeError(f"{name} is not a result of a stage")
            h.update(f"d{name}\0".encode())
            for each in fields(value):
                _feed(h, getattr(value, each.name))


@dataclass
class _Writer:
    """The files of a result that is being encoded."""

    files: dict[str, bytes] = field(default_factory=dict)

    def tree(self, value: Any, path: str) -> Any:
        match value:
            case None | bool() | int() | float() | str():
                return value
            case np.generic():
                return value.item()
            case bytes():
                return {"bytes": self.file(path, ".png" if value.startswith(b"\x89PNG") else ".bin", value)}
            case np.ndarray():
                return self.array(value, path)
            case tuple() | list():
                return [self.tree(item, f"{path}_{k}") for k, item in enumerate(value)]
            case Mapping():
                return {"map": [[self.tree(k, path), self.tree(item, f"{path}_{k}")] for k, item in value.items()]}
        name = type(value).__name__
        if not is_dataclass(value) or TYPES.get(name) is not type(value):
            raise TypeError(f"{name} is not a result of a stage")
        stem = f"{path}_" if path else ""
        return {"type": name} | {f.name: self.tree(getattr(value, f.name), stem + f.name) for f in fields(value)}

    def array(self, value: NDArray[Any], path: str) -> Any:
        kind = value.dtype.str
        if value.size <= INLINE_MAX and value.dtype.kind in "iufb":
            return {"array": value.tolist(), "dtype": kind, "shape": list(value.shape)}
        image = _as_image(value)
        if image is not None:
            return {"image": self.file(path, ".png", image), "dtype": kind}
        stream = io.BytesIO()
        np.save(stream, value, allow_pickle=False)
        return {"numpy": self.file(path, ".npy", stream.getvalue())}

    def file(self, path: str, suffix: str, data: bytes) -> str:
        name = f"{path or 'value'}{suffix}"
        self.files[name] = data
        return name


def _as_image(value: NDArray[Any]) -> bytes | None:
    """Return an array as a PNG image that people can look at, or None if an image cannot represent it exactly."""
    from PIL import Image

    if value.ndim == 3 and value.shape[2] == 3 and value.dtype == np.uint8:
        pixels = value
    elif value.ndim == 2 and value.dtype == np.bool_:
        pixels = value.astype(np.uint8) * 255
    elif value.ndim == 2 and value.dtype == np.int32 and 0 not in value.shape:
        if value.shape[1] < 8 or value.min() < 0 or value.max() > np.iinfo(np.uint16).max:
            return None
        pixels = value.astype(np.uint16)
    else:
        return None
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG", compress_level=1)  # fast: these files are written in each run
    return stream.getvalue()


def _value(tree: Any, files: Mapping[str, bytes]) -> Any:
    if isinstance(tree, list):
        return tuple(_value(item, files) for item in tree)
    if not isinstance(tree, dict):
        return tree
    if "type" in tree:
        made: type[Any] = TYPES[tree["type"]]
        return made(**{name: _value(item, files) for name, item in tree.items() if name != "type"})
    if "map" in tree:
        return {_value(key, files): _value(item, files) for key, item in tree["map"]}
    if "bytes" in tree:
        return files[tree["bytes"]]
    if "array" in tree:
        small = np.array(tree["array"], dtype=np.dtype(tree["dtype"])).reshape(tree["shape"])
        small.setflags(write=False)
        return small
    if "numpy" in tree:
        return np.load(io.BytesIO(files[tree["numpy"]]), allow_pickle=False)
    from PIL import Image

    with Image.open(io.BytesIO(files[tree["image"]])) as image:
        pixels = np.array(image)
    return pixels > 0 if tree["dtype"] == "|b1" else pixels.astype(np.dtype(tree["dtype"]))
