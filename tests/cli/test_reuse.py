"""Commands on scenes that reuse something: `--set`, stages with exceptions, recipes with parameters."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import simfoundry as sf
from simfoundry.spec.change.diff.words import describe, text
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.write import to_data
from tests.cli.command import run
from tests.spec.compose.documents import DESK, written

SCENE = f"""\
simfoundry: scene/1
name: cups
parameters: {{gap: 0.12}}
templates: {{dish: {{shape: {{cylinder: {{radius: 0.03, height: 0.04}}}}, mass: 0.2, color: [1, 0, 0]}}}}
objects:
{DESK}  # four cups
  cup: {{like: dish, place: {{on: desk, xy: [0, 0.1]}}, repeat: {{count: [2, 2], step: [$gap, 0.12]}}}}
  bowl: {{like: dish, place: {{on: desk, xy: [-0.3, 0]}}}}
relations: [OnTop(cup, desk), OnTop(bowl, desk)]
"""


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return written(tmp_path, SCENE, "cups.scene.yaml")


def test_parameters_are_set_from_the_command_line(scene: Path, tmp_path: Path) -> None:
    text = run("flatten", str(scene), "--set", "gap=0.3").out
    assert "cup_2_1:" in text and "xy: [0.3, 0.1]" in text and "gap" not in text.replace("gap: 0.03", "")
    assert run("compile", str(scene), "-t", "mjcf", "-o", str(tmp_path / "b"), "--set", "gap=0.3").code == 0
    assert 'pos="0.3 0.1' in (tmp_path / "b" / "mjcf" / "scene.xml").read_text()
    for command in ("check", "show", "judge", "flatten"):
        wrong = run(command, str(scene), "--set", "gpa=0.3")
        assert wrong.code in (1, 2) and "no parameter is called `gpa`" in wrong.out + wrong.err, command
        assert run(command, str(scene), "--set", "gap=x").code == 2
        assert run(command, str(scene), "--set", "gap=nan").code == 2
    assert scene.read_text() == SCENE


def test_an_edit_of_one_copy_in_a_stage_becomes_its_exception(scene: Path, tmp_path: Path) -> None:
    from pxr import Gf, Usd, UsdGeom

    sf.load(scene).compile("usd", out=tmp_path / "b")
    stage = Usd.Stage.Open(str(tmp_path / "b" / "usd" / "scene.usda"))
    (move,) = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Objects/cup_1_2")).GetOrderedXformOps()
    move.Set(move.Get() + Gf.Vec3d(0.05, 0, 0))
    stage.RemovePrim("/World/Objects/cup_2_2")
    stage.Save()
    done = run("import", "b/usd/scene.usda", "-o", "cups.scene.yaml")
    assert done.code == 0, done.err
    assert "cup_1_2 has an entry of its own now, separate from cup" in done.out
    text = scene.read_text()
    assert "repeat: {count: [2, 2], step: [$gap, 0.12]}" in text and "# four cups" in text and "like: dish" in text
    assert "cup_2_2: null" in text and "OnTop(cup, desk)" in text and text.count("cup_1_2") == 1
    assert run("diff", "cups.scene.yaml", "b/usd/scene.usda").out == "equivalent, written differently\n"
    spec = load(scene).spec
    assert isinstance(spec, SceneSpec) and spec.objects["cup_1_2"].pose.xyz == (0.05, 0.22, 0.0201)
    assert list(spec.objects) == ["desk", "cup_1_1", "cup_1_2", "cup_2_1", "bowl"]


def test_python_edits_single_copies(scene: Path) -> None:
    document = sf.load(scene)
    assert isinstance(document, sf.SceneDocument)
    document.objects["cup_2_1"].mass = 0.7
    document.objects["bowl"].color = None
    del document.objects["cup_1_1"]
    document.relations.remove("OnTop(cup_1_1, desk)")
    document.parameters = {"gap": 0.2}
    document.save()
    spec = load(scene).spec
    assert isinstance(spec, SceneSpec)
    assert list(spec.objects) == ["desk", "cup_1_2", "cup_2_1", "cup_2_2", "bowl"]
    assert spec.objects["cup_2_1"].mass == 0.7 and spec.objects["bowl"].color is None
    assert spec.objects["cup_2_1"].place is not None and spec.objects["cup_2_1"].place.xy == (0.2, 0.1)
    assert "repeat:" in scene.read_text() and "# four cups" in scene.read_text()


@pytest.mark.slow  # 2 s
@pytest.mark.usefixtures("scene")
def test_recipes_set_parameters_and_address_copies(tmp_path: Path) -> None:
    recipe = "simfoundry: cousins/1\nname: r\ntwin: cups.scene.yaml\nparameters: {gap: 0.2}\n"
    axis = "scene: {anchor: desk, objects: {cup_1_2: [OnTop]}}\n"
    (tmp_path / "r.cousins.yaml").write_text(recipe.replace("gap", "gpa") + axis)
    assert "no parameter of the twin's scene is called `gpa`" in run("check", "r.cousins.yaml").err
    (tmp_path / "r.cousins.yaml").write_text(recipe + axis)
    done = run("cousins", "r.cousins.yaml", "-n", "1", "-o", "out", "--json")
    assert done.code == 0 and json.loads(done.out)["accepted"] == 1, done.err
    cousin = load(tmp_path / "out" / "000001.scene.yaml").spec
    assert isinstance(cousin, SceneSpec)
    assert cousin.objects["cup_1_2"].place is None and cousin.objects["cup_2_1"].place is not None
    assert cousin.objects["cup_2_1"].place.xy == (0.2, 0.1)


@pytest.mark.slow  # 2 s
def test_a_pose_of_a_cousin_leaves_the_frame_of_its_twin(scene: Path, tmp_path: Path) -> None:
    framed = "frames: {mid: {xyz: [0.1, 0.1, 0], yaw_deg: 45}}\nobjects:\n"
    body = SCENE.replace("place: {on: desk, xy: [-0.3, 0]}", "pose: {frame: mid, xyz: [0, 0, 0.02]}")
    scene.write_text(body.replace("objects:\n", framed))
    (tmp_path / "r.cousins.yaml").write_text(
        "simfoundry: cousins/1\nname: r\ntwin: cups.scene.yaml\nscene: {anchor: desk, objects: {bowl: [OnTop]}}\n"
    )
    assert run("cousins", "r.cousins.yaml", "-n", "1", "-o", "out", "--json").code == 0
    assert "frame: null" in (tmp_path / "out" / "000001.scene.yaml").read_text()
    cousin = load(tmp_path / "out" / "000001.scene.yaml").spec
    assert isinstance(cousin, SceneSpec) and cousin.objects["bowl"].pose.frame is None


def test_what_moves_in_a_stage_leaves_its_frame(scene: Path, tmp_path: Path) -> None:
    from pxr import Gf, Usd, UsdGeom

    framed = "frames: {mid: {xyz: [0.1, 0.1, 0], yaw_deg: 45}}\nobjects:\n"
    body = SCENE.replace("place: {on: desk, xy: [-0.3, 0]}", "pose: {frame: mid, xyz: [0, 0, 0.02]}")
    scene.write_text(body.replace("objects:\n", framed) + "lights: {lamp: {type: point, frame: mid, xyz: [0, 0, 1]}}\n")
    sf.load(scene).compile("usd", out=tmp_path / "b")
    assert "no changes" in run("import", "b/usd/scene.usda", "-o", "cups.scene.yaml").out
    stage = Usd.Stage.Open(str(tmp_path / "b" / "usd" / "scene.usda"))
    for path in ("/World/Objects/bowl", "/World/Lights/lamp"):
        move = UsdGeom.Xformable(stage.GetPrimAtPath(path)).GetOrderedXformOps()[0]
        move.Set(move.Get() + Gf.Vec3d(0.05, 0, 0))
    stage.Save()
    before = load(scene).spec
    assert run("import", "b/usd/scene.usda", "-o", "cups.scene.yaml").code == 0
    after = load(scene).spec
    assert isinstance(before, SceneSpec) and isinstance(after, SceneSpec)
    assert after.objects["bowl"].pose.frame is None and after.objects["bowl"].pose.xyz == (0.15, 0.1, 0.02)
    assert after.objects["bowl"].pose.yaw_deg == 45
    assert after.lights["lamp"].frame is None and after.lights["lamp"].xyz == (0.15, 0.1, 1)
    sides = text(describe(to_data(before), to_data(after), SceneSpec))
    assert sides[0] == "bowl is now at (0.15, 0.1, 0.02) m (was at (0, 0, 0.02) m in the frame mid)"


def test_a_renamed_object_is_renamed_in_repeats(scene: Path) -> None:
    document = sf.load(scene)
    assert isinstance(document, sf.SceneDocument)
    document.objects.rename("desk", "bench")
    document.objects.rename("bench", "table")
    document.save()
    text = scene.read_text()
    assert "desk" not in text and "cup_1" not in text and "place: {on: table, xy: [0, 0.1]}" in text
