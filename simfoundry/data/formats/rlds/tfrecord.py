"""TFRecord files and the ``tf.train.Example`` messages in them.

Both formats are small and do not change. The packages that write them require TensorFlow (1.5 GB), or protobuf in a
version that conflicts with that of other packages.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import OutputError

# The values of a key: byte strings, or numbers of one dimension in float32 or int64.
Values: TypeAlias = list[bytes] | NDArray[Any]

# From TensorFlow's lib/hash/crc32c.h: checksums of data that contain checksums are rotated and shifted.
_MASK_DELTA = 0xA282EAD8

# The wire types and field numbers of tf.train.Example (tensorflow/core/example/feature.proto).
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_BYTES_LIST, _FLOAT_LIST, _INT_LIST = 1, 2, 3


def _checksum(data: bytes | memoryview) -> int:
    import google_crc32c

    crc = int(google_crc32c.value(bytes(data)))
    return (((crc >> 15) | (crc << 17)) + _MASK_DELTA) & 0xFFFFFFFF


def record(data: bytes) -> bytes:
    """Return data as a record of a TFRecord file."""
    length = struct.pack("<Q", len(data))
    return length + struct.pack("<I", _checksum(length)) + data + struct.pack("<I", _checksum(data))


def encode_example(features: Mapping[str, Values]) -> bytes:
    """Return a ``tf.train.Example`` with its keys in alphabetical order, so that equal values give equal bytes."""
    entries = []
    for key in sorted(features):
        entry = _field(1, key.encode()) + _field(2, _feature(features[key]))
        entries.append(_field(1, entry))
    return _field(1, b"".join(entries))


def _feature(values: Values) -> bytes:
    if isinstance(values, list):
        return _field(_BYTES_LIST, b"".join(_field(1, one) for one in values))
    if values.dtype.kind == "f":
        return _field(_FLOAT_LIST, _field(1, values.astype("<f4").tobytes()))
    return _field(_INT_LIST, _field(1, b"".join(_varint(int(one) % 2**64) for one in values.ravel())))


def _field(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | _BYTES) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    found = bytearray()
    while value >= 0x80:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)


@dataclass(frozen=True)
class RecordPlace:
    """The place of a record's data in a TFRecord file."""

    path: Path
    start: int
    length: int


def find_records(path: Path) -> Iterator[RecordPlace]:
    """Yield the places of all records in a file, without reading their data.

    Raises:
        OutputError: If the file is not a TFRecord file, or incomplete.
    """
    size, start = path.stat().st_size, 0
    with path.open("rb") as stream:
        while start < size:
            stream.seek(start)
            head = stream.read(12)
            length = struct.unpack("<Q", head[:8])[0] if len(head) == 12 else size
            if length > size - start - 16 or struct.unpack("<I", head[8:])[0] != _checksum(head[:8]):
                raise OutputError(f"{path} is not a valid TFRecord file, or it is incomplete")
            yield RecordPlace(path, start + 12, length)
            start += length + 16


def record_data(place: RecordPlace, count: int = 0) -> memoryview:
    """Return the data of a record, with ``count`` bytes after them. The file is mapped: only what is used is read."""
    with place.path.open("rb") as stream:
        mapped = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
    return mapped[place.start : place.start + place.length + count]


def read_record(place: RecordPlace) -> memoryview:
    """Read the data of a record, and compare them with their checksum.

    Raises:
        OutputError: If the checksum is wrong.
    """
    found = record_data(place, 4)
    data, checksum = found[:-4], found[-4:]
    if struct.unpack("<I", checksum)[0] != _checksum(data):
        raise OutputError(f"{place.path} is damaged: the checksum of the record at byte {place.start} is wrong")
    return data


def example_features(data: memoryview) -> dict[str, memoryview]:
    """Return the encoded values of each key of a ``tf.train.Example``, for :func:`decode_values`.

    Raises:
        ValueError: If the data are not such a message.
    """
    found: dict[str, memoryview] = {}
    for number, features in _fields(data):
        for inner, entry in _fields(features) if number == 1 else ():
            parts = dict(_fields(entry)) if inner == 1 else {}
            if 1 in parts:
                found[bytes(parts[1]).decode()] = parts.get(2, memoryview(b""))
    return found


def decode_values(data: memoryview) -> Values:
    """Return the values of a key.

    Raises:
        ValueError: If the data are not a ``tf.train.Feature``.
    """
    for number, values in _fields(data):
        if number == _BYTES_LIST:
            return [bytes(one) for field, one in _fields(values) if field == 1]
        packed = b"".join(bytes(one) for field, one in _fields(values) if field == 1)
        if number == _FLOAT_LIST:
            return np.frombuffer(packed, "<f4")
        if number == _INT_LIST:
            return _integers(packed)
    return []


def count_values(data: memoryview) -> int:
    """Return the number of values of a key that contains byte strings or integers of one byte, such as truth values."""
    for number, values in _fields(data):
        if number == _BYTES_LIST:
            return sum(field == 1 for field, _ in _fields(values))
        if number == _INT_LIST:
            return sum(len(one) for field, one in _fields(values) if field == 1)
    return 0


def _integers(packed: bytes) -> NDArray[np.int64]:
    numbers, start = [], 0
    while start < len(packed):
        value, start = _read_varint(memoryview(packed), start)
        numbers.append(value - 2**64 if value >= 2**63 else value)
    return np.array(numbers, dtype=np.int64)


def _fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the number and the content of each field of a message. Numbers that are not packed have their own bytes."""
    start = 0
    while start < len(data):
        tag, start = _read_varint(data, start)
        end = start
        if tag & 7 == _BYTES:
            length, start = _read_varint(data, start)
            end = start + length
        elif tag & 7 == _VARINT:
            _, end = _read_varint(data, start)
        elif tag & 7 in (_FIXED32, _FIXED64):
            end = start + (4 if tag & 7 == _FIXED32 else 8)
        else:
            raise ValueError(f"the message has the unknown wire type {tag & 7}")
        if end > len(data):
            raise ValueError("the message is incomplete")
        yield tag >> 3, data[start:end]
        start = end


def _read_varint(data: memoryview, start: int) -> tuple[int, int]:
    """Return a number of variable length, and the index after it."""
    value, shift = 0, 0
    while start < len(data) and shift < 70:
        byte = data[start]
        value, shift, start = value | (byte & 0x7F) << shift, shift + 7, start + 1
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, start
    raise ValueError("the message is incomplete")
