"""Places solved into poses: heights, gaps and walls, measured by formulas and by MuJoCo's own distances."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from simfoundry.assets.convex import hull
from simfoundry.scene.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.scene.hulls import PROUD
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Box, Capsule, Cylinder, Mesh, Primitive, SceneObject, Sphere
from simfoundry.scene.place import CLEARANCE, PlaceError, order, place_all, seen_by_camera, solve
from simfoundry.scene.poses import with_poses
from simfoundry.scene.tessellate import tessellate
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_scene
from simfoundry.spec.place import Place
from simfoundry.spec.scene import SceneSpec
from simfoundry.spec.write import to_yaml
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.scenes import box, pose, scene_of, solid

ROUNDING = 1e-6
SQRT2, SQRT3 = math.sqrt(2), math.sqrt(3)

DISHES = """\
simfoundry: scene/1
name: dishes
materials: {ceramic: {density: 2400, friction: 0.4}}
objects:
  desk: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, pose: {xyz: [0.45, 0, -0.02]}}
  plate:
    shape: {lathe: {profile: [[0, 0], [0.07, 0], [0.12, 0.015], [0.12, 0.02], [0.07, 0.006], [0, 0.006]]}}
    material: ceramic
  bowl:
    shape:
      lathe:
        profile:
          [[0, 0], [0.04, 0], [0.08, 0.03], [0.09, 0.06], [0.085, 0.06], [0.075, 0.033], [0.038, 0.006], [0, 0.006]]
    material: ceramic
  cup:
    shape: {lathe: {profile: [[0, 0], [0.035, 0], [0.04, 0.1], [0.036, 0.1], [0.031, 0.005], [0, 0.005]]}}
    material: ceramic
  box: {shape: {box: [0.06, 0.04, 0.05]}, mass: 0.1}
  marker: {shape: {cylinder: {radius: 0.006, height: 0.14}}, mass: 0.02}
  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [0.8, -0.1, 0.2], yaw_deg: 30}}
"""
CABINET = """\
simfoundry: asset/1
name: cabinet
materials: {wood: {density: 600}}
links:
  frame:
    material: wood
    parts:
      floor: {shape: {box: [0.3, 0.4, 0.01]}, pose: {xyz: [0, 0, 0.005]}}
      roof: {shape: {box: [0.3, 0.4, 0.01]}, pose: {xyz: [0, 0, 0.155]}}
      back: {shape: {box: [0.01, 0.4, 0.14]}, pose: {xyz: [0.145, 0, 0.08]}}
  tray:
    material: wood
    parts:
      floor: {shape: {box: [0.26, 0.36, 0.01]}}
      front: {shape: {box: [0.01, 0.38, 0.12]}, pose: {xyz: [-0.135, 0, 0.055]}}
      back: {shape: {box: [0.01, 0.36, 0.06]}, pose: {xyz: [0.125, 0, 0.025]}}
      left: {shape: {box: [0.26, 0.01, 0.06]}, pose: {xyz: [0, 0.175, 0.025]}}
      right: {shape: {box: [0.26, 0.01, 0.06]}, pose: {xyz: [0, -0.175, 0.025]}}
      knob: {shape: {sphere: 0.02}, pose: {xyz: [-0.16, 0, 0.06]}}
joints:
  drawer: {type: prismatic, parent: frame, child: tray, pose: {xyz: [0, 0, 0.02]}, axis: [-1, 0, 0], limits: [0, 0.24]}
"""


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> dict[str, SceneObject]:
    folder = tmp_path_factory.mktemp("dishes")
    (folder / "dishes.scene.yaml").write_text(DISHES)
    (folder / "cabinet.asset.yaml").write_text(CABINET)
    return {item.name: item for item in lower_file(folder / "dishes.scene.yaml").objects}


def distance(a: SceneObject, b: SceneObject) -> float:
    """The smallest distance [m] between colliders of two objects, negative where they meet, as MuJoCo computes it."""
    import mujoco

    world = MujocoWorld(scene_of(replace(a, fixed=True), replace(b, fixed=True)))
    world.model.opt.ccd_tolerance = 1e-9
    root = {name: world.model.body(name).id for name in (a.name, b.name)}
    touching = [g for g in range(world.model.ngeom) if world.model.geom_contype[g]]
    of = {n: [g for g in touching if _root(world, g) == i] for n, i in root.items()}
    found = [
        mujoco.mj_geomDistance(world.model, world.data, g, h, 1.0, np.zeros(6)) for g in of[a.name] for h in of[b.name]
    ]
    return float(min(found))


def _root(world: MujocoWorld, geom: int) -> int:
    body = int(world.model.geom_bodyid[geom])
    while world.model.body_parentid[body] != 0:
        body = int(world.model.body_parentid[body])
    return body


def put(item: SceneObject, place: Place, *others: SceneObject, viewer: Pose | None = None) -> SceneObject:
    return replace(item, X_WO=solve(item, place, {other.name: other for other in others}, viewer))


def chain(things: Mapping[str, SceneObject], places: Mapping[str, Place]) -> dict[str, SceneObject]:
    """The things that are named, placed, and what they stand on."""
    placed, errors = place_all(things, places, None)
    assert not errors
    return placed


def tip(height: float) -> Mesh:
    """A tetrahedron that stands on its tip at the origin."""
    vertices = [[0, 0, 0], [0.03, 0, height], [-0.02, 0.03, height], [-0.02, -0.03, height]]
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]], dtype=np.int32)
    return Mesh(frozen_array(vertices), faces)


def meshed(name: str, mesh: Mesh, X_WO: Pose) -> SceneObject:
    item = solid(name, box(0.02, 0.02, 0.02), X_WO)
    link = item.links[0]
    return replace(item, links=(replace(link, colliders=(replace(link.colliders[0], geometry=mesh),)),))


FLAT, ON_EDGE = (0.0, 0.0, 0.0), (45.0, 0.0, 0.0)
ON_CORNER = (45.0, math.degrees(math.atan(1 / SQRT2)), 0.0)
CUBE = box(0.1, 0.1, 0.1)

Angles = tuple[float, float, float]
Case = tuple[Primitive, Angles, tuple[float, float], Primitive, Angles, float]
"""Thing, its rotation, its offset, carrier, its rotation, height of centre over centre."""

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
        "under", carrier, Pose.of([0.3, -0.2, 0.5], _rpy((*carrier_rpy[:2], carrier_rpy[2] + math.degrees(turn))))
    )
    spot = np.array([0.3, -0.2]) + offset[0] * a + offset[1] * b
    place = Place(on="under", xy=(spot[0], spot[1]), rpy_deg=(*rpy[:2], rpy[2] + math.degrees(turn)))
    X_WO = solve(solid("thing", thing, pose(0, 0, 0)), place, {"under": under}, None)
    lying = [
        shape for shape in (thing, carrier) if isinstance(shape, Cylinder) and case.split()[0] in ("lying", "crossed")
    ]
    assert X_WO.p[:2] == pytest.approx(spot, abs=ROUNDING)
    assert -2e-6 <= X_WO.p[2] - 0.5 - height - CLEARANCE <= 2e-6 + PROUD * len(lying)


def _rpy(degrees: tuple[float, float, float]) -> Array:
    return quat_from_rpy(*(math.radians(v) for v in degrees))


def test_every_pair_of_primitives_is_there() -> None:
    pairs = {(type(case[0]), type(case[3])) for case in HEIGHTS.values()}
    missing = [
        (a.__name__, b.__name__)
        for a in (Box, Sphere, Cylinder, Capsule)
        for b in (Box, Sphere, Cylinder, Capsule)
        if (a, b) not in pairs
    ]
    assert missing == []


SIDE = st.floats(0.01, 0.1)
SHAPES = st.one_of(
    st.builds(lambda a, b, c: box(a, b, c), SIDE, SIDE, SIDE),
    st.builds(Sphere, SIDE),
    st.builds(Cylinder, SIDE, SIDE),
    st.builds(Capsule, SIDE, SIDE),
)
ANGLE = st.floats(-180.0, 180.0).map(lambda angle: round(angle, 3))
TILT = st.one_of(st.just(FLAT), st.tuples(st.just(0.0), st.just(0.0), ANGLE), st.tuples(ANGLE, ANGLE, ANGLE))


@settings(max_examples=150, derandomize=True, deadline=None)
@given(SHAPES, SHAPES, TILT, TILT, st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)))
def test_nothing_interpenetrates_and_nothing_floats(
    thing: Primitive,
    carrier: Primitive,
    rpy: tuple[float, float, float],
    carrier_rpy: tuple[float, float, float],
    xy: tuple[float, float],
) -> None:
    """The distance of the two in MuJoCo is that of the clearance, along the slope of what they touch."""
    under = solid("under", carrier, Pose.of([0, 0, 0.4], _rpy(carrier_rpy)))
    try:
        over = put(solid("over", thing, pose(0, 0, 0)), Place(on="under", xy=xy, rpy_deg=rpy), under)
    except PlaceError as error:
        assert "is not above `under`" in error.message
        assume(False)
    assert 0 <= distance(over, under) <= 2e-4
    lower = replace(over, X_WO=Pose.of(over.X_WO.p - [0, 0, CLEARANCE + 2 * PROUD + 1e-5], over.X_WO.q))
    assert distance(lower, under) <= 2e-6 or _beside_one_another(over, under)


@settings(max_examples=60, derandomize=True, deadline=None)
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


def vertical_gap(a: SceneObject, b: SceneObject) -> float:
    """How far ``a`` can be lowered before it meets ``b`` [m], by a linear program over their corners."""
    from scipy.optimize import linprog

    corners = [o.X_WO.apply(tessellate(o.links[0].colliders[0].geometry).vertices) for o in (a, b)]
    n, m = map(len, corners)
    level = np.concatenate([corners[0][:, :2].T, -corners[1][:, :2].T], axis=1)
    sums = np.array([[1.0] * n + [0.0] * m, [0.0] * n + [1.0] * m])
    height = np.concatenate([corners[0][:, 2], -corners[1][:, 2]])
    found = linprog(height, A_eq=np.concatenate([level, sums]), b_eq=[0, 0, 1, 1], bounds=(0, None))
    return float(found.fun)


def _beside_one_another(a: SceneObject, b: SceneObject) -> bool:
    """Whether they overlap in the plane by less than a hair, so that lowering one hardly brings them closer."""
    below = replace(a, X_WO=Pose.of([*a.X_WO.p[:2], b.X_WO.p[2]], a.X_WO.q))
    return distance(below, b) > -1e-4


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


# -- dishes -----------------------------------------------------------------------------------------------------------


def test_a_chain_of_dishes(things: dict[str, SceneObject]) -> None:
    """Written from the last to the first, each stands on the one before, at its middle."""
    places = {
        "marker": Place(inside="cup", rpy_deg=(9, 0, 40)),
        "cup": Place(inside="bowl"),
        "bowl": Place(on="plate", yaw_deg=10),
        "plate": Place(on="desk", xy=(0.3, 0.1), yaw_deg=25),
    }
    placed = chain(things, places)
    z = {name: float(placed[name].X_WO.p[2]) for name in places}
    assert z["plate"] == pytest.approx(CLEARANCE, abs=ROUNDING)
    assert z["bowl"] == pytest.approx(0.006 + 2 * CLEARANCE, abs=2 * ROUNDING)
    assert z["cup"] == pytest.approx(0.012 + 3 * CLEARANCE, abs=3 * ROUNDING)
    roll = math.radians(9)
    floor = 0.012 + 3 * CLEARANCE + 0.005
    stands = floor + 0.07 * math.cos(roll) + 0.006 * math.sin(roll) + CLEARANCE
    assert stands - 4 * ROUNDING <= z["marker"] <= stands + PROUD
    for name in places:
        assert placed[name].X_WO.p[:2] == pytest.approx([0.3, 0.1], abs=ROUNDING)
    for thing, under in (("plate", "desk"), ("bowl", "plate"), ("cup", "bowl"), ("marker", "cup")):
        assert 0 <= distance(placed[thing], placed[under]) <= 2e-4


def test_a_cup_on_a_stack_of_yawed_plates(things: dict[str, SceneObject]) -> None:
    stack = {**things, **{f"plate{k}": replace(things["plate"], name=f"plate{k}") for k in (1, 2)}}
    placed = chain(
        stack,
        {
            "plate": Place(on="desk", at=(-0.2, 0.1), yaw_deg=7),
            "plate1": Place(on="plate", yaw_deg=33),
            "plate2": Place(on="plate1", yaw_deg=-50),
            "cup": Place(on="plate2"),
        },
    )
    for thing, under in (("plate1", "plate"), ("plate2", "plate1"), ("cup", "plate2")):
        assert 0 <= distance(placed[thing], placed[under]) <= 2e-4
        assert placed[thing].X_WO.p[2] > placed[under].X_WO.p[2] + 0.003
    assert distance(placed["cup"], placed["plate1"]) > 0.003


def test_a_sphere_in_a_bowl_touches_its_wall_or_its_floor(things: dict[str, SceneObject]) -> None:
    bowl = replace(things["bowl"], X_WO=pose(0.2, 0.1, 0.3, yaw=0.4))
    ball = put(solid("ball", Sphere(0.02), pose(0, 0, 0)), Place(inside="bowl"), bowl)
    assert ball.X_WO.p == pytest.approx([0.2, 0.1, 0.3 + 0.006 + 0.02 + CLEARANCE], abs=ROUNDING)
    cup = replace(things["cup"], X_WO=bowl.X_WO)
    globe = put(solid("globe", Sphere(0.033), pose(0, 0, 0)), Place(inside="cup"), cup)
    assert 0 <= distance(globe, cup) <= 2e-4
    assert 0.3 + 0.1 > globe.X_WO.p[2] > 0.3 + 0.005 + 0.033 + 0.005  # the wall holds it above the floor


def test_what_rests_on_the_rim_is_not_inside(things: dict[str, SceneObject]) -> None:
    with pytest.raises(PlaceError) as error:
        put(things["plate"], Place(inside="cup"), things["cup"])
    assert error.value.message == (
        "`plate` (24.0 x 24.0 x 2.0 cm) does not fit inside `cup` (8.0 x 8.0 x 10.0 cm outside)"
    )
    assert "make it smaller" in error.value.hint
    put(things["plate"], Place(on="cup"), things["cup"])


def test_a_block_has_no_inside() -> None:
    block = solid("block", CUBE, pose(0, 0, 0))
    with pytest.raises(PlaceError) as error:
        put(solid("ball", Sphere(0.01), pose(0, 0, 0)), Place(inside="block"), block)
    assert error.value.message == (
        "`ball` cannot be inside `block`, whose colliders are one convex part without a hollow"
    )


# -- a drawer ---------------------------------------------------------------------------------------------------------


def opened(cabinet: SceneObject, position: float) -> SceneObject:
    return replace(cabinet, joints=tuple(replace(joint, position=position) for joint in cabinet.joints))


BRICK, SLAB = box(0.06, 0.08, 0.14), box(0.06, 0.08, 0.04)


def test_a_closed_drawer_takes_what_fits_below_the_top(things: dict[str, SceneObject]) -> None:
    """It lies on the floor of the tray, 0.025 m above the foot of the cabinet, in the middle between its walls."""
    closed = opened(things["cabinet"], 0.0)
    slab = put(solid("slab", SLAB, pose(0, 0, 0)), Place(inside="cabinet.tray", yaw_deg=30), closed)
    local = closed.X_WO.inverse() @ slab.X_WO
    assert local.p == pytest.approx([-0.005, 0, 0.025 + 0.02 + CLEARANCE], abs=2 * ROUNDING)
    with pytest.raises(PlaceError) as error:
        put(solid("brick", BRICK, pose(0, 0, 0)), Place(inside="cabinet.tray"), closed)
    assert error.value.message == (
        "`brick` (6.0 x 8.0 x 14.0 cm) does not fit inside `cabinet.tray` (31.0 x 38.0 x 12.0 cm outside)"
    )


def test_an_open_drawer_takes_more(things: dict[str, SceneObject]) -> None:
    half = opened(things["cabinet"], 0.24)
    brick = put(solid("brick", BRICK, pose(0, 0, 0)), Place(inside="cabinet.tray", yaw_deg=30, at=(-0.05, 0)), half)
    local = half.X_WO.inverse() @ brick.X_WO
    assert local.p == pytest.approx([-0.29, 0, 0.025 + 0.07 + CLEARANCE], abs=2 * ROUNDING)
    assert 0 <= distance(brick, half) <= 2e-4


def test_a_board_on_the_sides_of_a_drawer_is_not_inside_behind_its_higher_front(
    things: dict[str, SceneObject],
) -> None:
    half = opened(things["cabinet"], 0.24)
    board = solid("board", box(0.1, 0.37, 0.01), pose(0, 0, 0))
    with pytest.raises(PlaceError, match="does not fit inside"):
        put(board, Place(inside="cabinet.tray", yaw_deg=30, at=(-0.05, 0)), half)
    on = put(board, Place(on="cabinet.tray", yaw_deg=30, at=(-0.05, 0)), half)
    assert (half.X_WO.inverse() @ on.X_WO).p[2] == pytest.approx(0.075 + 0.005 + CLEARANCE, abs=ROUNDING)


def test_on_a_cabinet_is_on_its_top_and_inside_it_is_below(things: dict[str, SceneObject]) -> None:
    cabinet, slab = opened(things["cabinet"], 0.0), solid("slab", SLAB, pose(0, 0, 0))
    on, inside = (put(slab, place, cabinet) for place in (Place(on="cabinet"), Place(inside="cabinet")))
    assert on.X_WO.p[2] == pytest.approx(0.2 + 0.16 + 0.02 + CLEARANCE, abs=ROUNDING)
    assert inside.X_WO.p[2] == pytest.approx(0.2 + 0.025 + 0.02 + CLEARANCE, abs=ROUNDING)


def test_on_a_link_is_below_what_covers_it(things: dict[str, SceneObject]) -> None:
    closed, slab = opened(things["cabinet"], 0.0), solid("slab", SLAB, pose(0, 0, 0))
    on = put(slab, Place(on="cabinet.tray"), closed)
    assert on.X_WO.p[2] == pytest.approx(0.2 + 0.025 + 0.02 + CLEARANCE, abs=ROUNDING)
    with pytest.raises(PlaceError, match=r"`brick` .* does not fit on `cabinet.tray`"):
        put(solid("brick", BRICK, pose(0, 0, 0)), Place(on="cabinet.tray"), closed)
    with pytest.raises(PlaceError, match=r"is not above `cabinet.tray`, which spans x 0\.\d+ to"):
        put(slab, Place(on="cabinet.tray", at=(0.3, 0)), opened(closed, 0.24))


def test_all_links_of_a_thing_count(things: dict[str, SceneObject]) -> None:
    """A cabinet whose drawer hangs over a step comes to rest on its drawer's knob or tray."""
    step = solid("step", box(0.1, 0.1, 0.1), pose(-0.35, 0, 0))
    placed = put(opened(things["cabinet"], 0.24), Place(on="step", xy=(0.0, 0.0)), step)
    assert placed.X_WO.p[2] == pytest.approx(0.05 - 0.015 + CLEARANCE, abs=ROUNDING)
    assert 0 <= distance(placed, step) <= 2e-4


# -- beside one another -----------------------------------------------------------------------------------------------

DESK = solid("desk", box(1.4, 1.0, 0.04), pose(0.4, 0.1, -0.02), fixed=True)
SIDES = {"left_of": (0, 1), "right_of": (0, -1), "behind": (1, 0), "in_front_of": (-1, 0)}


def facing(item: SceneObject, other: SceneObject, viewer_yaw: float) -> Array:
    """Where ``item`` is from ``other``, away from the viewer and to its left [m]."""
    x, y = (item.X_WO.p - other.X_WO.p)[:2]
    c, s = math.cos(viewer_yaw), math.sin(viewer_yaw)
    return np.array([c * x + s * y, -s * x + c * y])


@pytest.mark.parametrize("word", SIDES)
@pytest.mark.parametrize("yaw_deg", [None, 0.0, 37.0, -118.0, 180.0])
def test_sides_are_those_of_the_viewer(word: str, yaw_deg: float | None) -> None:
    """Two boxes that face the viewer: their distance is the gap, and they stand in one line."""
    yaw = math.radians(yaw_deg or 0.0)
    viewer = None if yaw_deg is None else pose(-0.3, 0.2, 0.5, yaw=yaw)
    anchor = solid("anchor", box(0.06, 0.1, 0.04), pose(0.4, 0.1, 0.02, yaw=yaw))
    place = Place.model_validate({"on": "desk", word: "anchor", "gap": 0.017, "yaw_deg": math.degrees(yaw)})
    thing = put(solid("thing", box(0.03, 0.07, 0.08), pose(0, 0, 0)), place, DESK, anchor, viewer=viewer)
    assert distance(thing, anchor) == pytest.approx(0.017, abs=2 * ROUNDING)
    away, left = SIDES[word]
    half = np.array([0.045, 0.085])
    assert facing(thing, anchor, yaw) == pytest.approx((half + 0.017) * [away, left], abs=2 * ROUNDING)


def test_sides_of_a_camera_that_is_turned_and_looks_down() -> None:
    for yaw in (0.4, -2.2, 3.0):
        away = np.array([math.cos(yaw), math.sin(yaw), 0])
        eye = np.array([0.4, 0.1, 0.9]) - 0.8 * away
        viewer = seen_by_camera(look_at(eye, np.array([0.4, 0.1, 0.0])))
        assert viewer.angle_to(Pose.of(q=quat_from_rpy(0, 0, yaw))) == pytest.approx(0, abs=1e-6)
    down = look_at(np.array([0.4, 0.1, 2.0]), np.array([0.4, 0.1, 0.0]), np.array([0.0, 1.0, 0.0]))
    assert seen_by_camera(down).rotation[:, 0] == pytest.approx([0, 1, 0], abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_gaps_of_round_and_tilted_things_are_between_their_surfaces(yaw: float) -> None:
    """Along the viewer's left no point of the one comes nearer to the other than the gap: counted on dense points."""
    viewer = pose(0, 0, 0, yaw=yaw)
    shapes: list[Primitive] = [Sphere(0.04), Cylinder(0.03, 0.1), Capsule(0.02, 0.07), box(0.05, 0.03, 0.08)]
    left = np.array([-math.sin(yaw), math.cos(yaw), 0])
    for one in shapes:
        for two in shapes:
            anchor = solid("anchor", two, pose(0.4, 0.1, 0.2, 0.3, -0.8, 1.0))
            place = Place(on="desk", left_of="anchor", gap=0.02, rpy_deg=(20, 50, 70))
            thing = put(solid("thing", one, pose(0, 0, 0)), place, DESK, anchor, viewer=viewer)
            gap = (surface(thing) @ left).min() - (surface(anchor) @ left).max()
            rounding = 2e-6 + PROUD * sum(isinstance(shape, Cylinder) for shape in (one, two)) + 2e-5
            assert 0.02 - 2e-6 <= gap <= 0.02 + rounding
            assert facing(thing, anchor, yaw)[0] == pytest.approx(0, abs=3e-6)


def surface(item: SceneObject) -> Array:
    """Many points of the first collider in the world, shape (n, 3)."""
    return item.X_WO.apply(tessellate(item.links[0].colliders[0].geometry, 240).vertices)


def test_two_words_fix_one_direction_each() -> None:
    one = solid("one", box(0.06, 0.06, 0.04), pose(0.4, 0.1, 0.02))
    two = solid("two", box(0.1, 0.1, 0.04), pose(0.7, -0.2, 0.02))
    place = Place(on="desk", right_of="one", in_front_of="two", gap=0.01)
    thing = put(solid("thing", box(0.02, 0.04, 0.02), pose(0, 0, 0)), place, DESK, one, two)
    assert thing.X_WO.p == pytest.approx([0.7 - 0.05 - 0.01 - 0.01, 0.1 - 0.03 - 0.01 - 0.02, 0.01 + CLEARANCE])


def test_a_thing_whose_frame_is_not_in_its_middle_is_put_by_its_middle() -> None:
    """Only `xy` and `at` speak of frames."""
    wedge = solid("wedge", CUBE, pose(0, 0, 0))
    link = wedge.links[0]
    shifted = replace(link.colliders[0], X_LG=pose(0.2, 0.1, 0.3), geometry=box(0.1, 0.06, 0.04))
    wedge = replace(wedge, links=(replace(link, colliders=(shifted,)),))
    anchor = solid("anchor", CUBE, pose(0.5, 0.2, 0.05))
    centred = put(wedge, Place(on="desk", yaw_deg=90), DESK)
    assert centred.X_WO.p == pytest.approx([0.4 + 0.1, 0.1 - 0.2, 0.02 - 0.3 + CLEARANCE], abs=ROUNDING)
    beside = put(wedge, Place(on="desk", behind="anchor", gap=0.01), DESK, anchor)
    assert beside.X_WO.p[:2] == pytest.approx([0.5 + 0.05 + 0.01 + 0.05 - 0.2, 0.2 - 0.1], abs=ROUNDING)
    framed = put(wedge, Place(on="desk", xy=(0.1, 0.2)), DESK)
    assert framed.X_WO.p[:2] == pytest.approx([0.1, 0.2])


@settings(max_examples=60, derandomize=True, deadline=None)
@given(SHAPES, SHAPES, st.floats(-180, 180), st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-1, 1)), TILT)
def test_a_whole_scene_may_be_moved_and_turned(
    carrier: Primitive,
    thing: Primitive,
    turn: float,
    offset: tuple[float, float, float],
    rpy: tuple[float, float, float],
) -> None:
    """What is written in the frames of others gives the same scene elsewhere."""
    X_WV = Pose.of(offset, quat_from_rpy(0, 0, math.radians(turn)))
    tilted, desk = solid("under", carrier, pose(0.1, 0.2, 0.3, 0.2, -0.4, 0.5)), DESK
    item, viewer = solid("thing", thing, pose(0, 0, 0)), pose(0, 0, 0, yaw=0.3)
    turned = {"rpy_deg": (rpy[0], rpy[1], rpy[2] + turn)}
    for words in ({"on": "under", "at": (0.003, -0.002)}, {"on": "under"}, {"on": "desk", "left_of": "under"}):
        here = put(item, Place.model_validate({**words, "rpy_deg": rpy}), tilted, desk, viewer=viewer)
        moved = [replace(other, X_WO=X_WV @ other.X_WO) for other in (tilted, desk)]
        there = put(item, Place.model_validate({**words, **turned}), *moved, viewer=X_WV @ viewer)
        assert (X_WV.inverse() @ there.X_WO).p == pytest.approx(here.X_WO.p, abs=2 * PROUD + 5 * ROUNDING)
        assert there.X_WO.angle_to(X_WV @ here.X_WO) < 1e-6


# -- order and errors -------------------------------------------------------------------------------------------------


def test_each_comes_after_what_it_needs() -> None:
    places = {
        "a": Place(on="b", left_of="c"),
        "b": Place(inside="d.tray"),
        "c": Place(on="desk", behind="b"),
        "d": Place(on="desk"),
        "e": Place(on="desk"),
    }
    assert order(places) == ["d", "e", "b", "c", "a"]
    assert order({}) == []


def test_rings_and_unknown_names_come_to_an_end() -> None:
    places = {"a": Place(on="b"), "b": Place(on="a"), "c": Place(on="c"), "d": Place(on="nothing"), "e": Place(on="a")}
    assert order(places) == ["d", "a", "b", "c", "e"]
    things = {name: solid(name, CUBE, pose(0, 0, 0)) for name in places}
    placed, errors = place_all(things, places, None)
    assert {name: item.X_WO for name, item in placed.items()} == {name: item.X_WO for name, item in things.items()}
    assert errors == {}


def test_what_is_not_above_its_carrier_says_where_both_are() -> None:
    with pytest.raises(PlaceError) as error:
        put(solid("cup", Cylinder(0.04, 0.1), pose(0, 0, 0)), Place(on="desk", xy=(1.2, 0)), DESK)
    assert error.value.message == (
        "`cup` at (1.200, 0.000) is not above `desk`, which spans x -0.300 to 1.100 and y -0.400 to 0.600"
    )
    assert error.value.hint == "move it over `desk`"


def test_only_the_cause_is_reported() -> None:
    """What stands on a thing that could not be placed is not a second error."""
    things = {"desk": DESK} | {name: solid(name, CUBE, pose(0, 0, 0)) for name in ("a", "b", "c")}
    places = {"a": Place(on="desk", xy=(5, 5)), "b": Place(on="a"), "c": Place(on="desk")}
    placed, errors = place_all(things, places, None)
    assert list(errors) == ["a"]
    assert placed["c"].X_WO.p[2] == pytest.approx(0.05 + CLEARANCE)
    assert list(placed) == ["desk", "a", "b", "c"]


def test_other_impossible_places() -> None:
    cube = solid("cube", CUBE, pose(0, 0, 0))
    bare = replace(cube, name="bare", links=(replace(cube.links[0], colliders=(), visuals=()),))
    cases = [
        (cube, Place(on="bare"), "`bare` touches nothing, so it carries nothing"),
        (bare, Place(on="desk"), "`bare` has no shape that could be placed"),
        (cube, Place(inside="desk.drawer"), "`desk` has no link `drawer`"),
        (cube, Place(on="ghost"), "`ghost` has no place itself"),
    ]
    for item, place, message in cases:
        with pytest.raises(PlaceError) as error:
            put(item, place, DESK, bare)
        assert error.value.message == message


def test_a_thousand_things_are_placed_in_a_second() -> None:
    """The bar is one second; slow machines get three."""
    shapes: list[Primitive] = [box(0.03, 0.02, 0.02), Sphere(0.01), Cylinder(0.01, 0.03), Capsule(0.008, 0.02)]
    things = {f"t{k}": solid(f"t{k}", shapes[k % 4], pose(0, 0, 0)) for k in range(1000)}
    table = solid("table", box(1.4, 1.4, 0.04), pose(0, 0, 0), fixed=True)
    spots = [(-0.65 + 0.04 * (k % 32), -0.65 + 0.04 * (k // 32)) for k in range(1000)]
    places = {
        name: Place(on="table", xy=spot, yaw_deg=7.0 * k)
        for k, (name, spot) in enumerate(zip(things, spots, strict=True))
    }
    start = time.perf_counter()
    placed, errors = place_all({"table": table, **things}, places, None)
    assert time.perf_counter() - start < 3
    assert errors == {}
    assert placed["t999"].X_WO.p == pytest.approx([*spots[999], 0.02 + 0.018 + CLEARANCE], abs=ROUNDING)


# -- at rest ----------------------------------------------------------------------------------------------------------


def test_what_is_placed_stays_where_it_is(things: dict[str, SceneObject]) -> None:
    """One second in MuJoCo: nothing moves by more than what engines let bodies sink into one another."""
    placed = chain(
        {name: item for name, item in things.items() if name not in ("cabinet", "marker")},
        {
            "plate": Place(on="desk", xy=(0.4, 0.1)),
            "bowl": Place(on="plate"),
            "cup": Place(inside="bowl"),
            "box": Place(on="desk", left_of="plate", yaw_deg=20),
        },
    )
    world = MujocoWorld(scene_of(*placed.values()))
    world.step(round(1 / world.timestep))
    after = world.state().poses
    for name in ("plate", "bowl", "cup", "box"):
        assert np.linalg.norm(after[name].p - placed[name].X_WO.p) < 2e-3
        assert math.degrees(after[name].angle_to(placed[name].X_WO)) < 1


# -- in documents -----------------------------------------------------------------------------------------------------

SCENE = """\
simfoundry: scene/1
name: placed
viewpoint: arm
objects:
  desk: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, pose: {xyz: [0.45, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2, place: {on: plate}}
  plate: {shape: {cylinder: {radius: 0.1, height: 0.02}}, mass: 0.4, place: {on: desk, xy: [0.45, 0.1]}}
  book: {shape: {box: [0.2, 0.1, 0.03]}, mass: 0.5, place: {on: desk, left_of: plate, yaw_deg: 90}}
robots:
  arm: {model: franka_robotiq, pose: {xyz: [0.5, -0.9, 0], yaw_deg: 90}}
cameras:
  over: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [1.5, 0.1, 0.8], look_at: [0.4, 0.1, 0]}}
  hand: {size: [64, 48], fx: 60, fy: 60, mount: arm.hand, pose: {look_at: [0, 0, 1]}}
"""


@pytest.mark.parametrize(
    ("viewpoint", "left"), [("arm", (-1, 0)), ("hand", (-1, 0)), ("over", (0, -1)), (None, (0, 1))]
)
def test_a_document_is_lowered_with_its_places(tmp_path: Path, viewpoint: str | None, left: tuple[int, int]) -> None:
    path = tmp_path / "placed.scene.yaml"
    path.write_text(SCENE.replace("viewpoint: arm\n", "" if viewpoint is None else f"viewpoint: {viewpoint}\n"))
    scene = lower_file(path)
    assert [item.name for item in scene.objects] == ["desk", "cup", "plate", "book"]
    assert scene.object("cup").X_WO.p == pytest.approx([0.45, 0.1, 0.02 + 0.05 + 2 * CLEARANCE], abs=2e-6)
    book, aside = scene.object("book").X_WO, 0.1 + 0.03 + (0.05 if left[0] else 0.1)
    assert book.p == pytest.approx([0.45 + left[0] * aside, 0.1 + left[1] * aside, 0.015 + CLEARANCE], abs=2e-6)
    assert book.q == pytest.approx(quat_from_rpy(0, 0, math.pi / 2))


def test_a_place_that_cannot_be_taken_is_found_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "placed.scene.yaml"
    path.write_text(SCENE.replace("xy: [0.45, 0.1]", "xy: [0.45, 1.1]").replace("left_of: plate", "xy: [3, 0]"))
    with pytest.raises(SpecError) as error:
        lower_file(path)
    assert [(d.code, d.line, d.path) for d in error.value.diagnostics] == [
        ("SF210", 7, "objects.plate.place"),
        ("SF210", 8, "objects.book.place"),
    ]


def test_settled_poses_take_the_place_of_places(tmp_path: Path) -> None:
    path = tmp_path / "placed.scene.yaml"
    path.write_text(SCENE)
    spec = load_scene(path).spec
    assert isinstance(spec, SceneSpec)
    scene = lower_file(path)
    moved = with_poses(spec, {item.name: item.X_WO for item in scene.objects if item.name != "book"})
    assert moved.objects["cup"].place is None
    assert moved.objects["cup"].pose.xyz == (0.45, 0.1, 0.0702)
    assert moved.objects["book"] == spec.objects["book"]
    path.write_text(to_yaml(moved))
    again = lower_file(path)
    for item in scene.objects:
        assert again.object(item.name).X_WO.p == pytest.approx(item.X_WO.p, abs=1e-4)


def test_places_give_the_same_bytes_twice(tmp_path: Path) -> None:
    path = tmp_path / "placed.scene.yaml"
    path.write_text(SCENE)
    first, second = ([item.X_WO.p.tobytes() + item.X_WO.q.tobytes() for item in lower_file(path).objects] for _ in "ab")
    assert first == second


def test_numbers_beyond_all_bounds_are_refused() -> None:
    huge = solid("huge", box(1e100, 1e100, 1e100), pose(0, 0, 0))
    for place in (Place(on="huge", xy=(1e308, 0)), Place(on="huge", left_of="huge", gap=1e308)):
        with pytest.raises(PlaceError) as error:
            put(solid("ball", Sphere(1e100), pose(0, 0, 0)), place, huge)
        assert len(error.value.message) < 200
