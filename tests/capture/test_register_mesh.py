"""A mesh is found in an image on any side, turned anyhow, and at an unknown scale."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.shapes.evidence import Evidence, gather
from simfoundry.capture.shapes.mesh_template import MAX_SIDES, MeshTemplate, resting_sides
from simfoundry.capture.shapes.register_mesh import register_mesh, register_upright
from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Mesh, closed_mesh, tessellate
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Camera, Link, Scene, SceneObject, Visual


def bracket() -> Mesh:
    """An L of two boxes whose mirror image differs from it, 12 cm long and 9 cm high."""
    parts = [
        (Box(np.array([0.12, 0.05, 0.03])), (0.0, 0.0, 0.015)),
        (Box(np.array([0.03, 0.03, 0.06])), (0.045, 0.01, 0.06)),
    ]
    meshes = [(tessellate(box), np.array(p)) for box, p in parts]
    vertices = np.concatenate([m.vertices + p for m, p in meshes])
    return closed_mesh(vertices, np.concatenate([meshes[0][0].faces, meshes[1][0].faces + 8]))


def evidence_of(mesh: Mesh, X_WO: Pose, size: int = 1) -> Evidence:
    """Exact depth of a mesh on the plane z = 0, as a camera 0.7 m away sees it in 160 x 120 pixels times the size."""

    def item(name: str, geometry: Mesh | Box, pose: Pose) -> SceneObject:
        link = Link("body", 1.0, np.zeros(3), np.eye(3), (Visual("v", geometry, frozen_array([1, 1, 1, 1])),), ())
        return SceneObject(name, category=name, fixed=True, X_WO=pose, links=(link,))

    table = item("table", Box(np.array([1.0, 1.0, 0.02])), Pose.of((0, 0, -0.01)))
    scene = Scene("one", frozen_array([0, 0, -9.81]), (table, item("bracket", mesh, X_WO)))
    X_WC = look_at(np.array([-0.5, 0.1, 0.5]), np.array([0.0, 0.0, 0.03]))
    f, w, h = 190.0 * size, 160 * size, 120 * size
    ray = raycast(scene, Camera("view", w, h, f, f, (w - 1) / 2, (h - 1) / 2, X_WC))
    mask = ray.objects == 2
    frame = Frame(ray.color, ray.depth, np.array([[f, 0, (w - 1) / 2], [0, f, (h - 1) / 2], [0, 0, 1]]))
    return gather(frame, SupportSurface(X_WC, np.zeros((0, 2)), 0.0, ~mask), mask, 0.0)


def lying(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Pose:
    """The bracket, turned, with its lowest point on the plane."""
    q = quat_from_rpy(*np.radians([roll_deg, pitch_deg, yaw_deg]))
    low = Pose.of(q=q).apply(bracket().vertices)[:, 2].min()
    return Pose.of((0.02, -0.03, -float(low)), q)


def errors(found: Pose, truth: Pose, mesh: Mesh, scale: float = 1.0) -> Array:
    """How far the vertices of the mesh are from where they belong [m]."""
    return np.asarray(np.linalg.norm(found.apply(mesh.vertices * scale) - truth.apply(mesh.vertices), axis=1))


def test_a_mesh_is_found_on_its_side() -> None:
    truth = lying(90, 0, 130)
    evidence, template = evidence_of(bracket(), truth), MeshTemplate.of(bracket())
    found = register_mesh(evidence, template)
    assert errors(found.X_WO, truth, bracket()).max() < 0.002
    assert found.scale == 1.0 and found.agreement.explained > 0.98
    again = register_mesh(evidence, template)
    assert np.array_equal(again.X_WO.p, found.X_WO.p) and np.array_equal(again.X_WO.q, found.X_WO.q)


@pytest.mark.slow
@pytest.mark.parametrize("turn", [(0, 0, 20), (180, 0, 75), (0, 90, -50), (0, -90, 170), (-90, 0, 0), (90, 25, 40)])
@pytest.mark.parametrize("is_known", [True, False])
def test_a_mesh_is_found_in_any_pose(turn: tuple[float, float, float], is_known: bool) -> None:
    truth = lying(*turn)
    mesh = bracket()
    given = mesh if is_known else closed_mesh(mesh.vertices * 7.3 + [0.2, 0.1, -0.4], mesh.faces)
    found = register_mesh(evidence_of(mesh, truth), MeshTemplate.of(given), scale=1.0 if is_known else None)
    assert found.scale == pytest.approx(1.0 if is_known else 1 / 7.3, rel=0.03)
    shown = found.X_WO.apply(given.vertices * found.scale)
    assert np.linalg.norm(shown - truth.apply(mesh.vertices), axis=1).max() < 0.004


@pytest.mark.slow
def test_a_mesh_without_a_distinct_side_stays_upright() -> None:
    block = tessellate(Box(np.array([0.06, 0.06, 0.06])))
    low = closed_mesh(block.vertices + [0, 0, 0.03], block.faces)
    found = register_upright(evidence_of(low, Pose.of((0.01, 0.02, 0), quat_from_rpy(0, 0, 0.3))), MeshTemplate.of(low))
    assert found.X_WO.rotation[2, 2] > 0.999 and found.X_WO.p == pytest.approx([0.01, 0.02, 0.0], abs=0.002)


def test_the_sides_of_a_mesh() -> None:
    box = tessellate(Box(np.array([0.1, 0.2, 0.3])))
    down = np.round(resting_sides(box.vertices)[:, 2], 6)  # the axes of the box that point up
    assert len(down) == 6 and len(np.unique(down, axis=0)) == 6 and down[0].tolist() == [0, 0, 1]
    sides = resting_sides(tessellate(Cylinder(0.03, 0.2)).vertices)
    assert 8 <= len(sides) <= MAX_SIDES
    np.testing.assert_allclose(
        np.einsum("sij,skj->sik", sides, sides), np.tile(np.eye(3), (len(sides), 1, 1)), atol=1e-9
    )
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert np.array_equal(resting_sides(flat), np.eye(3)[None])
