"""Broken mesh files: their names say how, their bytes follow from a seed."""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from simfoundry.assets.solids import prism_mesh
from tests.assets.meshes import blob, block, obj

Rng = np.random.Generator
FORMATS = ("obj", "stl", "ply", "glb")
TEN_MILLION = 10_000_000


def sound(rng: Rng) -> trimesh.Trimesh:
    """A closed mesh of some centimeters: a block, an L or a blob."""
    outline = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.05
    vertices, faces = (block((0.1, 0.2, 0.3)), prism_mesh(outline, 0.1), blob(rng, 30))[rng.integers(3)]
    return trimesh.Trimesh(vertices, faces, process=False)


def written(mesh: trimesh.Trimesh, form: str) -> bytes:
    """The bytes of a mesh in a format."""
    if form == "obj":
        return obj(mesh.vertices, mesh.faces).encode()
    with np.errstate(all="ignore"):  # of numbers that are none
        data = mesh.export(file_type=form)
    return data.encode() if isinstance(data, str) else bytes(data)


# -- damage to the surface, the same in every format ----------------------------------------------------------------


def not_a_number(mesh: trimesh.Trimesh, rng: Rng) -> None:
    mesh.vertices[rng.integers(len(mesh.vertices)), 1] = np.nan


def infinite(mesh: trimesh.Trimesh, rng: Rng) -> None:
    mesh.vertices[rng.integers(len(mesh.vertices)), 2] = np.inf


def far_away(mesh: trimesh.Trimesh, rng: Rng) -> None:
    mesh.vertices[rng.integers(len(mesh.vertices))] = 1e30


def denormal(mesh: trimesh.Trimesh, _rng: Rng) -> None:
    mesh.vertices *= 1e-40


def one_point(mesh: trimesh.Trimesh, _rng: Rng) -> None:
    mesh.vertices[:] = mesh.vertices[0]


def one_line(mesh: trimesh.Trimesh, _rng: Rng) -> None:
    mesh.vertices[:, 1:] = 0


def one_plane(mesh: trimesh.Trimesh, _rng: Rng) -> None:
    mesh.vertices[:, 2] = 0


def with_a_hole(mesh: trimesh.Trimesh, rng: Rng) -> None:
    mesh.faces = np.delete(mesh.faces, rng.integers(len(mesh.faces), size=2), axis=0)


def a_face_thrice(mesh: trimesh.Trimesh, rng: Rng) -> None:
    mesh.faces = np.concatenate([mesh.faces, mesh.faces[[rng.integers(len(mesh.faces))] * 2]])


def faces_turned(mesh: trimesh.Trimesh, rng: Rng) -> None:
    some = rng.random(len(mesh.faces)) < 0.5
    mesh.faces[some] = mesh.faces[some][:, ::-1]


def faces_without_area(mesh: trimesh.Trimesh, rng: Rng) -> None:
    some = rng.random(len(mesh.faces)) < 0.5
    mesh.faces[some, 1] = mesh.faces[some, 0]


def corners_shuffled(mesh: trimesh.Trimesh, rng: Rng) -> None:
    mesh.faces = rng.integers(len(mesh.vertices), size=mesh.faces.shape)


SURFACES: tuple[Callable[[trimesh.Trimesh, Rng], None], ...] = (
    not_a_number, infinite, far_away, denormal, one_point, one_line, one_plane, with_a_hole, a_face_thrice,
    faces_turned, faces_without_area, corners_shuffled,
)  # fmt: skip


# -- damage to the bytes --------------------------------------------------------------------------------------------


def truncated(data: bytes, rng: Rng) -> bytes:
    return data[: int(rng.integers(1, len(data)))]


def overwritten(data: bytes, rng: Rng) -> bytes:
    out = np.frombuffer(data, dtype=np.uint8).copy()
    some = rng.random(len(out)) < 0.03
    out[some] = rng.integers(256, size=int(some.sum()), dtype=np.uint8)
    return out.tobytes()


def garbage(_data: bytes, rng: Rng) -> bytes:
    return rng.bytes(4000)


def empty(_data: bytes, _rng: Rng) -> bytes:
    return b""


def zeros(data: bytes, _rng: Rng) -> bytes:
    return bytes(len(data))


def wrong_counts(data: bytes, rng: Rng) -> bytes:
    return _counted(data, lambda n: max(0, n + int(rng.integers(-9, 10))))


def huge_counts(data: bytes, _rng: Rng) -> bytes:
    return _counted(data, lambda n: 4_000_000_000)


def _counted(data: bytes, change: Callable[[int], int]) -> bytes:
    """The file with every count of its head changed, and of a text without counts, every corner."""
    if data[:4] == b"glTF":
        return glb_with(data, lambda tree: [a.update(count=change(a["count"])) for a in tree["accessors"]])
    if data[:3] == b"ply":
        return re.sub(rb"(element \w+ )(\d+)", lambda m: m[1] + str(change(int(m[2]))).encode(), data)
    if data[:2] in (b"v ", b"f "):
        return re.sub(rb"f (\d+) (\d+)", lambda m: b"f %d %s" % (change(int(m[1])), m[2]), data)
    return data[:80] + struct.pack("<I", change(struct.unpack("<I", data[80:84])[0])) + data[84:]


BYTES: tuple[Callable[[bytes, Rng], bytes], ...] = (
    truncated, overwritten, garbage, empty, zeros, wrong_counts, huge_counts,
)  # fmt: skip


# -- what only some formats can say ---------------------------------------------------------------------------------


def glb_with(data: bytes, change: Callable[[dict[str, Any]], object]) -> bytes:
    """A GLB with its tree changed."""
    length = struct.unpack("<I", data[12:16])[0]
    tree = json.loads(data[20 : 20 + length])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return b"glTF" + struct.pack("<III", 2, 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest


def special(rng: Rng) -> Iterator[tuple[str, dict[str, bytes]]]:
    """Files by name, the mesh first."""
    glb, text = written(sound(rng), "glb"), written(sound(rng), "obj")
    ring = [{"children": [1]}, {"children": [0], "mesh": 0}]
    chain: list[object] = [*({"children": [k + 1]} for k in range(5000)), {"mesh": 0}]
    yield "ring_of_nodes", {"a.glb": glb_with(glb, lambda t: t.update(nodes=ring, scenes=[{"nodes": [0]}]))}
    yield "chain_of_nodes", {"a.glb": glb_with(glb, lambda t: t.update(nodes=chain, scenes=[{"nodes": [0]}]))}
    many = [{"mesh": 0}] * 300_000
    yield "many_nodes", {"a.glb": glb_with(glb, lambda t: t.update(nodes=many, scenes=[{"nodes": [*range(300_000)]}]))}
    yield (
        "file_elsewhere",
        {"a.glb": glb_with(glb, lambda t: t.update(buffers=[{"uri": "/etc/passwd", "byteLength": 9}]))},
    )
    yield "no_accessors", {"a.glb": glb_with(glb, lambda t: t.pop("accessors"))}
    yield "nan_in_glb_tree", {"a.glb": glb.replace(b'"count"', b'"kount"')}
    yield "deep_json", {"a.glb": b"glTF" + struct.pack("<III", 2, 200_020, 200_000) + b"JSON" + b"[" * 200_000}
    yield "negative_corners", {"a.obj": re.sub(rb"f (\d+)", rb"f -999999", text)}
    yield "corner_nought", {"a.obj": re.sub(rb"f (\d+)", rb"f 0", text)}
    yield "words_for_numbers", {"a.obj": text.replace(b"v 0", b"v nought")}
    yield "long_line", {"a.obj": text + b"# " + b"x" * 20_000_000 + b"\n"}
    yield "polygon_of_many_corners", {"a.obj": text + b"f" + b" 1 2 3 4" * 200_000 + b"\n"}
    yield "library_is_itself", {"a.obj": b"mtllib a.obj\n" + text}
    yield "picture_is_no_picture", {"a.obj": b"mtllib a.mtl\nusemtl m\n" + text, "a.mtl": MTL, "a.png": b"\x89PNG\r\n"}
    yield (
        "picture_bomb",
        {"a.obj": b"mtllib a.mtl\nusemtl m\n" + textured(text), "a.mtl": MTL, "a.png": picture(13_000)},
    )
    yield "list_of_lists", {"a.ply": PLY_LISTS}
    yield "ply_without_end", {"a.ply": b"ply\nformat ascii 1.0\n" + b"comment x\n" * 100_000}


MTL = b"newmtl m\nmap_Kd a.png\n"
PLY_LISTS = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uint int vertex_indices\nend_header\n" + bytes(36) + b"\xff\xff\xff\x7f" + bytes(12)
)


def textured(text: bytes) -> bytes:
    """An OBJ with texture coordinates."""
    return b"vt 0 0\nvt 1 0\nvt 0 1\n" + re.sub(rb"f (\d+) (\d+) (\d+)", rb"f \1/1 \2/2 \3/3", text)


def picture(side: int) -> bytes:
    """A PNG of one color: small on disk, large in memory."""
    from PIL import Image

    stream = io.BytesIO()
    Image.new("L", (side, side)).save(stream, format="PNG", compress_level=9)
    return stream.getvalue()


def ten_million(folder: Path) -> Iterator[tuple[str, Path]]:
    """Meshes of ten million triangles, written below ``folder`` one at a time; each is removed after its use."""
    vertices, faces = block((0.1, 0.2, 0.3))
    corners = np.tile(faces, (TEN_MILLION // len(faces) + 1, 1))[:TEN_MILLION].astype(np.int32)

    def stl() -> Iterator[bytes]:
        yield bytes(80) + struct.pack("<I", TEN_MILLION)
        for _ in range(100):
            yield bytes(50 * (TEN_MILLION // 100))

    def ply() -> Iterator[bytes]:
        yield (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\n"
            f"property float y\nproperty float z\nelement face {TEN_MILLION}\n"
            "property list uchar int vertex_indices\nend_header\n"
        ).encode() + vertices.astype("<f4").tobytes()
        rows = np.zeros(TEN_MILLION, dtype=[("n", "u1"), ("v", "<i4", 3)])
        rows["n"], rows["v"] = 3, corners
        yield rows.tobytes()

    def text() -> Iterator[bytes]:
        yield obj(vertices, faces).encode()
        for _ in range(100):
            yield b"f 1 2 4\n" * (TEN_MILLION // 100)

    def glb() -> Iterator[bytes]:
        points, indices = vertices.astype("<f4").tobytes(), corners.astype("<u4").tobytes()
        tree = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
                {"bufferView": 1, "componentType": 5125, "count": 3 * TEN_MILLION, "type": "SCALAR"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
                {"buffer": 0, "byteOffset": len(points), "byteLength": len(indices)},
            ],
            "buffers": [{"byteLength": len(points) + len(indices)}],
        }
        head = json.dumps(tree).encode()
        head += b" " * (-len(head) % 4)
        size = len(points) + len(indices)
        yield b"glTF" + struct.pack("<III", 2, 28 + len(head) + size, len(head)) + b"JSON" + head
        yield struct.pack("<I", size) + b"BIN\0" + points + indices

    for name, blocks in (("a.stl", stl), ("a.ply", ply), ("a.obj", text), ("a.glb", glb)):
        path = folder / name
        with path.open("wb") as stream:
            for part in blocks():
                stream.write(part)
        yield f"ten_million_{path.suffix[1:]}", path
        path.unlink()


def broken(rng: Rng) -> Iterator[tuple[str, dict[str, bytes]]]:
    """A name, and files of which the first is the mesh, for every damage in every format."""
    for form in FORMATS:
        for spoil in SURFACES:
            mesh = sound(rng)
            spoil(mesh, rng)
            yield f"{spoil.__name__}_{form}", {f"a.{form}": written(mesh, form)}
        for damage in BYTES:
            yield f"{damage.__name__}_{form}", {f"a.{form}": damage(written(sound(rng), form), rng)}
    yield from special(rng)
