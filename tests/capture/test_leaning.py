"""Boxes that lean get their orientation and their size; those that stand are left to the fit of upright ones."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.shapes.fit import candidates, choose
from simfoundry.capture.shapes.fit_leaning import fit_leaning_box
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Mesh, tessellate
from tests.capture.test_register_mesh import evidence_of

SIZE = np.array([0.05, 0.09, 0.15])


def leaning(roll_deg: float, pitch_deg: float, yaw_deg: float) -> tuple[Mesh, Pose]:
    """A carton, turned, with its lowest corner on the table."""
    mesh = tessellate(Box(SIZE))
    q = quat_from_rpy(*np.radians([roll_deg, pitch_deg, yaw_deg]))
    return mesh, Pose.of((0, 0, -float(Pose.of(q=q).apply(mesh.vertices)[:, 2].min())), q)


@pytest.mark.parametrize(
    "turn",
    [
        pytest.param((35, 0, 120), marks=pytest.mark.slow),
        pytest.param((0, 30, 20), marks=pytest.mark.slow),
        (25, 20, -40),
    ],
)
def test_a_leaning_carton(turn: tuple[float, float, float]) -> None:
    mesh, X_WO = leaning(*turn)
    found = fit_leaning_box(evidence_of(mesh, X_WO))
    assert found is not None and isinstance(found.geometry, Box)
    assert np.sort(found.geometry.size) == pytest.approx(np.sort(SIZE), abs=0.006)
    assert found.X_WO.p == pytest.approx(X_WO.p, abs=0.006)
    assert found.agreement.explained > 0.97 and found.agreement.intrusion < 0.03


def test_a_standing_carton_is_not_leaning() -> None:
    assert fit_leaning_box(evidence_of(*leaning(0, 0, 30))) is None
    assert fit_leaning_box(evidence_of(*leaning(90, 0, 30))) is None


@pytest.mark.slow
def test_the_best_candidate_of_a_leaning_carton() -> None:
    assert choose(candidates(evidence_of(*leaning(25, 20, -40)))).family == "leaning"
    assert choose(candidates(evidence_of(*leaning(0, 0, 30)))).family == "box"
