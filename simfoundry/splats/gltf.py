"""Gaussian splats as glTF files with the extension ``KHR_gaussian_splatting``, in one file (GLB).

The extension has linear scales, opacities in [0, 1], quaternions in xyzw order, and one accessor for each coefficient
of the spherical harmonics. The axes of glTF have y up; the splat keeps its own below a node that turns it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.geometry.frames import Array, from_xyzw, rotations, to_xyzw
from simfoundry.geometry.similarity import Similarity
from simfoundry.splats.gaussians import (
    EXPORT,
    MAX_DEGREE,
    GaussianSplat,
    Numbers,
    check_count,
    gaussian_splat,
    joined_splats,
)
from simfoundry.splats.y_up import X_ZY

EXTENSION = "KHR_gaussian_splatting"
# Only these values of the extension's keys are understood; see section "Extending the Base Extension".
_KERNEL, _COLORS = "ellipse", "srgb_rec709_display"

_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # types of chunks
# Maximum size of the JSON in a file [bytes]; it describes two dozen arrays.
_MAX_JSON = 16 * 2**20
# Maximum depth of nodes, which is deeper than any exporter writes and protects against cycles.
_MAX_DEPTH = 64

_POINTS, _FLOAT, _ARRAY_BUFFER = 0, 5126, 34962
# Component types, and the largest value of those that are normalized.
_COMPONENTS = {5120: ("i1", 127.0), 5121: ("u1", 255.0), 5122: ("<i2", 32767.0), 5123: ("<u2", 65535.0)}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

Floats = NDArray[np.float64]


class _BadFileError(Exception):
    """A file that is not a splat; the message completes "FILE could not be read as a splat: "."""


def read_gltf(path: Path) -> GaussianSplat:
    """Read the Gaussians in a GLB file, in meters and with z up.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    try:
        tree, binary = _chunks(path.read_bytes())
        placed = list(_placed(tree))
        check_count(path.name, sum(_count(tree, attributes) for attributes, _ in placed))
        parts = [_primitive(path.name, tree, binary, attributes).moved(S_WF) for attributes, S_WF in placed]
    except OSError as error:
        raise _unreadable(path.name, error.strerror or str(error)) from None
    except _BadFileError as error:
        raise _unreadable(path.name, str(error)) from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError):
        raise _unreadable(path.name, "its JSON does not describe a glTF 2.0 file") from None
    return joined_splats(path.name, parts)


def gltf_bytes(splat: GaussianSplat) -> bytes:
    """Return a splat as a GLB file, without loss. Equal splats give equal bytes."""
    arrays: dict[str, Numbers] = {
        "POSITION": splat.positions,
        f"{EXTENSION}:ROTATION": to_xyzw(splat.rotations.astype(np.float64)),
        f"{EXTENSION}:SCALE": splat.scales,
        f"{EXTENSION}:OPACITY": splat.opacities[:, None],
        **{_coefficient(k): splat.harmonics[:, k] for k in range(splat.harmonics.shape[1])},
    }
    types = {width: name for name, width in _WIDTHS.items()}
    blobs = [np.ascontiguousarray(values, dtype="<f4").tobytes() for values in arrays.values()]
    starts = np.cumsum([0, *map(len, blobs)]).tolist()
    accessors: list[dict[str, Any]] = [
        {"bufferView": k, "componentType": _FLOAT, "count": len(splat), "type": types[values.shape[1]]}
        for k, values in enumerate(arrays.values())
    ]
    accessors[0] |= {"min": splat.positions.min(axis=0).tolist(), "max": splat.positions.max(axis=0).tolist()}
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(blob), "target": _ARRAY_BUFFER}
        for start, blob in zip(starts, blobs, strict=False)
    ]
    extension = {"kernel": _KERNEL, "colorSpace": _COLORS}
    primitive = {
        "mode": _POINTS, "attributes": {name: k for k, name in enumerate(arrays)}, "extensions": {EXTENSION: extension},
    }  # fmt: skip
    tree = {
        "asset": {"version": "2.0", "generator": "SimFoundry"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "splat", "mesh": 0, "rotation": to_xyzw(X_ZY.inverse().q).tolist()}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = b"".join(
        struct.pack("<II", len(data), kind) + data for kind, data in ((_JSON, text), (_BINARY, b"".join(blobs)))
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _coefficient(k: int) -> str:
    degree = int(k**0.5)
    return f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k - degree * degree}"


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary chunk of a GLB file."""
    if len(data) < 20 or data[:4] != b"glTF" or struct.unpack_from("<I", data, 4)[0] != 2:
        raise _BadFileError("it is not a GLB file of glTF 2.0")
    length, kind = struct.unpack_from("<II", data, 12)
    if kind != _JSON or length > min(_MAX_JSON, len(data) - 20):
        raise _BadFileError("its first chunk is not JSON, or is too long")
    tree = json.loads(data[20 : 20 + length])
    if EXTENSION not in tree.get("extensionsUsed", []):
        raise _BadFileError(f"it does not use the extension {EXTENSION}")
    start = 20 + length
    if len(data) < start + 8:
        raise _BadFileError("it has no binary chunk")
    length, kind = struct.unpack_from("<II", data, start)
    if kind != _BINARY or length > len(data) - start - 8:
        raise _BadFileError("its binary chunk is damaged")
    return tree, data[start + 8 : start + 8 + length]


def _placed(tree: dict[str, Any]) -> Iterator[tuple[dict[str, int], Similarity]]:
    """Yield the attributes of each splat in the scene, with the map from its frame to the world with z up."""
    found = 0
    stack = [(k, X_ZY.matrix, 0) for k in tree["scenes"][tree.get("scene", 0)]["nodes"]]
    while stack:
        k, X_WP, depth = stack.pop()
        node = tree["nodes"][k]
        X_WN = X_WP @ _local(node)
        if depth >= _MAX_DEPTH or found > len(tree["nodes"]) * _MAX_DEPTH:
            raise _BadFileError("its nodes are nested too deeply, or contain themselves")
        found += 1
        stack += [(child, X_WN, depth + 1) for child in node.get("children", [])]
        for primitive in tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            extension = primitive.get("extensions", {}).get(EXTENSION)
            if extension is not None:
                _check_extension(extension, primitive)
                yield primitive["attributes"], _similarity(X_WN)


def _check_extension(extension: dict[str, Any], primitive: dict[str, Any]) -> None:
    if extension.get("extensions"):
        raise _BadFileError(f"its splat is compressed or extended by {next(iter(extension['extensions']))}")
    if extension.get("kernel") != _KERNEL:
        raise _BadFileError(f"its kernel is not `{_KERNEL}`")
    if extension.get("colorSpace") != _COLORS:
        raise _BadFileError(f"its color space is not `{_COLORS}`")
    if primitive.get("mode") != _POINTS:
        raise _BadFileError("its splat is not a primitive of points")


def _local(node: dict[str, Any]) -> Array:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    out = np.eye(4)
    turn = rotations(from_xyzw(node.get("rotation", (0.0, 0.0, 0.0, 1.0)))[None])[0]
    out[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return out


def _similarity(matrix: Array) -> Similarity:
    try:
        return Similarity.from_matrix(matrix)
    except ValueError as error:
        raise _BadFileError(f"a node of its splat is {error}") from None


def _count(tree: dict[str, Any], attributes: dict[str, int]) -> int:
    count = tree["accessors"][attributes["POSITION"]]["count"]
    if not isinstance(count, int) or isinstance(count, bool) or count < 0:
        raise _BadFileError("it has a count that is not a number")
    return count


def _primitive(name: str, tree: dict[str, Any], binary: bytes, attributes: dict[str, int]) -> GaussianSplat:
    """Return the splat of a primitive along the axes of its node."""
    count = _count(tree, attributes)
    degrees = [d for d in range(MAX_DEGREE + 1) if _coefficient(d * d) in attributes]
    if not degrees or _coefficient((MAX_DEGREE + 1) ** 2) in attributes:
        raise _BadFileError(f"its spherical harmonics do not have a degree between 0 and {MAX_DEGREE}")

    def column(attribute: str, kind: str) -> Floats:
        if attribute not in attributes:
            raise _BadFileError(f"the attribute {attribute} is missing")
        values = _accessor(tree, binary, attributes[attribute], kind)
        if len(values) != count:
            raise _BadFileError(f"the attribute {attribute} has another count than POSITION")
        return values

    scales = column(f"{EXTENSION}:SCALE", "VEC3")
    if (scales < 0).any():
        raise _BadFileError("it has negative scales, as files of drafts of the extension do, which had logarithms")
    return gaussian_splat(
        name,
        positions=column("POSITION", "VEC3"),
        scales=scales,
        rotations=from_xyzw(column(f"{EXTENSION}:ROTATION", "VEC4")),
        opacities=column(f"{EXTENSION}:OPACITY", "SCALAR")[:, 0],
        harmonics=np.stack([column(_coefficient(k), "VEC3") for k in range((degrees[-1] + 1) ** 2)], axis=1),
    )


def _accessor(tree: dict[str, Any], binary: bytes, index: int, kind: str) -> Floats:
    """Return the values of an accessor, of shape (count, width). Integers that are not normalized stay as they are."""
    accessor = tree["accessors"][index]
    if accessor["type"] != kind or "sparse" in accessor:
        raise _BadFileError(f"an accessor of its splat is sparse or not {kind}")
    view = tree["bufferViews"][accessor["bufferView"]]
    if view.get("buffer", 0) != 0 or "uri" in tree["buffers"][0] or view.get("extensions"):
        raise _BadFileError("its data is compressed or outside the file")
    type_name, largest = _COMPONENTS.get(accessor["componentType"], ("<f4", 1.0))
    if largest == 1.0 and accessor["componentType"] != _FLOAT:
        raise _BadFileError("an accessor of its splat has an unknown component type")
    width, count, item = _WIDTHS[kind], accessor["count"], np.dtype(type_name)
    stride = view.get("byteStride") or width * item.itemsize
    start, offset = view.get("byteOffset", 0), accessor.get("byteOffset", 0)
    last = start + offset + (count - 1) * stride + width * item.itemsize
    room = min(len(binary), start + view["byteLength"])
    if min(start, offset, count - 1) < 0 or stride < width * item.itemsize or last > room:
        raise _BadFileError("an accessor of its splat extends beyond the data")
    strides = (stride, item.itemsize)
    raw = np.ndarray((count, width), dtype=item, buffer=binary, offset=start + offset, strides=strides)
    values = raw.astype(np.float64)
    return np.maximum(values / largest, -1.0) if accessor.get("normalized") else values


def _unreadable(name: str, reason: str) -> MeshError:
    return MeshError("SF301", f"{name} could not be read as a splat: {reason}", EXPORT)
