"""Models are located by pairs of points wherever they are in an image, and turned by their colors."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simfoundry.capture.cad.library import open_library, packed, unpacked
from simfoundry.capture.cad.locate import located_models, pose_worth, turned_by_color
from simfoundry.capture.cad.pair_features import PairFeatures
from simfoundry.capture.cad.placed_model import ObservedScene, color_difference, color_shares
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Mesh, tessellate
from tests.capture.test_cad import save
from tests.capture.test_explain import BRICK, CAN, X_BRACKET, X_BRICK, X_CAN, item, picture
from tests.capture.test_register_mesh import bracket, errors

RED, BLUE = (200, 30, 30), (30, 30, 200)


def two_colored() -> Mesh:
    """A box that is red where x is positive and blue elsewhere, which looks the same after half a turn in depth."""
    plain = tessellate(Box(np.array([0.12, 0.06, 0.05])))
    corners = plain.vertices[plain.faces].reshape(-1, 3)
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    stream = io.BytesIO()
    Image.fromarray(np.array([[BLUE] * 8 + [RED] * 8] * 16, np.uint8)).save(stream, format="PNG")
    u = np.column_stack([0.5 + corners[:, 0] / 0.13, np.full(len(corners), 0.5)])
    return Mesh(frozen_array(corners), faces, frozen_array(u), stream.getvalue())


def least_turn(a: Pose, b: Pose) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(a.rotation.T @ b.rotation) - 1) / 2, -1, 1))))


def test_pairs_of_points_vote_for_the_pose() -> None:
    template = MeshTemplate.of(bracket())
    X = Pose.of((0.1, -0.2, 0.3), (0.5, -0.1, 0.7, 0.4))
    seen = template.normals @ X.rotation.T @ [0.3, 0.5, 0.8] > 0.2  # a third of the surface
    points, normals = X.apply(template.points[seen]), template.normals[seen] @ X.rotation.T
    votes, R, t = PairFeatures.of(template).poses(points, normals, np.arange(0, len(points), 60))
    assert (np.diff(votes) <= 0).all()
    found = Pose.of(t[0], Pose.from_matrix(R[0]).q)
    assert errors(found, X, bracket()).max() < 0.015 and least_turn(found, X) < 12, "before it is refined"


@pytest.mark.slow
def test_color_tells_how_a_box_is_turned() -> None:
    mesh, X_WO = two_colored(), Pose.of((0.02, 0.01, 0.025), (0.0, 0.0, 0.3, 0.954))
    frame, support, truth = picture(item("box", mesh, X_WO))
    scene, template = ObservedScene.of(frame, support), MeshTemplate.of(mesh)
    assert template.colors is not None
    assert {tuple(c) for c in np.rint(255 * template.colors).astype(int)} >= {RED, BLUE}
    wrong = X_WO @ Pose.about(np.array([0.0, 0.0, 1.0]), np.pi)
    found = turned_by_color(scene, template, wrong, truth == 1)
    assert errors(found, X_WO, mesh).max() < 1e-6
    assert turned_by_color(scene, template, X_WO, truth == 1) is X_WO
    right, other = (pose_worth(scene, template, X, truth == 1) for X in (X_WO, wrong))
    assert right > 0.7 * (truth == 1).sum() and other < 0.1 * right, "what is nearly edge-on does not count"
    again = unpacked(packed(template)).colors
    assert again is not None and np.array_equal(again, template.colors), "the cache keeps colors"


def test_highlights_and_shadows_change_no_hue() -> None:
    def difference(seen: tuple[float, ...], known: tuple[float, ...]) -> float:
        a, b = (color_shares(np.array(c)) for c in (seen, known))
        return float(color_difference(a, b))

    red: Array = np.array([0.6, 0.1, 0.1])
    assert difference(tuple(0.6 * red), tuple(red)) < 0.1, "in a shadow"
    assert difference(tuple(0.6 * red + 0.15), tuple(red)) < 0.1, "in a highlight"
    assert difference((0.02, 0.02, 0.015), (0.06, 0.05, 0.06)) < 0.1, "black"
    assert difference((0.3, 0.3, 0.3), tuple(red)) > 0.3, "gray"
    assert difference((0.1, 0.1, 0.6), tuple(red)) > 0.5, "blue"


@pytest.mark.slow
def test_models_are_located_without_regions(tmp_path: Path) -> None:
    poses = {"bracket": X_BRACKET, "can": X_CAN, "brick": X_BRICK}
    meshes = {"bracket": bracket(), "can": CAN, "brick": BRICK}
    frame, support, truth = picture(*(item(name, mesh, poses[name]) for name, mesh in meshes.items()))
    for name, mesh in meshes.items():
        save(tmp_path, name, mesh)
    scene = ObservedScene.of(frame, support)
    for number, name in enumerate(meshes, 1):
        others = (truth != number) & (truth > 0)
        (best, *_) = located_models(scene, open_library(tmp_path), scene.standing & ~others)
        assert best.model.name == name and best.worth > 0.7 * (truth == number).sum()
        low = best.X_WO.apply(meshes[name].vertices)
        assert np.abs(low.mean(axis=0) - poses[name].apply(meshes[name].vertices).mean(axis=0)).max() < 0.006
    assert located_models(scene, open_library(tmp_path), np.zeros_like(scene.standing)) == []
