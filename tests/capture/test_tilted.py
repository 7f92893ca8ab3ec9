"""Cans that lean and containers that lie or tilt get their axis and profile; upright ones are left to other fits."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.accuracy.scene_accuracy import surface_distance
from simfoundry.capture.shapes.fit import candidates, choose, fit_shape
from simfoundry.capture.shapes.fit_tilted import fit_tilted, fit_tilted_hollow
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.shapes import Cylinder, Mesh, revolved, tessellate
from tests.capture.test_register_mesh import evidence_of

CAN = tessellate(Cylinder(0.035, 0.11))
BOTTLE = revolved([(0, 0.16), (0.012, 0.16), (0.012, 0.12), (0.03, 0.1), (0.03, 0), (0, 0)])
CUP = revolved([(0, 0.005), (0.036, 0.005), (0.041, 0.09), (0.045, 0.09), (0.04, 0), (0, 0)])


def tilted(mesh: Mesh, roll_deg: float, pitch_deg: float, yaw_deg: float) -> tuple[Mesh, Pose]:
    """A mesh, turned, with its lowest point on the table."""
    q = quat_from_rpy(*np.radians([roll_deg, pitch_deg, yaw_deg]))
    return mesh, Pose.of((0, 0, -float(Pose.of(q=q).apply(mesh.vertices)[:, 2].min())), q)


def axis_error_deg(found: Pose, truth: Pose) -> float:
    cosine = min(1.0, abs(float(found.rotation[:, 2] @ truth.rotation[:, 2])))
    return float(np.degrees(np.arccos(cosine)))


@pytest.mark.parametrize(("mesh", "turn"), [(CAN, (35, 0, 120)), (CAN, (10, 25, -40)), (BOTTLE, (0, 50, 70))])
@pytest.mark.slow
def test_a_leaning_solid(mesh: Mesh, turn: tuple[float, float, float]) -> None:
    truth = tilted(mesh, *turn)
    found = fit_tilted(evidence_of(*truth, size=2))
    assert found is not None and axis_error_deg(found.X_WO, truth[1]) < 5
    solid = tessellate(found.geometry)
    assert surface_distance(found.X_WO.apply(solid.vertices), truth[1].apply(mesh.vertices))[0] < 0.006
    assert found.agreement.explained > 0.97 and found.agreement.intrusion < 0.03


@pytest.mark.parametrize("turn", [(0, -90, 20), (0, -60, -30)])
@pytest.mark.slow
def test_a_container_that_shows_its_inside(turn: tuple[float, float, float]) -> None:
    truth = tilted(CUP, *turn)
    evidence = evidence_of(*truth, size=2)
    found = fit_tilted_hollow(evidence)
    assert found is not None and found.X_WO.rotation[:, 2] @ truth[1].rotation[:, 2] > np.cos(np.radians(5))
    assert found.profile is not None and found.profile[0, 1] < 0.02, "the cavity is deep"
    assert choose(candidates(evidence)).family == "tilted_hollow"
    shape = fit_shape(evidence.frame, evidence.support, ~evidence.support.inliers, 0.0)
    assert shape.hollow and shape.confidence > 0.8


@pytest.mark.slow
def test_what_is_no_tilted_container() -> None:
    assert fit_tilted_hollow(evidence_of(*tilted(CAN, 0, -60, 20), size=2)) is None, "a lid is no opening"
    assert fit_tilted_hollow(evidence_of(*tilted(CUP, 0, 90, 20), size=2)) is None, "the opening faces away"
    assert fit_tilted_hollow(evidence_of(*tilted(CUP, 0, 0, 0), size=2)) is None, "it is upright"
