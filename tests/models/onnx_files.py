"""ONNX files with the inputs and outputs of real networks, and contents that a test can foresee.

The files are written as protocol buffers by hand, because the package that writes them is large.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

FLOAT, INT64 = 1, 7  # element types of TensorProto


def _varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def field(number: int, value: int | str | bytes) -> bytes:
    """Return a field of a message: a number, or text, bytes or a message with its length."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def value(name: str, shape: Sequence[int | str]) -> bytes:
    """Describe an input or output; named sizes are free."""
    sizes = b"".join(field(1, field(2 if isinstance(size, str) else 1, size)) for size in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, sizes)))


def constant(name: str, array: Any) -> bytes:
    array = np.asarray(array)
    kind = INT64 if array.dtype == np.int64 else FLOAT
    data = array.astype(np.int64 if kind == INT64 else np.float32).tobytes()
    dims = b"".join(field(1, size) for size in array.shape)
    return dims + field(2, kind) + field(8, name) + field(9, data)


def node(operator: str, inputs: Sequence[str], output: str, **attributes: int) -> bytes:
    named = b"".join(field(5, field(1, key) + field(3, number) + field(20, 2)) for key, number in attributes.items())
    return b"".join(field(1, name) for name in inputs) + field(2, output) + field(4, operator) + named


def write(
    path: Path, nodes: Iterable[bytes], constants: Iterable[bytes], ins: Iterable[bytes], outs: Iterable[bytes]
) -> Path:
    """Write a network of operator set 13."""
    parts = [(1, nodes), (5, constants), (11, ins), (12, outs)]
    graph = b"".join(field(number, one) for number, some in parts for one in some) + field(2, "g")
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13)))
    return path


def lama(path: Path) -> Path:
    """Write a network that paints a mask with the level 128, as LaMa receives and returns images."""
    nodes = [
        node("Mul", ["image", "c255"], "a"), node("Sub", ["one", "mask"], "b"), node("Mul", ["a", "b"], "c"),
        node("Mul", ["mask", "c128"], "d"), node("Add", ["c", "d"], "output"),
    ]  # fmt: skip
    constants = [constant("c255", np.float32(255)), constant("one", np.float32(1)), constant("c128", np.float32(128))]
    ins = [value("image", (1, 3, 512, 512)), value("mask", (1, 1, 512, 512))]
    return write(path, nodes, constants, ins, [value("output", (1, 3, 512, 512))])


def efficientsam(path: Path, labels: Sequence[int] = (1, 1, 6, 1)) -> Path:
    """Write a network whose best candidate is what is dark, and whose second is what is bright."""
    nodes = [
        node("Mul", ["batched_images", "third"], "scaled"), node("ReduceSum", ["scaled", "axis"], "gray", keepdims=1),
        node("Sub", ["gray", "half"], "bright"), node("Neg", ["bright"], "dark"),
        node("Concat", ["dark", "bright", "gray"], "stack", axis=1),
        node("Unsqueeze", ["stack", "axis"], "output_masks"), node("Identity", ["ious"], "iou_predictions"),
    ]  # fmt: skip
    constants = [
        constant("third", np.float32(1 / 3)), constant("half", np.float32(0.5)), constant("axis", np.array([1])),
        constant("ious", np.array([[[0.95, 0.9, 0.1]]], np.float32)),
    ]  # fmt: skip
    ins = [
        value("batched_images", (1, 3, 1024, 1024)), value("batched_point_coords", (1, 1, 6, 2)),
        value("batched_point_labels", labels),
    ]  # fmt: skip
    outs = [value("output_masks", (1, 1, 3, 1024, 1024)), value("iou_predictions", (1, 1, 3))]
    return write(path, nodes, constants, ins, outs)


def da3(path: Path, raw: float = 1.5) -> Path:
    """Write a network that returns one depth everywhere, before its scaling by the focal length, and no sky."""
    nodes = [
        node("Mul", ["image", "zero"], "nothing"), node("ReduceSum", ["nothing", "axis"], "sky", keepdims=1),
        node("Add", ["sky", "raw"], "depth"),
    ]  # fmt: skip
    constants = [constant("zero", np.float32(0)), constant("axis", np.array([1])), constant("raw", np.float32(raw))]
    outs = [value("depth", (1, 1, "h", "w")), value("sky", (1, 1, "h", "w"))]
    return write(path, nodes, constants, [value("image", (1, 3, "h", "w"))], outs)
