"""Panoramas for dome lights: equirectangular images in the formats Radiance HDR, OpenEXR, PNG and JPEG."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MAX_BYTES, MeshError, too_large
from simfoundry.assets.textures import read_texture

# Largest number of pixels, as for textures: 8192 x 8192.
MAX_PIXELS = 8192 * 8192

# Number of bytes at the start of a file to search for the image size; headers have a few hundred bytes.
_HEADER = 2**16

_RADIANCE_SIZE = re.compile(rb"\n\n-Y (\d{1,6}) \+X (\d{1,6})\n")

Pixels = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Panorama:
    """An equirectangular image of the surroundings: ``content`` in the format of ``suffix``, such as `.hdr`.

    The center of the image is in the direction of the x axis, the left edge of the center line in that of -x through
    +y, and the top row in that of z.
    """

    suffix: str
    content: bytes

    def pixels(self) -> Pixels | None:
        """Return the linear radiance of each pixel, shape (height, width, 3).

        The result is None for OpenEXR, whose compression methods are not implemented.
        """
        if self.suffix == ".hdr":
            return _radiance_pixels(self.content)
        if self.suffix == ".exr":
            return None
        import io

        from PIL import Image

        with Image.open(io.BytesIO(self.content)) as picture:
            srgb = np.asarray(picture.convert("RGB"), dtype=np.float32) / 255
        return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def read_panorama(path: Path) -> Panorama:
    """Read the panorama of a dome light.

    Raises:
        MeshError: If the file is too large or not an image of its type.
    """
    try:
        if (size := path.stat().st_size) > MAX_BYTES:
            raise too_large(path.name, size)
        content, suffix = path.read_bytes(), path.suffix.lower()
    except OSError as error:
        raise MeshError(
            "SF301", f"{path.name} could not be read: {error.strerror or error}", "make it readable"
        ) from None
    if suffix not in (".hdr", ".exr"):
        return Panorama(".png", read_texture(path))
    found = _radiance_size(content) if suffix == ".hdr" else _openexr_size(content)
    if found is None or min(found) < 1:
        kind = "Radiance HDR" if suffix == ".hdr" else "OpenEXR"
        raise MeshError("SF301", f"{path.name} is not a {kind} image", "export it again")
    if found[0] * found[1] > MAX_PIXELS:
        message = f"{path.name} has {found[0]} x {found[1]} pixels; the limit is 8192 x 8192"
        raise MeshError("SF301", message, "make the image smaller")
    if suffix == ".hdr":
        try:
            _radiance_pixels(content)
        except (ValueError, IndexError):
            raise MeshError("SF301", f"{path.name} is truncated", "export it again") from None
    return Panorama(suffix, content)


def _radiance_size(content: bytes) -> tuple[int, int] | None:
    """Return the width and height [px] of a Radiance HDR image, or None if it is not one."""
    found = _RADIANCE_SIZE.search(content[:_HEADER]) if content.startswith((b"#?RADIANCE", b"#?RGBE")) else None
    return None if found is None else (int(found[2]), int(found[1]))


def _openexr_size(content: bytes) -> tuple[int, int] | None:
    """Return the width and height [px] of an OpenEXR image, or None if it is not one."""
    head = content[:_HEADER]
    start = head.find(b"dataWindow\0box2i\0\x10\0\0\0")
    if not head.startswith(b"\x76\x2f\x31\x01") or start < 0 or start + 37 > len(head):
        return None
    x0, y0, x1, y1 = struct.unpack_from("<4i", head, start + 21)
    return x1 - x0 + 1, y1 - y0 + 1


def _radiance_pixels(content: bytes) -> Pixels:
    """Decode a Radiance HDR image, with or without run-length encoding."""
    found = _RADIANCE_SIZE.search(content[:_HEADER])
    assert found is not None
    height, width = int(found[1]), int(found[2])
    data, at = np.frombuffer(content, dtype=np.uint8), found.end()
    out = np.zeros((height, width, 4), dtype=np.uint8)
    for row in range(height):
        if bytes(data[at : at + 4]) == bytes((2, 2, width >> 8 & 255, width & 255)) and 8 <= width < 32768:
            at += 4
            for channel in range(4):
                at = _decode_runs(data, at, out[row, :, channel])
        else:
            out[row] = data[at : at + 4 * width].reshape(width, 4)
            at += 4 * width
    scale = np.ldexp(np.float32(1), out[:, :, 3].astype(np.int32) - 136)
    return np.where(out[:, :, 3:] > 0, out[:, :, :3] * scale[:, :, None], 0).astype(np.float32)


def _decode_runs(data: NDArray[np.uint8], at: int, line: NDArray[np.uint8]) -> int:
    """Decode one channel of a row that starts at index ``at``, and return the index after it."""
    filled = 0
    while filled < len(line):
        count = int(data[at])
        if count > 128:  # a run of equal bytes
            count -= 128
            line[filled : filled + count] = data[at + 1]
            at += 2
        else:
            piece = data[at + 1 : at + 1 + count]
            if not count or len(piece) < count:
                raise ValueError("truncated")
            line[filled : filled + count] = piece
            at += 1 + count
        filled += count
    if filled > len(line):
        raise ValueError("a run passes the end of its row")
    return at
