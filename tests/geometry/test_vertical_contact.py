"""How far things come down, by formulas for every pair of primitives, by MuJoCo's distances and by linear programs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from simfoundry.assets.convex import hull
from simfoundry.geometry import vertical_contact
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.geometry.hulls import PROUD, hulls_of
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Mesh, Primitive, Sphere
from simfoundry.geometry.vertical_contact import heights
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.place import CLEARANCE, solve
from simfoundry.spec.models.scene import Place
from tests.placing import (
    CUBE,
    FLAT,
    ROUNDING,
    SHAPES,
    TILT,
    distance,
    meshed,
    put,
    rotation,
    vertical_gap,
)
from tests.scenes import box, pose, solid

SQRT2, SQRT3 = math.sqrt(2), math.sqrt(3)
ON_EDGE = (45.0, 0.0, 0.0)
ON_CORNER = (45.0, math.degrees(math.atan(1 / SQRT2)), 0.0)

Angles = tuple[float, float, float]
Case = tuple[Primitive, Angles, tuple[float, float], Primitive, Angles, float]
"""Thing, its rotation, its offset, carrier, its rotation, height of center over center."""

HEIGHTS: dict[str, Case] = {
    "box on box": (CUBE, FLAT, (0.03, 0), CUBE, FLAT, 0.1),
    "box on its edge": (CUBE, ON_EDGE, (0, 0), CUBE, FLAT, 0.05 + 0.05 * SQRT2),
    "box on its corner": (CUBE, ON_CORNER, (0, 0), CUBE, FLAT, 0.05 + 0.05 * SQRT3),
    "box on a box's corner": (CUBE, FLAT, (0, 0), CUBE, ON_CORNER, 0.05 + 0.05 * SQRT3),
    "crossed edges": (CUBE, ON_EDGE, (0, 0), CUBE, (0.0, 45.0, 0.0), 0.1 * SQRT2),
    "crossed edges, aside": (CUBE, ON_EDGE, (0, 0.02), CUBE, (0.0, 45.0, 0.0), 0.1 * SQRT2),
    "sphere on box": (Sphere(0.03), FLAT, (0.02, 0.04), CUBE, FLAT, 0.08),
    "sphere on a box's edge": (Sphere(0.05), FLAT, (0.08, 0), CUBE, FLAT, 0.05 + 0.04),
    "sphere on a box's corner": (Sphere(0.13), FLAT, (0.05 + 0.03, 0.05 + 0.04), CUBE, FLAT, 0.05 + 0.12),
    "sphere beside a ridge": (Sphere(0.05), FLAT, (0, 0.05), CUBE, ON_EDGE, 0.1 * SQRT2 / 2 + 0.05 * SQRT2 - 0.05),
    "sphere on sphere": (Sphere(0.03), FLAT, (0.03, 0), Sphere(0.02), FLAT, 0.04),
    "box on sphere": (CUBE, FLAT, (0.03, 0.02), Sphere(0.02), FLAT, 0.07),
    "box's edge on sphere": (CUBE, FLAT, (0.08, 0), Sphere(0.05), FLAT, 0.05 + 0.04),
    "cylinder on box": (Cylinder(0.03, 0.12), FLAT, (0.05, 0), CUBE, FLAT, 0.11),
    "box on cylinder": (CUBE, FLAT, (0.05, 0), Cylinder(0.03, 0.12), FLAT, 0.11),
    "cylinder on cylinder": (Cylinder(0.03, 0.12), FLAT, (0.04, 0), Cylinder(0.02, 0.02), FLAT, 0.07),
    "lying cylinder": (Cylinder(0.03, 0.12), (90.0, 0.0, 20.0), (0.01, 0), CUBE, FLAT, 0.08),
    "crossed cylinders": (Cylinder(0.03, 0.2), (90.0, 0.0, 0.0), (0.05, 0.05), Cylinder(0.02, 0.2), (0, 90.0, 0), 0.05),
    "sphere on cylinder": (Sphere(0.03), FLAT, (0.02, 0), Cylinder(0.03, 0.12), FLAT, 0.09),
    "cylinder on sphere": (Cylinder(0.03, 0.12), FLAT, (0.02, 0), Sphere(0.03), FLAT, 0.09),
    "capsule on box": (Capsule(0.02, 0.1), FLAT, (0.03, 0), CUBE, FLAT, 0.05 + 0.07),
    "lying capsule": (Capsule(0.02, 0.1), (0.0, 90.0, 33.0), (0.03, 0), CUBE, FLAT, 0.07),
    "crossed capsules": (Capsule(0.02, 0.1), (0.0, 90.0, 0.0), (0.04, 0.03), Capsule(0.03, 0.1), (90.0, 0, 0), 0.05),
    "parallel capsules": (Capsule(0.02, 0.1), (0.0, 90.0, 0.0), (0.01, 0.03), Capsule(0.03, 0.1), (0, 90.0, 0), 0.04),
    "sphere on a lying capsule": (Sphere(0.02), FLAT, (0.02, 0.03), Capsule(0.03, 0.1), (0.0, 90.0, 0.0), 0.04),
    "lying capsule on sphere": (Capsule(0.03, 0.1), (0.0, 90.0, 0.0), (0.02, 0.03), Sphere(0.02), FLAT, 0.04),
    "sphere on a capsule's end": (Sphere(0.02), FLAT, (0.05 + 0.03, 0), Capsule(0.03, 0.1), (0.0, 90.0, 0.0), 0.04),
    "capsule on an edge": (Capsule(0.05, 0.2), (90.0, 0.0, 0.0), (0.08, 0), CUBE, FLAT, 0.05 + 0.04),
    "box on capsule": (CUBE, FLAT, (0.03, 0), Capsule(0.02, 0.1), FLAT, 0.12),
    "capsule on cylinder": (Capsule(0.02, 0.1), FLAT, (0.02, 0), Cylinder(0.03, 0.1), FLAT, 0.12),
    "cylinder on capsule": (Cylinder(0.03, 0.1), FLAT, (0.02, 0), Capsule(0.02, 0.1), FLAT, 0.12),
}  # fmt: skip


@pytest.mark.parametrize("case", HEIGHTS)
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_heights_of_every_pair_of_primitives(case: str, turn: float) -> None:
    """Exact but for a cylinder on its side, whose prism may stand out."""
    thing, rpy, offset, carrier, carrier_rpy, height = HEIGHTS[case]
    a, b = (np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)]))
    under = solid(
        "under", carrier, Pose.of([0.3, -0.2, 0.5], rotation((*carrier_rpy[:2], carrier_rpy[2] + math.degrees(turn))))
    )
    spot = np.array([0.3, -0.2]) + offset[0] * a + offset[1] * b
    place = Place(on="under", xy=(spot[0], spot[1]), rpy_deg=(*rpy[:2], rpy[2] + math.degrees(turn)))
    X_WO = solve(solid("thing", thing, pose(0, 0, 0)), place, {"under": under}, None)
    lying = [
        shape for shape in (thing, carrier) if isinstance(shape, Cylinder) and case.split()[0] in ("lying", "crossed")
    ]
    assert X_WO.p[:2] == pytest.approx(spot, abs=ROUNDING)
    assert -2e-6 <= X_WO.p[2] - 0.5 - height - CLEARANCE <= 2e-6 + PROUD * len(lying)


def tip(height: float) -> Mesh:
    """A tetrahedron that stands on its tip at the origin."""
    vertices = [[0, 0, 0], [0.03, 0, height], [-0.02, 0.03, height], [-0.02, -0.03, height]]
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]], dtype=np.int32)
    return Mesh(frozen_array(vertices), faces)


def test_every_pair_of_primitives_is_there() -> None:
    pairs = {(type(case[0]), type(case[3])) for case in HEIGHTS.values()}
    missing = [
        (a.__name__, b.__name__)
        for a in (Box, Sphere, Cylinder, Capsule)
        for b in (Box, Sphere, Cylinder, Capsule)
        if (a, b) not in pairs
    ]
    assert missing == []


@given(SHAPES, SHAPES, TILT, TILT, st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)))
def test_nothing_interpenetrates_and_nothing_floats(
    thing: Primitive,
    carrier: Primitive,
    rpy: tuple[float, float, float],
    carrier_rpy: tuple[float, float, float],
    xy: tuple[float, float],
) -> None:
    """MuJoCo sees them at most the clearance apart, and touching as soon as that is taken away.

    The prism around a cylinder may touch in its place. What is narrowed by a part in a million may sink in by that.
    """
    under = solid("under", carrier, Pose.of([0, 0, 0.4], rotation(carrier_rpy)))
    try:
        over = put(solid("over", thing, pose(0, 0, 0)), Place(on="under", xy=xy, rpy_deg=rpy), under)
    except PlaceError as error:
        assert "is not above `under`" in error.message
        assume(False)
    assert -3e-7 <= distance(over, under) <= 2e-4 + ROUNDING
    lower = replace(over, X_WO=Pose.of(over.X_WO.p - [0, 0, CLEARANCE + ROUNDING], over.X_WO.q))
    cylinders = sum(isinstance(shape, Cylinder) for shape in (thing, carrier))
    assert distance(lower, under) <= PROUD * cylinders + ROUNDING


@given(st.integers(0, 10**6), st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)))
def test_meshes_of_many_corners_touch_and_do_not_interpenetrate(seed: int, xy: tuple[float, float]) -> None:
    rng = np.random.default_rng(seed)
    one, two = (hull(rng.normal(size=(int(rng.integers(4, 65)), 3)) * rng.uniform(0.01, 0.05, 3)) for _ in range(2))
    under = meshed("under", Mesh(frozen_array(one[0]), one[1]), Pose.of([0, 0, 0.4], rng.normal(size=4)))
    over = meshed("over", Mesh(frozen_array(two[0]), two[1]), pose(0, 0, 0))
    try:
        over = put(over, Place(on="under", xy=xy, rpy_deg=(30, -50, 70)), under)
    except PlaceError:
        assume(False)
    assert 0 <= distance(over, under) <= CLEARANCE + 1e-6
    assert 0 < vertical_gap(over, under) <= CLEARANCE + 2e-6


def test_a_tip_on_the_middle_of_a_face_where_its_triangles_meet() -> None:
    cone = put(meshed("cone", tip(0.05), pose(0, 0, 0)), Place(on="box", xy=(0, 0)), solid("box", CUBE, pose(0, 0, 0)))
    assert cone.X_WO.p == pytest.approx([0, 0, 0.05 + CLEARANCE], abs=ROUNDING)


def test_what_fits_exactly_between_two_walls_does_not_stand_on_them() -> None:
    walls = [solid(f"wall{k}", box(0.02, 0.1, 0.1), pose(sign * 0.03, 0, 0)) for k, sign in enumerate((-1, 1))]
    colliders = tuple(replace(wall.links[0].colliders[0], X_LG=wall.X_WO, name=wall.name) for wall in walls) + (
        replace(walls[0].links[0].colliders[0], geometry=box(0.1, 0.1, 0.02), X_LG=pose(0, 0, -0.06)),
    )
    slot = replace(walls[0], name="slot", X_WO=pose(0, 0, 0), links=(replace(walls[0].links[0], colliders=colliders),))
    for shape, half in ((box(0.04, 0.04, 0.04), 0.02), (Cylinder(0.02 - PROUD, 0.06), 0.03), (Sphere(0.02), 0.02)):
        thing = put(solid("thing", shape, pose(0, 0, 0)), Place(inside="slot", xy=(0, 0)), slot)
        assert thing.X_WO.p == pytest.approx([0, 0, -0.05 + half + CLEARANCE], abs=ROUNDING)


@given(
    st.sampled_from([CUBE, Sphere(0.03), Cylinder(0.03, 0.12), Capsule(0.02, 0.1)]),
    st.tuples(*[st.floats(-180, 180)] * 3),
    st.tuples(*[st.floats(-0.8, 0.8)] * 2),
)
def test_what_stands_on_a_level_top_rests_where_every_pair_of_parts_says(
    shape: Primitive, angles: Angles, at: tuple[float, float]
) -> None:
    table = hulls_of([(Box(np.array([1.2, 1.0, 0.1])), Pose.of((0, 0, 0.7)), 0)])
    thing = hulls_of([(shape, Pose.of((*at, 2.0), rotation(angles)), 0), (shape, Pose.of((*at, 2.5)), 1)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vertical_contact, "_level_top", lambda shape: None)
        expected = heights(thing, table)
    assert heights(thing, table) == pytest.approx(expected, abs=1e-12)
