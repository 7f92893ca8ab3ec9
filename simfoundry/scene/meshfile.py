"""Mesh and texture files, which are named after their content so that identical files are written only once."""

from __future__ import annotations

import hashlib

import numpy as np

from simfoundry.geometry.shapes import Mesh


def obj_bytes(mesh: Mesh, material_file: str | None = None) -> bytes:
    """Return a mesh as a Wavefront OBJ file in meters, including texture coordinates (v up) if the mesh has any.

    ``material_file`` is the name of an MTL file in the same folder. Its only material, ``skin``, is assigned to every
    face.
    """
    parts = [] if material_file is None else [f"mtllib {material_file}\n"]
    # Add zero to turn -0.0 into 0.0, because the two are printed differently.
    parts.append(_rows("v %.12g %.12g %.12g\n", np.asarray(mesh.vertices) + 0.0))
    corners = np.asarray(mesh.faces, dtype=np.int64) + 1
    if mesh.uv is not None:
        parts.append(_rows("vt %.12g %.12g\n", np.asarray(mesh.uv) + 0.0))
        corners = np.repeat(corners, 2, axis=1)
    if material_file is not None:
        parts.append("usemtl skin\n")
    parts.append(_rows("f %d/%d %d/%d %d/%d\n" if mesh.uv is not None else "f %d %d %d\n", corners))
    return "".join(parts).encode()


def _rows(form: str, values: np.ndarray) -> str:
    return (form * len(values)) % tuple(values.ravel().tolist())


def texture_name(png: bytes) -> str:
    """Return the file name of a PNG texture."""
    return f"{hashlib.sha256(png).hexdigest()[:16]}.png"


def has_texture(mesh: Mesh) -> bool:
    """Return True if a mesh has a texture and texture coordinates."""
    return mesh.texture is not None and mesh.uv is not None


def obj_with_material(mesh: Mesh, name: str = "") -> dict[str, bytes]:
    """Return an OBJ file, plus MTL and PNG files if the mesh has a texture, keyed by file name.

    The OBJ file comes first. The base name of the files is ``name``. By default, the mesh and the texture are named
    after their content.
    """
    digest = name or mesh.digest
    if mesh.texture is None or mesh.uv is None:
        return {f"{digest}.obj": obj_bytes(mesh)}
    png = f"{name}.png" if name else texture_name(mesh.texture)
    material = f"newmtl skin\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {png}\n"
    return {f"{digest}.obj": obj_bytes(mesh, f"{digest}.mtl"), f"{digest}.mtl": material.encode(), png: mesh.texture}
