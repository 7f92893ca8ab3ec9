"""Read 3D Gaussian splats from PLY files written by trainers, and convert the raw parameters to physical values.

The files contain raw training parameters (Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023): opacities before the
logistic function, scales before the exponential, unnormalized quaternions, and colors as spherical harmonics grouped by
channel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh_summary import file_digest

# Maximum number of Gaussians in a splat; each takes 250 bytes in memory, and a room has about one million.
MAX_GAUSSIANS = 5_000_000

EXPORT = "export it again from the trainer as a PLY file"

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Gaussians:
    """A splat of n Gaussians in single precision, expressed along the axes of its file.

    Attributes:
        positions: Centers [m], shape (n, 3).
        scales: Standard deviations along the axes of each Gaussian [m], shape (n, 3).
        rotations: Unit quaternions (wxyz), shape (n, 4).
        opacities: Opacities in [0, 1], shape (n,).
        harmonics: Spherical harmonics coefficients for red, green and blue in ascending order, shape
            (n, (degree + 1)^2, 3).
    """

    positions: Array
    scales: Array
    rotations: Array
    opacities: Array
    harmonics: Array

    @property
    def degree(self) -> int:
        """Return the maximum degree of the spherical harmonics."""
        return math.isqrt(self.harmonics.shape[1]) - 1


def read_splat(path: Path, scale: float = 1.0) -> Gaussians:
    """Read the Gaussians in a PLY file, in meters.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    raw = _vertices(path)
    names = raw.dtype.names or ()
    missing = [n for n in (*_XYZ, *_DC, *_SCALE, *_ROTATION, "opacity") if n not in names]
    if missing:
        raise MeshError("SF301", f"{path.name} is not a Gaussian splat: the property `{missing[0]}` is missing", EXPORT)
    if not 0 < len(raw) <= MAX_GAUSSIANS:
        message = f"{path.name} has {len(raw)} Gaussians; it must have 1 to {MAX_GAUSSIANS}"
        raise MeshError("SF301", message, EXPORT)
    rotations = _columns(raw, _ROTATION)
    lengths = np.linalg.norm(rotations, axis=1, keepdims=True)
    turned = lengths != 0
    with np.errstate(over="ignore"):  # infinite values are reported below
        found = Gaussians(
            positions=_single(_columns(raw, _XYZ) * scale),
            scales=_single(np.exp(_columns(raw, _SCALE)) * scale),
            rotations=_single(np.where(turned, rotations / np.where(turned, lengths, 1.0), [1.0, 0.0, 0.0, 0.0])),
            opacities=_single(1.0 / (1.0 + np.exp(-_columns(raw, ("opacity",))[:, 0]))),
            harmonics=_single(_harmonics(path, raw, names)),
        )
    if not all(np.isfinite(values).all() for values in vars(found).values()):
        raise MeshError("SF301", f"{path.name} has Gaussians with non-finite values", EXPORT)
    return found


def check_splat(path: Path, scale: float, store: Cache) -> None:
    """Check that a splat can be read. Usable files are remembered in ``store``, because reading one takes seconds.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    try:
        key = key_of("usable splat", file_digest(path), repr(scale))
    except OSError as error:
        raise MeshError("SF301", f"{path.name} could not be read: {error.strerror or error}", EXPORT) from None
    if store.get(key) is None:
        read_splat(path, scale)
        store.put(key, b"usable")


_XYZ = ("x", "y", "z")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
# Total number of coefficients after the first of each channel, for degrees 0 to 3.
_RESTS = (0, 9, 24, 45)


def _vertices(path: Path) -> Any:
    """Return the vertex element of a PLY file as a structured array."""
    import trimesh

    try:
        cloud = trimesh.load(path, file_type="ply", process=False)
        return np.asarray(cloud.metadata["_ply_raw"]["vertex"]["data"])
    except Exception as error:  # trimesh does not wrap the exceptions of its parsers
        reason = " ".join(str(error).split())[:120]
        raise MeshError("SF301", f"{path.name} could not be read as a splat: {reason}", EXPORT) from None


def _columns(raw: Any, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([np.asarray(raw[name], dtype=np.float64).reshape(-1) for name in names], axis=1)


def _harmonics(path: Path, raw: Any, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Return spherical harmonics coefficients in ascending order, as an array of shape (n, k, 3).

    The file contains the first coefficient of each channel, followed by the remaining coefficients channel by channel.
    """
    rest = sum(1 for name in names if name.startswith("f_rest_"))
    if rest not in _RESTS or any(f"f_rest_{k}" not in names for k in range(rest)):
        known = ", ".join(map(str, _RESTS))
        raise MeshError("SF301", f"{path.name} has {rest} `f_rest` properties; a splat must have {known}", EXPORT)
    first = _columns(raw, _DC)[:, None, :]
    if not rest:
        return first
    others = _columns(raw, tuple(f"f_rest_{k}" for k in range(rest))).reshape(len(raw), 3, rest // 3)
    return np.concatenate([first, others.transpose(0, 2, 1)], axis=1)


def _single(values: NDArray[np.float64]) -> Array:
    out = values.astype(np.float32)
    out.setflags(write=False)
    return out
