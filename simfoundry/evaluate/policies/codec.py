"""Array encoding in msgpack, as used by openpi, RoboArena and GR00T.

openpi and RoboArena encode an array as a map ``{b"__ndarray__": True, b"data", b"dtype", b"shape"}`` and a NumPy scalar
as ``{b"__npgeneric__": True, b"data", b"dtype"}`` (openpi-client 0.1.2, ``msgpack_numpy.py``). GR00T encodes an array
as a NumPy file, ``{"__ndarray_class__": True, "as_npy": bytes}``, and describes the inputs and outputs of a policy with
``{"__ModalityConfig_class__": True, "as_json": {...}}`` (``gr00t/policy/server_client.py``, N1.6 and N1.7).

Received data is never executed. Only numbers and booleans are accepted. Objects (which other codecs pickle), structured
types and complex numbers are rejected. Decoding never allocates more memory than the size of the message.
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

# Accepted kinds of NumPy types: floats, integers and booleans.
PLAIN = "fiub"
MAX_DIMENSIONS = 8  # images and action chunks have at most four; this bounds hostile messages


class CodecError(ValueError):
    """An error raised for a message that violates the protocol.

    The text of the error describes the violation.
    """


@dataclass(frozen=True)
class Codec:
    """A msgpack codec for messages.

    ``to_map`` and ``from_map`` convert the values that msgpack cannot represent.
    """

    to_map: Callable[[Any], Any]
    from_map: Callable[[dict[Any, Any]], Any]

    def pack(self, message: Any) -> bytes:
        """Serialize a message to bytes.

        Raises:
            CodecError: If a value is not supported.
        """
        import msgpack

        try:
            packed: bytes = msgpack.packb(message, default=self.to_map)
        except TypeError as error:
            raise CodecError(str(error)) from None
        return packed

    def unpack(self, data: bytes) -> Any:
        """Parse a message from bytes.

        Raises:
            CodecError: If the message is invalid.
        """
        import msgpack

        try:
            return msgpack.unpackb(data, object_hook=self.from_map)
        except CodecError:
            raise
        except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
            raise CodecError(f"it is not valid msgpack ({str(error).rstrip('.') or type(error).__name__})") from None


def array_of(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], order: str = "C") -> np.ndarray[Any, Any]:
    """Interpret bytes as an array.

    Raises:
        CodecError: If the type, the shape or the size is invalid.
    """
    if dtype.kind not in PLAIN:
        raise CodecError(f"it contains an array of `{dtype}`, but only plain numbers are allowed")
    if len(shape) > MAX_DIMENSIONS or any(n < 0 for n in shape):
        raise CodecError(f"it contains an array with the invalid shape {list(shape)[:MAX_DIMENSIONS]}")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise CodecError(
            f"it contains an array of shape {list(shape)} and type `{dtype}`, which does not fit {len(data)} bytes"
        )
    array = np.frombuffer(data, dtype) if data else np.empty(0, dtype)
    return array.reshape(shape, order="F" if order == "F" else "C")


def type_of(name: Any) -> np.dtype[Any]:
    """Return the NumPy type for a name such as ``<f4``.

    Names longer than eight characters are not parsed.

    Raises:
        CodecError: If the type is unknown.
    """
    try:
        if not isinstance(name, str) or len(name) > 8:
            raise TypeError
        return np.dtype(name)
    except (TypeError, ValueError):
        raise CodecError("it contains an array of unknown type") from None


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
            raise CodecError("it contains an array without data or shape")
        return array_of(data, type_of(found.get(b"dtype")), tuple(shape))
    if b"__npgeneric__" in found:
        kind, value = type_of(found.get(b"dtype")), found.get(b"data")
        if kind.kind not in PLAIN or not isinstance(value, bool | int | float):
            raise CodecError("it contains a number of unknown type")
        try:
            return kind.type(value)
        except (OverflowError, ValueError):
            raise CodecError(f"it contains a number that is out of range for `{kind}`") from None
    return found


# Maximum size of the header of a NumPy file [bytes].
HEADER = 10_000


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
            raise CodecError("it contains a modality without a description")
        return described
    return found


def from_npy(data: Any) -> np.ndarray[Any, Any]:
    """Parse an array from a NumPy file.

    Unlike ``numpy.load``, this function compares the size declared in the header with the amount of available data
    before it allocates any memory.

    Raises:
        CodecError: If the file is invalid.
    """
    if not isinstance(data, bytes) or not data.startswith(b"\x93NUMPY") or data[6:7] not in (b"\x01", b"\x02"):
        raise CodecError("it contains an array that is not a NumPy file")
    start = 10 if data[6] == 1 else 12  # the length of the header has two bytes in version 1, and four in version 2
    length = int.from_bytes(data[8:start], "little")
    if length > HEADER or start + length > len(data):
        raise CodecError("it contains an array whose header is too long")
    try:
        header = ast.literal_eval(data[start : start + length].decode("latin1").strip())
        shape, kind, columns = header["shape"], header["descr"], header["fortran_order"]
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError):
        raise CodecError("it contains an array whose header could not be parsed") from None
    if not isinstance(shape, tuple) or not all(type(n) is int for n in shape):
        raise CodecError("it contains an array without a shape")
    return array_of(data[start + length :], type_of(kind), shape, "F" if columns is True else "C")


# The codec for messages of openpi, RoboArena and DreamZero.
OPENPI_CODEC = Codec(_array_to_map, _map_to_array)
# The codec for messages of GR00T; a modality is decoded to the mapping in its JSON.
GROOT_CODEC = Codec(_array_to_npy_map, _npy_map_to_value)
