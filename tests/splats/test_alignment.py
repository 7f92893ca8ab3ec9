"""Alignment of backgrounds: known motions are found again, and what cannot be aligned is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, look_at, quat_from_rpy
from simfoundry.geometry.similarity import Similarity, fit_similarity
from simfoundry.splats.alignment import AlignmentError, ColorCloud, align_clouds, bridge_cameras, scale_from_depth


def room(count: int, seed: int) -> ColorCloud:
    """Return points on the walls of a room of 4 x 3 x 2.5 m with a table, colored by place."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1, 1, (count, 3)) * [2.0, 1.5, 1.25]
    wall = rng.integers(0, 5, count)
    for k, (axis, value) in enumerate([(0, -2.0), (0, 2.0), (1, 1.5), (2, -1.25)]):
        p[wall == k, axis] = value
    table = wall == 4
    p[table] = np.stack([0.4 * p[table, 0] + 0.5, 0.4 * p[table, 1] - 0.3, np.full(table.sum(), -0.5)], axis=1)
    colors = 0.5 + 0.5 * np.sin(p @ np.array([[1.1, 0.3, -0.7], [0.2, -1.3, 0.9], [0.8, 1.7, 0.4]]))
    return ColorCloud(p, colors)


def check(found: Similarity, wanted: Similarity, points: np.ndarray, mm: float = 1.0, deg: float = 0.1) -> None:
    assert found.residuals(points, wanted.apply(points)).max() < mm / 1000
    assert math.degrees(found.X_AB.angle_to(wanted.X_AB)) < deg
    assert found.scale == pytest.approx(wanted.scale, rel=1e-3)


MOTIONS = [
    Similarity(Pose.of((3.0, -1.0, 0.4), quat_from_rpy(0.3, -0.2, 2.1)), 0.37),
    Similarity(Pose.of((-20.0, 5.0, 9.0), quat_from_rpy(2.9, 1.2, -0.4)), 12.0),
    Similarity(Pose.of((0.1, 0.0, 0.0), quat_from_rpy(0.0, 0.0, math.pi)), 1.0),
]


@pytest.mark.parametrize("motion", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_a_moved_turned_scaled_copy_is_found(motion: int) -> None:
    S_AB = MOTIONS[motion]
    whole, rng = room(3000, seed=1), np.random.default_rng(2)
    order = rng.permutation(len(whole.points))  # a copy is not in the same order
    points_B = S_AB.inverse().apply(whole.points)[order]
    found = align_clouds(ColorCloud(points_B, whole.colors[order]), whole)
    check(found.S_AB, S_AB, points_B)
    assert found.error < 1e-6 and found.overlap == 1.0


@pytest.mark.slow
def test_a_noisy_part_is_found() -> None:
    """The copy has 70 % of the points, 2 mm of noise, and outliers."""
    S_AB, rng = MOTIONS[0], np.random.default_rng(3)
    whole = room(4000, seed=4)
    kept = rng.permutation(4000)[:2800]
    noisy = whole.points[kept] + rng.normal(0, 0.002, (2800, 3))
    noisy[:60] += rng.normal(0, 3.0, (60, 3))
    points_B = S_AB.inverse().apply(noisy)
    found = align_clouds(ColorCloud(points_B, whole.colors[kept]), whole)
    check(found.S_AB, S_AB, S_AB.inverse().apply(whole.points))


@pytest.mark.slow
def test_other_surroundings_are_refused() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(2000, 3))
    ball *= (rng.uniform(0, 1, 2000) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    with pytest.raises(AlignmentError, match="do not show the same surroundings"):
        align_clouds(ColorCloud(ball, np.full((2000, 3), 0.5)), room(2000, 1))


def test_too_few_points_are_refused() -> None:
    for count, words in ((3, "fewer than ten"), (20, "all at one place")):
        with pytest.raises(AlignmentError, match=words):
            align_clouds(ColorCloud(np.zeros((count, 3)), np.zeros((count, 3))), room(100, 1))


@pytest.mark.slow
def test_clouds_with_other_points_on_the_same_walls_are_aligned() -> None:
    S_AB, here = MOTIONS[1], room(4000, seed=6)
    points_B = S_AB.inverse().apply(here.points)
    found = align_clouds(ColorCloud(points_B, here.colors), room(4000, seed=7))
    check(found.S_AB, S_AB, points_B)


def test_weights_of_pairs_count() -> None:
    rng = np.random.default_rng(5)
    p_B = rng.normal(size=(6, 3))
    p_A = MOTIONS[0].apply(p_B)
    p_A[5] += 1.0  # a wrong pair
    check(fit_similarity(p_B, p_A, np.array([1, 2, 0.5, 1, 1, 0.0])), MOTIONS[0], p_B, mm=1e-6)
    twice = fit_similarity(np.concatenate([p_B, p_B[:2]]), np.concatenate([p_A, p_A[:2]]))
    weighted = fit_similarity(p_B, p_A, np.array([2.0, 2, 1, 1, 1, 1]))
    np.testing.assert_allclose(weighted.apply(p_B), twice.apply(p_B), atol=1e-12)
    for wrong in ([1.0, 1, 0, 0, 0, 0], [1.0, 1, 1, 1, 1, -1], [1.0] * 5, [1.0, 1, 1, 1, 1, np.nan]):
        with pytest.raises(ValueError, match="weight"):
            fit_similarity(p_B, p_A, np.array(wrong))


EYES = np.array([[1.0, 0.2, 0.9], [1.4, 0.1, 0.9], [1.8, 0.0, 0.9]])  # on a line


def cameras(count: int) -> tuple[list[Pose], list[Pose]]:
    """Return poses in W, and in a frame F from which the first motion leads to W."""
    X_WC = [look_at(eye, np.array([0.3, -0.2, 0.1])) for eye in EYES[:count]]
    S_FW = MOTIONS[0].inverse()
    return [Pose.of(S_FW.apply(X.p), (S_FW.X_AB @ X).q) for X in X_WC], X_WC


@pytest.mark.parametrize("count", [2, 3])
def test_cameras_bridge_two_frames(count: int) -> None:
    X_FC, X_WC = cameras(count)
    found = bridge_cameras(X_FC, X_WC)
    check(found.S_WF, MOTIONS[0], np.stack([X.p for X in X_FC]), mm=1e-6)
    assert found.position_error < 1e-9 and found.angle_error < 1e-7


def test_one_camera_bridges_if_the_scale_is_known() -> None:
    X_FC, X_WC = cameras(1)
    check(bridge_cameras(X_FC, X_WC, MOTIONS[0].scale).S_WF, MOTIONS[0], X_FC[0].p[None] + 1, mm=1e-6)
    with pytest.raises(ValueError, match="do not determine a scale"):
        bridge_cameras(X_FC, X_WC)
    with pytest.raises(ValueError, match="numbers of poses differ"):
        bridge_cameras([], [])
    X_FC, X_WC = cameras(3)
    with pytest.raises(ValueError, match="contradict each other"):
        bridge_cameras(X_FC, X_WC[::-1])


def test_the_scale_is_the_median_of_the_depth_ratios() -> None:
    rng = np.random.default_rng(0)
    depth_W = rng.uniform(0.5, 2.0, (20, 20))
    depth_F = depth_W / 0.37
    depth_F[:5] *= rng.uniform(0.2, 3, (5, 20))  # objects that only one side has
    depth_F[5:8], depth_W[8:9] = 0.0, np.nan
    assert scale_from_depth(depth_F, depth_W) == pytest.approx(0.37, rel=1e-9)
    with pytest.raises(ValueError, match="only 0 pixels"):
        scale_from_depth(depth_F * 0, depth_W)
    with pytest.raises(ValueError, match="disagree"):
        scale_from_depth(rng.uniform(0.1, 3, (20, 20)), depth_W)
