"""Mesh files: good ones are read as they are meant, bad ones end in a finding."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simfoundry.assets import convex as convex_file
from simfoundry.assets import mass
from simfoundry.assets import mesh as mesh_file
from simfoundry.assets.cache import Cache
from simfoundry.assets.convex import MAX_HULL_VERTICES, hull, mesh_colliders
from simfoundry.assets.deviation import ALLOWED, simplified
from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, open_edges, read_mesh, weld
from simfoundry.assets.solids import lathe_mesh
from simfoundry.runtime.workers import CrashError
from tests.assets.meshes import blob, block, obj, rotation

CUBE = obj(*block((0.1, 0.2, 0.3)))


def failure(path: Path, scale: float = 1.0) -> MeshError:
    with pytest.raises(MeshError) as caught:
        read_mesh(path, scale)
    assert path.name in str(caught.value) and "\n" not in str(caught.value)
    assert caught.value.hint
    return caught.value


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def glb(folder: Path, *parts: Any) -> Path:
    """A GLB of trimesh meshes, whose frames are as they stand in the file: y up."""
    import trimesh

    scene = trimesh.Scene()
    for k, part in enumerate(parts):
        scene.add_geometry(part, geom_name=f"part{k}", node_name=f"node{k}")
    return written(folder, "thing.glb", scene.export(file_type="glb"))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.obj", ""),
        ("empty.stl", b""),
        ("empty.ply", b""),
        ("empty.glb", b""),
        ("words.stl", "hello"),
        ("words.glb", "hello"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("points.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
         "end_header\n0 0 0\n"),
        ("nan.obj", CUBE.replace("v -0.05", "v nan", 1)),
        ("infinite.obj", CUBE.replace("v -0.05", "v inf", 1)),
        ("corners.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("negative.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
         "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 0\n1 0 0\n0 1 0\n3 0 1 -7\n"),
        ("claims.stl", b"x" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 50),
        ("claims.glb", struct.pack("<4sIIII", b"glTF", 2, 4_000_000_000, 4_000_000_000, 0x4E4F534A) + b"{}"),
    ],
)  # fmt: skip
def test_what_holds_no_surface_is_a_finding(tmp_path: Path, name: str, content: str | bytes) -> None:
    assert failure(written(tmp_path, name, content)).code == "SF301"


@pytest.mark.parametrize("kind", ["glb", "stl", "ply"])
def test_a_truncated_file_never_escapes_as_something_else(tmp_path: Path, kind: str) -> None:
    import trimesh

    whole = trimesh.Trimesh(*blob(np.random.default_rng(1))).export(file_type=kind)
    for share in (0.01, 0.2, 0.5, 0.8, 0.99):
        path = written(tmp_path, f"cut.{kind}", whole[: int(len(whole) * share)])
        assert failure(path).code == "SF301"


def test_a_truncated_obj_is_a_finding_or_open(tmp_path: Path) -> None:
    for share in (0.1, 0.5, 0.9):
        path = written(tmp_path, "cut.obj", CUBE[: int(len(CUBE) * share)])
        try:
            parts = read_mesh(path)
        except MeshError as error:
            assert error.code == "SF301"
        else:
            assert open_edges(weld(parts[0].vertices, parts[0].faces)[1]) > 0


@pytest.mark.parametrize(
    ("factor", "scale", "hint"),
    [
        (1000.0, 1.0, "it looks like millimeters: `scale: 0.001`"),
        (100.0, 10.0, "it looks like millimeters: `scale: 0.01`"),
        (1e9, 1.0, "set `scale`"),
        (1e-4, 1.0, "set `scale` to the length of one mesh unit in meters"),
    ],
)
def test_an_implausible_size_says_what_scale_would_help(tmp_path: Path, factor: float, scale: float, hint: str) -> None:
    vertices, faces = block((0.1, 0.2, 0.3))
    error = failure(written(tmp_path, "cup.obj", obj(vertices * factor, faces)), scale)
    assert (error.code, error.hint) == ("SF303", hint)


def test_scale_turns_millimeters_into_meters(tmp_path: Path) -> None:
    vertices, faces = block((100, 200, 300))
    (part,) = read_mesh(written(tmp_path, "cup.obj", obj(vertices, faces)), 0.001)
    assert_allclose(np.ptp(part.vertices, axis=0), [0.1, 0.2, 0.3])


def test_stray_points_are_no_part_of_the_surface(tmp_path: Path) -> None:
    text = "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 12\nproperty list uchar int vertex_indices\nend_header\n500 500 500\n"
    vertices, faces = block((0.1, 0.2, 0.3))
    text += "".join(f"{x} {y} {z}\n" for x, y, z in vertices) + "".join(
        f"3 {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces
    )
    (part,) = read_mesh(written(tmp_path, "cup.ply", text))
    assert part.vertices.shape == (8, 3)
    assert mass.mesh(part.vertices, part.faces).volume == pytest.approx(0.006)


def test_faces_that_shrink_to_a_line_do_not_open_the_mesh() -> None:
    vertices, faces = block((0.1, 0.2, 0.3))
    split = np.concatenate([vertices, vertices[:1] + 1e-12, [[9.0, 9.0, 9.0]]])
    welded, kept = weld(split, np.concatenate([faces, [[0, 8, 1], [8, 0, 9]]]).astype(np.int32))
    assert open_edges(kept) == 0
    assert (len(welded), len(kept)) == (8, 12)


def test_seams_are_welded_and_holes_counted() -> None:
    vertices, faces = block((0.1, 0.2, 0.3))
    soup = vertices[faces].reshape(-1, 3)
    soup_faces = np.arange(36, dtype=np.int32).reshape(-1, 3)
    assert open_edges(soup_faces) == 36
    assert open_edges(weld(soup, soup_faces)[1]) == 0
    assert open_edges(faces[1:]) == 3
    assert open_edges(faces[2:]) == 4
    assert open_edges(np.concatenate([faces[1:], faces[:1, ::-1]])) > 0  # one face turned the wrong way
    assert open_edges(faces[:0]) == 0


def test_gltf_is_turned_from_y_up_to_z_up(tmp_path: Path) -> None:
    import trimesh

    vertices, faces = block((0.1, 0.3, 0.2), (0.0, 0.15, 0.5))  # 0.3 tall, 0.5 toward the viewer of glTF, +z
    (part,) = read_mesh(glb(tmp_path, trimesh.Trimesh(vertices, faces)))
    solid = mass.mesh(*weld(part.vertices, part.faces))
    assert_allclose(solid.com, [0, -0.5, 0.15], atol=1e-7)
    assert_allclose(np.ptp(part.vertices, axis=0), [0.1, 0.2, 0.3], atol=1e-7)
    assert solid.volume == pytest.approx(0.006)


def textured(vertices: Any, faces: Any, factor: list[int] | None) -> Any:
    import trimesh
    from PIL import Image

    image = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, baseColorFactor=factor)
    uv = np.linspace(0, 1, 2 * len(vertices)).reshape(-1, 2)
    return trimesh.Trimesh(
        vertices, faces, visual=trimesh.visual.TextureVisuals(uv=uv, material=material), process=False
    )


def test_the_parts_of_a_glb_keep_their_colors_and_textures(tmp_path: Path) -> None:
    import trimesh

    plain = trimesh.Trimesh(*block((0.1, 0.1, 0.1)), process=False)
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 55, 0, 128])
    plain.visual = trimesh.visual.TextureVisuals(material=material)
    picture = textured(*block((0.1, 0.1, 0.1), (0.3, 0, 0)), None)
    parts = read_mesh(glb(tmp_path, plain, picture))
    by_x = sorted(parts, key=lambda part: float(part.vertices[:, 0].mean()))
    assert by_x[0].texture is None and by_x[0].uv is None
    # glTF writes linear colors: 55/255 is 0.502 in sRGB.
    assert_allclose(by_x[0].rgba or (), [1, 0.502, 0, 128 / 255], atol=1e-3)
    assert by_x[1].rgba is None
    assert (by_x[1].texture or b"").startswith(b"\x89PNG")
    assert by_x[1].uv is not None and by_x[1].uv.shape == (len(by_x[1].vertices), 2)


def test_a_tinted_texture_keeps_its_tint(tmp_path: Path) -> None:
    (part,) = read_mesh(glb(tmp_path, textured(*block((0.1, 0.1, 0.1)), [255, 0, 0, 255])))
    assert part.texture is not None
    assert_allclose(part.rgba or (), [1, 0, 0, 1])


def test_the_vertex_colors_of_a_ply_are_averaged(tmp_path: Path) -> None:
    import trimesh

    cube = trimesh.Trimesh(*block((0.1, 0.1, 0.1)), process=False, vertex_colors=[[51, 102, 255, 255]] * 8)
    (part,) = read_mesh(written(tmp_path, "cup.ply", cube.export(file_type="ply")))
    assert_allclose(part.rgba or (), [0.2, 0.4, 1, 1])


def test_reading_twice_gives_the_same(tmp_path: Path) -> None:
    import trimesh

    path = glb(tmp_path, *(trimesh.Trimesh(*block((0.1, 0.1, 0.1), (0.2 * k, 0, 0))) for k in range(5)))
    first, second = read_mesh(path), read_mesh(path)
    assert [p.vertices.tobytes() for p in first] == [p.vertices.tobytes() for p in second]


def convex(part: tuple[Any, Any]) -> bool:
    vertices, faces = part
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    heights = np.einsum("fk,vk->fv", normals, vertices) - np.einsum("fk,fk->f", normals, a)[:, None]
    return bool((heights <= 1e-9).all()) and open_edges(faces) == 0


def test_a_hull_is_convex_closed_and_small() -> None:
    points = np.random.default_rng(2).normal(size=(500, 3))
    points *= np.array([0.1, 0.2, 0.3]) / np.linalg.norm(points, axis=1, keepdims=True)
    whole, small = hull(points, limit=500), hull(points)
    assert convex(whole) and convex(small)
    assert len(small[0]) <= MAX_HULL_VERTICES < len(whole[0])
    assert 0.8 < mass.mesh(*small).volume / mass.mesh(*whole).volume < 1


@pytest.mark.parametrize(
    "points", [np.zeros((5, 3)), np.eye(3), np.random.default_rng(0).normal(size=(9, 3)) * [1, 1, 0]]
)
def test_flat_points_have_no_hull(points: Any) -> None:
    with pytest.raises(MeshError) as caught:
        hull(points)
    assert caught.value.code == "SF301"


def ell() -> tuple[Any, Any]:
    from simfoundry.assets.solids import prism_mesh

    return prism_mesh(np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.1, 0.1)


def entries(cache: Cache) -> dict[str, bytes]:
    return {str(p.relative_to(cache.folder)): p.read_bytes() for p in cache.folder.rglob("*") if p.is_file()}


def test_what_is_nearly_convex_collides_as_its_hull_or_simpler(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    cone = lathe_mesh(np.array([[0, 0.1], [0.02, 0.1], [0.05, 0], [0, 0]]), 24)
    found = mesh_colliders(*cone, "auto", cache)
    assert len(found.parts) == 1 and found.primitive is None
    found = mesh_colliders(*ell(), "hull", cache)
    assert len(found.parts) == 1 and found.primitive is None
    assert found.error == pytest.approx(0.1, rel=0.02)  # from the middle of the longest side to either leg
    assert mesh_colliders(*ell(), "none", cache).parts == ()
    assert entries(cache) == {}


def turned_by(seed: int) -> tuple[np.ndarray, np.ndarray]:
    return rotation(np.random.default_rng(seed)), np.array([0.3, -0.2, 0.1])


def test_meshes_of_primitives_collide_as_those() -> None:
    turn, shift = turned_by(5)
    vertices, faces = block((0.1, 0.2, 0.3))
    found = mesh_colliders(vertices @ turn.T + shift, faces, "auto")
    assert found.primitive is not None and found.primitive.kind == "box" and found.parts == ()
    assert sorted(found.primitive.size) == pytest.approx([0.1, 0.2, 0.3])
    assert_allclose(found.primitive.center, shift, atol=1e-9)
    assert found.error < 1e-6

    def can(sides: int) -> tuple[np.ndarray, np.ndarray]:
        return lathe_mesh(np.array([[0, 0.05], [0.03, 0.05], [0.03, -0.05], [0, -0.05]]), sides)

    vertices, faces = can(48)
    found = mesh_colliders(vertices @ turn.T + shift, faces, "auto")
    assert found.primitive is not None and found.primitive.kind == "cylinder"
    assert found.primitive.size == pytest.approx((0.03, 0.1), rel=2e-3)
    assert abs(found.primitive.rotation[:, 2] @ turn[:, 2]) == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.det(found.primitive.rotation) == pytest.approx(1.0)
    assert found.error == pytest.approx(0.03 * (1 - math.cos(math.pi / 48)), abs=1e-4)
    few = mesh_colliders(*can(7), "auto")
    assert few.primitive is None and len(few.parts) == 1  # a heptagon is no cylinder

    arc = np.linspace(0, math.pi, 24)
    ball = lathe_mesh(np.column_stack([0.04 * np.sin(arc), 0.04 * np.cos(arc)]), 48)
    found = mesh_colliders(*ball, "auto")
    assert found.primitive is not None and found.primitive.kind == "sphere"
    assert found.primitive.size == pytest.approx((0.04,), rel=0.01)


def test_a_large_mesh_is_simplified_within_a_bound() -> None:
    arc = np.linspace(0, math.pi, 101)
    vertices, faces = lathe_mesh(np.column_stack([0.04 * np.sin(arc), -0.06 * np.cos(arc)]), 100)
    corners, sides, lost = simplified(vertices, faces, 1000)
    assert 1000 <= len(sides) < len(faces) / 2 and 0 < lost <= ALLOWED * 0.12, "of 1000 triangles none is near enough"
    radius = np.linalg.norm(corners / [0.04, 0.04, 0.06], axis=1)
    assert np.abs(radius - 1).max() * 0.04 < 2 * lost
    assert simplified(vertices, faces, len(faces))[0] is vertices
    gravel = np.random.default_rng(0).random((6000, 3))  # a soup that no fewer triangles stand for
    soup = np.arange(6000, dtype=np.int32).reshape(-1, 3)
    assert len(simplified(gravel, soup, 100)[1]) >= 500


def test_decomposition_is_kept_and_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = Cache(tmp_path)
    vertices, faces = ell()
    found = mesh_colliders(vertices, faces, "auto", cache)
    parts = found.parts
    assert found.error < 0.004
    assert len(parts) >= 2 and all(map(convex, parts))
    volume = sum(mass.mesh(*p).volume for p in parts)
    assert volume == pytest.approx(mass.mesh(vertices, faces).volume, rel=0.05)
    kept = entries(cache)
    assert len(kept) == 1

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("decomposed again")

    monkeypatch.setattr(convex_file, "decompose", refuse)
    again = mesh_colliders(vertices, faces, "auto", cache)
    assert again.error == found.error
    assert [(v.tobytes(), f.tobytes()) for v, f in again.parts] == [(v.tobytes(), f.tobytes()) for v, f in parts]
    with pytest.raises(AssertionError, match="again"):
        mesh_colliders(vertices * 1.01, faces, "auto", cache)
    assert entries(cache) == kept


@pytest.mark.slow
def test_a_mesh_whose_check_crashes_is_decomposed_without_it() -> None:
    vertices, faces = ell()
    for k, share in ((1, 0.69), (0, 0.75)):  # a point on an edge, and a triangle without area beside it
        (a, b, c), m = faces[k], len(vertices)
        vertices = np.vstack([vertices, vertices[a] * (1 - share) + vertices[b] * share])
        faces = np.vstack([np.delete(faces, k, 0), [[a, m, c], [m, b, c], [a, b, m]]])
    with pytest.raises(CrashError):
        convex_file._worker().call(convex_file.FUNCTION, vertices, faces, "auto")
    parts = mesh_colliders(vertices, faces, "decompose").parts
    assert sum(mass.mesh(*p).volume for p in parts) == pytest.approx(mass.mesh(*ell()).volume, rel=0.05)


@pytest.mark.parametrize("damage", [b"", b"PK", b"x" * 1000])
def test_a_damaged_entry_is_computed_again(tmp_path: Path, damage: bytes) -> None:
    cache = Cache(tmp_path)
    parts = mesh_colliders(*ell(), "decompose", cache).parts
    (path,) = (p for p in tmp_path.rglob("*") if p.is_file())
    good = path.read_bytes()
    for bad in (damage, good[: len(good) // 2]):
        path.write_bytes(bad)
        assert len(mesh_colliders(*ell(), "decompose", cache).parts) == len(parts)
        assert path.read_bytes() == good


def test_every_part_knows_its_frame(tmp_path: Path) -> None:
    (part,) = read_mesh(written(tmp_path, "cup.obj", CUBE))
    assert isinstance(part, MeshPart)
    assert_allclose(
        mass.mesh(part.vertices, part.faces).inertia, mass.box(np.array([0.1, 0.2, 0.3])).inertia, atol=1e-18
    )


def test_real_meshes_are_read_or_explained(shared_data: Path) -> None:
    for name, volume in (("003_cracker_box", 0.0015), ("025_mug", 0.0001)):
        files = sorted((shared_data / "ycb_models" / name).rglob("*.obj")) or pytest.skip(f"no mesh of {name}")
        parts = read_mesh(files[0])
        welded = weld(np.concatenate([p.vertices for p in parts]), parts[0].faces)
        assert mass.mesh(*welded).volume > volume


def test_a_line_has_no_hull() -> None:
    with pytest.raises(MeshError, match="flat"):
        hull(np.zeros((0, 3)))


def test_a_texture_beyond_all_screens_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    monkeypatch.setattr(mesh_file, "MAX_PIXELS", 16 * 16)
    written(tmp_path, "a.mtl", "newmtl m\nmap_Kd a.png\n")
    path = written(tmp_path, "a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n")
    Image.new("RGB", (16, 16), (200, 10, 10)).save(tmp_path / "a.png")
    assert read_mesh(path)[0].texture is not None
    Image.new("RGB", (17, 16), (200, 10, 10)).save(tmp_path / "a.png")
    assert "17 x 16 pixels; the limit is 16 x 16" in str(failure(path))
