"""Mesh files with too many triangles are refused by what their head or their lines say, before they are read."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from simfoundry.assets import mesh as counts
from simfoundry.assets.errors import MAX_FACES, MeshError
from simfoundry.assets.mesh import check_counts
from tests.assets.meshes import blob, obj


def stl(faces: int) -> bytes:
    return bytes(80) + struct.pack("<I", faces) + bytes(50) * faces


def ply(vertices: int, faces: int) -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nelement face {faces}\n"
    return f"{head}property list uchar int vertex_indices\nend_header\n".encode()


def glb(indices: int, nodes: int = 1, points: int = 3) -> bytes:
    tree = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [{"count": indices}, {"count": points}],
    }
    text = json.dumps(tree).encode()
    return b"glTF" + struct.pack("<III", 2, 20 + len(text), len(text)) + b"JSON" + text


def ascii_stl(faces: int) -> bytes:
    return b"solid a\n" + b"facet normal 0 0 1\nouter loop\nendloop\nendfacet\n" * faces


TOO_MANY = {
    "a.stl": stl(1001),
    "lines.stl": ascii_stl(1001),
    "a.obj": b"\nf 1 2 3" * 1001,
    "points.obj": b"\nv 0 0 0" * 3001,
    "a.ply": ply(8, 1001),
    "points.ply": ply(3001, 8),
    "huge.ply": ply(8, 10**30),
    "a.glb": glb(3003),
    "points.glb": glb(3, points=3001),
    "nodes.glb": glb(3, nodes=1001),
    "a.gltf": glb(3003)[20:],
}


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand triangles, so that files of more are small."""
    monkeypatch.setattr(counts, "MAX_FACES", 1000)
    monkeypatch.setattr(counts, "MAX_POINTS", 3000)


@pytest.mark.parametrize("name", TOO_MANY)
def test_too_many_are_refused_with_the_limit(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(TOO_MANY[name])
    with pytest.raises(MeshError, match=r"has \d+ (triangles; the limit is 1000|points; the limit is 3000)") as error:
        check_counts(tmp_path / name)
    assert (error.value.code, error.value.hint) == ("SF301", "decimate it")


FEW = {
    "a.stl": stl(1000),
    "lines.stl": ascii_stl(1000),
    "a.obj": obj(*blob(np.random.default_rng(1))).encode(),
    "a.ply": ply(8, 1000),
    "a.glb": glb(3000),
    "garbage.glb": b"glTF\x02\xff\xff",
    "no_list.glb": glb(3).replace(b'"accessors"', b'"accessor5"'),
    "garbage.ply": b"ply\nelement face many\n",
    "empty.stl": b"",
    "empty.obj": b"",
}


@pytest.mark.parametrize("name", FEW)
def test_all_others_pass(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(FEW[name])
    check_counts(tmp_path / name)


def test_the_limit_is_that_of_the_reader() -> None:
    assert MAX_FACES == 2_000_000
