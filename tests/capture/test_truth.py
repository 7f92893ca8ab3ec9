"""The measures of reconstruction on scenes whose differences are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.accuracy.scene_accuracy import compare, surface_distance
from simfoundry.geometry.frames import Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.scene.model import Camera, Scene, SceneObject
from tests.tabletop import box, one, pose, rgba

GRAY = rgba("808080")
CAMERA = Camera("view", 64, 48, 60, 60, 31.5, 23.5, look_at(np.array([-0.7, 0.2, 0.6]), np.array([0.1, 0.0, 0.0])))


def scene(*objects: SceneObject, camera: Camera = CAMERA) -> Scene:
    return Scene("desk", frozen_array([0, 0, -9.81]), objects, (camera,))


def table() -> SceneObject:
    return one("table", box(1, 1, 0.04), GRAY, pose(0, 0, -0.02), fixed=True)


def brick(name: str, X_WO: Pose, x: float = 0.1, y: float = 0.06, z: float = 0.04) -> SceneObject:
    return one(name, box(x, y, z), GRAY, X_WO)


def test_the_same_scene_in_another_frame_is_the_same() -> None:
    """The recovered scene has a world of its own; only the camera ties the two together."""
    X_new_old = Pose.of([0.4, -0.3, 0.2], quat_from_rpy(0.3, -0.4, 1.1))
    real = [brick("a", pose(0.1, 0.05, 0.02, yaw=0.4)), brick("b", pose(-0.1, 0.2, 0.02, 0.2, 0.1, 0.9), y=0.03)]
    moved = [replace(o, name=f"{o.name}_found", X_WO=X_new_old @ o.X_WO) for o in reversed(real)]
    camera = replace(CAMERA, X_WC=X_new_old @ CAMERA.X_WC)
    found = compare(scene(table(), *real), CAMERA, scene(*moved, camera=camera), camera)
    assert [(c.name, c.recovered) for c in found] == [("a", "a_found"), ("b", "b_found")]
    for c in found:
        assert c.position < 1e-9 and c.f1 == 1.0 and c.chamfer < 1e-9
        assert c.size == c.size_true and c.mass == pytest.approx(c.mass_true)


def test_known_offsets_come_out() -> None:
    real = brick("a", pose(0.1, 0.05, 0.02, yaw=0.4))
    off = brick("x", Pose.of(np.array(real.X_WO.p) + np.array([0.003, -0.004, 0.005]), real.X_WO.q), z=0.05)
    c = compare(scene(real), CAMERA, scene(off), CAMERA)[0]
    assert c.position == pytest.approx(np.sqrt(0.003**2 + 0.004**2 + 0.005**2), abs=1e-9)
    assert c.size_true == (0.04, 0.06, 0.1) and c.size == (0.05, 0.06, 0.1)
    assert 0.001 < c.chamfer < 0.008


def test_a_shift_beyond_a_centimeter_costs_f1() -> None:
    real = brick("a", pose(0.1, 0.05, 0.02))
    values = []
    for shift in (0.0, 0.02, 0.04):
        found = brick("x", pose(0.1 + shift, 0.05, 0.02))
        values.append(compare(scene(real), CAMERA, scene(found), CAMERA)[0].f1)
    assert values[0] == 1.0 and values[0] > values[1] > values[2] > 0.2


def test_what_is_too_far_is_not_found() -> None:
    real = brick("a", pose(0.1, 0.05, 0.02))
    c = compare(scene(real), CAMERA, scene(brick("x", pose(0.17, 0.05, 0.02))), CAMERA)[0]
    assert c.recovered == "" and c.to_json()["position"] is None and np.isnan(c.f1)
    assert [c.recovered for c in compare(scene(real), CAMERA, scene(table()), CAMERA)] == [""]
    assert compare(scene(table()), CAMERA, scene(real), CAMERA) == []


def test_a_missed_object_takes_no_neighbors_match() -> None:
    """Least total distance alone would give ``stray`` to ``kept`` so that ``missed`` could have its place."""
    kept, missed = brick("kept", pose(0.0, 0.0, 0.02)), brick("missed", pose(0.05, 0.0, 0.02))
    found, stray = brick("found", pose(0.004, 0.0, 0.02)), brick("stray", pose(-0.5, 0.0, 0.02))
    result = compare(scene(missed, kept), CAMERA, scene(stray, found), CAMERA)
    assert {c.name: c.recovered for c in result} == {"kept": "found", "missed": ""}


def test_distance_of_point_sets() -> None:
    a = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    chamfer, f1 = surface_distance(a, a[:2] + np.array([0.0, 0.005, 0.0]))
    assert chamfer == pytest.approx((np.mean([0.005, 0.005, np.hypot(1, 0.005), np.hypot(2, 0.005)]) + 0.005) / 2)
    assert f1 == pytest.approx(2 * 1.0 * 0.5 / 1.5)
    assert surface_distance(a, a + np.array([0.0, 0.02, 0.0]))[1] == 0.0
