"""Objects in open containers and on flat ones: solids of containers, what carries what, and scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from simfoundry.capture.description.level_object import level_thickness
from simfoundry.capture.doubts.image_doubts import image_doubts
from simfoundry.capture.findings import SUPPORT_DOUBT
from simfoundry.capture.frame import Segmentation
from simfoundry.capture.reconstruct import carrying_height, fit_segments
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.regions import pixel_area
from simfoundry.capture.segment.support_graph import carriers, parts_of
from simfoundry.capture.shapes.fit import fit_shape
from simfoundry.capture.shapes.fit_open_box import open_box_mesh
from simfoundry.capture.shapes.solid_casts import cast_mesh, cast_open_box
from simfoundry.capture.statements.stated import stated_segmentation
from simfoundry.capture.synthesize import simulate_frame
from simfoundry.geometry.frames import Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Camera, Scene
from tests.capture.depth_camera import EYE, Solid, see, yaw_pose
from tests.corpora import synthetic_tables
from tests.corpora.carriers import carrier_table, judged

TRAY_SIZE, WALL = np.array([0.26, 0.19, 0.05]), 0.006
TRAY: Solid = (open_box_mesh(TRAY_SIZE, WALL), yaw_pose(0.03, 0.0, 0.025, 25))
CAN: Solid = (Cylinder(0.03, 0.08), Pose.of((0.05, 0.01, WALL + 0.04)))


def test_an_open_box_is_closed_as_a_surface() -> None:
    mesh = open_box_mesh(TRAY_SIZE, WALL)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    outside, inside = float(np.prod(TRAY_SIZE)), float(np.prod(TRAY_SIZE - [2 * WALL, 2 * WALL, WALL]))
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.volume == pytest.approx(outside - inside)


def test_rays_against_an_open_box_are_those_against_its_mesh() -> None:
    X_WO = Pose.of((0.1, -0.05, 0.03), quat_from_rpy(0.1, -0.2, 0.7))
    mesh = open_box_mesh(TRAY_SIZE, WALL)
    eye = np.array([-0.5, 0.2, 0.6])
    rays = X_WO.p - eye + np.random.default_rng(0).uniform(-0.2, 0.2, (3000, 3))
    fast = cast_open_box(eye, rays, TRAY_SIZE, WALL, X_WO)
    exact = cast_mesh(eye, rays, X_WO.apply(mesh.vertices), mesh.faces)
    hit = np.isfinite(exact.depth)
    assert 0.2 < hit.mean() < 0.9 and np.array_equal(hit, np.isfinite(fast.depth))
    assert np.allclose(fast.depth[hit], exact.depth[hit]) and np.allclose(fast.slant[hit], exact.slant[hit])


@pytest.mark.slow
def test_a_tray_is_fitted_with_its_cavity() -> None:
    frame, support, labels = see([TRAY])
    shape = fit_shape(frame, support, labels == 1, 0.0, labels=labels)
    assert shape.wall > 0 and shape.hollow and shape.profile is None
    size = np.ptp(np.asarray(shape.geometry.vertices), axis=0)  # type: ignore[union-attr]
    assert np.allclose(np.sort(size), np.sort(TRAY_SIZE), atol=0.008)


def test_a_tray_carries_what_it_surrounds() -> None:
    """The floor of the tray is as low as the noise of the table."""
    frame, support, labels = see([TRAY, CAN])
    assert carriers(parts_of(labels, support.X_WC.apply(frame.points), pixel_area(frame))) == {1: 0, 2: 1}


@pytest.mark.slow
def test_what_is_in_a_tray_stands_on_its_floor() -> None:
    frame, support, labels = see([TRAY, CAN])
    points_W = support.X_WC.apply(frame.points)
    on = Segmentation(labels, {1: 0, 2: 1})
    shapes, found, findings = fit_segments(frame, support, on, lambda stage, share: None)
    assert found == {1: 0, 2: 1} and findings == ()
    assert carrying_height(shapes[1], points_W[labels == 2]) == pytest.approx(WALL, abs=0.004)
    assert isinstance(shapes[2].geometry, Cylinder) and shapes[2].geometry.height == pytest.approx(0.08, abs=0.006)


def test_a_neighbor_does_not_carry() -> None:
    """A can before a carton, which is on one side of it only, and a can between two cartons."""
    carton, other = ((Box(np.array([0.06, 0.16, 0.1])), yaw_pose(x, 0.02, 0.05, 5)) for x in (0.12, -0.1))
    can: Solid = (Cylinder(0.025, 0.06), Pose.of((0.02, 0.02, 0.03)))
    frame, support, labels = see([carton, can, other], eye=EYE + np.array([0.0, 0.0, 0.3]))
    assert carriers(parts_of(labels, support.X_WC.apply(frame.points), pixel_area(frame))) == {1: 0, 2: 0, 3: 0}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 4])
def test_scenes_with_carriers(seed: int) -> None:
    """A tray, a bowl and a book: everything is found, stands where it does in truth, and stays there."""
    result = judged(carrier_table(seed), with_masks=True)
    assert result.is_right and result.passed


@pytest.mark.slow
@pytest.mark.parametrize("stated", [False, True])
def test_a_lower_table_beside_the_first_one_carries_its_own_objects(stated: bool) -> None:
    """Two blocks on it, 25 cm below the table with three, found or as the masks of a person."""
    gray, rng = frozen_array([0.6, 0.6, 0.6, 1.0]), np.random.default_rng(0)
    scene_objects = [
        synthetic_tables._object(name, Pose.of(), [(synthetic_tables._box(*size), Pose.of(place), gray)], fixed)
        for name, size, place, fixed in (
            ("table", (0.9, 1.2, 0.03), (0.1, 0.0, -0.015), True),
            ("side", (0.9, 0.7, 0.03), (0.1, -1.0, -0.265), True),
            ("floor", (8.0, 8.0, 0.02), (0.0, 0.0, -0.7), True),
            *((f"t{k}", (0.05, 0.05, 0.08), (0.0, y, 0.04), False) for k, y in enumerate((0.1, -0.1, -0.3))),
            *((f"s{k}", (0.05, 0.05, 0.08), (0.05, y, -0.21), False) for k, y in enumerate((-0.8, -0.95))),
        )
    ]
    X_WC = look_at(np.array([-0.75, -0.4, 0.65]), np.array([0.1, -0.4, 0.05]))
    camera = Camera("view", 640, 480, 540, 540, 319.5, 239.5, X_WC)
    scene = Scene("two", gravity=frozen_array([0, 0, -9.81]), objects=tuple(scene_objects))
    ray = raycast(scene, camera)
    frame = replace(simulate_frame(ray, rng), instances=None)
    support = find_support(frame)
    (side,) = (rival for rival in support.rivals if rival.carried > 0)
    assert side.height == pytest.approx(-0.25, abs=0.01) and 0.003 < side.carried < 0.02
    truth = np.where(ray.objects > 3, ray.objects - 3, 0).astype(np.int32)
    truth[ray.objects == 2] = 6
    found = stated_segmentation(frame, support, truth) if stated else decompose(frame, support)
    number = {k: int(np.bincount(found.labels[truth == k]).argmax()) for k in range(1, 7)}
    assert 0 not in number.values() and found.surfaces == {number[6]: 0} and found.labels.max() == 6
    assert found.supports == {number[k]: number[6] if k in (4, 5) else 0 for k in number}
    assert set(np.unique(found.objects)) == {0, *(number[k] for k in range(1, 6))}
    shapes, carriers, findings = fit_segments(frame, support, found, lambda stage, share: None)
    heights = {k: shapes[number[k]].X_WO.p[2] for k in range(1, 6)}
    assert findings == () and carriers == found.supports
    assert np.allclose([heights[k] for k in range(1, 6)], [0.04] * 3 + [-0.21] * 2, atol=0.01)
    top = shapes[number[6]]
    assert top.X_WO.p[2] + level_thickness(top) / 2 == pytest.approx(-0.25, abs=0.005)
    assert not any(f.code == SUPPORT_DOUBT for f in image_doubts(frame, support, found))
    alone = decompose(frame, replace(support, levels=()))
    assert alone.labels.max() == 3 and any(f.code == SUPPORT_DOUBT for f in image_doubts(frame, support, alone))
