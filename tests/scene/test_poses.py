"""Poses into the words of a spec and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.lower import pose
from simfoundry.scene.state import pose_spec, with_poses
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.shapes import BoxShape

ANGLE = st.floats(-math.pi, math.pi)
LENGTH = st.floats(-2, 2)


@given(st.tuples(LENGTH, LENGTH, LENGTH), st.tuples(ANGLE, ANGLE, ANGLE))
def test_any_pose_comes_back(p: tuple[float, float, float], rpy: tuple[float, float, float]) -> None:
    X_WO = Pose.of(p, quat_from_rpy(*rpy))
    back = pose(pose_spec(X_WO))
    assert np.abs(back.p - X_WO.p).max() <= 0.5e-4 + 1e-12
    assert math.degrees(back.angle_to(X_WO)) < 0.07  # an upright pose may hide a tilt of 0.05 degrees


@pytest.mark.parametrize("pitch", [90.0, -90.0, 89.9999, 90.001])
def test_a_pose_on_its_side_comes_back(pitch: float) -> None:
    X_WO = Pose.of([0.1, 0.2, 0.3], quat_from_rpy(0.4, math.radians(pitch), -1.2))
    assert math.degrees(pose(pose_spec(X_WO)).angle_to(X_WO)) < 0.03


def test_upside_down_is_not_upright() -> None:
    """Rounding can make the cosine of its tilt a little less than -1."""
    rng = np.random.default_rng(3)
    for yaw in rng.uniform(-math.pi, math.pi, 500):
        X_WO = Pose.of([0, 0, 0.1], quat_from_rpy(math.pi, 0.0, yaw))
        spec = pose_spec(X_WO)
        assert spec.rpy_deg is not None and abs(spec.rpy_deg[0]) == 180
        assert math.degrees(pose(spec).angle_to(X_WO)) < 0.02


def test_upright_poses_are_written_as_a_person_would() -> None:
    assert pose_spec(Pose.of([0.12345, -0.0, 0])) == FramedPose(xyz=(0.1235, 0, 0))
    assert pose_spec(Pose.of([0, 0, 1], quat_from_rpy(0, 0, math.radians(30)))) == FramedPose(xyz=(0, 0, 1), yaw_deg=30)
    tilted = Pose.of([0, 0, 1], quat_from_rpy(math.radians(0.2), 0, math.radians(30)))
    assert pose_spec(tilted) == FramedPose(xyz=(0, 0, 1), rpy_deg=(0.2, 0, 30))


def test_only_what_is_free_and_named_moves() -> None:
    shape = BoxShape(box=(0.1, 0.1, 0.1))
    at = FramedPose(xyz=(1, 2, 3), yaw_deg=4)
    objects = {n: ObjectSpec(shape=shape, mass=1.0, fixed=n == "desk", pose=at) for n in ("desk", "cup", "plate")}
    spec = SceneSpec(simfoundry="scene/1", name="s", objects=objects)
    X_WO = Pose.of([0.5, 0.6, 0.7], quat_from_rpy(0.1, 0.2, 0.3))
    moved = with_poses(spec, {"desk": X_WO, "cup": X_WO})
    assert moved.objects["desk"] == objects["desk"] and moved.objects["plate"] == objects["plate"]
    assert moved.objects["cup"] == objects["cup"].model_copy(update={"pose": pose_spec(X_WO)})
    assert spec.objects["cup"].pose == at
