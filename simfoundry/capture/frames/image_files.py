"""Read image files as they are stored: pictures, NumPy arrays, and depth in OpenEXR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.runtime.extras import install_line

# Names of channels with depth, best first: of OpenEXR itself, of Blender (`V`), of a gray image, and of files whose
# three channels are equal, as Record3D and OpenCV write them.
DEPTH_CHANNELS = ("Z", "depth", "V", "Y", "R")


# Maximum number of values in an array; equals Pillow's pixel limit, which protects against decompression bombs.
NUMBERS_MAX = 178_956_970


def read_image(file: Path, mode: str = "") -> NDArray[Any]:
    """Return the values in an image file (``.npy``, ``.exr`` or a picture), shape (h, w) or (h, w, channels).

    Args:
        file: The file.
        mode: Pillow's mode to which a picture is converted, such as ``RGB``; by default, a palette image is decoded to
            its indices.

    Raises:
        ValueError, OSError: The file is damaged, truncated or too large, or has no channel with depth, or the package
            that reads it is missing.
    """
    suffix = file.suffix.lower()
    if suffix == ".exr":
        return _openexr(file)
    return _numpy(file) if suffix == ".npy" else _picture(file, mode)


def _numpy(file: Path) -> NDArray[Any]:
    stored = np.load(file, mmap_mode="r", allow_pickle=False)  # fails if the file is shorter than declared
    if stored.size > NUMBERS_MAX:
        raise ValueError(f"it contains {stored.size:.2g} numbers; the maximum is {NUMBERS_MAX:.2g}")
    return np.array(stored)


def _picture(file: Path, mode: str) -> NDArray[Any]:
    from PIL import Image

    try:
        with Image.open(file) as image:
            return np.array(image.convert(mode) if mode and image.mode != mode else image)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from None


def _openexr(file: Path) -> NDArray[Any]:
    """Return the depth in an OpenEXR file, shape (h, w); in almost all such files, in meters."""
    try:
        import OpenEXR
    except ImportError:
        raise ValueError(f"EXR files need a package; run `{install_line('sensors')}`") from None
    try:
        header = OpenEXR.File(str(file), separate_channels=True, header_only=True)
        low, high = header.header()["dataWindow"]
        width, height = (int(high[k]) - int(low[k]) + 1 for k in (0, 1))
        if not 0 < width * height <= NUMBERS_MAX:
            raise ValueError(f"it has {width} x {height} pixels; the maximum is {NUMBERS_MAX:.2g} pixels")
        channels = OpenEXR.File(str(file), separate_channels=True).channels()
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    name = _depth_channel(tuple(channels))
    if name is None:
        raise ValueError(f"it has the channels {', '.join(channels)}; depth is expected in one of {DEPTH_CHANNELS}")
    return np.array(channels[name].pixels)


def _depth_channel(names: tuple[str, ...]) -> str | None:
    """Return the channel with depth: the only channel, or one with a known name, which may follow a layer's name."""
    if len(names) == 1:
        return names[0]
    for wanted in DEPTH_CHANNELS:
        found = [name for name in names if name.rpartition(".")[2].lower() == wanted.lower()]
        if found:
            return min(found, key=len)
    return None
