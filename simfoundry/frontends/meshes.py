"""Mesh files taken over as they are where the language reads them, and written anew as OBJ where it does not."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, extent, read_parts
from simfoundry.frontends.draft import MeshDraft
from simfoundry.frontends.file_search import NotFoundError, Search
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Array
from simfoundry.spec.files import MESH_SUFFIXES

TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff")


def mesh_draft(path: Path, scale: tuple[float, float, float], search: Search) -> MeshDraft:
    """A mesh file at a scale [m per unit]; it is copied if the language can say that, and baked into an OBJ if not.

    Raises :class:`MeshError`.
    """
    x, y, z = scale
    if 0.0 in scale:
        raise MeshError("SF301", f"{path.name} is scaled to nothing: {scale}")
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        return _baked(path, scale)
    if not (x > 0 and abs(y - x) <= 1e-12 * x and abs(z - x) <= 1e-12 * x):
        return _baked(path, scale)
    files = {file_name(path): path.read_bytes()}
    if suffix == ".obj":
        _add_materials(files, path, search)
    source = path if list(files) == [path.name] or len(files) > 1 else None
    return MeshDraft(files, x, source)


def width(mesh: MeshDraft) -> float:
    """The longest side of the bounds of a mesh [m]; 0 where it cannot be read, which is found where it is used."""
    name, data = next(iter(mesh.files.items()))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        try:
            return extent(read_parts(path, mesh.scale))
        except MeshError:
            return 0.0


def file_name(path: Path) -> str:
    """The name of a file as it is, if every format can hold it; else a plain one."""
    name = path.name
    simple = name.isascii() and name.replace("_", "").replace("-", "").replace(".", "").isalnum()
    return name if simple else f"{plain_name(path.stem, 'mesh')}{path.suffix.lower()}"


def _add_materials(files: dict[str, bytes], path: Path, search: Search) -> None:
    """Add the material libraries of an OBJ, and their textures, under the names by which they are called."""
    main = next(iter(files))
    for line in files[main].splitlines():
        if not line.startswith(b"mtllib "):
            continue
        name = line[7:].decode("utf-8", "replace").strip()
        found = _near(name, path.parent, search)
        if found is None or "/" in name or "\\" in name or name in files:
            continue
        data = found.read_bytes()
        files[name] = data
        for entry in data.splitlines():
            words = entry.decode("utf-8", "replace").split()
            if len(words) > 1 and words[0].lower() == "map_kd":
                texture = words[-1]
                image = _near(texture, path.parent, search)
                if image is not None and image.suffix.lower() in TEXTURE_SUFFIXES and "/" not in texture:
                    files[texture] = image.read_bytes()


def _near(name: str, folder: Path, search: Search) -> Path | None:
    try:
        return search.find(name, folder)
    except NotFoundError:
        return None


def _baked(path: Path, scale: tuple[float, float, float]) -> MeshDraft:
    """The mesh as an OBJ in metres."""
    suffix = path.suffix.lower()
    if suffix == ".dae":
        from simfoundry.frontends.collada import read_collada

        parts = read_collada(path, scale)
    elif suffix in (*MESH_SUFFIXES, ".gltf"):
        parts = read_parts(path, scale)
    else:
        raise MeshError("SF301", f"{path.name} is of a kind that is not read", "convert it to OBJ, STL, PLY or GLB")
    return mesh_of_parts(parts, plain_name(path.stem, "mesh"))


def mesh_of_parts(parts: Sequence[MeshPart], name: str) -> MeshDraft:
    """An OBJ in metres with a material for each part that has a colour or texture of its own."""
    out, library = io.StringIO(), io.StringIO()
    pictures: dict[str, bytes] = {}
    for k, part in enumerate(parts):
        _material(library, pictures, part, name, k)
    if library.getvalue():
        out.write(f"mtllib {name}.mtl\n")
    points = textured = 1
    for k, part in enumerate(parts):
        out.write(_rows("v %.9g %.9g %.9g\n", part.vertices))
        if part.uv is not None:
            out.write(_rows("vt %.9g %.9g\n", part.uv))
        if part.texture is not None or part.rgba is not None:
            out.write(f"usemtl m{k}\n")
        elif library.getvalue():
            out.write(f"g p{k}\n")
        corners = part.faces.astype(np.int64)
        if part.uv is None:
            out.write(_rows("f %d %d %d\n", corners + points))
        else:
            both = np.stack([corners + points, corners + textured], axis=2).reshape(len(corners), 6)
            out.write(_rows("f %d/%d %d/%d %d/%d\n", both))
            textured += len(part.uv)
        points += len(part.vertices)
    files = {f"{name}.obj": out.getvalue().encode()}
    if library.getvalue():
        files[f"{name}.mtl"] = library.getvalue().encode()
    return MeshDraft(files | pictures)


def _material(library: io.StringIO, pictures: dict[str, bytes], part: MeshPart, name: str, k: int) -> None:
    if part.texture is None and part.rgba is None:
        return
    r, g, b, a = part.rgba or (1.0, 1.0, 1.0, 1.0)
    library.write(f"newmtl m{k}\nKd {r:.6g} {g:.6g} {b:.6g}\nd {a:.6g}\n")
    if part.texture is not None:
        same = next((n for n, data in pictures.items() if data == part.texture), None)
        picture = same or f"{name}_{len(pictures)}.png"
        pictures[picture] = part.texture
        library.write(f"map_Kd {picture}\n")


def _rows(form: str, values: Array | np.ndarray[Any, Any]) -> str:
    return (form * len(values)) % tuple((np.asarray(values) + 0).ravel().tolist())
