"""Read and validate the triangles, colors and textures in mesh files."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MAX_BYTES, MAX_FACES, MeshError, Scale, implausible_size, too_large
from simfoundry.assets.mass import Array, Faces
from simfoundry.assets.textures import gltf_tree

# Number of encoded textures kept in memory, which can have up to 200 MB of pixels each.
#
# The links of a model usually share a few textures, and encoding a texture as PNG takes half a second.
MAX_ENCODED = 4

# Compression of textures: level 3 takes a third of the time of level 6, and its files are 11 % larger.
LEVEL = 3

# Maximum number of pixels in a texture; larger textures take a GiB and a minute, and no simulator renders them.
MAX_PIXELS = 8192**2


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A single geometry in a mesh file.

    Attributes:
        vertices: Vertex positions [m], shape (n, 3).
        faces: Vertex indices of the triangles (int32), shape (m, 3).
        uv: Texture coordinates with v up, shape (n, 2), or None.
        texture: Texture image as PNG bytes, or None.
        rgba: Color in [0, 1], or None if the file does not specify a color.
    """

    vertices: Array
    faces: Faces
    uv: Array | None = None
    texture: bytes | None = None
    rgba: tuple[float, float, float, float] | None = None


def read_mesh(path: Path, scale: Scale = 1.0) -> tuple[MeshPart, ...]:
    """Return the geometries in a mesh file, in meters and with z up.

    glTF files are rotated, because the glTF standard requires y up. A non-uniform ``scale`` applies after the rotation.

    Raises:
        MeshError: If the file has no usable triangles or its size is implausible.
    """
    parts = read_parts(path, file_scale(path, scale))
    wrong = implausible_size(path.name, extent(parts), scale)
    if wrong is not None:
        raise wrong
    return parts


def _is_y_up(path: Path) -> bool:
    return path.suffix.lower() in (".glb", ".gltf")


def file_scale(path: Path, scale: Scale) -> Scale:
    """Return a scale along the axes of a mesh, with z up, as a scale along the axes of its file."""
    if not isinstance(scale, tuple) or not _is_y_up(path):
        return scale
    x, y, z = scale
    return x, z, y


def sides(parts: tuple[MeshPart, ...]) -> Array:
    """Return the extents of a mesh's bounding box [m], shape (3,)."""
    return np.asarray(np.ptp(np.concatenate([p.vertices for p in parts]), axis=0))


def extent(parts: tuple[MeshPart, ...]) -> float:
    """Return the longest side of a mesh's bounding box [m]."""
    return float(sides(parts).max())


def read_parts(path: Path, scale: Scale = 1.0) -> tuple[MeshPart, ...]:
    """Return the geometries in a mesh file, like :func:`read_mesh`, but do not check that their size is plausible.

    ``scale`` may be non-uniform or negative along the file's axes. In any case, faces point outward.
    """
    import trimesh

    check_counts(path)
    try:
        with np.errstate(all="ignore"):  # non-finite numbers are reported below
            scene = trimesh.load_scene(path, process=False)
            meshes = [m for m in scene.dump(concatenate=False) if isinstance(m, trimesh.Trimesh) and len(m.faces)]
    except Exception as error:  # trimesh does not wrap the exceptions of its parsers
        reason = " ".join(str(error).split())[:120]
        raise MeshError("SF301", f"{path.name} could not be read as a mesh: {reason}", "export it again") from None
    if not meshes:
        raise MeshError("SF301", f"{path.name} has no triangles", "export the surface, not only points or curves")
    if sum(len(m.faces) for m in meshes) > MAX_FACES:
        raise MeshError("SF301", f"{path.name} has more than {MAX_FACES} triangles", "decimate it first")
    if any(m.faces.min() < 0 or m.faces.max() >= len(m.vertices) for m in meshes):
        raise MeshError("SF301", f"{path.name} has triangles that refer to nonexistent vertices", "export it again")
    parts = tuple(_part(path, m, scale) for m in meshes)
    bad = sum(int((~np.isfinite(part.vertices)).any(axis=1).sum()) for part in parts)
    if bad:
        message = f"{path.name} has {bad} vertices with non-finite coordinates"
        raise MeshError("SF301", message, "repair or export it again")
    return parts


def _part(path: Path, mesh: Any, scale: Scale) -> MeshPart:
    y_up = _is_y_up(path)
    used, faces = np.unique(mesh.faces, return_inverse=True)  # vertices without faces are not part of the surface
    if np.prod(np.broadcast_to(scale, 3)) < 0:
        faces = np.ascontiguousarray(faces.reshape(-1, 3)[:, ::-1])
    vertices = np.array(mesh.vertices, dtype=np.float64)[used] * np.asarray(scale)
    if y_up:
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])
    uv, texture, rgba = _appearance(path.name, mesh)
    if rgba is not None and y_up:  # glTF colors are linear; colors in other formats are sRGB
        rgba = (srgb_of_linear(rgba[0]), srgb_of_linear(rgba[1]), srgb_of_linear(rgba[2]), rgba[3])
    uv = None if uv is None else uv[used]
    return MeshPart(vertices, faces.reshape(-1, 3).astype(np.int32), uv, texture, rgba)


def srgb_of_linear(linear: float) -> float:
    """Convert a linear color value in [0, 1] to sRGB in [0, 1] (IEC 61966-2-1)."""
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def _appearance(name: str, mesh: Any) -> tuple[Array | None, bytes | None, tuple[float, float, float, float] | None]:
    """Return the texture coordinates, the texture as PNG, and the color of a trimesh mesh.

    If a mesh has both a texture and a color, the texture is multiplied by the color.
    """
    visual = mesh.visual
    if visual.kind == "texture":
        material, uv = visual.material, getattr(visual, "uv", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        factor = getattr(material, "baseColorFactor", None)
        if image is not None and uv is not None:
            tint = None if factor is None else _rgba(np.asarray(factor))
            return np.array(uv, dtype=np.float64)[:, :2], texture_png(name, image), tint
        color = getattr(material, "diffuse", None) if factor is None else factor
        return None, None, None if color is None else _rgba(np.asarray(color))
    if visual.kind in ("vertex", "face"):
        colors = visual.vertex_colors if visual.kind == "vertex" else visual.face_colors
        return None, None, _rgba(np.asarray(colors, dtype=np.float64).mean(axis=0))
    return None, None, None


def _rgba(color: Array) -> tuple[float, float, float, float]:
    values = [float(v) / 255.0 if np.max(color) > 1.0 else float(v) for v in color]
    values += [1.0] * (4 - len(values))
    return values[0], values[1], values[2], values[3]


def texture_png(name: str, image: Any) -> bytes:
    """Encode an image as PNG.

    Raises:
        MeshError: If the image is too large.
    """
    width, height = image.size
    if width * height > MAX_PIXELS:
        most = math.isqrt(MAX_PIXELS)
        message = f"{name} has a texture of {width} x {height} pixels; the limit is {most} x {most}"
        raise MeshError("SF301", message, "make the texture smaller")
    image = image.convert("RGBA" if image.mode in ("RGBA", "LA", "P") else "RGB")
    return _encoded(image.mode, image.size, image.tobytes())


@lru_cache(maxsize=MAX_ENCODED)
def _encoded(mode: str, size: tuple[int, int], pixels: bytes) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.frombytes(mode, size, pixels).save(stream, format="PNG", compress_level=LEVEL)
    return stream.getvalue()


def merged(parts: Sequence[MeshPart]) -> tuple[Array, Faces]:
    """Concatenate the geometries of a mesh file.

    Returns:
        The vertices [m], shape (n, 3), and the faces, shape (m, 3), of all geometries.
    """
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)])
    return np.concatenate([p.vertices for p in parts]), faces.astype(np.int32)


def weld(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Merge coincident vertices (for example, at texture seams), and remove degenerate faces and unused vertices."""
    first, place = _places(vertices)
    joined = place[faces]
    proper = (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    used, corners = np.unique(joined[proper], return_inverse=True)
    return vertices[first][used], corners.reshape(-1, 3).astype(np.int32)


def adjacent_faces(vertices: Array, faces: Faces) -> NDArray[np.int64]:
    """Return the pairs of faces that share an edge, whose vertices may only coincide, as an array of shape (n, 2)."""
    joined = _places(vertices)[1][faces]
    edges = np.sort(joined[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort((owner, edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    return np.column_stack([owner[:-1][same], owner[1:][same]])


def _places(vertices: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first vertex at each place, and the number of the place of each vertex."""
    tolerance = 1e-7 * max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    cells = np.round((vertices - vertices.min(axis=0)) / tolerance).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return first.astype(np.int64), inverse.reshape(-1).astype(np.int64)


def open_edges(faces: Faces) -> int:
    """Return the number of directed edges in welded faces that have no opposite edge.

    The result is 0 for a closed surface.
    """
    if not len(faces):
        return 0
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    n = int(faces.max()) + 1
    forward, n_forward = np.unique(edges[:, 0] * n + edges[:, 1], return_counts=True)
    backward, n_backward = np.unique(edges[:, 1] * n + edges[:, 0], return_counts=True)
    keys = np.union1d(forward, backward)
    count = np.zeros(len(keys), dtype=np.int64)
    count[np.searchsorted(keys, forward)] += n_forward
    count[np.searchsorted(keys, backward)] -= n_backward
    return int(np.abs(count).sum() // 2)


# Maximum number of points in a mesh; each triangle needs at most three.
MAX_POINTS = 3 * MAX_FACES

# Sizes [bytes] of the header of a binary STL (an 80-byte comment and a 4-byte count) and of each triangle.
STL_HEAD, STL_FACE = 84, 50

# Maximum size of a PLY header [bytes]; splats with all spherical harmonics need 2 kB.
PLY_HEAD = 100_000
PLY_ELEMENT = re.compile(rb"^element[ \t]+(vertex|face)[ \t]+(\S+)", re.MULTILINE)
# glTF primitive mode for triangle lists, which is also the default (glTF 2.0, section 3.7.2.1).
GLB_TRIANGLES = 4


def check_counts(path: Path) -> None:
    """Check that a mesh file does not have too many bytes, triangles or points.

    Corrupt files pass this check, because the mesh reader reports them.

    Raises:
        MeshError: If a limit is exceeded.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise too_large(path.name, size)
    counter = _COUNTERS.get(path.suffix.lower())
    triangles, points = counter(path) if counter is not None else (0, 0)
    if triangles > MAX_FACES:
        raise MeshError("SF301", f"{path.name} has {triangles} triangles; the limit is {MAX_FACES}", "decimate it")
    if points > MAX_POINTS:
        raise MeshError("SF301", f"{path.name} has {points} points; the limit is {MAX_POINTS}", "decimate it")


def _stl(path: Path) -> tuple[int, int]:
    with path.open("rb") as stream:
        head = stream.read(STL_HEAD)
        count = int.from_bytes(head[80:], "little")
        if STL_HEAD + STL_FACE * count == path.stat().st_size:
            return count, 0
        return _lines(path, b"facet normal"), 0


def _obj(path: Path) -> tuple[int, int]:
    return _lines(path, b"\nf "), _lines(path, b"\nv ")


def _lines(path: Path, start: bytes) -> int:
    """Count the lines that begin with ``start``. Lines whose beginning crosses a block boundary are missed."""
    count = 0
    with path.open("rb") as stream:
        while block := stream.read(2**24):
            count += block.count(start)
    return count


def _ply(path: Path) -> tuple[int, int]:
    with path.open("rb") as stream:
        head = stream.read(PLY_HEAD).partition(b"end_header")[0]
    counts = {name: int(count) for name, count in PLY_ELEMENT.findall(head) if count.isdigit() and len(count) < 40}
    return counts.get(b"face", 0), counts.get(b"vertex", 0)


def _glb(path: Path) -> tuple[int, int]:
    """Return the total numbers of triangles and points. Each mesh is counted once per node that uses it."""
    try:
        tree = gltf_tree(path, MAX_BYTES)
        counts = [int(accessor["count"]) for accessor in tree["accessors"]]
        meshes = [[_primitive(part, counts) for part in mesh["primitives"]] for mesh in tree["meshes"]]
        shown = [meshes[node["mesh"]] for node in tree.get("nodes", []) if "mesh" in node] or meshes
    except (ValueError, KeyError, TypeError, IndexError, AttributeError):
        return 0, 0
    return sum(n for mesh in shown for n, _ in mesh), sum(n for mesh in shown for _, n in mesh)


def _primitive(part: Any, counts: list[int]) -> tuple[int, int]:
    points = counts[part["attributes"]["POSITION"]]
    corners = counts[part["indices"]] if "indices" in part else points
    return corners // 3 if part.get("mode", GLB_TRIANGLES) == GLB_TRIANGLES else 0, points


_COUNTERS: dict[str, Callable[[Path], Any]] = {".stl": _stl, ".obj": _obj, ".ply": _ply, ".glb": _glb, ".gltf": _glb}
