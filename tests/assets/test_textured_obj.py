"""OBJ files of this package are read as those of others are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.assets import mesh as mesh_file
from simfoundry.assets.errors import MeshError
from simfoundry.assets.textured_obj import read_textured_obj
from simfoundry.geometry.shapes import Mesh
from simfoundry.render.montage import png_bytes
from simfoundry.scene.meshfile import obj_with_material

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
TEXTURE = np.random.default_rng(0).integers(0, 255, (8, 8, 3)).astype(np.uint8)


@pytest.mark.parametrize(
    ("is_own", "old", "new"),
    [
        (True, b"", b""),
        (True, b"\nv 0 0 0\n", b"\nv 1e-3 -0.5 1e400\n"),
        (False, b"1/1 3/3", b"1/1 3/2"),  # a corner that is not the same in both lists
        (False, b"vt 0.5 0\n", b"vt 0.5 0\nvt 0.5 0\n"),
        (False, b"usemtl skin", b"usemtl other"),
        (False, b"\nv 0 0 0\n", b"\n# a comment\nv 0 0 0\n"),
        (False, b"\nv 0 0 0\n", b"\nv 0 0.0.1 0\n"),
        (False, b"mtllib thing", b"mtllib ../thing"),
    ],
)
def test_own_files_are_read_as_files_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_own: bool, old: bytes, new: bytes
) -> None:
    def parts() -> list[Any]:
        try:
            return [(*map(_plain, (p.vertices, p.faces, p.uv)), p.texture, p.rgba) for p in mesh_file.read_parts(path)]
        except MeshError as error:
            return [str(error)]

    def _plain(values: Any) -> Any:
        return None if values is None else (values.dtype.str, values.tolist())

    uv = np.array([[0.25, 0.75], [0.5, 0.0], [1.0, 0.125], [0.0, 1.0]])
    mesh = Mesh(np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [1e-7, 0, -0.3]]), TETRAHEDRON, uv, png_bytes(TEXTURE))
    for name, data in obj_with_material(mesh, "thing").items():
        (tmp_path / name).write_bytes(data.replace(old, new))
    path = tmp_path / "thing.obj"
    assert (read_textured_obj(path, mesh_file.MAX_PIXELS) is not None) == is_own
    here = parts()
    monkeypatch.setattr(mesh_file, "read_textured_obj", lambda path, most: None)
    assert here == parts()


@pytest.mark.parametrize("damage", [lambda data: data[:-40], lambda data: b"", None])
def test_an_own_file_with_a_damaged_texture_is_read_as_those_of_others(tmp_path: Path, damage: Any) -> None:
    mesh = Mesh(np.eye(4, 3), TETRAHEDRON, np.zeros((4, 2)), png_bytes(TEXTURE))
    for name, data in obj_with_material(mesh, "thing").items():
        if damage is not None or not name.endswith(".png"):
            (tmp_path / name).write_bytes(damage(data) if name.endswith(".png") else data)
    assert read_textured_obj(tmp_path / "thing.obj", mesh_file.MAX_PIXELS) is None
