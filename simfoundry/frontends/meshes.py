"""Import mesh files, either by copying them if documents support their format or by converting them to OBJ."""

from __future__ import annotations

import io
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, extent, read_parts, texture_png
from simfoundry.frontends.draft import MeshDraft, TextureDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import FileSearch, NotFoundError, read_xml
from simfoundry.frontends.names import plain_name
from simfoundry.frontends.shapes import Rgba
from simfoundry.geometry.frames import Array
from simfoundry.spec.files import MESH_SUFFIXES

Scale = tuple[float, float, float]

TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff")

# Relative tolerance for equal scales, which allows for double-precision rounding.
EVEN_SCALE = 1e-12

# Start of a line where Bullet's OBJ reader (tiny_obj_loader.cpp) begins a new shape; a `g` without a name does not.
_GROUP = re.compile(rb"^[ \t]*[og][ \t]", re.MULTILINE)


def mesh_draft(path: Path, scale: Scale, search: FileSearch) -> MeshDraft:
    """Return a draft for a mesh file with the given scale [m per unit] along each axis.

    The file is copied if documents support its format and scale. Otherwise, the scaled mesh is written to an OBJ file.

    Raises:
        MeshError: If the mesh cannot be read.
    """
    x, y, z = scale
    if 0.0 in scale:
        raise MeshError("SF301", f"{path.name} has a scale of zero along an axis: {scale}")
    is_even = x > 0 and abs(y - x) <= EVEN_SCALE * x and abs(z - x) <= EVEN_SCALE * x
    if path.suffix.lower() not in MESH_SUFFIXES or not is_even:
        return _baked(path, scale)
    files = {_file_name(path): path.read_bytes()}
    if path.suffix.lower() == ".obj":
        _add_materials(files, path, search)
    return MeshDraft(files, x, path if list(files) == [path.name] or len(files) > 1 else None)


@dataclass
class FileShelf:
    """A collection of files that will be written to ``folder``, a path relative to ``base``.

    Files that are already below ``root`` are not copied. ``files`` maps paths to contents, and ``taken`` maps mesh
    identities to paths.
    """

    base: Path
    folder: str
    root: Path | None
    files: dict[str, bytes] = field(default_factory=dict)
    taken: dict[int, str] = field(default_factory=dict)

    def place(self, mesh: MeshDraft) -> str:
        """Add a mesh and return its path relative to ``base``.

        Identical files are stored only once.
        """
        source = None if mesh.source is None else mesh.source.resolve()
        if source is not None and self.root is not None and source.is_relative_to(self.root.resolve()):
            return Path(os.path.relpath(source, self.base.resolve())).as_posix()
        if id(mesh) not in self.taken:
            self.taken[id(mesh)] = self._store(mesh.files)
        return self.taken[id(mesh)].removeprefix("./")

    def place_texture(self, texture: TextureDraft) -> str:
        """Add the image of a primitive and return its path relative to ``base``."""
        return self.place_file(f"{plain_name(texture.name, 'texture')}.png", texture.png)

    def place_file(self, name: str, content: bytes) -> str:
        """Add a file and return its path relative to ``base``."""
        return self._store({name: content}).removeprefix("./")

    def _store(self, files: dict[str, bytes]) -> str:
        main = next(iter(files))
        places = chain([self.folder], (f"{self.folder}/{plain_name(Path(main).stem, 'mesh')}_{k}" for k in count(2)))
        free = (p for p in places if all(self.files.get(f"{p}/{name}", data) == data for name, data in files.items()))
        place = next(free)
        self.files |= {f"{place}/{name}": data for name, data in files.items()}
        return f"{place}/{main}"


def mesh_width(mesh: MeshDraft) -> float:
    """Return the longest side [m] of a mesh's bounding box, or 0 for an unreadable mesh, which is reported later."""
    name, data = next(iter(mesh.files.items()))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        try:
            return extent(read_parts(path, mesh.scale))
        except MeshError:
            return 0.0


def _file_name(path: Path) -> str:
    """Return the name of a file, simplified if it contains characters that some formats do not support."""
    name = path.name
    simple = name.isascii() and name.replace("_", "").replace("-", "").replace(".", "").isalnum()
    return name if simple else f"{plain_name(path.stem, 'mesh')}{path.suffix.lower()}"


def _add_materials(files: dict[str, bytes], path: Path, search: FileSearch) -> None:
    """Add an OBJ file's material libraries and their textures, using the names under which they are referenced."""
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
    """Return the text after ``keyword`` in each line of an OBJ or MTL file that starts with it."""
    lines = (line.decode("utf-8", "replace").strip().partition(" ") for line in data.splitlines())
    return [rest.strip() for word, _, rest in lines if word.lower() == keyword and rest.strip()]


def _beside(name: str, folder: Path, search: FileSearch) -> Path | None:
    try:
        return search.find(name, folder)
    except NotFoundError:
        return None


def _baked(path: Path, scale: Scale) -> MeshDraft:
    """Convert a mesh file to an OBJ file in meters."""
    if path.suffix.lower() == ".dae":
        parts = read_collada(path, scale)
    elif path.suffix.lower() in (*MESH_SUFFIXES, ".gltf"):
        parts = read_parts(path, scale)
    else:
        raise MeshError("SF301", f"{path.name} has an unsupported format", "convert it to OBJ, STL, PLY or GLB")
    return mesh_of_parts(parts, plain_name(path.stem, "mesh"))


def mesh_of_parts(parts: Sequence[MeshPart], name: str) -> MeshDraft:
    """Return the parts as an OBJ file in meters, including a material for each part that has a color or texture."""
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
    """Split an OBJ file into its groups, because PyBullet uses one convex hull per group of a collision mesh.

    Returns:
        A list with the name and the mesh (in meters) of each group. The list is empty if the file is not an OBJ file,
        has fewer than two groups, or is invalid. Invalid files are reported by the mesh reader.
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
    """Return the vertices of an OBJ file and the triangles of each group.

    Groups without faces are omitted.
    """
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
    """Convert an OBJ face corner to a vertex index.

    OBJ indices start at 1; negative indices count backward from the last of ``count`` vertices.
    """
    number = int(word.partition("/")[0])
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise IndexError(word)
    return index


# Rotations from the file's axes to axes with z up, by the file's up axis.
UP = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z_UP": np.eye(3),
}

# Maximum number of nodes to visit; 30 nodes that each instantiate the next one twice expand to a billion nodes.
MAX_NODES = 10_000

# Number of decimals in coordinates [m]; pycollada uses single precision, with a resolution of 1e-7 at one meter.
DECIMALS = 8

_BROKEN_MATERIAL = re.compile(r"Material #(\S+) not found")

# Errors to ignore because they concern elements we do not use: animations, cameras, lights and missing images.
HARMLESS = ("DaeBrokenRefError", "DaeUnsupportedError")


def read_collada(path: Path, scale: tuple[float, float, float]) -> tuple[MeshPart, ...]:
    """Return the geometries in a COLLADA file, in meters and with z up.

    ``scale`` is applied after the conversion from the file's unit and up axis.

    Raises:
        MeshError: If the file cannot be read.
    """
    import collada
    from collada.common import DaeError

    try:
        # Reading the XML first rejects entities and excessively large files.
        strips = next((e for tag in ("tristrips", "trifans") for e in read_xml(path).walk() if e.tag == tag), None)
        if strips is not None:
            raise strips.refused(f"`<{strips.tag}>` is not supported", "export plain triangles")
        data = path.read_bytes()
        document = collada.Collada(io.BytesIO(data), ignore=[DaeError])
        broken = [match[1] for e in document.errors if (match := _BROKEN_MATERIAL.search(str(e)))]
        if broken:  # pycollada omits geometry with a broken material, so remove the material
            bindings = b"|".join(re.escape(name.encode()) for name in broken)
            pattern = rb'<instance_material[^>]*target="#(?:%s)"[^>]*?(?:/>|>.*?</instance_material>)' % bindings
            document = collada.Collada(io.BytesIO(re.sub(pattern, b"", data, flags=re.DOTALL)), ignore=[DaeError])
        for error in document.errors:
            if type(error).__name__ not in HARMLESS or "Geometry" in str(error):
                raise error
        parts = list(_document_parts(document, path, np.array(scale)))
    except Exception as error:  # pycollada does not wrap the exceptions of its parsers
        reason, hint = " ".join(str(error).split())[:120], ""
        if isinstance(error, ImportRefusedError | MeshError):
            reason, hint = error.reason if isinstance(error, ImportRefusedError) else error.message, error.hint
        message = f"{path.name} could not be read as a mesh: {reason}"
        raise MeshError("SF301", message, hint or "export it again") from None
    if not parts:
        raise MeshError("SF301", f"{path.name} has no triangles", "export the surface, not only points or curves")
    return tuple(parts)


def _document_parts(document: Any, path: Path, scale: Array) -> Iterator[MeshPart]:
    """Yield the geometries as posed in the visual scene, or untransformed if the file has no scene."""
    X_WF = np.eye(4)
    asset = document.assetInfo
    X_WF[:3, :3] = np.diag(scale) @ UP.get(asset.upaxis, np.eye(3)) * (asset.unitmeter or 1.0)
    if document.scene is None:
        for geometry in document.geometries:
            yield from _geometry_parts(geometry, X_WF, {}, path)
        return
    waiting, count = [(node, X_WF) for node in reversed(document.scene.nodes)], 0
    while waiting:
        node, X_WN = waiting.pop()
        count += 1
        if count > MAX_NODES:
            raise MeshError("SF301", f"the scene has more than {MAX_NODES} nodes", "merge its meshes")
        if hasattr(node, "geometry"):
            yield from _geometry_parts(node.geometry, X_WN, {m.symbol: m.target for m in node.materials}, path)
        elif hasattr(node, "matrix"):
            waiting += [(child, X_WN @ node.matrix) for child in reversed(node.children)]


def _geometry_parts(geometry: Any, X_WN: Array, materials: Mapping[str, Any], path: Path) -> Iterator[MeshPart]:
    """Yield each primitive of a geometry as a mesh part.

    ``materials`` maps material symbols to materials.
    """
    for primitive in geometry.primitives:
        if not hasattr(primitive, "triangleset") and type(primitive).__name__ != "TriangleSet":
            continue  # lines
        triangles = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
        if not len(triangles.vertex_index):
            continue
        corners, uv = np.asarray(triangles.vertex_index, dtype=np.int64), None
        used, inverse = np.unique(corners, return_inverse=True)
        points, faces = np.asarray(triangles.vertex, dtype=np.float64), inverse.reshape(-1, 3)
        if triangles.texcoordset:
            uv = np.asarray(triangles.texcoordset[0], dtype=np.float64)[triangles.texcoord_indexset[0].ravel(), :2]
            used, faces = corners.ravel(), np.arange(corners.size).reshape(-1, 3)
        vertices = np.round(points[used] @ X_WN[:3, :3].T + X_WN[:3, 3], DECIMALS)
        if np.linalg.det(X_WN[:3, :3]) < 0:
            faces = faces[:, ::-1]
        texture, rgba = _appearance(materials.get(triangles.material), path, has_uv=uv is not None)
        yield MeshPart(vertices, np.ascontiguousarray(faces, dtype=np.int32), uv, texture, rgba)


def _appearance(material: Any, path: Path, has_uv: bool) -> tuple[bytes | None, Rgba | None]:
    """Return the texture of a material as PNG, or the material's color.

    A texture is used only if its file is in the same folder as ``path`` and the mesh has texture coordinates.
    """
    from PIL import Image

    diffuse = None if material is None else material.effect.diffuse
    if diffuse is None:
        return None, None
    if not hasattr(diffuse, "sampler"):
        r, g, b, a = (min(max(float(v), 0.0), 1.0) for v in [*diffuse, 1.0, 1.0, 1.0, 1.0][:4])
        return None, (r, g, b, a if len(diffuse) > 3 and a > 0 else 1.0)
    file = path.parent / Path(diffuse.sampler.surface.image.path).name
    if not has_uv or not file.is_file():
        return None, None
    try:
        with Image.open(file) as picture:
            return texture_png(file.name, picture.convert("RGB")), None
    except OSError:  # not a readable image
        return None, None
