"""Models of a CAD library correct a segmentation: they join parts of one object, and divide two in one region."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.cad.explain import explained_segmentation
from simfoundry.capture.cad.library import open_library
from simfoundry.capture.cad.match import CadLookup
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.geometry.frames import Pose, frozen_array, look_at
from simfoundry.geometry.shapes import Box, Cylinder, Mesh, revolved, tessellate
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Camera, Link, Scene, SceneObject, Visual
from tests.capture.test_cad import save
from tests.capture.test_register_mesh import bracket, errors, lying

CAN, BRICK = tessellate(Cylinder(0.033, 0.1)), tessellate(Box(np.array([0.11, 0.05, 0.09])))
X_BRACKET, X_CAN, X_BRICK = lying(0, 0, 30), Pose.of((0.04, 0.06, 0.05)), Pose.of((0.05, -0.16, 0.045))


def item(name: str, mesh: Mesh | Box, pose: Pose) -> SceneObject:
    link = Link("body", 1.0, np.zeros(3), np.eye(3), (Visual("v", mesh, frozen_array([1, 1, 1, 1])),), ())
    return SceneObject(name, category=name, fixed=True, X_WO=pose, links=(link,))


def picture(*objects: SceneObject) -> tuple[Frame, SupportSurface, Labels]:
    """Exact depth of objects on a table, and the number of the object at each pixel."""
    table = item("table", Box(np.array([1.0, 1.0, 0.02])), Pose.of((0, 0, -0.01)))
    X_WC = look_at(np.array([-0.5, 0.1, 0.5]), np.array([0.0, 0.0, 0.03]))
    f, w, h = 570.0, 480, 360
    K = np.array([[f, 0, (w - 1) / 2], [0, f, (h - 1) / 2], [0, 0, 1]])
    camera = Camera("view", w, h, f, f, (w - 1) / 2, (h - 1) / 2, X_WC)
    ray = raycast(Scene("some", frozen_array([0, 0, -9.81]), (table, *objects)), camera)
    truth = np.where(ray.objects > 1, ray.objects - 1, 0).astype(np.int32)
    outline = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return Frame(ray.color, ray.depth, K), SupportSurface(X_WC, outline, 0.0, truth == 0), truth


def overlap(a: Mask, b: Mask) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.mark.slow
def test_models_divide_and_join_regions(tmp_path: Path) -> None:
    objects = item("bracket", bracket(), X_BRACKET), item("can", CAN, X_CAN), item("brick", BRICK, X_BRICK)
    frame, support, truth = picture(*objects)
    save(tmp_path, "bracket", bracket())
    save(tmp_path, "can", CAN)
    library = open_library(tmp_path)
    left = np.arange(truth.shape[1])[None] < np.median(np.nonzero(truth == 1)[1])
    labels = np.select([(truth == 1) & left, truth == 3, truth > 0], [1, 3, 2]).astype(np.int32)
    found = explained_segmentation(frame, support, Segmentation(labels, {1: 0, 2: 0, 3: 0}), library)
    again = explained_segmentation(frame, support, Segmentation(labels, {1: 0, 2: 0, 3: 0}), library)
    assert np.array_equal(found.segmentation.labels, again.segmentation.labels)
    sure = {match.model: k for k, match in found.matches.items() if match.is_sure}
    assert set(sure) == {"bracket", "can"} and found.segmentation.labels.max() == 3
    for name, number in (("bracket", 1), ("can", 2)):
        assert overlap(found.segmentation.labels == sure[name], truth == number) > 0.97
    for name, mesh, pose in (("bracket", bracket(), X_BRACKET), ("can", CAN, X_CAN)):
        X_WO = found.matches[sure[name]].X_WO
        off = errors(X_WO, pose, mesh) if name == "bracket" else np.abs(X_WO.p - pose.p)
        assert off.max() < 0.003, name
    (brick,) = {1, 2, 3} - set(sure.values())
    assert np.array_equal(found.segmentation.labels == brick, truth == 3), "no model explains it"
    assert CadLookup(library, found.matches[sure["can"]]).base_z(0.07) == pytest.approx(0.0, abs=0.002)


@pytest.mark.slow
def test_two_of_a_kind_in_one_region(tmp_path: Path) -> None:
    beside = Pose.of((0.045, -0.01, 0.05))
    frame, support, truth = picture(item("one", CAN, X_CAN), item("other", CAN, beside))
    save(tmp_path, "can", CAN)
    labels = (truth > 0).astype(np.int32)
    found = explained_segmentation(frame, support, Segmentation(labels, {1: 0}), open_library(tmp_path))
    assert [(m.model, m.is_sure) for m in found.matches.values()] == [("can", True)] * 2
    places = sorted((m.X_WO.p[1], k) for k, m in found.matches.items())
    for (y, k), (pose, number) in zip(places, ((beside, 2), (X_CAN, 1)), strict=True):
        assert y == pytest.approx(pose.p[1], abs=0.003)
        assert overlap(found.segmentation.labels == k, truth == number) > 0.95


@pytest.mark.slow
def test_the_floor_of_a_thin_bowl_is_part_of_it(tmp_path: Path) -> None:
    bowl = revolved([(0, 0.003), (0.05, 0.003), (0.08, 0.05), (0.083, 0.05), (0.055, 0.0), (0, 0)])
    frame, support, truth = picture(item("bowl", bowl, Pose.of((0, 0, 0))))
    save(tmp_path, "bowl", bowl)
    found = explained_segmentation(frame, support, Segmentation(truth, {1: 0}), open_library(tmp_path))
    assert [(m.model, m.is_sure) for m in found.matches.values()] == [("bowl", True)]
    assert overlap(found.segmentation.labels == 1, truth == 1) > 0.97
