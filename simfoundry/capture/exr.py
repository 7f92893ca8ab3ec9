"""Read depth images in the format OpenEXR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.runtime.extras import install_line

# Names of channels with depth, best first: of OpenEXR itself, of Blender (`V`), of a gray image, and of files whose
# three channels are equal, as Record3D and OpenCV write them.
DEPTH_CHANNELS = ("Z", "depth", "V", "Y", "R")


def read_exr(file: Path, most: int) -> NDArray[Any]:
    """Return the depth in an OpenEXR file as it is stored, shape (h, w); in almost all such files, in meters.

    Args:
        file: The file.
        most: Maximum number of pixels.

    Raises:
        ValueError: The file is damaged or too large, or has no channel with depth, or the package that reads it is
            missing.
    """
    try:
        import OpenEXR
    except ImportError:
        raise ValueError(f"EXR files need a package; run `{install_line('sensors')}`") from None
    try:
        header = OpenEXR.File(str(file), separate_channels=True, header_only=True)
        low, high = header.header()["dataWindow"]
        width, height = (int(high[k]) - int(low[k]) + 1 for k in (0, 1))
        if not 0 < width * height <= most:
            raise ValueError(f"it has {width} x {height} pixels; the maximum is {most:.2g} pixels")
        channels = OpenEXR.File(str(file), separate_channels=True).channels()
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    name = _depth_channel(tuple(channels))
    if name is None:
        raise ValueError(f"it has the channels {', '.join(channels)}; depth is expected in one of {DEPTH_CHANNELS}")
    return np.array(channels[name].pixels)


def _depth_channel(names: tuple[str, ...]) -> str | None:
    """Return the channel with depth: the only one, or one with a known name, perhaps after that of a layer."""
    if len(names) == 1:
        return names[0]
    for wanted in DEPTH_CHANNELS:
        found = [name for name in names if name.rpartition(".")[2].lower() == wanted.lower()]
        if found:
            return min(found, key=len)
    return None
