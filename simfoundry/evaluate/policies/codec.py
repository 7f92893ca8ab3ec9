"""Arrays in msgpack, as sent by openpi, RoboArena and GR00T; received data is never executed.

openpi and RoboArena send an array as a map ``{b"__ndarray__": True, b"data", b"dtype", b"shape"}``, a NumPy scalar as
``{b"__npgeneric__": True, b"data", b"dtype"}`` (openpi-client 0.1.2, ``msgpack_numpy.py``). GR00T sends an array as a
NumPy file, ``{"__ndarray_class__": True, "as_npy": bytes}``, and describes the inputs and outputs of a policy by
``{"__ModalityConfig_class__": True, "as_json": {...}}`` (``gr00t/policy/server_client.py``, N1.6 and N1.7). Only
numbers and booleans are allowed: objects (which other codecs pickle), structures and complex numbers are refused, and
nothing larger than the message is allocated.
"""

from __future__ import annotations

import ast
import io
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

PLAIN = "fiub"
"""Accepted kinds of NumPy types: floats, integers, booleans."""
MAX_DIMENSIONS = 8


class CodecError(ValueError):
    """A message that violates the protocol; the text describes the violation."""


@dataclass(frozen=True)
class Codec:
    """Messages in msgpack; ``to_map`` and ``from_map`` convert the values that msgpack itself does not have."""

    to_map: Callable[[Any], Any]
    from_map: Callable[[dict[Any, Any]], Any]

    def pack(self, message: Any) -> bytes:
        """Serialize a message to bytes; raises :class:`CodecError` for unsupported values."""
        import msgpack

        try:
            packed: bytes = msgpack.packb(message, default=self.to_map)
        except TypeError as error:
            raise CodecError(str(error)) from None
        return packed

    def unpack(self, data: bytes) -> Any:
        """Parse a message from bytes; raises :class:`CodecError`."""
        import msgpack

        try:
            return msgpack.unpackb(data, object_hook=self.from_map)
        except CodecError:
            raise
        except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
            raise CodecError(f"it is not msgpack ({str(error).rstrip('.') or type(error).__name__})") from None


def array_of(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], order: str = "C") -> np.ndarray[Any, Any]:
    """Interpret bytes as an array of exactly that size; raises :class:`CodecError`."""
    if dtype.kind not in PLAIN:
        raise CodecError(f"it holds an array of `{dtype}`, not of plain numbers")
    if len(shape) > MAX_DIMENSIONS or any(n < 0 for n in shape):
        raise CodecError(f"it holds an array of the invalid shape {list(shape)[:MAX_DIMENSIONS]}")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise CodecError(f"it holds an array of {list(shape)} `{dtype}` in {len(data)} bytes")
    array = np.frombuffer(data, dtype) if data else np.empty(0, dtype)
    return array.reshape(shape, order="F" if order == "F" else "C")


def type_of(name: Any) -> np.dtype[Any]:
    """Return the type named by a text such as ``<f4``; raises :class:`CodecError`. Only short texts are parsed."""
    try:
        if not isinstance(name, str) or len(name) > 8:
            raise TypeError
        return np.dtype(name)
    except (TypeError, ValueError):
        raise CodecError("it holds an array of an unknown type") from None


def _array_to_map(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in PLAIN:
        if isinstance(value, np.ndarray):
            shape = list(value.shape)
            return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": shape}
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"a `{type(value).__name__}` cannot be sent")


def _map_to_array(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        data, shape = found.get(b"data"), found.get(b"shape")
        if not isinstance(data, bytes) or not isinstance(shape, list) or not all(type(n) is int for n in shape):
            raise CodecError("it holds an array without data or shape")
        return array_of(data, type_of(found.get(b"dtype")), tuple(shape))
    if b"__npgeneric__" in found:
        kind, value = type_of(found.get(b"dtype")), found.get(b"data")
        if kind.kind not in PLAIN or not isinstance(value, bool | int | float):
            raise CodecError("it holds a number of an unknown type")
        try:
            return kind.type(value)
        except (OverflowError, ValueError):
            raise CodecError(f"it holds a number out of range for `{kind}`") from None
    return found


HEADER = 10_000
"""Maximum header size of a NumPy file [bytes]."""


def _array_to_npy_map(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        stream = io.BytesIO()
        try:
            np.save(stream, value, allow_pickle=False)
        except ValueError:
            raise TypeError(f"an array of `{value.dtype}` cannot be sent") from None
        return {"__ndarray_class__": True, "as_npy": stream.getvalue()}
    raise TypeError(f"a `{type(value).__name__}` cannot be sent")


def _npy_map_to_value(found: dict[Any, Any]) -> Any:
    if "__ndarray_class__" in found:
        return from_npy(found.get("as_npy"))
    if "__ModalityConfig_class__" in found:
        described = found.get("as_json")
        try:
            described = json.loads(described) if isinstance(described, str) else described
        except ValueError:
            described = None
        if not isinstance(described, dict):
            raise CodecError("it holds a modality without a description")
        return described
    return found


def from_npy(data: Any) -> np.ndarray[Any, Any]:
    """Parse an array from a NumPy file; raises :class:`CodecError`.

    ``numpy.load`` allocates the size stated by the header before it checks the available data; here both must agree
    first.
    """
    if not isinstance(data, bytes) or not data.startswith(b"\x93NUMPY") or data[6:7] not in (b"\x01", b"\x02"):
        raise CodecError("it holds an array that is not a NumPy file")
    wide = 2 if data[6] == 1 else 4
    length = int.from_bytes(data[8 : 8 + wide], "little")
    start = 8 + wide
    if length > HEADER or start + length > len(data):
        raise CodecError("it holds an array whose header is too long")
    try:
        header = ast.literal_eval(data[start : start + length].decode("latin1").strip())
        shape, kind, columns = header["shape"], header["descr"], header["fortran_order"]
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError):
        raise CodecError("it holds an array whose header cannot be read") from None
    if not isinstance(shape, tuple) or not all(type(n) is int for n in shape):
        raise CodecError("it holds an array without a shape")
    return array_of(data[start + length :], type_of(kind), shape, "F" if columns is True else "C")


OPENPI_CODEC = Codec(_array_to_map, _map_to_array)
"""Messages of openpi, RoboArena and DreamZero."""
GROOT_CODEC = Codec(_array_to_npy_map, _npy_map_to_value)
"""Messages of GR00T; a modality becomes the mapping of its JSON."""
