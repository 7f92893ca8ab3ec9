"""Objects in open containers and on flat ones: solids of containers, what carries what, and scenes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from simfoundry.capture.frame import Segmentation
from simfoundry.capture.reconstruct import carrying_height, fit_segments
from simfoundry.capture.segment.regions import pixel_area
from simfoundry.capture.segment.support_graph import carriers, parts_of
from simfoundry.capture.shapes.fit import fit_shape
from simfoundry.capture.shapes.fit_open_box import open_box_mesh
from simfoundry.capture.shapes.solid_casts import cast_mesh, cast_open_box
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder
from tests.capture.depth_camera import EYE, Solid, see, yaw_pose
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
