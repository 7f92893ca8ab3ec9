"""The commands `simfoundry background`: every way to align, on a splat and on a mesh, and files that cannot be used."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, look_at, quat_from_rpy
from simfoundry.geometry.similarity import Similarity
from simfoundry.scene.state import pose
from simfoundry.spec.load import load_scene
from simfoundry.splats.alignment import ColorCloud
from simfoundry.splats.files import read_splat, splat_bytes
from simfoundry.splats.gaussians import GaussianSplat, gaussian_splat
from simfoundry.splats.harmonics import SH0
from tests.cli.command import run
from tests.splats.test_alignment import room

S_WF = Similarity(Pose.of((0.4, -0.3, 0.2), quat_from_rpy(0.1, -0.15, 1.2)), 0.4)
"""The map from the frame of the splat's file to the world."""

SCENE = """\
simfoundry: scene/1
name: lab
objects:
  desk: {fixed: true, shape: {box: [1.6, 1.6, 0.04]}, mass: 20, pose: {xyz: [0.5, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2, pose: {xyz: [0.5, 0, 0.05]}}
cameras:
  front: {size: [160, 120], fx: 150, fy: 150, pose: {xyz: [-0.4, 0.1, 0.6], look_at: [0.5, 0, 0]}}
  left: {size: [160, 120], fx: 150, fy: 150, pose: {xyz: [0.3, 0.9, 0.7], look_at: [0.5, 0, 0]}}
background:  # filmed on Tuesday
  splat: room.spz.ply
  pose: {xyz: [1, 2, 3]}  # a guess
"""


def surroundings() -> GaussianSplat:
    """Return a table whose top is that of the desk, and walls around it, in the world."""
    cloud = room(3000, seed=1)
    cloud = ColorCloud(*(values[cloud.points[:, 2] != -0.5] for values in cloud))  # without a table of its own
    steps = np.linspace(-0.3, 1.3, 41)
    table = np.stack(np.meshgrid(steps, steps - 0.5, [0.0]), axis=-1).reshape(-1, 3)
    points = np.concatenate([cloud.points + [0, 0, 0.6], table])
    colors = np.concatenate([cloud.colors, np.full((len(table), 3), 0.6)])
    scales = np.full((len(points), 3), 0.03)
    scales[-len(table) :, 2] = 1e-4
    n = len(points)
    return gaussian_splat(
        "room", points, scales, np.tile([1.0, 0, 0, 0], (n, 1)), np.full(n, 0.98), ((colors - 0.5) / SH0)[:, None]
    )


@pytest.fixture(scope="module")
def world() -> GaussianSplat:
    return surroundings()


@pytest.fixture
def lab(tmp_path: Path, world: GaussianSplat) -> Path:
    (tmp_path / "room.spz.ply").write_bytes(splat_bytes(world.moved(S_WF.inverse()), "a.ply"))
    (tmp_path / "lab.scene.yaml").write_text(SCENE)
    return tmp_path / "lab.scene.yaml"


def check(lab: Path, *arguments: str, mm: float = 1.0, deg: float = 0.1) -> dict[str, object]:
    """Align with --write, and compare what the document has then with the truth."""
    done = run("background", "align", str(lab), *arguments, "--write", "--json")
    assert done.code == 0, done.err
    spec = load_scene(lab).spec.background  # type: ignore[union-attr]
    found = Similarity(pose(spec.pose), spec.scale)
    corners = S_WF.inverse().apply(np.array([[-2.0, -1.5, 0], [2, 1.5, 0], [0.5, 0, 1.5]]))
    assert found.residuals(corners, S_WF.apply(corners)).max() < mm / 1000
    assert math.degrees(found.X_AB.angle_to(S_WF.X_AB)) < deg
    text = lab.read_text()
    assert "background:  # filmed on Tuesday\n" in text and "splat: room.spz.ply" in text
    facts: dict[str, object] = json.loads(done.out)
    return facts


def matrix_of(S_FW: Similarity, X_WC: Pose) -> list[list[float]]:
    return Pose.of(S_FW.apply(X_WC.p), (S_FW.X_AB @ X_WC).q).matrix.tolist()  # type: ignore[no-any-return]


CAMERAS = {
    "front": look_at(np.array([-0.4, 0.1, 0.6]), np.array([0.5, 0, 0])),
    "left": look_at(np.array([0.3, 0.9, 0.7]), np.array([0.5, 0, 0])),
}


def test_pairs_of_points_align(lab: Path) -> None:
    p_F = np.array([[0.0, 0, 0], [3, 0.5, 0], [0, 4, 1], [1, 1, 5]])
    rows = np.concatenate([p_F, S_WF.apply(p_F)], axis=1)
    lines = ["# background, world", *(", ".join(map(repr, map(float, row))) for row in rows), "0 0 0 9 9 9 0  # wrong"]
    lab.with_name("pairs.txt").write_text("\n".join(lines))
    assert check(lab, "--pairs", str(lab.with_name("pairs.txt")))["error_m"] < 1e-9  # type: ignore[operator]


@pytest.mark.slow  # the page about backgrounds runs it, too
@pytest.mark.slow  # 3 s
def test_a_reference_aligns(lab: Path, world: GaussianSplat) -> None:
    rng = np.random.default_rng(0)
    part = world.selected(np.sort(rng.permutation(len(world))[: int(0.8 * len(world))]))
    lab.with_name("reference.glb").write_bytes(splat_bytes(part, "a.glb"))
    facts = check(lab, "--to", str(lab.with_name("reference.glb")))
    assert "median distance to reference.glb" in str(facts["note"])


def test_two_cameras_align(lab: Path) -> None:
    poses = {name: matrix_of(S_WF.inverse(), X_WC) for name, X_WC in CAMERAS.items()}
    lab.with_name("cameras.json").write_text(json.dumps(poses))
    check(lab, "--cameras", str(lab.with_name("cameras.json")))


def test_one_camera_and_the_tabletop_align(lab: Path) -> None:
    """The scale is that of the depth of the table, on which the cup, which the splat lacks, does not count."""
    poses = {"front": matrix_of(S_WF.inverse(), CAMERAS["front"])}
    lab.with_name("cameras.json").write_text(json.dumps(poses))
    check(lab, "--cameras", str(lab.with_name("cameras.json")), mm=5.0)  # 0.1 % of the distance to the walls


@pytest.mark.slow
def test_a_mesh_is_aligned_with_a_mesh(lab: Path) -> None:
    """Boxes of different sizes around the room, with the same surface but other triangles."""
    trimesh = pytest.importorskip("trimesh")
    boxes = [
        trimesh.creation.box((4, 0.1, 2)), trimesh.creation.box((1, 0.6, 0.8)), trimesh.creation.box((0.4, 2.0, 0.3)),
    ]  # fmt: skip
    for box, place in zip(boxes, ((0, 1.5, 1), (0.8, 0.2, 0.4), (-1.2, 0, 0.2)), strict=True):
        box.apply_translation(place)
    mesh = trimesh.util.concatenate(boxes)
    mesh.subdivide().export(lab.with_name("world.stl"))
    matrix = S_WF.inverse().X_AB.matrix
    matrix[:3, :3] /= S_WF.scale
    mesh.apply_transform(matrix).export(lab.with_name("room.stl"))
    lab.write_text(SCENE.replace("splat: room.spz.ply", "mesh: room.stl"))
    done = run("background", "align", str(lab), "--to", str(lab.with_name("world.stl")), "--write")
    assert done.code == 0, done.err
    spec = load_scene(lab).spec.background  # type: ignore[union-attr]
    found = Similarity(pose(spec.pose), spec.scale)
    corners = S_WF.inverse().apply(np.array([[-2.0, 1.5, 0], [2, 1.5, 2], [-1.2, -1, 0.3]]))
    assert found.residuals(corners, S_WF.apply(corners)).max() < 1e-3
    assert math.degrees(found.X_AB.angle_to(S_WF.X_AB)) < 0.1


def test_without_write_nothing_changes(lab: Path) -> None:
    poses = {name: matrix_of(S_WF.inverse(), X_WC) for name, X_WC in CAMERAS.items()}
    lab.with_name("cameras.json").write_text(json.dumps(poses))
    done = run("background", "align", str(lab), "--cameras", str(lab.with_name("cameras.json")))
    assert done.code == 0 and done.out.startswith(
        "pose: {xyz: [0.4, -0.3, 0.2], rpy_deg: [5.7296, -8.5944, 68.7549]}\n"
    )
    assert lab.read_text() == SCENE


def test_convert_writes_every_format_and_the_world(lab: Path, world: GaussianSplat) -> None:
    source = lab.with_name("room.spz.ply")
    for name in ("a.spz", "a.glb", "a.usda", "a.usdc"):
        done = run("background", "convert", str(source), str(lab.with_name(name)))
        assert done.code == 0 and f"{len(world)} Gaussians" in done.out
        assert len(read_splat(lab.with_name(name))) == len(world)
    assert run("background", "convert", str(source), str(lab.with_name("a.glb"))).code == 2  # it exists
    lab.write_text(SCENE.replace("{xyz: [1, 2, 3]}", "{xyz: [1, 2, 3], yaw_deg: 90}\n  scale: 2"))
    done = run("background", "convert", str(source), str(lab.with_name("world.ply")), "--in", str(lab))
    assert done.code == 0
    x, y, z = read_splat(source).positions.T
    expected = np.stack([1 - 2 * y, 2 + 2 * x, 3 + 2 * z], axis=1)
    np.testing.assert_allclose(read_splat(lab.with_name("world.ply")).positions, expected, atol=1e-5)


BAD = {
    "two": (["--pairs", "lab.scene.yaml", "--to", "room.spz.ply"], None, "exactly one of"),
    "none": ([], None, "exactly one of"),
    "line": (["--pairs", "f"], "0 0 0 1 1 1\n1 2 3\n", "f, line 2: expected six numbers"),
    "straight": (["--pairs", "f"], "0 0 0 0 0 0\n1 0 0 1 0 0\n2 0 0 2 0 0\n", "lie on a line"),
    "infinite": (["--pairs", "f"], "0 0 0 0 0 0\n1 0 0 1 0 0\n0 1 0 0 inf 0\n", "must be finite"),
    "empty": (["--pairs", "f"], "# nothing\n", "at least three pairs"),
    "binary": (["--pairs", "f"], "\udcff", "not a text file"),
    "no json": (["--cameras", "f"], "front: 1", "not a JSON mapping"),
    "list": (["--cameras", "f"], "[1]", "not a JSON mapping"),
    "nested": (["--cameras", "f"], "[" * 100_000, "not a JSON mapping"),
    "unknown": (["--cameras", "f"], '{"back": [[1]]}', "no fixed camera `back`; it has front, left"),
    "shape": (["--cameras", "f"], '{"front": [[1, 2], [3, 4]]}', "not a rigid transform"),
    "nan": (["--cameras", "f"], '{"front": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}', "not a rigid transform"),
    "nothing": (["--cameras", "f"], "{}", "has no cameras"),
    "depth": (["--cameras", "f"], '{"front": [[1,0,0,90],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}', "cannot be aligned"),
    "other": (["--to", "f.ply"], "no splat", "f.ply could not be read"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_used_is_one_sentence(case: str, lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments, content, words = BAD[case]
    monkeypatch.chdir(lab.parent)
    if content is not None:
        Path(arguments[-1]).write_bytes(content.encode("utf-8", "surrogateescape"))
    done = run("background", "align", "lab.scene.yaml", *arguments)
    assert done.code == 2 and words in done.err and "Traceback" not in done.err
    assert lab.read_text() == SCENE


def test_a_scene_without_a_background_says_so(lab: Path) -> None:
    lab.write_text(SCENE.partition("background:")[0])
    done = run("background", "align", str(lab), "--to", str(lab.with_name("room.spz.ply")))
    assert done.code == 2 and "has no background; add `background: {splat: room.ply}` first" in done.err
