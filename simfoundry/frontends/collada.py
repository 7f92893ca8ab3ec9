"""Read COLLADA meshes (.dae) with pycollada: triangles with materials, posed by their scene, in meters with z up."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, texture_png
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.xmltree import read_xml
from simfoundry.geometry.frames import Array

UP = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z_UP": np.eye(3),
}
"""Rotations from a file's axes to axes with z up."""

MAX_NODES = 10_000
"""Largest number of visited nodes: 30 nodes that each instantiate the next one twice expand to a billion."""

DECIMALS = 8
"""Decimals of coordinates [m]: pycollada uses single precision, which has a resolution of 1e-7 at one meter."""

_BROKEN_MATERIAL = re.compile(r"Material #(\S+) not found")

HARMLESS = ("DaeBrokenRefError", "DaeUnsupportedError")
"""Errors that are ignored because the elements are not used: animations, cameras, lights, missing images."""


def read_collada(path: Path, scale: tuple[float, float, float]) -> tuple[MeshPart, ...]:
    """Return the geometries of a COLLADA file; ``scale`` comes after the file's own unit and up axis.

    Raises :class:`MeshError`.
    """
    import collada
    from collada.common import DaeError

    try:
        root = read_xml(path)  # rejects entities and excessive numbers of elements or levels
        strips = next((e for tag in ("tristrips", "trifans") for e in root.walk() if e.tag == tag), None)
        if strips is not None:
            raise strips.refused(f"`<{strips.tag}>` is not read", "export plain triangles")
        data = path.read_bytes()
        document = collada.Collada(io.BytesIO(data), ignore=[DaeError])
        broken = [match[1] for e in document.errors if (match := _BROKEN_MATERIAL.search(str(e)))]
        if broken:  # pycollada omits geometry with a broken material; without the material it is kept, uncolored
            bindings = b"|".join(re.escape(name.encode()) for name in broken)
            pattern = rb'<instance_material[^>]*target="#(?:%s)"[^>]*?(?:/>|>.*?</instance_material>)' % bindings
            document = collada.Collada(io.BytesIO(re.sub(pattern, b"", data, flags=re.DOTALL)), ignore=[DaeError])
        for error in document.errors:
            if type(error).__name__ not in HARMLESS or "Geometry" in str(error):
                raise error
        parts = list(_document_parts(document, path, np.array(scale)))
    except (ImportRefusedError, MeshError) as error:
        reason, hint = (error.reason if isinstance(error, ImportRefusedError) else error.message), error.hint
        raise MeshError("SF301", f"{path.name} cannot be read as a mesh: {reason}", hint or "export it again") from None
    except Exception as error:  # pycollada does not wrap the exceptions of its parsers
        reason = " ".join(str(error).split())[:120]
        raise MeshError("SF301", f"{path.name} cannot be read as a mesh: {reason}", "export it again") from None
    if not parts:
        raise MeshError("SF301", f"{path.name} has no triangles", "export the surface, not only points or curves")
    return tuple(parts)


def _document_parts(document: Any, path: Path, scale: Array) -> Iterator[MeshPart]:
    """Yield the geometries as posed by the visual scene, or all of them without a pose if there is no scene."""
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
            raise MeshError("SF301", f"its scene has more than {MAX_NODES} nodes", "join its meshes")
        if hasattr(node, "geometry"):
            yield from _geometry_parts(node.geometry, X_WN, {m.symbol: m.target for m in node.materials}, path)
        elif hasattr(node, "matrix"):
            waiting += [(child, X_WN @ node.matrix) for child in reversed(node.children)]


def _geometry_parts(geometry: Any, X_WN: Array, materials: Mapping[str, Any], path: Path) -> Iterator[MeshPart]:
    """Yield each primitive of a geometry; ``materials`` maps its material symbols to materials."""
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


def _appearance(
    material: Any, path: Path, has_uv: bool
) -> tuple[bytes | None, tuple[float, float, float, float] | None]:
    """Return the texture as PNG if its file is beside ``path`` and there are coordinates for it, else the color."""
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
