"""The synthetic depth camera has the noise it claims, and its files hold what was seen."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.frame import Frame
from simfoundry.capture.synthesize import (
    ACTIVE_STEREO,
    SensorModel,
    simulate_color,
    simulate_depth,
    simulate_frame,
    write_capture,
)
from simfoundry.geometry.frames import Array, frozen_array, look_at
from simfoundry.geometry.shapes import Sphere
from simfoundry.render.raycast import Raycast, raycast
from simfoundry.scene.model import Camera, Scene
from tests.tabletop import box, front_camera, one, pose, rgba, tabletop

QUIET = SensorModel(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.075, math.inf, 0, 90.0, 0.0, 0.0, math.inf)


def wall(distance: float, tilt: float = 0.0) -> Raycast:
    """A large wall at ``distance`` [m] whose normal is turned by ``tilt`` [rad] from the optical axis, narrow view."""
    camera = Camera("eye", 120, 100, 3000.0, 2800.0, 60.3, 48.2, look_at(np.zeros(3), np.array([1.0, 0.0, 0.0])))
    slab = one("wall", box(1e-3, 9.0, 9.0), rgba("808080"), pose(distance, 0, 0, yaw=tilt))
    return raycast(Scene("wall", frozen_array([0, 0, 0]), (slab,)), camera)


def only(**changes: float) -> SensorModel:
    return SensorModel(**{**QUIET.__dict__, **changes})


@pytest.mark.parametrize(("distance", "tilt"), [(0.5, 0.0), (1.1, 0.0), (2.5, 0.0), (1.1, 1.2)])
def test_axial_spread_is_that_of_the_formula(distance: float, tilt: float) -> None:
    ray = wall(distance, tilt)
    error = simulate_depth(ray, np.random.default_rng(3), SensorModel(disparity_step=0, dropout=0)) - ray.depth
    z = float(np.median(ray.depth))
    added = 0.0001 / math.sqrt(z) * tilt**2 / (math.pi / 2 - tilt) ** 2
    expected = 0.0012 + 0.0019 * (z - 0.4) ** 2 + added
    assert error.std() == pytest.approx(expected, rel=0.04)
    assert abs(error.mean()) < 4 * expected / math.sqrt(error.size)


def test_depth_comes_in_steps_of_disparity() -> None:
    ray = wall(1.4, 0.5)
    seen = simulate_depth(ray, np.random.default_rng(0), only(disparity_step=0.125))
    disparity = ray.camera.fx * 0.075 / seen
    np.testing.assert_allclose(disparity / 0.125, np.rint(disparity / 0.125), atol=1e-6)
    assert 3 < len(np.unique(seen.round(9))) < 300
    assert np.abs(seen - ray.depth).max() <= ray.depth.max() ** 2 * 0.125 / (ray.camera.fx * 0.075) / 2 * 1.01


def test_an_ideal_sensor_returns_the_depth_as_it_is() -> None:
    ray = raycast(tabletop(), front_camera(160, 120))
    np.testing.assert_array_equal(simulate_depth(ray, np.random.default_rng(0), QUIET), ray.depth)
    np.testing.assert_array_equal(simulate_color(ray, np.random.default_rng(0), 0.0, 0.0), ray.color)


def ball_before_wall() -> Raycast:
    camera = Camera("eye", 160, 120, 200.0, 190.0, 80.3, 58.2, look_at(np.zeros(3), np.array([1.0, 0.0, 0.0])))
    objects = (
        one("wall", box(0.02, 9.0, 9.0), rgba("808080"), pose(1.5, 0, 0, yaw=0.2)),
        one("ball", Sphere(0.12), rgba("808080"), pose(0.8, 0.02, 0.03)),
    )
    return raycast(Scene("ball", frozen_array([0, 0, 0]), objects), camera)


def distance_to_outline(ray: Raycast) -> Array:
    """Of each pixel to the nearest one of the other object [px]."""
    from scipy.ndimage import distance_transform_edt

    ball = ray.objects == 2
    return np.asarray(np.where(ball, distance_transform_edt(ball), distance_transform_edt(~ball)))


def test_the_wall_beside_the_ball_is_hidden_and_the_rest_of_it_is_not() -> None:
    ray = ball_before_wall()
    seen = simulate_depth(ray, np.random.default_rng(1), only(edge_jump=0.03, edge_band=3))
    away, lost = distance_to_outline(ray), np.isnan(seen)
    wall_side = ray.objects == 1
    assert lost[wall_side & (away <= 1)].all()
    assert not lost[wall_side & (away > 3)].any()
    assert not lost[ray.objects == 2].any()
    np.testing.assert_array_equal(seen[~lost], ray.depth[~lost])


def test_lateral_noise_mixes_the_two_sides_of_an_edge_and_nothing_else() -> None:
    ray = ball_before_wall()
    seen = simulate_depth(ray, np.random.default_rng(1), only(edge_jump=0.03, lateral=0.8))
    changed = np.abs(seen - ray.depth) > 0.3
    away = distance_to_outline(ray)
    assert 0.1 < changed[away <= 1].mean() < 0.6
    assert not (seen != ray.depth)[away > 3].any()


def test_grazing_surfaces_and_those_out_of_range_return_nothing() -> None:
    steep = np.radians(79)
    assert np.isnan(simulate_depth(wall(1.0, steep), np.random.default_rng(0), only(grazing_deg=75.0))).all()
    assert np.isfinite(simulate_depth(wall(1.0, steep), np.random.default_rng(0), only(grazing_deg=82.0))).all()
    assert np.isnan(simulate_depth(wall(0.2), np.random.default_rng(0), only(nearest=0.25))).all()
    assert np.isnan(simulate_depth(wall(3.2), np.random.default_rng(0), only(farthest=3.0))).all()


def test_a_smooth_slope_is_not_an_edge() -> None:
    ray = wall(1.0, np.radians(70))
    assert np.isfinite(simulate_depth(ray, np.random.default_rng(0), only(edge_jump=0.0005, edge_band=2))).all()


def test_dropout_takes_its_share() -> None:
    lost = np.isnan(simulate_depth(wall(1.0), np.random.default_rng(5), only(dropout=0.1)))
    assert lost.mean() == pytest.approx(0.1, abs=0.01)


def test_the_seed_alone_decides() -> None:
    ray = raycast(tabletop(), front_camera(160, 120))
    first, again, other = (simulate_frame(ray, np.random.default_rng(seed)) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.depth, again.depth)
    np.testing.assert_array_equal(first.color, again.color)
    assert (first.color != other.color).any()
    assert not np.array_equal(first.depth, other.depth, equal_nan=True)
    points = first.points[first.instances == 1]
    height = ray.camera.X_WC.apply(points[np.isfinite(points[:, 2])])[:, 2]
    assert abs(float(np.median(height[height > -0.02]))) < 1e-3  # the table's top is z = 0


def test_color_noise_has_the_spread_it_is_given() -> None:
    ray = wall(1.0)
    noise = simulate_color(ray, np.random.default_rng(2), read=2.0, shot=0.2).astype(float) - ray.color
    expected = math.sqrt(4 + 0.04 * float(ray.color.mean()) + 1 / 12)  # and a twelfth for rounding
    assert noise.std() == pytest.approx(expected, rel=0.03)


def test_files_hold_the_frame_and_the_same_bytes_each_time(tmp_path: Path) -> None:
    from PIL import Image

    frame = simulate_frame(raycast(tabletop(), front_camera(160, 120)), np.random.default_rng(4), ACTIVE_STEREO)
    facts = write_capture(tmp_path / "a", frame)
    write_capture(tmp_path / "b", frame)
    assert facts.depth is not None and facts.masks is not None and facts.masks.image == "instances.png"
    for name in (facts.color, facts.depth.image, facts.masks.image):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    with Image.open(tmp_path / "a" / facts.color) as picture:
        assert picture.mode == "RGB"
        np.testing.assert_array_equal(np.asarray(picture), frame.color)
    with Image.open(tmp_path / "a" / facts.depth.image) as picture:
        counts = np.asarray(picture).astype(np.float64)
    np.testing.assert_array_equal(counts == 0, np.isnan(frame.depth))
    np.testing.assert_allclose(np.where(counts == 0, np.nan, counts * facts.depth.scale), frame.depth, atol=0.51e-4)
    with Image.open(tmp_path / "a" / facts.masks.image) as picture:
        np.testing.assert_array_equal(np.asarray(picture), frame.instances)
    camera = facts.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == tuple(frame.K[[0, 1, 0, 1], [0, 1, 2, 2]])


def test_depth_that_does_not_fit_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    depth = np.full((2, 3), 1.0)
    depth[0, 0] = 7.0
    frame = Frame(np.zeros((2, 3, 3), dtype=np.uint8), depth, np.eye(3))
    with pytest.raises(
        ValueError, match=r"1 to 7 m does not fit in 16 bits with a depth_scale of 0.0001 m.*6.554 m; use a larger"
    ):
        write_capture(tmp_path / "c", frame)
    assert not (tmp_path / "c").exists()
    assert write_capture(tmp_path / "c", frame, depth_scale=1e-3).masks is None
