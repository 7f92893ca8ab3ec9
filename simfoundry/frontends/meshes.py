"""Mesh files of imports: copied if documents support the format, else converted to OBJ; OBJ groups can be split."""

from __future__ import annotations

import io
import re
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, extent, read_parts
from simfoundry.frontends.draft import MeshDraft
from simfoundry.frontends.file_search import FileSearch, NotFoundError
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Array
from simfoundry.spec.files import MESH_SUFFIXES

Scale = tuple[float, float, float]

TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff")

EVEN_SCALE = 1e-12
"""Relative tolerance for equal scales: rounding of double precision."""

_GROUP = re.compile(rb"^[ \t]*[og][ \t]", re.MULTILINE)
"""Line prefixes at which Bullet's reader (tiny_obj_loader.cpp) starts a new shape; a bare `g` does not."""


def mesh_draft(path: Path, scale: Scale, search: FileSearch) -> MeshDraft:
    """Return a mesh file at a scale [m per unit]: copied if documents can express the scale, else baked into an OBJ.

    Raises :class:`MeshError`.
    """
    x, y, z = scale
    if 0.0 in scale:
        raise MeshError("SF301", f"{path.name} is scaled to nothing: {scale}")
    is_even = x > 0 and abs(y - x) <= EVEN_SCALE * x and abs(z - x) <= EVEN_SCALE * x
    if path.suffix.lower() not in MESH_SUFFIXES or not is_even:
        return _baked(path, scale)
    files = {_file_name(path): path.read_bytes()}
    if path.suffix.lower() == ".obj":
        _add_materials(files, path, search)
    return MeshDraft(files, x, path if list(files) == [path.name] or len(files) > 1 else None)


def mesh_width(mesh: MeshDraft) -> float:
    """Return the longest side of a mesh's bounding box [m]; 0 if it cannot be read, which is reported later."""
    name, data = next(iter(mesh.files.items()))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        try:
            return extent(read_parts(path, mesh.scale))
        except MeshError:
            return 0.0


def _file_name(path: Path) -> str:
    """Return the name of a file, simplified if some format does not support it."""
    name = path.name
    simple = name.isascii() and name.replace("_", "").replace("-", "").replace(".", "").isalnum()
    return name if simple else f"{plain_name(path.stem, 'mesh')}{path.suffix.lower()}"


def _add_materials(files: dict[str, bytes], path: Path, search: FileSearch) -> None:
    """Add the material libraries of an OBJ and their textures, under the names that the files use."""
    for name in _names_after(files[next(iter(files))], "mtllib"):
        found = _beside(name, path.parent, search)
        if found is None or "/" in name or "\\" in name or name in files:
            continue
        files[name] = found.read_bytes()
        for texture in (entry.split()[-1] for entry in _names_after(files[name], "map_kd")):
            image = _beside(texture, path.parent, search)
            if image is not None and image.suffix.lower() in TEXTURE_SUFFIXES and "/" not in texture:
                files[texture] = image.read_bytes()


def _names_after(data: bytes, keyword: str) -> list[str]:
    """Return the rest of each line of an OBJ or MTL file that starts with a keyword."""
    lines = (line.decode("utf-8", "replace").strip().partition(" ") for line in data.splitlines())
    return [rest.strip() for word, _, rest in lines if word.lower() == keyword and rest.strip()]


def _beside(name: str, folder: Path, search: FileSearch) -> Path | None:
    try:
        return search.find(name, folder)
    except NotFoundError:
        return None


def _baked(path: Path, scale: Scale) -> MeshDraft:
    """Return the mesh as an OBJ in meters."""
    if path.suffix.lower() == ".dae":
        from simfoundry.frontends.collada import read_collada

        parts = read_collada(path, scale)
    elif path.suffix.lower() in (*MESH_SUFFIXES, ".gltf"):
        parts = read_parts(path, scale)
    else:
        raise MeshError("SF301", f"{path.name} is of a kind that is not read", "convert it to OBJ, STL, PLY or GLB")
    return mesh_of_parts(parts, plain_name(path.stem, "mesh"))


def mesh_of_parts(parts: Sequence[MeshPart], name: str) -> MeshDraft:
    """Return an OBJ in meters with a material for each part that has its own color or texture."""
    out, library = io.StringIO(), io.StringIO()
    pictures: dict[str, bytes] = {}
    for k, part in enumerate(parts):
        _add_material(library, pictures, part, name, k)
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


def _add_material(library: io.StringIO, pictures: dict[str, bytes], part: MeshPart, name: str, k: int) -> None:
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


Groups = list[tuple[str, list[tuple[int, int, int]]]]


def group_drafts(path: Path, scale: Scale) -> list[tuple[str, MeshDraft]]:
    """Return a mesh [m] for each group of an OBJ with several groups, by group name; empty for any other file.

    PyBullet creates one convex hull per group for collision meshes of a URDF. Errors in an OBJ are reported by the mesh
    reader.
    """
    data = path.read_bytes() if path.suffix.lower() == ".obj" else b""
    if not _GROUP.search(data):
        return []
    try:
        points, groups = _groups(data.decode("utf-8", "replace"))
    except (ValueError, IndexError):
        return []
    if len(groups) < 2:
        return []
    vertices = np.array(points, dtype=np.float64).reshape(-1, 3) * scale
    out = []
    for k, (name, triangles) in enumerate(groups, 1):
        used, corners = np.unique(np.array(triangles, dtype=np.int64), return_inverse=True)
        faces = corners.reshape(-1, 3).astype(np.int32)
        part = MeshPart(vertices[used], faces if np.prod(scale) > 0 else np.ascontiguousarray(faces[:, ::-1]))
        out.append((name or f"group_{k}", mesh_of_parts([part], plain_name(f"{path.stem}_{k}", "mesh"))))
    return out


def _groups(text: str) -> tuple[list[list[float]], Groups]:
    """Return the vertices and the triangles by group of an OBJ; groups without faces are omitted."""
    points: list[list[float]] = []
    groups: Groups = [("", [])]
    for words in filter(None, map(str.split, text.splitlines())):
        if words[0] == "v":
            points.append([float(word) for word in words[1:4]])
        elif words[0] in ("o", "g") and len(words) > 1:
            groups.append((words[1], []))
        elif words[0] == "f":
            corners = [_vertex(word, len(points)) for word in words[1:]]
            groups[-1][1].extend((corners[0], a, b) for a, b in pairwise(corners[1:]))
    return points, [(name, triangles) for name, triangles in groups if triangles]


def _vertex(word: str, count: int) -> int:
    """Return the vertex index of a face corner, which counts from 1 or, if negative, back from the last vertex."""
    number = int(word.partition("/")[0])
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise IndexError(word)
    return index
