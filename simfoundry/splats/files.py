"""Splat files by format: read, written, and checked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh_summary import file_digest
from simfoundry.spec.files import SPLAT_SUFFIXES

if TYPE_CHECKING:
    from simfoundry.splats.gaussians import GaussianSplat


def read_splat(path: Path, scale: float = 1.0) -> GaussianSplat:
    """Read the Gaussians in a PLY, SPZ, GLB or USD file, in meters and with z up.

    Formats whose axes have y up are turned; those of PLY files are taken as they are.

    Args:
        path: The file.
        scale: Length of one unit in the file [m]; of a unit that the file states, its multiple.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    from simfoundry.geometry.frames import IDENTITY
    from simfoundry.geometry.similarity import Similarity
    from simfoundry.splats.gaussians import MAX_SPLAT_BYTES, gaussian_splat

    _check_suffix(path)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise MeshError("SF301", f"{path.name} could not be read: {error.strerror or error}") from None
    if size > MAX_SPLAT_BYTES:
        message = f"{path.name} has {size / 2**20:.0f} MiB; the limit is {MAX_SPLAT_BYTES // 2**20} MiB"
        raise MeshError("SF301", message, "remove Gaussians that are transparent or far away first")
    splat = _read(path)
    if scale == 1.0:
        return splat
    moved = splat.moved(Similarity(IDENTITY, scale))
    return gaussian_splat(path.name, **vars(moved))  # a scale can exceed single precision


def _read(path: Path) -> GaussianSplat:
    match path.suffix.lower():
        case ".ply":
            from simfoundry.splats.ply import read_ply

            return read_ply(path)
        case ".spz":
            from simfoundry.splats.spz import read_spz

            return read_spz(path)
        case ".glb":
            from simfoundry.splats.gltf import read_gltf

            return read_gltf(path)
        case _:
            from simfoundry.splats.usd import read_usd

            return read_usd(path)


def splat_bytes(splat: GaussianSplat, name: str) -> bytes:
    """Return a splat in the format that the suffix of a file name states. Equal splats give equal bytes.

    Raises:
        MeshError: If the suffix stands for no format, or if the format cannot represent the splat.
    """
    path = Path(name)
    _check_suffix(path)
    match path.suffix.lower():
        case ".ply":
            from simfoundry.splats.ply import ply_bytes

            return ply_bytes(splat)
        case ".spz":
            from simfoundry.splats.spz import spz_bytes

            return spz_bytes(splat)
        case ".glb":
            from simfoundry.splats.gltf import gltf_bytes

            return gltf_bytes(splat)
        case ".usda":
            from simfoundry.splats.usd import splat_text

            return splat_text(splat)
        case _:
            from simfoundry.splats.usd import splat_layer

            return splat_layer(splat)


def check_splat(path: Path, scale: float, store: Cache) -> None:
    """Check that a splat can be read. Usable files are remembered in ``store``, because reading one takes seconds.

    Raises:
        MeshError: If the file is not a usable splat.
    """
    try:
        key = key_of("usable splat 2", file_digest(path), path.suffix.lower(), repr(scale))
    except OSError as error:
        raise MeshError("SF301", f"{path.name} could not be read: {error.strerror or error}") from None
    if store.get(key) is None:
        read_splat(path, scale)
        store.put(key, b"usable")


def _check_suffix(path: Path) -> None:
    if path.suffix.lower() not in SPLAT_SUFFIXES:
        known = ", ".join(SPLAT_SUFFIXES)
        raise MeshError("SF301", f"{path.name} has no suffix of a splat format", f"the formats are {known}")
