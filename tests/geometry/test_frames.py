"""Poses and quaternions, with rotations that have no symmetry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from simfoundry.geometry.frames import (
    IDENTITY,
    Array,
    Pose,
    from_xyzw,
    look_at,
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rpy,
    quat_multiply,
    rpy_from_quat,
    to_xyzw,
)

ANGLES = st.floats(-math.pi, math.pi)
QUATERNIONS = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-2)
POINTS = st.tuples(*[st.floats(-9, 9)] * 3)
POSES = st.builds(Pose.of, POINTS, QUATERNIONS)


def assert_pose(found: Pose, expected: Pose) -> None:
    assert_allclose(found.matrix, expected.matrix, atol=1e-9)


@given(POSES, POSES, POINTS)
def test_composition_maps_points_one_after_the_other(a: Pose, b: Pose, point: tuple[float, float, float]) -> None:
    p = np.array(point)
    assert_allclose((a @ b).apply(p), a.apply(b.apply(p)), atol=1e-9)
    assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-9)


@given(POSES, POSES, POSES)
def test_poses_are_a_group(a: Pose, b: Pose, c: Pose) -> None:
    assert_pose((a @ b) @ c, a @ (b @ c))
    assert_pose(a @ a.inverse(), IDENTITY)
    assert_pose(a.inverse() @ a, IDENTITY)
    assert_pose((a @ b).inverse(), b.inverse() @ a.inverse())
    assert_pose(a @ IDENTITY, a)


@given(POSES)
def test_a_pose_survives_its_matrix(a: Pose) -> None:
    again = Pose.from_matrix(a.matrix)
    assert_pose(again, a)
    assert a.angle_to(again) < 1e-7
    assert again.q[0] >= 0 and np.linalg.norm(again.q) == pytest.approx(1)
    assert_pose(Pose.from_matrix(a.rotation), Pose.of(q=a.q))


@given(QUATERNIONS)
def test_a_rotation_is_orthogonal_and_right_handed(q: tuple[float, ...]) -> None:
    r = Pose.of(q=q).rotation
    assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 2, 3], [-3, 1, 2]])
@pytest.mark.parametrize("angle", [math.pi, math.pi - 1e-9, 1e-9, 2.0])
def test_matrices_near_half_a_turn_are_read_back(axis: list[float], angle: float) -> None:
    u = np.array(axis) / np.linalg.norm(axis)
    q = np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * u])
    r = matrix_from_quat(q)
    assert_allclose(matrix_from_quat(quat_from_matrix(r)), r, atol=1e-12)


def rotation_about(axis: int, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    r = np.eye(3)
    r[i, i] = r[j, j] = c
    r[j, i], r[i, j] = s, -s
    return r


@given(ANGLES, ANGLES, ANGLES)
def test_roll_pitch_yaw_turn_about_fixed_axes(roll: float, pitch: float, yaw: float) -> None:
    expected = rotation_about(2, yaw) @ rotation_about(1, pitch) @ rotation_about(0, roll)
    q = quat_from_rpy(roll, pitch, yaw)
    assert_allclose(matrix_from_quat(q), expected, atol=1e-12)
    assert_allclose(matrix_from_quat(quat_from_rpy(*rpy_from_quat(q))), expected, atol=1e-6)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_gimbal_lock_keeps_the_rotation(pitch: float) -> None:
    q = quat_from_rpy(0.7, pitch, -1.1)
    assert_allclose(matrix_from_quat(quat_from_rpy(*rpy_from_quat(q))), matrix_from_quat(q), atol=1e-8)


def test_a_quarter_turn_about_each_axis() -> None:
    h = math.sqrt(0.5)
    assert_allclose(Pose.of(q=(h, 0, 0, h)).apply(np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-12)
    assert_allclose(Pose.of(q=(h, h, 0, 0)).apply(np.array([0, 1.0, 0])), [0, 0, 1], atol=1e-12)
    assert_allclose(Pose.of(q=(h, 0, h, 0)).apply(np.array([0, 0, 1.0])), [1, 0, 0], atol=1e-12)


def test_quaternion_orders_are_converted_both_ways() -> None:
    q = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]])
    assert to_xyzw(q[0]).tolist() == [0.2, 0.3, 0.4, 0.1]
    assert from_xyzw([0.2, 0.3, 0.4, 0.1]).tolist() == q[0].tolist()
    assert from_xyzw(to_xyzw(q)).tolist() == q.tolist()


@given(QUATERNIONS, QUATERNIONS)
def test_products_turn_one_after_the_other(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    x, y = Pose.of(q=a), Pose.of(q=b)
    assert_allclose(matrix_from_quat(quat_multiply(x.q, y.q)), x.rotation @ y.rotation, atol=1e-12)


@pytest.mark.parametrize("target", [[0.2, -0.3, 0.1], [5, 5, 5], [1, 2, -4], [1, 2, 9]])
def test_a_camera_looks_where_it_should(target: list[float]) -> None:
    eye = np.array([1.0, 2.0, 3.0])
    X_WC = look_at(eye, np.array(target))
    in_camera = X_WC.inverse().apply(np.array(target, dtype=np.float64))
    assert_allclose(in_camera[:2], [0, 0], atol=1e-9)
    assert in_camera[2] == pytest.approx(math.dist(eye, target))
    down = X_WC.rotation.T @ np.array([0.0, 0.0, -1.0])
    assert down[1] >= -1e-9 and abs(down[0]) < 1e-9  # what falls, falls down in the picture


def test_what_is_left_in_the_world_is_left_in_the_picture() -> None:
    X_WC = look_at(np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.0, 1.0]))
    assert X_WC.inverse().apply(np.array([2.0, 0.5, 1.0]))[0] == pytest.approx(-0.5)


def test_a_pose_refuses_what_is_no_rotation_and_cannot_be_changed() -> None:
    for q in ([0, 0, 0, 0], [math.nan, 0, 0, 1], [math.inf, 0, 0, 0]):
        with pytest.raises(ValueError, match="non-zero quaternion"):
            Pose.of(q=q)
    with pytest.raises(ValueError, match="its own position"):
        look_at(np.ones(3), np.ones(3))
    with pytest.raises(ValueError, match="read-only"):
        Pose.of().p[0] = 1.0


def test_the_angle_between_poses_is_that_of_the_rotation() -> None:
    a = Pose.of(q=quat_from_rpy(0.3, -0.4, 2.0))
    u = np.array([1.0, 2.0, -2.0]) / 3
    b = a @ Pose.of(q=np.concatenate([[math.cos(0.6)], math.sin(0.6) * u]))
    assert a.angle_to(b) == pytest.approx(1.2)
    assert b.angle_to(a) == pytest.approx(1.2)
