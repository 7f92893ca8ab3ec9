"""Places in words: sides and gaps as a viewer sees them, the order of solving, errors, documents."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.assets import convex
from simfoundry.assets.errors import MeshError
from simfoundry.assets.solids import lathe_mesh
from simfoundry.geometry.frames import Array, Pose, look_at, quat_from_rpy
from simfoundry.geometry.hulls import PROUD
from simfoundry.geometry.shapes import Capsule, Cylinder, Primitive, Sphere
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.frames import FrameTree, seen_by_camera
from simfoundry.scene.lower import lower_file
from simfoundry.scene.misfits import certain_misfits, uncut
from simfoundry.scene.model import SceneObject
from simfoundry.scene.objects import ObjectLowering
from simfoundry.scene.place import CLEARANCE, order, place_all
from simfoundry.scene.state import with_poses
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.scene import Place, SceneSpec
from simfoundry.spec.yaml.write import to_yaml
from tests.assets.meshes import blob, obj
from tests.placing import (
    CUBE,
    DESK,
    ROUNDING,
    SHAPES,
    TILT,
    distance,
    put,
    surface,
)
from tests.scenes import box, pose, solid

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


def test_two_words_fix_one_direction_each() -> None:
    one = solid("one", box(0.06, 0.06, 0.04), pose(0.4, 0.1, 0.02))
    two = solid("two", box(0.1, 0.1, 0.04), pose(0.7, -0.2, 0.02))
    place = Place(on="desk", right_of="one", in_front_of="two", gap=0.01)
    thing = put(solid("thing", box(0.02, 0.04, 0.02), pose(0, 0, 0)), place, DESK, one, two)
    assert thing.X_WO.p == pytest.approx([0.7 - 0.05 - 0.01 - 0.01, 0.1 - 0.03 - 0.01 - 0.02, 0.01 + CLEARANCE])


def test_a_thing_whose_frame_is_not_in_its_middle_is_put_by_its_middle() -> None:
    """Only `xy` and `local_xy` speak of frames."""
    wedge = solid("wedge", CUBE, pose(0, 0, 0))
    link = wedge.links[0]
    shifted = replace(link.colliders[0], X_LG=pose(0.2, 0.1, 0.3), geometry=box(0.1, 0.06, 0.04))
    wedge = replace(wedge, links=(replace(link, colliders=(shifted,)),))
    anchor = solid("anchor", CUBE, pose(0.5 - 0.1, 0.2 - 0.3, 0.05))
    aside = replace(anchor.links[0].colliders[0], X_LG=pose(0.1, 0.3, 0))
    anchor = replace(anchor, links=(replace(anchor.links[0], colliders=(aside,)),))
    centered = put(wedge, Place(on="desk", yaw_deg=90), DESK)
    assert centered.X_WO.p == pytest.approx([0.4 + 0.1, 0.1 - 0.2, 0.02 - 0.3 + CLEARANCE], abs=ROUNDING)
    beside = put(wedge, Place(on="desk", behind="anchor", gap=0.01), DESK, anchor)
    assert beside.X_WO.p[:2] == pytest.approx([0.5 + 0.05 + 0.01 + 0.05 - 0.2, 0.2 - 0.1], abs=ROUNDING)
    framed = put(wedge, Place(on="desk", xy=(0.1, 0.2)), DESK)
    assert framed.X_WO.p[:2] == pytest.approx([0.1, 0.2])


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
    for words in ({"on": "under", "local_xy": (0.003, -0.002)}, {"on": "under"}, {"on": "desk", "left_of": "under"}):
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
    assert error.value.hint == "move `cup` over `desk`"


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
        (cube, Place(on="bare"), "`bare` has no colliders, so it cannot support objects"),
        (bare, Place(on="desk"), "`bare` has no shape to place"),
        (cube, Place(inside="desk.drawer"), "`desk` has no link or part `drawer`"),
        (cube, Place(on="ghost"), "`ghost` is not placed itself"),
    ]
    for item, place, message in cases:
        with pytest.raises(PlaceError) as error:
            put(item, place, DESK, bare)
        assert error.value.message == message


def test_a_thousand_things_are_placed() -> None:
    shapes: list[Primitive] = [box(0.03, 0.02, 0.02), Sphere(0.01), Cylinder(0.01, 0.03), Capsule(0.008, 0.02)]
    things = {f"t{k}": solid(f"t{k}", shapes[k % 4], pose(0, 0, 0)) for k in range(1000)}
    table = solid("table", box(1.4, 1.4, 0.04), pose(0, 0, 0), fixed=True)
    spots = [(-0.65 + 0.04 * (k % 32), -0.65 + 0.04 * (k // 32)) for k in range(1000)]
    places = {
        name: Place(on="table", xy=spot, yaw_deg=7.0 * k)
        for k, (name, spot) in enumerate(zip(things, spots, strict=True))
    }
    placed, errors = place_all({"table": table, **things}, places, None)
    assert errors == {}
    assert placed["t999"].X_WO.p == pytest.approx([*spots[999], 0.02 + 0.018 + CLEARANCE], abs=ROUNDING)


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
    beyond = ({"xy": (1e308, 0)}, {"left_of": "huge", "gap": 1e308})  # a document may not say so
    for place in (Place.model_construct(on="huge", **more) for more in beyond):
        with pytest.raises(PlaceError) as error:
            put(solid("ball", Sphere(1e100), pose(0, 0, 0)), place, huge)
        assert len(error.value.message) < 200


PROFILE = [[0, 0], [0.04, 0], [0.04, 0.09], [0.036, 0.09], [0.036, 0.01], [0, 0.01]]
CUP = f"{{shape: {{lathe: {{profile: {PROFILE}}}}}, mass: 0.2, place: {{on: desk, xy: [0, 0]}}}}"


def test_what_does_not_fit_is_said_before_other_meshes_are_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "simfoundry.yaml").touch()
    (tmp_path / "blob.obj").write_text(obj(*blob(np.random.default_rng(1))))
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = tmp_path / "fit.scene.yaml"
    path.write_text(
        "simfoundry: scene/1\nname: fit\nobjects:\n"
        "  blob: {asset: blob.obj, mass: 1, pose: {xyz: [3, 0, 0]}}\n"
        "  flat: {asset: flat.obj, mass: 1, pose: {xyz: [6, 0, 0]}}\n"
        "  desk: {fixed: true, shape: {box: [1, 1, 0.1]}}\n"
        f"  cup: {CUP}\n"
        "  crate: {shape: {box: [0.2, 0.2, 0.2]}, mass: 1, place: {inside: cup}}\n"
    )
    monkeypatch.setattr(convex, "decompose", lambda *_: pytest.fail("a mesh was cut"))
    with pytest.raises(SpecError) as error:
        lower_file(path)
    assert sorted((d.code, d.path) for d in error.value.diagnostics) == [
        ("SF210", "objects.crate.place"),
        ("SF302", "objects.flat.asset"),
    ]


BOWL_PROFILE = [[0, 0], [0.05, 0], [0.08, 0.05], [0.076, 0.05], [0.048, 0.004], [0, 0.004]]


@pytest.mark.parametrize(("length", "fits"), [(0.05, True), (0.2, False)])
def test_what_cannot_fit_is_said_before_its_container_is_cut(
    length: float, fits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "simfoundry.yaml").touch()
    (tmp_path / "bowl.obj").write_text(obj(*lathe_mesh(np.array(BOWL_PROFILE))))
    path = tmp_path / "fit.scene.yaml"
    path.write_text(
        "simfoundry: scene/1\nname: fit\nobjects:\n"
        "  desk: {fixed: true, shape: {box: [1, 1, 0.1]}}\n"
        "  bowl: {asset: bowl.obj, mass: 0.1, place: {on: desk}}\n"
        f"  stick: {{shape: {{box: [{length}, 0.02, 0.02]}}, mass: 0.1, place: {{inside: bowl, yaw_deg: 30}}}}\n"
    )
    cuts: list[str] = []

    def cut(name: str, *_: object) -> NoReturn:
        cuts.append(name)
        raise MeshError("SF301", "not cut here", "")

    monkeypatch.setattr(convex, "decompose", cut)
    with pytest.raises(SpecError) as error:
        lower_file(path)
    (finding,) = error.value.diagnostics
    assert (finding.code, cuts) == (("SF301", ["bowl.obj"]) if fits else ("SF210", []))
    if not fits:
        assert finding.message.startswith("`stick` (18.3 x 11.7 x 2.0 cm) does not fit inside `bowl` (16.0 x ")


@pytest.mark.slow  # 6 s: it places by brute force
def test_what_is_refused_uncut_fits_no_cut_container_either(tmp_path: Path) -> None:
    """The bowl as a mesh, and as the convex parts that make it up."""
    rng = np.random.default_rng(0)
    (tmp_path / "bowl.obj").write_text(obj(*lathe_mesh(np.array(BOWL_PROFILE))))
    refused = 0
    for k in range(40):
        size = np.round(rng.uniform(0.02, [0.3, 0.12, 0.12]), 3).tolist()
        at = np.round(rng.uniform(-0.03, 0.03, 2), 3).tolist()
        place = f"{{inside: bowl, local_xy: {at}, rpy_deg: [0, {9 * k}, 0]}}"
        thing = f"stick: {{shape: {{box: {size}}}, mass: 0.1, place: {place}}}"
        head = "simfoundry: scene/1\nname: fit\nobjects:\n"
        (tmp_path / "cut.scene.yaml").write_text(
            f"{head}  bowl: {{shape: {{lathe: {{profile: {BOWL_PROFILE}}}}}, mass: 0.1}}\n  {thing}\n"
        )
        (tmp_path / "uncut.scene.yaml").write_text(f"{head}  bowl: {{asset: bowl.obj, mass: 0.1}}\n  {thing}\n")
        loaded = load_scene(tmp_path / "uncut.scene.yaml")
        assert isinstance(loaded.spec, SceneSpec)
        work = ObjectLowering(loaded, cuts=False)
        objects = {name: work.lower(name) for name in loaded.spec.objects}
        assert objects["bowl"] is not None and objects["stick"] is not None
        shapes = {"bowl": uncut(objects["bowl"]), "stick": objects["stick"]}
        stick = {"stick": loaded.spec.objects["stick"].place}
        if certain_misfits(shapes, stick, None, {"bowl"}, FrameTree()):  # type: ignore[arg-type]
            refused += 1
            with pytest.raises(SpecError, match="SF210"):
                lower_file(tmp_path / "cut.scene.yaml")
    assert 5 <= refused < 40


def test_places_inside_do_not_change_the_order_of_objects(tmp_path: Path) -> None:
    path = tmp_path / "order.scene.yaml"
    path.write_text(
        "simfoundry: scene/1\nname: order\nobjects:\n"
        "  ball: {shape: {sphere: 0.02}, mass: 0.1, pose: {xyz: [1, 1, 1]}}\n"
        "  pea: {shape: {sphere: 0.005}, mass: 0.1, place: {inside: cup}}\n"
        f"  cup: {CUP}\n"
        "  desk: {fixed: true, shape: {box: [1, 1, 0.1]}}\n"
    )
    assert [item.name for item in lower_file(path).objects] == ["ball", "pea", "cup", "desk"]
