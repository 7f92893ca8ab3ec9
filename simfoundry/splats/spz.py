"""Gaussian splats as SPZ files (Niantic): quantized, and compressed with gzip (versions 2 and 3) or Zstandard (4).

Version 4 has the values of version 3 in one compressed stream for each attribute; it is read, but not written.
Positions are fixed-point numbers of 24 bits, scales are logarithms in steps of 1/16, opacities and colors have 8 bits,
and rotations 8 bits (version 2) or 9 bits and a sign (version 3) for each of three quaternion components. The axes are
x right, y up, z backward.
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.geometry.frames import from_xyzw, to_xyzw
from simfoundry.runtime.extras import install_line
from simfoundry.splats.gaussians import EXPORT, MAX_DEGREE, GaussianSplat, check_count, gaussian_splat
from simfoundry.splats.y_up import turned_y_up, turned_z_up

_MAGIC = 0x5053474E
_HEAD = struct.Struct("<IIIBBBB")  # magic, version, count, degree, fractional bits, flags, reserved

# The header of version 4: magic, version, count, degree, fractional bits, flags, number of streams, offset of the table
# of streams, and 12 reserved bytes. The table has the compressed and the real size of each stream.
_HEAD_4 = struct.Struct("<IIIBBBBI12x")
_ENTRY_4 = struct.Struct("<QQ")
_HAS_EXTENSIONS = 2  # a flag; extensions can change the range of the harmonics

# Largest window of a Zstandard frame [bytes], which bounds the memory that reading takes; writers use up to 8 MiB.
_MAX_WINDOW = 2**27

# Bytes of the quaternion of a Gaussian in each version.
_TURN_BYTES = {2: 3, 3: 4, 4: 4}
# Range of the first harmonic coefficient that 8 bits represent: 0.5 +- 0.5 / 0.15.
_COLOR_SCALE = 0.15
# Largest magnitude of a component that is not the largest of a unit quaternion, and its number of steps (9 bits).
_SMALL, _STEPS = math.sqrt(0.5), 511
# Bits after the point: at 20, a position within 8 m has a resolution of 1 um. Larger scenes have fewer bits.
_MAX_FRACTION = 20
_LIMIT = 2**23 - 1  # largest fixed-point number of 24 bits

Bytes = NDArray[np.uint8]


class _Arrays(NamedTuple):
    """Quantized values in the order of the file: (n, 9), (n,), (n, 3), (n, 3), (n, 3 or 4), (n, rest, 3)."""

    positions: Bytes
    opacities: Bytes
    colors: Bytes
    scales: Bytes
    rotations: Bytes
    harmonics: Bytes


def read_spz(path: Path) -> GaussianSplat:
    """Read the Gaussians in an SPZ file, in the units of the file and with z up.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    try:
        packed = path.read_bytes()
    except OSError as error:
        raise _unreadable(path.name, error.strerror or str(error)) from None
    if packed[:4] == struct.pack("<I", _MAGIC):  # its header is not compressed
        return _read_streams(path.name, packed)
    stream = zlib.decompressobj(wbits=31)  # gzip
    try:
        head = stream.decompress(packed, _HEAD.size)
        version, count, degree, fraction = _header(path.name, head)
        sizes = _sizes(count, degree, version)
        body = stream.decompress(stream.unconsumed_tail, sum(sizes))
    except zlib.error:
        raise _unreadable(path.name, "its compressed data is damaged") from None
    if len(body) < sum(sizes):
        raise _unreadable(path.name, "it ends before its last Gaussian")
    ends = np.cumsum(sizes)
    parts = np.split(np.frombuffer(body, dtype=np.uint8)[: ends[-1]], ends[:-1])
    return _splat_of(path.name, parts, (version, count, degree, fraction))


def _splat_of(name: str, parts: Sequence[Bytes], header: tuple[int, int, int, int]) -> GaussianSplat:
    """Return the splat of quantized attributes, each of shape (bytes,), in the order of the file."""
    version, count, degree, fraction = header
    rest = (degree + 1) ** 2 - 1
    colors, scales = (part.reshape(count, 3) for part in parts[2:4])
    turns = parts[4].reshape(count, _TURN_BYTES[version])
    arrays = _Arrays(parts[0].reshape(count, 9), parts[1], colors, scales, turns, parts[5].reshape(count, rest, 3))
    return turned_z_up(_decoded(name, arrays, fraction))


def _read_streams(name: str, packed: bytes) -> GaussianSplat:
    """Read the Gaussians of a file of version 4.

    Raises:
        MeshError: If the file is not a usable splat, or if Zstandard is not installed.
    """
    if len(packed) < _HEAD_4.size:
        raise _unreadable(name, "it ends in its header")
    *_, flags, number, at = _HEAD_4.unpack_from(packed)
    header = version, count, degree, _ = _header(name, packed[: _HEAD.size], (4,))
    if flags & _HAS_EXTENSIONS:
        raise _unreadable(name, "it has extensions, which are not supported; write it without them, or as version 3")
    sizes = _sizes(count, degree, version)
    start = at + number * _ENTRY_4.size
    fewest = len(sizes) - (sizes[-1] == 0)  # the last stream may be absent if there are no harmonics
    if not fewest <= number <= len(sizes) or start > len(packed):
        raise _unreadable(name, f"it has {number} streams; {len(sizes)} attributes are expected")
    parts = []
    for k in range(number):
        length, real = _ENTRY_4.unpack_from(packed, at + k * _ENTRY_4.size)
        if real != sizes[k] or length > len(packed) - start:
            raise _unreadable(name, f"stream {k + 1} does not have the size of {count} Gaussians")
        parts.append(_unzipped(name, packed[start : start + length], real))
        start += length
    return _splat_of(name, [*parts, *[np.zeros(0, np.uint8)] * (len(sizes) - number)], header)


def _unzipped(name: str, data: bytes, size: int) -> Bytes:
    """Return ``size`` bytes of a Zstandard frame."""
    try:
        import zstandard
    except ImportError:
        reason = f"version 4 of the format needs zstandard; install it with `{install_line('studio')}`"
        raise _unreadable(name, reason) from None
    if size == 0:
        return np.zeros(0, np.uint8)
    try:
        with zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW).stream_reader(data) as reader:
            body = reader.read(size)
    except zstandard.ZstdError:
        raise _unreadable(name, "its compressed data is damaged") from None
    if len(body) < size:
        raise _unreadable(name, "it ends before its last Gaussian")
    return np.frombuffer(body, np.uint8)


def spz_bytes(splat: GaussianSplat, version: Literal[2, 3] = 3) -> bytes:
    """Return a splat as an SPZ file. Equal splats give equal bytes.

    Values outside the range of the format are clipped: opacities have 255 steps, scales lie between 45 um and 380 m in
    steps of 6 %, and the harmonics above degree 0 lie within +-1 in steps of 1/128.

    Raises:
        MeshError: If the splat extends beyond 8,000 km, which 24 bits cannot represent.
    """
    splat = turned_y_up(splat)
    reach = float(np.abs(splat.positions).max())
    fraction = min(_MAX_FRACTION, math.floor(math.log2(_LIMIT / reach)) if reach > 0 else _MAX_FRACTION)
    if fraction < 0:
        raise MeshError("SF301", f"the splat extends {reach:.3g} m, too far for an SPZ file", "scale it first")
    fixed = np.rint(splat.positions.astype(np.float64) * 2**fraction).astype("<i4")
    first = splat.harmonics[:, 0].astype(np.float64)
    with np.errstate(divide="ignore"):
        logarithms = np.log(splat.scales.astype(np.float64))
    turns = to_xyzw(splat.rotations.astype(np.float64))
    arrays = _Arrays(
        np.ascontiguousarray(fixed).view(np.uint8).reshape(len(splat), 3, 4)[..., :3],
        _byte(splat.opacities * 255.0),
        _byte((first * _COLOR_SCALE + 0.5) * 255.0),
        _byte((logarithms + 10.0) * 16.0),
        _first_three(turns) if version == 2 else _smallest_three(turns),
        _byte(splat.harmonics[:, 1:] * 128.0 + 128.0),
    )
    head = _HEAD.pack(_MAGIC, version, len(splat), splat.degree, fraction, 0, 0)
    return gzip.compress(head + b"".join(part.tobytes() for part in arrays), mtime=0)


def _header(name: str, head: bytes, versions: Sequence[int] = (2, 3)) -> tuple[int, int, int, int]:
    """Return the version, the number of Gaussians, the degree, and the number of bits after the point.

    ``versions`` are those that have the compression of the file.
    """
    if len(head) < _HEAD.size or struct.unpack_from("<I", head)[0] != _MAGIC:
        raise _unreadable(name, "it is not an SPZ file")
    _, version, count, degree, fraction, _, _ = _HEAD.unpack(head)
    if version not in versions:
        raise _unreadable(
            name,
            f"it has version {version} of the format; versions 2 and 3 with gzip, and 4 with Zstandard can be read",
        )
    if degree > MAX_DEGREE:
        raise _unreadable(name, f"its spherical harmonics have degree {degree}; the limit is {MAX_DEGREE}")
    if fraction > 24:
        raise _unreadable(name, f"its positions have {fraction} bits after the point; they have 24 bits in all")
    check_count(name, count)
    return version, count, degree, fraction


def _sizes(count: int, degree: int, version: int) -> tuple[int, ...]:
    return tuple(count * size for size in (9, 1, 3, 3, _TURN_BYTES[version], 3 * ((degree + 1) ** 2 - 1)))


def _decoded(name: str, arrays: _Arrays, fraction: int) -> GaussianSplat:
    """Return the splat along the axes of the file."""
    n = len(arrays.opacities)
    words = np.zeros((n, 3, 4), dtype=np.uint8)
    words[..., 1:] = arrays.positions.reshape(n, 3, 3)  # in the upper bytes, so that the sign is at its place
    fixed = words.view("<i4")[..., 0] >> 8
    first = (arrays.colors / 255.0 - 0.5) / _COLOR_SCALE
    rest = (arrays.harmonics.astype(np.float64) - 128.0) / 128.0
    unpack = _from_first_three if arrays.rotations.shape[1] == 3 else _from_smallest_three
    return gaussian_splat(
        name,
        positions=fixed / 2.0**fraction,
        scales=np.exp(arrays.scales / 16.0 - 10.0),
        rotations=from_xyzw(unpack(arrays.rotations)),
        opacities=arrays.opacities / 255.0,
        harmonics=np.concatenate([first[:, None], rest], axis=1),
    )


def _byte(values: NDArray[np.floating]) -> Bytes:
    """Round to the nearest byte, half up, as other writers do."""
    return np.asarray(np.clip(np.floor(values + 0.5), 0, 255), dtype=np.uint8)


def _first_three(xyzw: NDArray[np.float64]) -> Bytes:
    return _byte(np.where(xyzw[:, 3:] < 0, -xyzw, xyzw)[:, :3] * 127.5 + 127.5)


def _from_first_three(packed: Bytes) -> NDArray[np.float64]:
    xyz = packed / 127.5 - 1.0
    w = np.sqrt(np.maximum(0.0, 1.0 - (xyz**2).sum(axis=1, keepdims=True)))
    return np.concatenate([xyz, w], axis=1)


def _smallest_three(xyzw: NDArray[np.float64]) -> Bytes:
    """Return 32 bits for each quaternion: the index of the largest component, and signs and sizes of the others."""
    rows = np.arange(len(xyzw))
    largest = np.abs(xyzw).argmax(axis=1)
    turns = xyzw * np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    word = largest.astype(np.uint32)
    for k in range(4):
        size = np.minimum(np.floor(np.abs(turns[:, k]) / _SMALL * _STEPS + 0.5), _STEPS).astype(np.uint32)
        word = np.where(largest == k, word, word << 10 | (turns[:, k] < 0).astype(np.uint32) << 9 | size)
    return np.asarray(word.astype("<u4").view(np.uint8).reshape(-1, 4), dtype=np.uint8)


def _from_smallest_three(packed: Bytes) -> NDArray[np.float64]:
    word = np.ascontiguousarray(packed).view("<u4")[:, 0]
    largest = (word >> 30).astype(np.int64)
    out = np.zeros((len(word), 4))
    for k in (3, 2, 1, 0):
        value = (word & _STEPS) / _STEPS * _SMALL * np.where(word >> 9 & 1, -1.0, 1.0)
        out[:, k] = np.where(largest == k, 0.0, value)
        word = np.where(largest == k, word, word >> 10)
    out[np.arange(len(out)), largest] = np.sqrt(np.maximum(0.0, 1.0 - (out**2).sum(axis=1)))
    return out


def _unreadable(name: str, reason: str) -> MeshError:
    return MeshError("SF301", f"{name} could not be read as a splat: {reason}", EXPORT)
