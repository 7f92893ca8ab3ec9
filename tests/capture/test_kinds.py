"""Kinds of objects by form and size, on sizes of the YCB objects and of kitchenware."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.description.kinds import KINDS, kind_of
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.frames import IDENTITY
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Mesh, Sphere, tessellate


def solid(geometry: Geometry, hollow: bool = False) -> FittedShape:
    return FittedShape(geometry, IDENTITY, 0.001, 0.9, hollow)


def free(*size: float) -> Mesh:
    """Return a free-form solid of a size: a box that is not known to be one."""
    return tessellate(Box(np.array(size)))


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        (solid(Cylinder(0.034, 0.102)), "can"),  # tomato soup can
        (solid(Cylinder(0.051, 0.14)), "can"),  # master chef can
        (solid(free(0.066, 0.066, 0.25)), "bottle"),
        (solid(free(0.25, 0.066, 0.07)), "bottle"),  # lying
        (solid(Cylinder(0.033, 0.24)), "bottle"),
        (solid(Cylinder(0.009, 0.12)), "pen"),  # large marker
        (solid(free(0.12, 0.018, 0.018)), "pen"),
        (solid(Sphere(0.0365)), "ball"),  # baseball
        (solid(Box(np.array([0.16, 0.21, 0.06]))), "box"),  # cracker box
        (solid(free(0.09, 0.09, 0.08), hollow=True), "cup"),  # mug
        (solid(free(0.16, 0.16, 0.055), hollow=True), "bowl"),
        (solid(free(0.26, 0.26, 0.027), hollow=True), "plate"),
        (solid(free(0.19, 0.19, 0.14), hollow=True), "bowl"),
        (solid(free(0.2, 0.15, 0.08)), "object"),
    ],
)
def test_the_kind_of_a_solid(shape: FittedShape, kind: str) -> None:
    assert kind_of(shape).name == kind


@pytest.mark.parametrize("hollow", [True, False])
def test_any_solid_has_a_kind(hollow: bool) -> None:
    rng = np.random.default_rng(3)
    for size in np.exp(rng.uniform(np.log(1e-3), np.log(2.0), (200, 3))):
        assert kind_of(solid(free(*size), hollow)) in KINDS
