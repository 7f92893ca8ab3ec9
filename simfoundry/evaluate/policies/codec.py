"""Arrays in msgpack in the format of openpi and RoboArena; received data is never executed.

An array is a map ``{b"__ndarray__": True, b"data", b"dtype", b"shape"}``, a NumPy scalar ``{b"__npgeneric__": True,
b"data", b"dtype"}``. Only numbers and booleans are allowed: objects (which other codecs pickle), structures and complex
numbers are refused (format: openpi-client 0.1.2, ``msgpack_numpy.py``).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

PLAIN = "fiub"
"""Accepted kinds of NumPy types: floats, integers, booleans."""
MAX_DIMENSIONS = 8


class CodecError(ValueError):
    """A message that violates the protocol; the text describes the violation."""


def pack(message: Any) -> bytes:
    """Serialize a message to bytes; raises :class:`CodecError` for unsupported values."""
    import msgpack

    try:
        packed: bytes = msgpack.packb(message, default=_array_to_map)
    except TypeError as error:
        raise CodecError(str(error)) from None
    return packed


def unpack(data: bytes) -> Any:
    """Parse a message from bytes; raises :class:`CodecError`. Allocates nothing larger than ``data``."""
    import msgpack

    try:
        return msgpack.unpackb(data, object_hook=_map_to_array)
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
