"""Objects that are renamed, copied, added or deleted in compiled stages, and the documents that are written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

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
from tests.frontends.usd.stages import DESK, OBJECTS, OVERLAY, Project, project, put, translate

if TYPE_CHECKING:
    pass


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
    UsdGeom.NurbsPatch.Define(stage, "/World/Patch")
    reading = desk.read(stage)
    assert reading.data == reading.before
    told = {note.prim: f"{note.message}; {note.hint}" for note in reading.notes}
    assert set(told) == {
        f"{OBJECTS}/cabinet/tray",
        f"{OBJECTS}/cabinet/Joints/drawer",
        f"{OBJECTS}/ball/base",
        f"{OBJECTS}/plate/base/Visuals/extra",
        "/World/Patch",
    }
    assert "from 0.3 to 9; the value is defined in cabinet.asset.yaml" in told[f"{OBJECTS}/cabinet/tray"]
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
