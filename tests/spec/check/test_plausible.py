"""Volumes without numpy are those of the solids that are lowered."""

from __future__ import annotations

import pytest

from simfoundry.geometry.frames import IDENTITY
from simfoundry.scene.bodies import BodyBuilder
from simfoundry.spec.check.checker import HEAVIEST, LIGHTEST, implausible, volume
from simfoundry.spec.models.base import BodySpec
from simfoundry.spec.models.shapes import (
    BoxShape,
    CapsuleShape,
    CompoundPart,
    CompoundShape,
    ConeShape,
    CylinderShape,
    EllipsoidShape,
    Lathe,
    LatheShape,
    OpenBox,
    OpenBoxShape,
    Prism,
    PrismShape,
    Round,
    Shape,
    SphereShape,
)

SHAPES: list[Shape] = [
    BoxShape(box=(0.1, 0.2, 0.3)),
    SphereShape(sphere=0.07),
    CylinderShape(cylinder=Round(radius=0.04, height=0.1)),
    CapsuleShape(capsule=Round(radius=0.04, height=0.1)),
    PrismShape(prism=Prism(outline=((0, 0), (0.3, 0), (0.1, 0.1), (0, 0.4)), height=0.05)),
    EllipsoidShape(ellipsoid=(0.03, 0.04, 0.05)),
    ConeShape(cone=Round(radius=0.04, height=0.1)),
    OpenBoxShape(open_box=OpenBox(size=(0.3, 0.2, 0.1), wall=0.01)),
    CompoundShape(
        compound={"a": CompoundPart(shape=SphereShape(sphere=0.02)), "b": CompoundPart(shape=BoxShape(box=(1, 1, 1)))}
    ),
    LatheShape(lathe=Lathe(profile=((0, 0.02), (0.05, 0.1), (0.06, 0.1), (0.04, 0), (0, 0)))),  # a bowl
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_the_volume_is_that_of_the_solid(shape: Shape) -> None:
    builder = BodyBuilder("thing", BodySpec(density=1000.0), {}, None)
    builder.add_shape("shape", shape, IDENTITY, None)
    # A lathe is lowered with 48 sides and so a little smaller than the round body.
    rel = 1e-9 if not isinstance(shape, LatheShape) else 0.005
    assert volume(shape) == pytest.approx(builder.link(False, None).mass / 1000, rel=rel)


def test_only_what_nothing_weighs_is_implausible() -> None:
    assert implausible(LIGHTEST) == implausible(HEAVIEST) == implausible(700) == ""
    assert implausible(LIGHTEST * 0.99) and implausible(HEAVIEST * 1.01)
