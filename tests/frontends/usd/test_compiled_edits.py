"""Stages edited as people edit them, and the document that comes back."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from simfoundry.backends.usd import compile_usd
from simfoundry.errors import OutputError
from simfoundry.frontends.usd.compiled.loading import import_stage, import_usd
from simfoundry.frontends.usd.compiled.stage import StageError
from simfoundry.scene.lower import lower_file
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import to_data
from tests.cli.command import run
from tests.frontends.usd.stages import CABINET, DESK, OVERLAY, Project, project

if TYPE_CHECKING:
    from pxr import Usd

OBJECTS = "/World/Objects"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Project:
    return project(tmp_path_factory.mktemp("desk"))


@pytest.fixture(scope="module")
def tuesday(tmp_path_factory: pytest.TempPathFactory) -> Project:
    return project(tmp_path_factory.mktemp("tuesday"), "tuesday")


def translate(stage: Usd.Stage, path: str, x: float, y: float, z: float) -> None:
    from pxr import Gf, UsdGeom

    UsdGeom.XformCommonAPI(stage.GetPrimAtPath(path))
    attribute = stage.GetPrimAtPath(path).GetAttribute("xformOp:translate")
    attribute.Set(Gf.Vec3d(x, y, z))


def put(stage: Usd.Stage, path: str, name: str, value: Any) -> None:
    attribute = stage.GetPrimAtPath(path).GetAttribute(name)
    assert attribute, f"{path} has no {name}"
    attribute.Set(value)


def lines(text: str, original: str) -> tuple[list[str], list[str]]:
    """The lines that went and those that came."""
    before, after = original.splitlines(), text.splitlines()
    return [ln for ln in before if ln not in after], [ln for ln in after if ln not in before]


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


def test_a_new_name_is_used_wherever_the_old_one_was(desk: Project) -> None:
    from pxr import Usd

    stage = desk.edit()
    editor = Usd.NamespaceEditor(stage)
    assert editor.RenamePrim(stage.GetPrimAtPath(f"{OBJECTS}/plate"), "Dish") and editor.ApplyEdits()
    imported = desk.onto(stage)
    expected = (
        DESK.replace("  plate:", "  dish:")
        .replace("right_of: plate", "right_of: dish")
        .replace("OnTop(plate", "OnTop(dish")
        .replace("(cup, plate)", "(cup, dish)")
    )
    assert imported.text == expected


def test_a_copy_is_a_thing_of_its_own(desk: Project) -> None:
    from pxr import Sdf

    stage = desk.edit()
    layer = stage.GetRootLayer()
    Sdf.CopySpec(layer, f"{OBJECTS}/plate", layer, f"{OBJECTS}/plate_01")
    translate(stage, f"{OBJECTS}/plate_01", 0.2, 0.0, 0.01)
    objects = desk.read(stage).data["objects"]
    assert list(objects)[-1] == "plate_01"
    assert objects["plate_01"] == {
        **{k: v for k, v in objects["plate"].items() if k != "place"},
        "pose": {"xyz": (0.2, 0.0, 0.01)},
    }


def test_a_part_of_another_stage_is_a_thing_of_its_own(desk: Project, tuesday: Project) -> None:
    from pxr import Sdf

    stage, other = desk.edit(), tuesday.edit()
    Sdf.CopySpec(other.GetRootLayer(), f"{OBJECTS}/bowl", stage.GetRootLayer(), f"{OBJECTS}/bowl")
    objects = desk.read(stage).data["objects"]
    assert list(objects)[-1] == "bowl" and objects["bowl"]["material"] == "ceramic" and "place" not in objects["bowl"]


def test_what_speaks_of_a_deleted_thing_goes_and_what_stood_by_it_stays(desk: Project) -> None:
    stage = desk.edit()
    stage.RemovePrim(f"{OBJECTS}/plate")
    stage.RemovePrim("/World/Cameras/front")
    data = desk.read(stage).data
    assert "plate" not in data["objects"] and list(data["cameras"]) == ["wrist"] and "viewpoint" not in data
    assert data["relations"] == ("Closed(cabinet.drawer)",)
    np.testing.assert_allclose(data["objects"]["cup"]["pose"]["xyz"], desk.scene.object("cup").X_WO.p, atol=1e-4)


def test_deactivated_is_deleted_and_grouped_is_not(desk: Project) -> None:
    from pxr import Gf, Usd, UsdGeom

    stage = desk.edit()
    stage.GetPrimAtPath(f"{OBJECTS}/shelf").SetActive(False)
    group = UsdGeom.Xform.Define(stage, "/World/Things")
    group.AddTranslateOp().Set(Gf.Vec3d(0, 0, 0.1))
    editor = Usd.NamespaceEditor(stage)
    assert editor.MovePrimAtPath(f"{OBJECTS}/ball", "/World/Things/ball") and editor.ApplyEdits()
    objects = desk.read(stage).data["objects"]
    assert "shelf" not in objects
    assert objects["ball"]["pose"] == {"xyz": (0.2, -0.2, 0.13), "rpy_deg": (10.0, 20.0, 30.0)}


def test_what_a_document_cannot_say_is_told(desk: Project) -> None:
    from pxr import Gf, UsdGeom

    stage = desk.edit()
    put(stage, f"{OBJECTS}/cabinet/tray", "physics:mass", 9.0)
    put(stage, f"{OBJECTS}/cabinet/Joints/drawer", "physics:upperLimit", 0.3)
    put(stage, f"{OBJECTS}/ball/base", "physics:centerOfMass", Gf.Vec3f(0, 0, 0.01))
    UsdGeom.Sphere.Define(stage, f"{OBJECTS}/plate/base/Visuals/extra")
    UsdGeom.Cone.Define(stage, "/World/Cone")
    reading = desk.read(stage)
    assert reading.data == reading.before
    told = {note.prim: f"{note.message}; {note.hint}" for note in reading.notes}
    assert set(told) == {
        f"{OBJECTS}/cabinet/tray",
        f"{OBJECTS}/cabinet/Joints/drawer",
        f"{OBJECTS}/ball/base",
        f"{OBJECTS}/plate/base/Visuals/extra",
        "/World/Cone",
    }
    assert "from 0.3 to 9; it is defined in cabinet.asset.yaml" in told[f"{OBJECTS}/cabinet/tray"]
    assert "`physics:upperLimit` changed from 0.2 to 0.3" in told[f"{OBJECTS}/cabinet/Joints/drawer"]


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_added_cylinders_stand_as_the_stage_has_them(desk: Project, axis: str) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    stage = desk.edit()
    cylinder = UsdGeom.Cylinder.Define(stage, "/Can")
    cylinder.GetAxisAttr().Set(axis)
    cylinder.GetRadiusAttr().Set(0.03)
    cylinder.GetHeightAttr().Set(0.12)
    cylinder.AddTranslateOp().Set(Gf.Vec3d(0.1, 0.2, 0.3))
    cylinder.AddRotateXYZOp().Set(Gf.Vec3f(20, -40, 70))
    UsdPhysics.CollisionAPI.Apply(cylinder.GetPrim())
    can = SceneSpec.model_validate(desk.read(stage).data).objects["can"]
    assert can.fixed and can.collision == "auto" and can.shape is not None
    assert to_data(can.shape) == {"cylinder": {"radius": 0.03, "height": 0.12}}
    from simfoundry.scene.lower import pose

    world = UsdGeom.XformCache().GetLocalToWorldTransform(cylinder.GetPrim())
    along = np.array(world.TransformDir(Gf.Vec3d(*np.eye(3)["XYZ".index(axis)])))
    np.testing.assert_allclose(np.abs(pose(can.pose).rotation[:, 2] @ along), 1.0, atol=1e-6)


def test_an_overlay_stays_one(tuesday: Project) -> None:
    stage = tuesday.edit()
    translate(stage, f"{OBJECTS}/ball", 0.3, -0.25, 0.03)  # of the base
    translate(stage, f"{OBJECTS}/bowl", 0.35, -0.1, 0.025)  # of the overlay
    stage.RemovePrim(f"{OBJECTS}/shelf")
    put(stage, f"{OBJECTS}/plate/base", "physics:mass", 0.5)
    expected = OVERLAY.replace(
        "    place: {on: desk, xy: [0.3, -0.1]}  # for the soup\n", "    pose: {xyz: [0.35, -0.1, 0.025]}\n"
    )
    expected += "  shelf: null\n  plate:\n    mass: 0.5\n  ball:\n    pose: {xyz: [0.3, -0.25, 0.03]}\n"
    assert tuesday.onto(stage).text == expected


def test_an_overlay_that_was_not_edited_keeps_its_text(tuesday: Project) -> None:
    assert tuesday.onto(tuesday.edit()).text == OVERLAY


def test_a_document_that_went_on_keeps_what_it_has_and_says_where_both_changed(desk: Project, tmp_path: Path) -> None:
    original = tmp_path / "desk.scene.yaml"
    original.write_text(
        DESK.replace("friction: 0.8", "friction: 0.6").replace("    mass: 0.1\n", "    mass: 0.2  # weighed\n")
    )
    stage = desk.edit()
    put(stage, f"{OBJECTS}/ball/base", "physics:mass", 0.3)
    imported = import_usd(desk.save(stage), original)
    assert imported.disputed == ("objects.ball.mass",)
    assert "    mass: 0.3  # weighed\n    friction: 0.6\n" in imported.text


def test_another_document_is_refused(desk: Project, tmp_path: Path) -> None:
    original = tmp_path / "other.scene.yaml"
    original.write_text(DESK.replace("name: desk", "name: other"))
    with pytest.raises(StageError, match=r"was compiled from `desk`, but .*other.scene.yaml is `other`"):
        import_usd(desk.save(desk.edit()), original)


def test_a_document_is_edited_in_place_or_written_where_its_files_are_found(desk: Project, tmp_path: Path) -> None:
    stage = desk.edit()
    put(stage, f"{OBJECTS}/ball/base", "physics:mass", 0.3)
    path = desk.save(stage)
    out = desk.document.with_name("again.scene.yaml")
    import_stage(path, out, desk.document)
    assert out.read_text() == DESK.replace("mass: 0.1", "mass: 0.3")
    out.write_text(DESK)
    import_stage(path, out)
    assert out.read_text() == DESK.replace("mass: 0.1", "mass: 0.3")
    import_stage(path, out, force=True)
    assert "#" not in out.read_text() and "mass: 0.3" in out.read_text()
    elsewhere = desk.document.parent / "sub" / "desk.scene.yaml"
    import_stage(path, elsewhere)
    assert "asset: ../cabinet.asset.yaml" in elsewhere.read_text()
    assert not load(elsewhere).errors
    with pytest.raises(OutputError, match=r"desk\.scene\.yaml must be in the same folder as"):
        import_stage(path, tmp_path / "desk.scene.yaml", desk.document)


ARM = """\
<mujoco><worldbody><body name="base"><geom type="box" size=".05 .05 .05"/>
  <body name="hand" pos="0 0 .1"><joint name="turn" axis="0 0 1" range="-1 1" limited="true"/>
    <geom type="box" size=".02 .02 .1"/></body></body></worldbody></mujoco>
"""


def test_a_robot_stands_where_it_was_put_and_its_posture_is_told(tmp_path: Path) -> None:
    from pxr import Gf, UsdGeom

    project(tmp_path)
    (tmp_path / "arm.xml").write_text(ARM)
    document = tmp_path / "desk.scene.yaml"
    text = DESK.replace("model: franka_robotiq", "model: {mjcf: arm.xml}")
    document.write_text(text)
    scene = lower_file(document)
    compile_usd(scene).write(tmp_path / "build" / "usd")
    made = Project(document, tmp_path / "build" / "usd" / "scene.usda", scene)
    stage = made.edit()
    assert made.onto(stage).text == text
    UsdGeom.XformCommonAPI(stage.GetPrimAtPath("/World/Robots/arm")).SetTranslate(Gf.Vec3d(0.1, 0.05, 0))
    states = [p for p in stage.Traverse() if p.GetAttribute("state:angular:physics:position")]
    turn = next(p for p in states if str(p.GetPath()).startswith("/World/Robots/arm/"))
    turn.GetAttribute("state:angular:physics:position").Set(20.0)
    imported = made.onto(stage)
    assert imported.text == text.replace("arm.xml}}", "arm.xml}, pose: {xyz: [0.1, 0.05, 0]}}")
    assert [note.prim for note in imported.notes] == [str(turn.GetPath())]


def test_the_command_writes_the_edit_into_the_document(desk: Project) -> None:
    stage = desk.edit()
    translate(stage, f"{OBJECTS}/cup", 0.61, -0.05, 0.05)
    path = desk.save(stage)
    out = desk.document.with_name("edited.scene.yaml")
    out.write_text(DESK)
    done = run("import", path, "-o", out, "--json")
    assert done.code == 0, done.err
    assert done.json["changed"] is True and done.json["notes"] == []
    assert out.read_text() == DESK.replace(
        "place: {on: desk, right_of: plate, gap: 0.05}  # within reach", "pose: {xyz: [0.61, -0.05, 0.05]}"
    )
    again = run("import", path, "--onto", out)
    assert again.code == 0 and again.out.strip().endswith("no changes")


def test_a_folder_of_stages_comes_back_as_their_documents(desk: Project) -> None:
    folder = desk.stage.parent.parent / "many"
    folder.mkdir()
    for name in ("one", "two"):
        Path(folder / f"{name}.usda").write_bytes(desk.stage.read_bytes())
    done = run("import", folder, "-o", desk.document.parent, "--json")
    assert done.code == 0, done.err
    assert [report["format"] for report in done.json["files"]] == ["a compiled stage"] * 2
    for name in ("one", "two"):
        text = desk.document.with_name(f"{name}.scene.yaml").read_text()
        assert parse(text).data == to_data(SceneSpec.model_validate(parse(DESK).data))
