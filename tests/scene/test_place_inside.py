"""Dishes in dishes and things in drawers: the real colliders of lathes and of an articulated cabinet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from simfoundry.geometry.hulls import PROUD
from simfoundry.geometry.shapes import Capsule, Sphere
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import SceneObject
from simfoundry.scene.place import CLEARANCE, place_all
from simfoundry.spec.models.scene import Place
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.placing import (
    CUBE,
    ROUNDING,
    distance,
    put,
)
from tests.scenes import box, pose, scene_of, solid

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


def chain(things: Mapping[str, SceneObject], places: Mapping[str, Place]) -> dict[str, SceneObject]:
    """The things that are named, placed, and what they stand on."""
    placed, errors = place_all(things, places, None)
    assert not errors
    return placed


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
            "plate": Place(on="desk", local_xy=(-0.2, 0.1), yaw_deg=7),
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


def test_rounded_rails_are_walls() -> None:
    """A tray of a floor and four lying capsules, away from its frame; the rails along y stand 0.3 m apart."""
    tray = solid("tray", box(0.4, 0.2, 0.01), pose(0.5, 0.2, 0.1, yaw=0.6))
    link = tray.links[0]
    rails = [
        (Capsule(0.02, 0.2), pose(0.1, 0, 0.03, math.pi / 2)),
        (Capsule(0.02, 0.2), pose(-0.2, 0, 0.03, math.pi / 2)),
        (Capsule(0.02, 0.4), pose(0, 0.1, 0.03, 0, math.pi / 2)),
        (Capsule(0.02, 0.4), pose(0, -0.1, 0.03, 0, math.pi / 2)),
    ]
    fence = tuple(replace(link.colliders[0], geometry=shape, X_LG=X_LG) for shape, X_LG in rails)
    tray = replace(tray, links=(replace(link, colliders=(*link.colliders, *fence)),))
    ball = put(solid("ball", Sphere(0.03), pose(0, 0, 0)), Place(inside="tray"), tray)
    assert (tray.X_WO.inverse() @ ball.X_WO).p == pytest.approx([-0.05, 0, 0.035 + CLEARANCE], abs=2 * ROUNDING)
    with pytest.raises(PlaceError, match=r"does not fit inside `tray`"):
        put(solid("lid", box(0.4, 0.3, 0.01), pose(0, 0, 0)), Place(inside="tray", yaw_deg=math.degrees(0.6)), tray)


def test_a_block_has_no_inside() -> None:
    block = solid("block", CUBE, pose(0, 0, 0))
    with pytest.raises(PlaceError) as error:
        put(solid("ball", Sphere(0.01), pose(0, 0, 0)), Place(inside="block"), block)
    assert error.value.message == ("`ball` cannot be inside `block`, whose only collider is convex and has no cavity")


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
    brick = put(
        solid("brick", BRICK, pose(0, 0, 0)), Place(inside="cabinet.tray", yaw_deg=30, local_xy=(-0.05, 0)), half
    )
    local = half.X_WO.inverse() @ brick.X_WO
    assert local.p == pytest.approx([-0.29, 0, 0.025 + 0.07 + CLEARANCE], abs=2 * ROUNDING)
    assert 0 <= distance(brick, half) <= 2e-4


def test_a_board_on_the_sides_of_a_drawer_is_not_inside_behind_its_higher_front(
    things: dict[str, SceneObject],
) -> None:
    half = opened(things["cabinet"], 0.24)
    board = solid("board", box(0.1, 0.37, 0.01), pose(0, 0, 0))
    with pytest.raises(PlaceError, match="does not fit inside"):
        put(board, Place(inside="cabinet.tray", yaw_deg=30, local_xy=(-0.05, 0)), half)
    on = put(board, Place(on="cabinet.tray", yaw_deg=30, local_xy=(-0.05, 0)), half)
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
        put(slab, Place(on="cabinet.tray", local_xy=(0.3, 0)), opened(closed, 0.24))


def test_all_links_of_a_thing_count(things: dict[str, SceneObject]) -> None:
    """A cabinet whose drawer hangs over a step comes to rest on its drawer's knob or tray."""
    step = solid("step", box(0.1, 0.1, 0.1), pose(-0.35, 0, 0))
    placed = put(opened(things["cabinet"], 0.24), Place(on="step", xy=(0.0, 0.0)), step)
    assert placed.X_WO.p[2] == pytest.approx(0.05 - 0.015 + CLEARANCE, abs=ROUNDING)
    assert 0 <= distance(placed, step) <= 2e-4


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
