"""From documents to the lowered scene: masses, colors, joints, and the same bytes every time."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simfoundry.assets import convex
from simfoundry.assets.cache import Cache
from simfoundry.geometry.frames import Pose, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Mesh, Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower, lower_file
from simfoundry.scene.model import JointType, Link, Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_scene
from tests.assets.meshes import block, obj

CABINET = """\
simfoundry: asset/1
name: cabinet
category: drawer_cabinet
materials:
  wood: {density: 600, friction: 0.4, color: [0.5, 0.3, 0.1]}
  steel: {density: 7800, friction: 0.2, restitution: 0.3}
links:
  frame:
    material: wood
    parts:
      box: {shape: {box: [0.4, 0.5, 0.3]}}
  handle:
    parts: {bar: {shape: {cylinder: {radius: 0.01, height: 0.1}}, material: steel, color: [0.1, 0.2, 0.3, 0.4]}}
  drawer:
    material: wood
    friction: 0.7
    parts:
      tray: {shape: {box: [0.3, 0.4, 0.1]}}
      knob: {shape: {sphere: 0.02}, pose: {xyz: [0.2, 0, 0]}, material: steel}
  door:
    mass: 1.5
    inertial: {com: [0.1, 0.2, 0.3], inertia: [0.02, 0.03, 0.04, 0.001, 0.002, 0.003]}
    parts: {panel: {shape: {box: [0.02, 0.4, 0.3]}}}
joints:
  grip: {type: fixed, parent: drawer, child: handle, pose: {xyz: [0.2, 0.1, 0]}}
  slide:
    type: prismatic
    parent: frame
    child: drawer
    pose: {xyz: [0.1, 0.2, 0.3], rpy_deg: [0, 0, 90]}
    axis: [2, 0, 0]
    limits: [0, 0.25]
    damping: 3
    friction: 0.5
    armature: 0.01
  hinge:
    type: revolute
    parent: frame
    child: door
    pose: {xyz: [0, 0, 0.5]}
    axis: [0, 0, -1]
    limits_deg: [-30, 120]
"""
HEAD = "simfoundry: scene/1\nname: test\n"


def lowered(folder: Path, text: str, cache: Cache | None = None) -> Scene:
    path = folder / "test.scene.yaml"
    path.write_text(HEAD + text)
    (folder / "cabinet.asset.yaml").write_text(CABINET)
    (folder / "cup.obj").write_text(obj(*block((0.1, 0.2, 0.3), (0.0, 0.0, 0.15))))
    return lower_file(path, cache)


def only_link(folder: Path, text: str) -> Link:
    return lowered(folder, text).objects[0].links[0]


MATERIALS = "materials: {wood: {density: 600, friction: 0.4, restitution: 0.2, color: [0.5, 0.3, 0.1]}, bare: {}}\n"
BOX = "shape: {box: [0.1, 0.2, 0.3]}"  # 0.006 m^3


@pytest.mark.parametrize(
    ("body", "mass"),
    [
        ("mass: 0.3", 0.3),
        ("density: 500", 3.0),
        ("material: wood", 3.6),
        ("material: wood, mass: 0.3", 0.3),
        ("material: wood, density: 500", 3.0),
        ("material: bare, density: 500", 3.0),
        ("mass: {value: 0.3, range: [0.1, 0.5], source: vlm}", 0.3),
        ("density: {value: 500}, material: wood", 3.0),
        ("fixed: true", 6.0),
        ("fixed: true, material: bare", 6.0),
        ("fixed: true, material: wood", 3.6),
        ("fixed: true, mass: 2", 2.0),
    ],
)
@pytest.mark.parametrize("geometry", [BOX, "asset: cup.obj"])
def test_mass_goes_before_density_before_material(tmp_path: Path, body: str, mass: float, geometry: str) -> None:
    link = only_link(tmp_path, f"{MATERIALS}objects:\n  thing: {{{geometry}, {body}}}\n")
    assert link.mass == pytest.approx(mass)
    assert_allclose(link.inertia, mass / 12 * np.diag([0.13, 0.10, 0.05]), atol=1e-9)
    assert_allclose(link.com, [0, 0, 0] if geometry == BOX else [0, 0, 0.15], atol=1e-9)


@pytest.mark.parametrize(
    ("body", "rgba"),
    [
        ("mass: 1", (0.7, 0.7, 0.7, 1)),
        ("material: bare, mass: 1", (0.7, 0.7, 0.7, 1)),
        ("material: wood", (0.5, 0.3, 0.1, 1)),
        ("material: wood, color: [0, 0.5, 1]", (0, 0.5, 1, 1)),
        ("material: wood, color: [0, 0.5, 1, 0.25]", (0, 0.5, 1, 0.25)),
    ],
)
def test_the_nearest_color_counts(tmp_path: Path, body: str, rgba: tuple[float, ...]) -> None:
    link = only_link(tmp_path, f"{MATERIALS}objects:\n  thing: {{{BOX}, {body}}}\n")
    assert_allclose(link.visuals[0].rgba, rgba)


def test_a_mesh_keeps_its_own_color_before_its_materials(tmp_path: Path) -> None:
    import trimesh

    cube = trimesh.Trimesh(*block((0.1, 0.1, 0.1)), process=False, vertex_colors=[[51, 102, 255, 255]] * 8)
    (tmp_path / "blue.ply").write_bytes(cube.export(file_type="ply"))
    text = f"{MATERIALS}objects:\n  a: {{asset: blue.ply, material: wood}}\n"
    text += "  b: {asset: blue.ply, material: wood, color: [1, 0, 0]}\n"
    a, b = (o.links[0].visuals[0].rgba for o in lowered(tmp_path, text).objects)
    assert_allclose(a, [0.2, 0.4, 1, 1])
    assert_allclose(b, [1, 0, 0, 1])


def test_surfaces_come_from_the_body_and_then_from_the_material(tmp_path: Path) -> None:
    text = f"{MATERIALS}objects:\n  a: {{{BOX}, material: wood}}\n  b: {{{BOX}, material: wood, friction: 0.9}}\n"
    text += f"  c: {{{BOX}, mass: 1}}\n  d: {{{BOX}, mass: 1, collision: none}}\n"
    a, b, c, d = (o.links[0].colliders for o in lowered(tmp_path, text).objects)
    assert (a[0].friction, a[0].restitution) == (0.4, 0.2)
    assert (b[0].friction, b[0].restitution) == (0.9, 0.2)
    assert (c[0].friction, c[0].restitution) == (0.5, 0.0)
    assert d == ()
    assert isinstance(a[0].geometry, Box)


def test_a_mesh_that_is_only_looked_at_replaces_the_picture_alone(tmp_path: Path) -> None:
    text = "objects:\n  a: {shape: {sphere: 0.1}, mass: 1, visual: cup.obj, scale: 0.5}\n"
    text += "  b: {asset: cup.obj, mass: 1, visual: cup.obj}\n"
    a, b = (o.links[0] for o in lowered(tmp_path, text).objects)
    assert [v.name for v in a.visuals] == ["visual"] and [v.name for v in b.visuals] == ["visual"]
    shown = a.visuals[0].geometry
    assert isinstance(shown, Mesh)
    assert_allclose(np.ptp(shown.vertices, axis=0), [0.05, 0.1, 0.15])
    assert a.colliders[0].geometry == Sphere(0.1)
    assert_allclose(a.inertia, np.eye(3) * 0.4 * 0.01)


def test_links_come_parents_first_and_joints_in_si(tmp_path: Path) -> None:
    text = "objects:\n  cabinet:\n    asset: cabinet.asset.yaml\n    joints: {slide: 0.2, hinge: {deg: 45}}\n"
    (item,) = lowered(tmp_path, text).objects
    assert item.category == "drawer_cabinet"
    assert [link.name for link in item.links] == ["frame", "drawer", "door", "handle"]
    joints = {j.name: j for j in item.joints}
    seen = {item.root.name}
    for link in item.links[1:]:
        joint = next(j for j in item.joints if j.child == link.name)
        assert joint.parent in seen
        seen.add(link.name)
    slide, hinge = joints["slide"], joints["hinge"]
    assert (slide.type, slide.limits, slide.position) == (JointType.PRISMATIC, (0.0, 0.25), 0.2)
    assert (slide.damping, slide.friction, slide.armature) == (3.0, 0.5, 0.01)
    assert slide.axis.tolist() == [1, 0, 0]  # made a unit
    assert_allclose(hinge.limits or (), [math.radians(-30), math.radians(120)])
    assert hinge.position == pytest.approx(math.pi / 4)
    assert joints["grip"].limits is None


def test_radians_and_degrees_mean_the_same(tmp_path: Path) -> None:
    text = "objects:\n  a: {asset: cabinet.asset.yaml, joints: {hinge: 0.5}}\n"
    text += f"  b: {{asset: cabinet.asset.yaml, joints: {{hinge: {{deg: {math.degrees(0.5)}}}}}}}\n"
    a, b = (next(j for j in o.joints if j.name == "hinge") for o in lowered(tmp_path, text).objects)
    assert a.position == pytest.approx(b.position, abs=1e-12)


def test_forward_kinematics_of_a_drawer_by_hand(tmp_path: Path) -> None:
    text = "objects:\n  cabinet:\n    asset: cabinet.asset.yaml\n    joints: {slide: 0.2, hinge: {deg: 90}}\n"
    text += "    pose: {xyz: [1, 2, 3], yaw_deg: 180}\n"
    (item,) = lowered(tmp_path, text).objects
    poses = link_poses(item)
    # The drawer is turned by a quarter: its x is the cabinet's y, so it stands 0.2 m further in y.
    assert_allclose(poses["drawer"].p, [0.1, 0.4, 0.3], atol=1e-12)
    # The handle is 0.2 m in front and 0.1 m to the left of the drawer: y + 0.2, x - 0.1.
    assert_allclose(poses["handle"].p, [0.0, 0.6, 0.3], atol=1e-12)
    # The hinge turns about -z: the door's x points along -y.
    assert_allclose(poses["door"].apply(np.array([1.0, 0, 0])), [0, -1, 0.5], atol=1e-12)
    assert_allclose((item.X_WO @ poses["handle"]).p, [1.0, 1.4, 3.3], atol=1e-12)
    assert_allclose(link_poses(item, {"slide": 0.0})["handle"].p, [0.0, 0.4, 0.3], atol=1e-12)


def test_links_weigh_what_their_parts_weigh(tmp_path: Path) -> None:
    (item,) = lowered(tmp_path, "objects:\n  cabinet: {asset: cabinet.asset.yaml}\n").objects
    links = {link.name: link for link in item.links}
    tray, knob = 600 * 0.012, 7800 * 4 / 3 * math.pi * 0.02**3
    assert links["drawer"].mass == pytest.approx(tray + knob)
    assert_allclose(links["drawer"].com, [0.2 * knob / (tray + knob), 0, 0], atol=1e-12)
    reduced = tray * knob / (tray + knob) * 0.04
    assert links["drawer"].inertia[2, 2] == pytest.approx(tray * 0.25 / 12 + 0.4 * knob * 0.0004 + reduced)
    assert links["handle"].mass == pytest.approx(7800 * math.pi * 1e-5)
    assert_allclose(links["handle"].visuals[0].rgba, [0.1, 0.2, 0.3, 0.4])
    assert [(c.friction, c.restitution) for c in links["drawer"].colliders] == [(0.7, 0.0), (0.7, 0.3)]
    door = links["door"]
    assert (door.mass, door.com.tolist()) == (1.5, [0.1, 0.2, 0.3])
    assert door.inertia.tolist() == [[0.02, 0.001, 0.002], [0.001, 0.03, 0.003], [0.002, 0.003, 0.04]]


def test_inertias_are_symmetric_to_the_last_bit_and_arrays_read_only(tmp_path: Path) -> None:
    prism = "shape: {prism: {outline: [[0, 0], [0.3, 0.1], [0.1, 0.1], [0.05, 0.4]], height: 0.07}}"
    text = f"objects:\n  a: {{{prism}, density: 800}}\n"
    text += "  b: {asset: cabinet.asset.yaml}\n  c: {asset: cup.obj, mass: 1}\n"
    for item in lowered(tmp_path, text).objects:
        for link in item.links:
            assert np.array_equal(link.inertia, link.inertia.T)
            assert np.linalg.eigvalsh(link.inertia)[0] > 0
            assert not any(a.flags.writeable for a in (link.com, link.inertia, *(v.rgba for v in link.visuals)))
            for geometry in [v.geometry for v in link.visuals] + [c.geometry for c in link.colliders]:
                if isinstance(geometry, Mesh):
                    assert not geometry.vertices.flags.writeable and not geometry.faces.flags.writeable


def test_poses_cameras_and_lights_are_resolved(tmp_path: Path) -> None:
    text = f"""objects:
  a: {{{BOX}, mass: 1, pose: {{xyz: [1, 2, 3], rpy_deg: [10, 20, 30]}}}}
  b: {{{BOX}, mass: 1, pose: {{quat_wxyz: [0.5, -0.5, 0.5, 0.5]}}}}
  c: {{{BOX}, mass: 1, pose: {{yaw_deg: -90}}}}
cameras:
  front: {{size: [640, 480], fx: 500, fy: 510, cy: 200, pose: {{xyz: [1, 0, 1], look_at: [0, 0.5, 0]}}}}
lights:
  sun: {{type: distant, direction: [1, 2, -3], color: [1, 0.5, 0.25]}}
relations: [OnTop(a, b), Upright(c)]
"""
    scene = lowered(tmp_path, text)
    a, b, c = (o.X_WO for o in scene.objects)
    expected = Pose.of((1, 2, 3), quat_from_rpy(*np.radians([10, 20, 30])))
    assert_allclose(a.matrix, expected.matrix, atol=1e-12)
    assert_allclose(b.q, [0.5, -0.5, 0.5, 0.5])
    assert_allclose(c.apply(np.array([1.0, 0, 0])), [0, -1, 0], atol=1e-12)
    camera = scene.cameras[0]
    assert (camera.width, camera.height, camera.cx, camera.cy) == (640, 480, 319.5, 200)
    assert_allclose(camera.X_WC.matrix, look_at(np.array([1.0, 0, 1]), np.array([0, 0.5, 0])).matrix)
    shines = scene.lights[0].X_WL.rotation @ np.array([0.0, 0, -1])
    assert_allclose(shines, np.array([1, 2, -3]) / math.sqrt(14), atol=1e-12)
    assert [str(r) for r in scene.relations] == ["OnTop(a, b)", "Upright(c)"]


def test_an_inside_out_mesh_is_turned(tmp_path: Path) -> None:
    vertices, faces = block((0.1, 0.2, 0.3))
    (tmp_path / "inside.obj").write_text(obj(vertices, faces[:, ::-1]))
    link = only_link(tmp_path, "objects:\n  a: {asset: inside.obj, density: 1000}\n")
    assert link.mass == pytest.approx(6.0)
    assert len(link.colliders) == 1


def test_an_open_mesh_weighs_as_its_hull_where_asked(tmp_path: Path) -> None:
    vertices, faces = block((0.1, 0.2, 0.3))
    (tmp_path / "open.obj").write_text(obj(vertices, faces[2:]))
    link = only_link(tmp_path, "objects:\n  a: {asset: open.obj, density: 1000, solid: hull, collision: hull}\n")
    assert link.mass == pytest.approx(6.0)
    with pytest.raises(SpecError) as caught:
        lowered(tmp_path, "objects:\n  a: {asset: open.obj, density: 1000}\n")
    (found,) = caught.value.diagnostics
    assert (found.code, found.line, found.column, found.path) == ("SF302", 4, 14, "objects.a.asset")


def test_every_bad_mesh_is_reported_not_only_the_first(tmp_path: Path) -> None:
    vertices, faces = block((0.1, 0.2, 0.3))
    (tmp_path / "open.obj").write_text(obj(vertices, faces[2:]))
    text = "objects:\n  cup2: {asset: open.obj, mass: 1}\n"
    text += "  cup: {shape: {box: [1.0e-8, 1.0e-8, 1.0e-8]}, density: 9}\n"
    with pytest.raises(SpecError) as caught:
        lowered(tmp_path, text)
    assert [(d.code, d.line) for d in caught.value.diagnostics] == [("SF302", 4), ("SF104", 5)]


def test_a_bad_mesh_of_an_asset_is_reported_in_the_asset(tmp_path: Path) -> None:
    (tmp_path / "bad.asset.yaml").write_text(
        "simfoundry: asset/1\nname: bad\nlinks:\n  base:\n    density: 9\n    parts:\n      a: {mesh: empty.obj}\n"
    )
    (tmp_path / "empty.obj").write_text("")
    with pytest.raises(SpecError) as caught:
        lowered(tmp_path, "objects:\n  a: {asset: bad.asset.yaml}\n  b: {asset: bad.asset.yaml}\n")
    (found,) = caught.value.diagnostics
    assert (found.code, Path(found.file).name, found.line, found.path) == (
        "SF301",
        "bad.asset.yaml",
        7,
        "links.base.parts.a",
    )


ELL = "asset: ell.obj, density: 700, collision: decompose"


def write_ell(folder: Path) -> None:
    from simfoundry.assets.solids import prism_mesh

    outline = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.05
    (folder / "ell.obj").write_text(obj(*prism_mesh(outline, 0.05)))


def test_decomposition_goes_through_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_ell(tmp_path)
    cache = Cache(tmp_path / "cache")
    text = f"objects:\n  a: {{{ELL}}}\n  b: {{{ELL}, pose: {{xyz: [1, 0, 0]}}}}\n"
    first = lowered(tmp_path, text, cache)
    assert len([p for p in cache.folder.rglob("*") if p.is_file()]) == 2  # by its content, and by its file for drafts
    monkeypatch.setattr(convex, "decompose", lambda *_: pytest.fail("decomposed again"))
    assert digest(lowered(tmp_path, text, cache)) == digest(first)
    names = [c.name for c in first.objects[0].links[0].colliders]
    assert len(names) >= 2 and names == [f"mesh_{k}" for k in range(len(names))]


def digest(scene: Scene) -> str:
    """A hash of every number and name of a scene, in order."""
    import hashlib
    from dataclasses import fields, is_dataclass

    h = hashlib.sha256()

    def feed(value: object) -> None:
        if isinstance(value, np.ndarray):
            h.update(str((value.shape, value.dtype)).encode() + value.tobytes())
        elif is_dataclass(value) and not isinstance(value, type):
            h.update(type(value).__name__.encode())
            for f in fields(value):
                feed(getattr(value, f.name))
        elif isinstance(value, tuple):
            h.update(b"(")
            for item in value:
                feed(item)
        else:
            h.update(repr(value).encode() + b";")

    feed(scene)
    return h.hexdigest()


@pytest.mark.slow  # 4 s: two processes
def test_two_processes_lower_to_the_same_bytes(tmp_path: Path) -> None:
    import trimesh

    write_ell(tmp_path)
    scene = trimesh.Scene([trimesh.Trimesh(*block((0.1, 0.1, 0.1), (0.1 * k, 0, 0.05 * k))) for k in range(4)])
    (tmp_path / "many.glb").write_bytes(scene.export(file_type="glb"))
    text = f"""{MATERIALS}objects:
  ell: {{{ELL}}}
  many: {{asset: many.glb, mass: 1, solid: hull, collision: hull}}
  cabinet: {{asset: cabinet.asset.yaml, joints: {{slide: 0.1}}, pose: {{xyz: [1, 2, 3], rpy_deg: [1, 2, 3]}}}}
  tray: {{shape: {{prism: {{outline: [[0, 0], [0.3, 0], [0.1, 0.1], [0, 0.4]], height: 0.1}}}}, material: wood}}
cameras:
  front: {{size: [640, 480], fx: 500, fy: 500, pose: {{xyz: [1, 0, 1], look_at: [0, 0, 0]}}}}
"""
    lowered(tmp_path, text)
    code = (
        "import sys; from pathlib import Path; from tests.scene.test_lower import digest; "
        "from simfoundry.scene.lower import lower_file; print(digest(lower_file(Path(sys.argv[1]))))"
    )
    found = []
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, "-c", code, str(tmp_path / "test.scene.yaml")]
        found.append(subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout)
    assert len(found[0].strip()) == 64
    assert found[0] == found[1]


def test_a_scene_with_errors_is_not_lowered(tmp_path: Path) -> None:
    with pytest.raises(SpecError) as caught:
        lowered(tmp_path, "objects:\n  a: {shape: {sphere: 1}, mass: 1, material: wod}\n  b: {}\n")
    assert [d.code for d in caught.value.diagnostics] == ["SF201", "SF107"]


def test_progress_counts_the_objects(tmp_path: Path) -> None:
    lowered(tmp_path, f"objects:\n  a: {{{BOX}, mass: 1}}\n  b: {{{BOX}, mass: 1}}\n")
    seen: list[tuple[str, int, int]] = []
    lower(load_scene(tmp_path / "test.scene.yaml"), progress=lambda *step: seen.append(step))
    assert seen == [("a", 0, 2), ("b", 1, 2)]
