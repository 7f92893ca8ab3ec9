"""GR00T's message format: msgpack with arrays as NumPy files (``gr00t/policy/server_client.py``, N1.6 and N1.7).

An array is ``{"__ndarray_class__": True, "as_npy": bytes}``; a policy's inputs and outputs are described by
``{"__ModalityConfig_class__": True, "as_json": {...}}``. Received data is not trusted: object arrays are refused, and
nothing larger than the message is allocated.
"""

from __future__ import annotations

import ast
import io
import json
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.codec import CodecError, array_of, type_of

HEADER = 10_000
"""Maximum header size of a NumPy file [bytes]."""


def pack(message: Any) -> bytes:
    """Serialize a message to bytes; raises :class:`CodecError` for unsupported values."""
    import msgpack

    try:
        packed: bytes = msgpack.packb(message, default=_array_to_map)
    except TypeError as error:
        raise CodecError(str(error)) from None
    return packed


def unpack(data: bytes) -> Any:
    """Parse a message from bytes; raises :class:`CodecError`. A modality becomes the mapping of its JSON."""
    import msgpack

    try:
        return msgpack.unpackb(data, object_hook=_map_to_value)
    except CodecError:
        raise
    except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise CodecError(f"it is not msgpack ({str(error).rstrip('.') or type(error).__name__})") from None


def _array_to_map(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        stream = io.BytesIO()
        try:
            np.save(stream, value, allow_pickle=False)
        except ValueError:
            raise TypeError(f"an array of `{value.dtype}` cannot be sent") from None
        return {"__ndarray_class__": True, "as_npy": stream.getvalue()}
    raise TypeError(f"a `{type(value).__name__}` cannot be sent")


def _map_to_value(found: dict[Any, Any]) -> Any:
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
