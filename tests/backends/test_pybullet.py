from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.features import Fidelity
from simfoundry.backends.pybullet import compile_pybullet, projection_matrix
from simfoundry.backends.pybullet.surfaces import SKIN, inset_hull
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh, Sphere
from simfoundry.scene.model import Scene
from tests.mechanisms import mechanisms, rough
from tests.scenes import box, full_scene, pose, primitives_scene, scene_of, solid, textured_object, wedge_mesh


def world(scene: Scene) -> dict[str, dict[str, dict[str, object]]]:
    data: dict[str, dict[str, dict[str, object]]] = json.loads(compile_pybullet(scene).files["world.json"])
    return data


def test_surfaces_are_square_roots_because_bullet_multiplies() -> None:
    objects = world(full_scene())["objects"]
    assert objects["puck"]["links"] == {
        "body": {
            "lateral_friction": pytest.approx(math.sqrt(0.1)),
            "restitution": pytest.approx(math.sqrt(0.4)),
        }
    }
    mean = (0.35 * 0.35 * 0.6) ** (1 / 3)
    links = objects["wedge"]["links"]
    assert isinstance(links, dict)
    assert links["body"]["lateral_friction"] == pytest.approx(math.sqrt(mean))


def test_losses_say_what_bullet_cannot_hold() -> None:
    losses = {loss.path: loss for loss in compile_pybullet(full_scene()).losses}
    assert set(losses) == {
        "wedge.friction", "wedge.colliders", "cabinet.slide.armature", "cabinet.hinge.armature", "sun", "lamp", "sky",
        "friction", "restitution",
    }  # fmt: skip
    assert losses["wedge.friction"].fidelity is Fidelity.APPROXIMATED
    assert "0.4189 replaces 0.35, 0.6" in losses["wedge.friction"].reason


def test_a_capsule_stays_a_capsule() -> None:
    root = ET.fromstring(compile_pybullet(primitives_scene()).files["pill.urdf"])
    assert [shape.attrib for shape in root.iterfind("link/collision/geometry/capsule")] == [
        {"radius": "0.02", "length": "0.06"}
    ]


def test_resistance_is_exact_against_one_friction_and_its_error_is_stated_against_two() -> None:
    """Bullet sums the coefficient of each times the sliding friction of the other."""
    ball = rough(solid("ball", Sphere(0.04), pose(0, 0, 1, 0.1), friction=0.3), 0.004, 0.002)
    table = solid("table", box(1, 1, 0.1), pose(0, 0, 0), friction=0.6, fixed=True)
    written = world(scene_of(ball, table))["objects"]
    links = {name: item["links"]["body"] for name, item in written.items()}  # type: ignore[index]
    assert links["ball"]["rolling_friction"] * math.sqrt(0.6) == pytest.approx(0.002)
    assert links["ball"]["spinning_friction"] * math.sqrt(0.6) == pytest.approx(0.004)
    assert "rolling_friction" not in links["table"]
    losses = {loss.path: loss.reason for loss in compile_pybullet(scene_of(ball, table)).losses}
    assert "rolling_friction" not in losses
    wall = solid("wall", box(1, 0.1, 1), pose(0, 1, 0), friction=0.15, fixed=True)
    losses = {loss.path: loss.reason for loss in compile_pybullet(scene_of(ball, table, wall)).losses}
    assert losses["rolling_friction"].endswith(
        "The worst pair is off by 41%."
    )  # a factor of 2 to either side, by its root
    twins = [rough(solid(f"ball_{k}", Sphere(0.04), pose(k, 0, 1), friction=0.3), 0.0, 0.002) for k in range(2)]
    links = {name: item["links"]["body"] for name, item in world(scene_of(*twins))["objects"].items()}  # type: ignore[index]
    assert 2 * links["ball_0"]["rolling_friction"] * math.sqrt(0.3) == pytest.approx(0.002)


def test_mechanisms_are_in_the_world_file() -> None:
    objects = world(mechanisms())["objects"]
    assert list(objects) == ["gripper", "pendulum", "pot", "pot.lid", "ball", "table"]
    assert objects["gripper"]["mimics"] == {"right_slide": {"joint": "left_slide", "multiplier": -0.5, "offset": 0.02}}
    assert objects["gripper"]["drives"] == {
        "left_slide": {"stiffness": 120, "damping": 6, "target": 0.03, "force_limit": 25}
    }
    assert objects["gripper"]["no_contact"] == [["palm", "left"], ["palm", "right"]]
    assert "self_collision" not in objects["pendulum"]
    assert json.loads(compile_pybullet(mechanisms()).files["world.json"])["no_contact"] == [
        [["pot", "grip"], ["pot.lid", "lid"]],
        [["ball", "body"], ["gripper", "left"]],
        [["pot.lid", "lid"], ["table", "body"]],
    ]


def test_the_loader_loads_mechanisms(run_loader: Callable[[Scene, str], str]) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    assert "gripper, pendulum, pot, pot.lid, ball, table" in run_loader(mechanisms(), "pybullet")


def test_loader_runs_from_a_moved_folder(run_loader: Callable[[Scene, str], str]) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    printed = run_loader(full_scene(), "pybullet")
    assert printed.count("\n") == 1
    assert "table, crate, ball, can, pill, puck, wedge, cabinet, fan" in printed


def test_two_builds_are_identical(manifest_elsewhere: Callable[[str], str]) -> None:
    assert compile_scene(full_scene(), "pybullet").manifest.decode() == manifest_elsewhere("pybullet")


def test_cameras_project_as_their_intrinsics() -> None:
    camera = full_scene().cameras[0]
    stored = world(full_scene())["cameras"][camera.name]
    view, projection = (np.array(stored[key]).reshape(4, 4).T for key in ("view", "projection"))
    np.testing.assert_allclose(projection, projection_matrix(camera), rtol=1e-10)
    p_C = np.array([0.21, -0.13, 0.9])
    clip = projection @ view @ np.append(camera.X_WC.apply(p_C), 1.0)
    ndc = clip[:3] / clip[3]
    # The middle of the first pixel is (0, 0), so the left edge of the picture is at -0.5.
    u, v = (ndc[0] + 1) / 2 * camera.width - 0.5, (1 - ndc[1]) / 2 * camera.height - 0.5
    assert u == pytest.approx(camera.fx * p_C[0] / p_C[2] + camera.cx, abs=1e-6)
    assert v == pytest.approx(camera.fy * p_C[1] / p_C[2] + camera.cy, abs=1e-6)
    assert -1 < ndc[2] < 1


def test_an_inset_hull_with_its_skin_has_the_faces_of_the_hull() -> None:
    turn = pose(0.2, -0.1, 0.3, 0.4, 0.9, -1.3)
    flat = wedge_mesh(0.1, 0.06, 0.05)
    mesh = Mesh(turn.apply(flat.vertices), flat.faces)
    inset = inset_hull(mesh, SKIN)
    assert inset is not None
    assert len(inset.vertices) == 6
    for triangle in inset.vertices[inset.faces]:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        normal /= np.linalg.norm(normal)
        assert (inset.vertices @ normal).max() == pytest.approx(triangle[0] @ normal, abs=1e-9)  # it faces outward
        assert (mesh.vertices @ normal).max() == pytest.approx(triangle[0] @ normal + SKIN, abs=1e-8)


def test_a_hull_thinner_than_its_skin_is_left_alone() -> None:
    sheet = wedge_mesh(0.1, 0.06, 0.0015)
    assert inset_hull(sheet, SKIN) is None
    assert inset_hull(Mesh(frozen_array(np.zeros((4, 3))), sheet.faces[:1]), SKIN) is None


def test_collision_files_are_inset_and_visual_files_are_not() -> None:
    artifact = compile_pybullet(Scene("s", frozen_array([0, 0, -9.81]), (textured_object(),)))
    root = ET.fromstring(artifact.files["wedge.urdf"])

    def extent(kind: str) -> float:
        mesh = root.find(f"link/{kind}/geometry/mesh")
        assert mesh is not None
        rows = artifact.files[mesh.attrib["filename"]].decode().splitlines()
        return float(np.ptp([float(row.split()[2]) for row in rows if row.startswith("v ")]))

    assert extent("visual") == pytest.approx(0.06, abs=1e-12)
    assert extent("collision") == pytest.approx(0.06 - 2 * SKIN, abs=1e-9)
