"""What carries must reach under what it carries."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.reconstruct import DEEPEST, FOOTHOLD, deepened
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder

EYE = np.array([-0.7, 0.1, 0.6])
YAW = 0.4


def pillar(depth: float) -> FittedShape:
    """A box 8 cm wide whose near face stays 0.1 m from the origin along its own x, whatever its depth."""
    turn = Pose.of(q=quat_from_rpy(0.0, 0.0, YAW))
    X_WO = turn @ Pose.of([0.1 + depth / 2, 0.02, 0.1])
    return FittedShape(Box(np.array([depth, 0.08, 0.2])), X_WO, 0.001, 0.5, hollow=False)


def can_at(along: float) -> FittedShape:
    turn = Pose.of(q=quat_from_rpy(0.0, 0.0, YAW))
    return FittedShape(Cylinder(0.03, 0.1), turn @ Pose.of([along, 0.03, 0.25]), 0.001, 0.8, hollow=False)


def near_face(shape: FittedShape) -> float:
    assert isinstance(shape.geometry, Box)
    local = Pose.of(q=quat_from_rpy(0.0, 0.0, YAW)).inverse() @ shape.X_WO
    return float(local.p[0] - shape.geometry.size[0] / 2)


def test_a_depth_reaches_under_what_stands_on_it() -> None:
    found = deepened(pillar(0.03), can_at(0.16), EYE)
    assert isinstance(found.geometry, Box)
    np.testing.assert_allclose(found.geometry.size, [0.06 + FOOTHOLD, 0.08, 0.2], atol=1e-9)
    assert near_face(found) == pytest.approx(0.1)  # the side that was seen stays where it is


def test_a_depth_that_suffices_stays() -> None:
    carrier = pillar(0.09)
    assert deepened(carrier, can_at(0.16), EYE) is carrier


def test_what_is_far_behind_is_not_reached_for() -> None:
    carrier = pillar(0.03)
    assert deepened(carrier, can_at(0.13 + DEEPEST + 0.01), EYE) is carrier
