"""Write surfaces as binary glTF 2.0 (GLB), which browsers show with materials and textures.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html. The axes stay as they are, with z up.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Geometry, Mesh
from simfoundry.render.surface import FEW_SEGMENTS, surface_patch

# Surface of dielectrics such as wood, ceramics and plastics: matt, without metal.
ROUGHNESS, METALLIC = 0.75, 0.0

# Component types, buffer targets and primitive modes of the specification.
_FLOAT, _UINT32, _VERTICES, _INDICES = 5126, 5125, 34962, 34963


# Extension for surfaces that have their own colors whatever the lights.
_UNLIT = "KHR_materials_unlit"


def glb_of(pieces: Sequence[tuple[Geometry, Pose, Sequence[float]]], is_lit: bool = True) -> bytes:
    """Return a GLB file with one primitive for each piece.

    Args:
        pieces: Each geometry with its pose in the common frame, and its color (sRGB and opacity in [0, 1], shape (4,)).
        is_lit: Whether lights matter; otherwise, the surfaces have exactly their colors.
    """
    writer = _GlbWriter(is_lit)
    for geometry, X_FG, rgba in pieces:
        writer.add(geometry, X_FG, rgba)
    return writer.bytes()


class _GlbWriter:
    """The parts of a file, which are added one after another."""

    def __init__(self, is_lit: bool = True) -> None:
        self.is_lit = is_lit
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []
        self.primitives: list[dict[str, Any]] = []

    def add(self, geometry: Geometry, X_FG: Pose, rgba: Sequence[float]) -> None:
        """Add a surface with its material."""
        patch = surface_patch(geometry, FEW_SEGMENTS)
        if not len(patch.corners):
            return
        texture = geometry.texture if isinstance(geometry, Mesh) and geometry.uv is not None else None
        points = X_FG.apply(patch.corners.reshape(-1, 3))
        normals = patch.normals.reshape(-1, 3) @ X_FG.rotation.T
        uv = patch.uv.reshape(-1, 2) * (1.0, -1.0) + (0.0, 1.0)  # v points down in glTF
        columns = (points, normals, uv) if texture is not None else (points, normals)
        table = np.ascontiguousarray(np.concatenate(columns, axis=1), dtype=np.float32)
        keys = table.view(np.dtype((np.void, table.dtype.itemsize * table.shape[1]))).reshape(-1)
        _, first, index = np.unique(keys, return_index=True, return_inverse=True)
        table = table[first]
        attributes = {"POSITION": self._vertices(table[:, :3], True), "NORMAL": self._vertices(table[:, 3:6])}
        if texture is not None:
            attributes["TEXCOORD_0"] = self._vertices(table[:, 6:])
        indices = self._accessor(index.reshape(-1).astype(np.uint32), "SCALAR", _UINT32, _INDICES)
        material = self._material(rgba, texture, patch.closed)
        self.primitives.append({"attributes": attributes, "indices": indices, "material": material})

    def _vertices(self, values: np.ndarray[Any, Any], bounds: bool = False) -> int:
        index = self._accessor(values.astype(np.float32), "VEC2" if values.shape[1] == 2 else "VEC3", _FLOAT, _VERTICES)
        if bounds:
            self.accessors[index] |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return index

    def _accessor(self, values: np.ndarray[Any, Any], kind: str, component: int, target: int) -> int:
        view = self._view(np.ascontiguousarray(values).tobytes(), target)
        self.accessors.append({"bufferView": view, "componentType": component, "count": len(values), "type": kind})
        return len(self.accessors) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        if target is not None:
            self.views[-1]["target"] = target
        self.data += data
        return len(self.views) - 1

    def _material(self, rgba: Sequence[float], texture: bytes | None, closed: bool) -> int:
        surface: dict[str, Any] = {
            "baseColorFactor": [*(_linear(float(v)) for v in rgba[:3]), float(rgba[3])],
            "metallicFactor": METALLIC,
            "roughnessFactor": ROUGHNESS,
        }
        if texture is not None:
            self.images.append({"bufferView": self._view(texture), "mimeType": "image/png"})
            surface["baseColorTexture"] = {"index": len(self.images) - 1}
        material: dict[str, Any] = {"pbrMetallicRoughness": surface, "doubleSided": not closed}
        if rgba[3] < 1:
            material["alphaMode"] = "BLEND"
        if not self.is_lit:
            material["extensions"] = {_UNLIT: {}}
        if material in self.materials:
            return self.materials.index(material)
        self.materials.append(material)
        return len(self.materials) - 1

    def bytes(self) -> bytes:
        """Return the file."""
        self.data += b"\0" * (-len(self.data) % 4)
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "SimFoundry"},
            "scene": 0,
            "scenes": [{"nodes": [0] if self.primitives else []}],
        }
        if self.primitives:
            document |= {
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": self.primitives}],
                "materials": self.materials,
                "accessors": self.accessors,
                "bufferViews": self.views,
                "buffers": [{"byteLength": len(self.data)}],
            }
        if not self.is_lit:
            document["extensionsUsed"] = [_UNLIT]
        if self.images:
            document |= {"images": self.images, "textures": [{"source": k} for k in range(len(self.images))]}
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        if self.primitives:
            chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + bytes(self.data)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _linear(value: float) -> float:
    """Convert an sRGB value in [0, 1] to linear light (IEC 61966-2-1)."""
    return round(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4, 6)
