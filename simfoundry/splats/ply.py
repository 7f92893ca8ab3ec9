"""Gaussian splats as PLY files in the layout of trainers.

The files contain raw training parameters: opacities before the logistic function, scales before the exponential,
quaternions (wxyz) of any length, and spherical harmonics grouped by channel. Their axes have no convention, so they are
taken as they are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.splats.gaussians import EXPORT, Floats, GaussianSplat, check_count, gaussian_splat

_XYZ = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
# Total number of coefficients after the first of each channel, for degrees 0 to 3.
_RESTS = (0, 9, 24, 45)

# Maximum size of a header [bytes]; with all spherical harmonics, it takes 2 kB.
_MAX_HEAD = 100_000

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}

# Written for an opacity of 1 or 0, whose logits are infinite. The logistic functions of these numbers round to 1 and 0
# in single precision: they differ from them by 2e-9 and 2e-48.
_OPAQUE, _TRANSPARENT = 20.0, -110.0
# Written for the logarithm of a scale of zero; its exponential rounds to zero in single precision.
_FLAT = -110.0


@dataclass(frozen=True)
class _Element:
    """An element of a PLY file: its name, the number of its rows, and the types of its properties."""

    name: str
    count: int
    fields: tuple[tuple[str, str], ...]


def read_ply(path: Path) -> GaussianSplat:
    """Read the Gaussians in a PLY file, in the units of the file.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    try:
        with path.open("rb") as stream:
            raw = _vertices(path.name, stream, path.stat().st_size)
    except OSError as error:
        raise _unreadable(path.name, error.strerror or str(error)) from None
    names = raw.dtype.names or ()
    missing = [n for n in (*_XYZ, *_DC, *_SCALE, *_ROTATION, "opacity") if n not in names]
    if missing:
        message = f"{path.name} is not a Gaussian splat: the property `{missing[0]}` is missing"
        raise MeshError("SF301", message, f"{EXPORT} as an uncompressed PLY file")
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are reported
        return gaussian_splat(
            path.name,
            positions=_columns(raw, _XYZ),
            scales=np.exp(_columns(raw, _SCALE).astype(np.float64)),
            rotations=_columns(raw, _ROTATION),
            opacities=1.0 / (1.0 + np.exp(-_columns(raw, ("opacity",))[:, 0].astype(np.float64))),
            harmonics=_harmonics(path.name, raw, names),
        )


def ply_bytes(splat: GaussianSplat) -> bytes:
    """Return a splat as a binary PLY file. Equal splats give equal bytes."""
    rest = 3 * (splat.harmonics.shape[1] - 1)
    names = (*_XYZ, *_NORMAL, *_DC, *(f"f_rest_{k}" for k in range(rest)), "opacity", *_SCALE, *_ROTATION)
    opacity, scales = splat.opacities.astype(np.float64), splat.scales.astype(np.float64)
    with np.errstate(divide="ignore"):
        logit = np.clip(np.log(opacity) - np.log1p(-opacity), _TRANSPARENT, _OPAQUE)
        logarithms = np.maximum(np.log(scales), _FLAT)
    others = splat.harmonics[:, 1:].transpose(0, 2, 1).reshape(len(splat), rest)
    columns = (
        splat.positions, np.zeros((len(splat), 3)), splat.harmonics[:, 0], others, logit[:, None], logarithms,
        splat.rotations,
    )  # fmt: skip
    data = np.concatenate([np.asarray(part, dtype="<f4") for part in columns], axis=1)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(splat)}"]
    head += [f"property float {name}" for name in names]
    return ("\n".join([*head, "end_header"]) + "\n").encode() + data.tobytes()


def _vertices(name: str, stream: BinaryIO, size: int) -> NDArray[np.void]:
    """Return the vertex element of a PLY file as a structured array."""
    order, elements = _header(name, stream)
    for element in elements:
        types = np.dtype([(field, order[1] + kind) for field, kind in element.fields])
        if element.name == "vertex":
            check_count(name, element.count)
        room = size - stream.tell()
        if order[0] == "ascii":
            if 2 * element.count * len(element.fields) > room + 1:
                raise _unreadable(name, "it ends before its last Gaussian")
            rows = _text_rows(name, stream, element, types)
        elif element.count * types.itemsize > room:
            raise _unreadable(name, "it ends before its last Gaussian")
        elif element.name != "vertex":
            stream.seek(element.count * types.itemsize, 1)
            continue
        else:
            rows = np.frombuffer(stream.read(element.count * types.itemsize), dtype=types)
        if element.name == "vertex":
            return rows
    raise _unreadable(name, "it has no vertices")


def _header(name: str, stream: BinaryIO) -> tuple[tuple[str, str], list[_Element]]:
    """Return the format with its byte order, and the elements up to the vertices."""
    head = stream.read(_MAX_HEAD)
    end = re.search(rb"^end_header[ \t]*\r?\n", head, re.MULTILINE)
    if not head.startswith(b"ply") or end is None:
        raise _unreadable(name, "it has no PLY header")
    stream.seek(end.end())
    form, elements = "", list[tuple[str, int, list[tuple[str, str]]]]()
    for line in head[: end.start()].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", word, *_]:
                form = word
            case ["element", *_] if elements and elements[-1][0] == "vertex":
                break  # nothing after the vertices matters
            case ["element", element, count] if count.isdecimal() and len(count) < 12:
                elements.append((element, int(count), []))
            case ["property", kind, field] if kind in _TYPES and elements:
                elements[-1][2].append((field, _TYPES[kind]))
            case ["property", "list", *_]:
                raise _unreadable(name, "it has lists before or in its vertices")
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise _unreadable(name, f"the line `{line[:60]}` of its header cannot be understood")
    if form not in _ORDERS:
        raise _unreadable(name, f"its format `{form[:40]}` is unknown")
    if any(len({field for field, _ in fields}) < len(fields) for _, _, fields in elements):
        raise _unreadable(name, "two of its properties have the same name")
    return (form, _ORDERS[form]), [_Element(element, count, tuple(fields)) for element, count, fields in elements]


def _text_rows(name: str, stream: BinaryIO, element: _Element, types: np.dtype[np.void]) -> NDArray[np.void]:
    lines = [line for line in (stream.readline() for _ in range(element.count)) if line.strip()]
    try:
        values = np.array([line.split() for line in lines], dtype=np.float64)
    except ValueError:
        raise _unreadable(name, "not all of its lines are numbers") from None
    if values.shape != (element.count, len(element.fields)):
        raise _unreadable(name, "its lines do not have one number for each property")
    rows = np.empty(element.count, dtype=types)
    for k, (field, _) in enumerate(element.fields):
        rows[field] = values[:, k]
    return rows


def _columns(raw: NDArray[np.void], names: Sequence[str]) -> Floats:
    with np.errstate(over="ignore"):
        return np.stack([raw[name].astype(np.float32) for name in names], axis=1)


def _harmonics(name: str, raw: NDArray[np.void], names: Sequence[str]) -> Floats:
    """Return spherical harmonics coefficients in ascending order, as an array of shape (n, k, 3).

    The file contains the first coefficient of each channel, followed by the remaining coefficients channel by channel.
    """
    rest = sum(1 for property_name in names if property_name.startswith("f_rest_"))
    if rest not in _RESTS or any(f"f_rest_{k}" not in names for k in range(rest)):
        known = ", ".join(map(str, _RESTS))
        raise MeshError("SF301", f"{name} has {rest} `f_rest` properties; a splat must have {known}", EXPORT)
    first = _columns(raw, _DC)[:, None, :]
    if not rest:
        return first
    others = _columns(raw, tuple(f"f_rest_{k}" for k in range(rest))).reshape(len(raw), 3, rest // 3)
    return np.concatenate([first, others.transpose(0, 2, 1)], axis=1)


def _unreadable(name: str, reason: str) -> MeshError:
    return MeshError("SF301", f"{name} could not be read as a splat: {reason}", EXPORT)
