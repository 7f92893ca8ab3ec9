"""Edits of values in compiled stages, and the resulting documents."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from simfoundry.frontends.usd.compiled.loading import import_usd
from simfoundry.scene.lower import lower_file
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import to_data
from tests.frontends.usd.stages import CABINET, DESK, OBJECTS, Project, lines, put, translate

if TYPE_CHECKING:
    from pxr import Usd


def test_a_person_edits_a_stage_and_gets_these_changes_and_no_others(desk: Project) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    stage = desk.edit()
    translate(stage, f"{OBJECTS}/ball", 0.31, -0.12, 0.03)
    stage.RemovePrim(f"{OBJECTS}/shelf")
    put(stage, f"{OBJECTS}/plate/base", "physics:mass", 0.52)
    put(stage, f"{OBJECTS}/cabinet/Joints/drawer", "state:linear:physics:position", 0.12)
    cube = UsdGeom.Cube.Define(stage, f"{OBJECTS}/Cube")
    cube.GetSizeAttr().Set(0.06)
    cube.AddTranslateOp().Set(Gf.Vec3d(0.5, -0.2, 0.03))
    UsdPhysics.RigidBodyAPI.Apply(cube.GetPrim())
    UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    UsdPhysics.MassAPI.Apply(cube.GetPrim()).CreateMassAttr(0.25)

    imported = desk.onto(stage)

    assert imported.notes == () and imported.disputed == ()
    shelf = DESK[DESK.index("  shelf:\n") : DESK.index("  plate:\n")]
    expected = (
        DESK.replace(shelf, "")
        .replace("xyz: [0.2, -0.2, 0.03], rpy", "xyz: [0.31, -0.12, 0.03], rpy")
        .replace("mass: {value: 0.45, range: [0.3, 0.6], source: vlm}", "mass: 0.52")
        .replace("drawer: 0.05", "drawer: 0.12")
        .replace(
            "\n\nrobots:",
            "\n  cube:\n    shape: {box: [0.06, 0.06, 0.06]}\n    mass: 0.25\n    pose: {xyz: [0.5, -0.2, 0.03]}"
            "\n\nrobots:",
        )
    )
    assert imported.text == expected


def test_an_edited_stage_keeps_the_limit_at_which_a_joint_is_closed(desk: Project, tmp_path: Path) -> None:
    stage = desk.edit()
    put(stage, f"{OBJECTS}/cabinet/Joints/door", "state:angular:physics:position", 100.0)
    assert stage.GetPrimAtPath(f"{OBJECTS}/cabinet/Joints/door").GetAttribute("simfoundry:closed").Get() == "upper"
    imported = desk.onto(stage)
    assert imported.text == DESK.replace("door: {deg: 30}", "door: {deg: 100}") and imported.notes == ()
    for file, text in (("desk.scene.yaml", imported.text), ("cabinet.asset.yaml", CABINET)):
        (tmp_path / file).write_text(text)
    door = next(j for j in lower_file(tmp_path / "desk.scene.yaml").object("cabinet").joints if j.name == "door")
    assert door.closed == "upper" and door.position == pytest.approx(math.radians(100))


def test_what_was_not_edited_is_not_written_anew(desk: Project) -> None:
    path = desk.save(desk.edit())
    assert import_usd(path, desk.document).text == DESK
    alone = parse(import_usd(path).text).data
    assert alone == to_data(SceneSpec.model_validate(parse(DESK).data))


@pytest.mark.parametrize("shift", [9e-5, -9e-5])
def test_less_than_a_tenth_of_a_millimeter_is_no_move(desk: Project, shift: float) -> None:
    stage = desk.edit()
    translate(stage, f"{OBJECTS}/plate", *(desk.scene.object("plate").X_WO.p + shift))
    assert desk.onto(stage).text == DESK


def test_a_place_gives_way_to_a_pose_where_the_thing_was_moved(desk: Project) -> None:
    stage = desk.edit()
    translate(stage, f"{OBJECTS}/cup", 0.61, -0.05, 0.05)
    gone, came = lines(desk.onto(stage).text, DESK)
    assert gone == ["    place: {on: desk, right_of: plate, gap: 0.05}  # within reach"]
    assert came == ["    pose: {xyz: [0.61, -0.05, 0.05]}"]


def test_a_body_that_a_simulator_moved_within_its_object_is_the_object_moved(desk: Project) -> None:
    from pxr import Gf, UsdGeom

    stage = desk.edit()
    UsdGeom.Xformable(stage.GetPrimAtPath(f"{OBJECTS}/plate/base")).AddTranslateOp().Set(Gf.Vec3d(0.1, 0, 0))
    data = desk.read(stage).data["objects"]
    assert data["plate"]["pose"] == {"xyz": (0.55, 0.1, 0.0101)} and "place" not in data["plate"]
    # The cup is placed beside the plate; it stayed, so its place would now be solved into another pose.
    assert "place" not in data["cup"]
    np.testing.assert_allclose(data["cup"]["pose"]["xyz"], desk.scene.object("cup").X_WO.p, atol=1e-4)


def test_places_on_a_desk_that_was_shifted_stay_and_on_one_that_was_raised_become_poses(desk: Project) -> None:
    stage = desk.edit()
    translate(stage, f"{OBJECTS}/desk", 0.5, 0.02, -0.02)
    assert desk.read(stage).data["objects"]["plate"]["place"] == {"on": "desk", "xy": (0.45, 0.1)}
    translate(stage, f"{OBJECTS}/desk", 0.45, 0.0, -0.05)
    assert desk.read(stage).data["objects"]["plate"]["pose"] == {"xyz": (0.45, 0.1, 0.0101)}


def test_turning_keeps_the_position_and_other_operations_are_understood(desk: Project) -> None:
    from pxr import Gf, UsdGeom

    stage = desk.edit()
    shelf = UsdGeom.Xformable(stage.GetPrimAtPath(f"{OBJECTS}/shelf"))
    shelf.ClearXformOpOrder()
    shelf.AddTranslateOp(opSuffix="mine").Set(Gf.Vec3d(0.8, 0.25, 0.21))
    shelf.AddRotateXYZOp().Set(Gf.Vec3f(0, 0, 40))
    assert desk.read(stage).data["objects"]["shelf"]["pose"] == {"xyz": (0.8, 0.25, 0.21), "yaw_deg": 40.0}


Edit = Callable[["Usd.Stage"], None]


def material_of(stage: Usd.Stage, shape: str, purpose: str = "") -> Usd.Prim:
    from pxr import UsdShade

    return (
        UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(f"{OBJECTS}/{shape}"))
        .ComputeBoundMaterial(purpose)[0]
        .GetPrim()
    )


def paint(stage: Usd.Stage) -> None:
    from pxr import Gf

    look = material_of(stage, "ball/base/Visuals/shape")
    put(stage, f"{look.GetPath()}/Surface", "inputs:diffuseColor", Gf.Vec3f(0.0, 0.21404114, 1.0))


def slippery(stage: Usd.Stage) -> None:
    material = material_of(stage, "ball/base/Colliders/shape", "physics")
    put(stage, str(material.GetPath()), "physics:dynamicFriction", 0.5)


def rough(stage: Usd.Stage) -> None:
    material = material_of(stage, "ball/base/Colliders/shape", "physics")
    put(stage, str(material.GetPath()), "simfoundry:friction", 0.9)


def stretch(stage: Usd.Stage) -> None:
    from pxr import Gf, UsdGeom

    UsdGeom.Xformable(stage.GetPrimAtPath(f"{OBJECTS}/shelf")).AddScaleOp().Set(Gf.Vec3f(2, 1, 0.5))


def resize(stage: Usd.Stage) -> None:
    for place in ("Visuals", "Colliders"):
        put(stage, f"{OBJECTS}/ball/base/{place}/shape", "radius", 0.045)


def weld(stage: Usd.Stage) -> None:
    from pxr import UsdPhysics

    stage.GetPrimAtPath(f"{OBJECTS}/ball/base").RemoveAPI(UsdPhysics.RigidBodyAPI)


def by_density(stage: Usd.Stage) -> None:
    from pxr import UsdPhysics

    api = UsdPhysics.MassAPI(stage.GetPrimAtPath(f"{OBJECTS}/ball/base"))
    api.GetMassAttr().Clear()
    api.CreateDensityAttr(850.0)


def gravity(stage: Usd.Stage) -> None:
    put(stage, "/World/Physics", "physics:gravityMagnitude", 1.62)


def zoom(stage: Usd.Stage) -> None:
    camera = stage.GetPrimAtPath("/World/Cameras/front")
    camera.GetAttribute("focalLength").Set(2 * camera.GetAttribute("focalLength").Get())


def dim(stage: Usd.Stage) -> None:
    light = stage.GetPrimAtPath("/World/Lights/lamp")
    light.GetAttribute("inputs:intensity").Set(light.GetAttribute("inputs:intensity").Get() / 4)


def aim(stage: Usd.Stage) -> None:
    from pxr import Gf

    put(stage, "/World/Lights/sun", "xformOp:orient", Gf.Quatd(1, 0, 0, 0))


def swing(stage: Usd.Stage) -> None:
    put(stage, f"{OBJECTS}/cabinet/Joints/door", "state:angular:physics:position", 75.0)


def pull(stage: Usd.Stage) -> None:
    """Move the drawer's own prim, as with the mouse; it opens along +x of the cabinet."""
    prim = stage.GetPrimAtPath(f"{OBJECTS}/cabinet/tray")
    at = prim.GetAttribute("xformOp:translate").Get()
    translate(stage, str(prim.GetPath()), at[0] + 0.04, at[1], at[2])


EDITS: list[tuple[Edit, tuple[str, ...], Any]] = [
    (paint, ("objects", "ball", "color"), (0.0, 0.5, 1.0)),
    (slippery, ("objects", "ball", "friction"), 0.25),
    (rough, ("objects", "ball", "friction"), 0.9),
    (stretch, ("objects", "shelf", "shape"), {"box": (0.6, 0.2, 0.01)}),
    (resize, ("objects", "ball", "shape"), {"sphere": 0.045}),
    (weld, ("objects", "ball", "fixed"), True),
    (gravity, ("gravity",), (0.0, 0.0, -1.62)),
    (dim, ("lights", "lamp", "intensity"), 0.1),
    (aim, ("lights", "sun", "direction"), (0.0, 0.0, -1.0)),
    (swing, ("objects", "cabinet", "joints", "door"), {"deg": 75.0}),
    (pull, ("objects", "cabinet", "joints", "drawer"), 0.09),
]


@pytest.mark.parametrize(("edit", "path", "value"), EDITS, ids=[edit.__name__ for edit, _, _ in EDITS])
def test_one_edit_is_one_change(desk: Project, edit: Edit, path: tuple[str, ...], value: Any) -> None:
    stage = desk.edit()
    edit(stage)
    reading = desk.read(stage)
    found: Any = reading.data
    for key in path:
        found = found[key]
    assert found == value
    rest, before = with_none(reading.data, path), with_none(reading.before, path)
    assert rest == before
    assert reading.notes == ()


def with_none(data: Any, path: tuple[str, ...]) -> Any:
    """The data with nothing at a path."""
    return {**data, path[0]: with_none(data.get(path[0], {}), path[1:]) if path[1:] else None}


def test_a_density_takes_the_place_of_a_mass(desk: Project) -> None:
    stage = desk.edit()
    by_density(stage)
    ball = desk.read(stage).data["objects"]["ball"]
    assert ball["density"] == 850.0 and "mass" not in ball


def test_a_lens_is_counted_in_pixels(desk: Project) -> None:
    stage = desk.edit()
    zoom(stage)
    camera = desk.read(stage).data["cameras"]["front"]
    assert (camera["fx"], camera["fy"]) == (1000.0, 1000.0) and camera["size"] == (640, 480)
    assert "cx" not in camera and "cy" not in camera


def test_a_camera_that_was_moved_looks_at_a_point_or_leans(desk: Project) -> None:
    from pxr import Gf

    stage = desk.edit()
    translate(stage, "/World/Cameras/front", -0.5, 0.1, 0.5)
    pose = desk.read(stage).data["cameras"]["front"]["pose"]
    assert pose == {"xyz": (-0.5, 0.1, 0.5), "look_at": (0.55, 0.0, 0.0)}
    camera = stage.GetPrimAtPath("/World/Cameras/front").GetAttribute("xformOp:orient")
    lean = Gf.Quatd(math.cos(0.1), 0, 0, math.sin(0.1))
    camera.Set(camera.Get() * lean)
    assert "quat_wxyz" in desk.read(stage).data["cameras"]["front"]["pose"]
