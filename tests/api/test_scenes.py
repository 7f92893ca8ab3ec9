"""``import simfoundry as sf``: edit in place, save, compile, open, judge."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import simfoundry as sf
from simfoundry.api import scenes, tasks
from simfoundry.api.document import EditableDocument
from simfoundry.api.entries import DocumentEntry, EntryField, ValueField
from simfoundry.backends.mjcf import naming_scene
from simfoundry.backends.names import InvalidSceneError

TEXT = """\
simfoundry: scene/1   # the first line
name: desk

materials:
  wood:    {density: 700,  friction: 0.5}   # aligned by hand
  ceramic: {density: 2400, friction: 0.35}

objects:
  # where all stands
  desk:
    fixed: true
    shape: {box: [1.4, 0.7, 0.04]}      # full extents, m
    material: wood
    pose: {xyz: [0.45, 0, -0.02]}

  mug:                                  # the one with a chip
    shape: {cylinder: {radius: 0.04, height: 0.095}}
    material: ceramic
    mass: {value: 0.31, range: [0.2, 0.45], source: table}   # weigh it
    pose: {xyz: [0.42,0.12,0.0475], yaw_deg: 30}

relations: [OnTop(mug, desk)]
# that is all
"""

SCRIPT = """\
import simfoundry as sf

scene = sf.load("desk.scene.yaml")
scene.objects["mug"].mass = 0.3
scene.objects["mug"].pose.xyz = (0.4, 0.1, 0.0475)
scene.save()
build = scene.compile("mujoco", "usd", out="build")
with scene.open("mujoco") as world:
    world.step(200)
    print(build.entries["mujoco"], world.judge("OnTop(mug, desk)").value)
"""


@pytest.fixture
def scene(tmp_path: Path) -> sf.SceneDocument:
    (tmp_path / "desk.scene.yaml").write_text(TEXT)
    return sf.load(str(tmp_path / "desk.scene.yaml"))


def test_ten_lines_load_edit_save_compile_step_and_judge(tmp_path: Path) -> None:
    (tmp_path / "desk.scene.yaml").write_text(TEXT)
    assert len(SCRIPT.splitlines()) <= 10
    run = subprocess.run([sys.executable, "-c", SCRIPT], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["build/mujoco/scene.xml", "True"]
    edited = TEXT.replace("{value: 0.31, range: [0.2, 0.45], source: table}", "0.3")
    assert (tmp_path / "desk.scene.yaml").read_text() == edited.replace("[0.42,0.12,0.0475]", "[0.4, 0.1, 0.0475]")


@pytest.mark.slow  # 7 s: mypy
def test_the_script_passes_strict_types(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT + "model = scene.to_mujoco()\nscene.relations.append('Open(mug)')\n")
    (tmp_path / "wrong.py").write_text("import simfoundry as sf\nsf.load('a').objects['mug'].mas = 1\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", ".mypy_cache/scripts"]
    right, wrong = (
        subprocess.run([*command, str(tmp_path / name)], capture_output=True, text=True)
        for name in ("script.py", "wrong.py")
    )
    assert right.returncode == 0, right.stdout
    assert '"ObjectEntry" has no attribute "mas"' in wrong.stdout


def test_values_read_as_their_model_has_them(scene: sf.SceneDocument) -> None:
    mug = scene.objects["mug"]
    assert mug.pose.xyz == (0.42, 0.12, 0.0475) and mug.pose.yaw_deg == 30 and mug.pose.rpy_deg is None
    assert mug.friction is None and not mug.fixed and scene.gravity == (0.0, 0.0, -9.81)
    assert scene.materials["wood"].restitution == 0.0
    assert list(scene.objects) == ["desk", "mug"] and list(scene.relations) == ["OnTop(mug, desk)"]


def test_every_field_of_the_models_can_be_edited() -> None:
    kinds = [k for m in (scenes, tasks) for k in vars(m).values() if isinstance(k, type)]
    for kind in (k for k in kinds if issubclass(k, DocumentEntry) and k not in (DocumentEntry, EditableDocument)):
        fields = {name for name, value in vars(kind).items() if isinstance(value, ValueField | EntryField | property)}
        left_out = {"simfoundry", "extends", "conflicts"} if issubclass(kind, EditableDocument) else set()
        assert fields == kind._model.model_fields.keys() - left_out, kind


def test_objects_come_go_and_change_their_names(scene: sf.SceneDocument) -> None:
    cup = scene.objects.add("cup", shape={"box": [0.06, 0.06, 0.1]}, mass=0.2, place={"on": "desk"})
    cup.update(place=None, pose={"xyz": np.array([0.1, 0.2, 0.05])})
    scene.relations.append("OnTop(cup, desk)")
    scene.objects.rename("mug", "jug")
    del scene.objects["cup"]
    scene.relations = [text for text in scene.relations if "cup" not in text]
    assert scene.text == TEXT.replace("  mug: ", "  jug: ").replace("OnTop(mug,", "OnTop(jug,")


@pytest.mark.parametrize(
    ("edit", "kind", "said"),
    [
        (lambda s: s.objects["mugg"], sf.UnknownNameError, "has no object `mugg`; did you mean `mug`?"),
        (lambda s: setattr(s.objects["mug"], "mas", 1), AttributeError, "no field `mas`; did you mean `mass`?"),
        (
            lambda s: setattr(s.objects["mug"], "mass", -1),
            sf.SpecError,
            "19:11: SF104 expected a number greater than 0",
        ),
        (lambda s: s.objects.add("cup", shape={"bux": [1]}), sf.SpecError, "unknown key `bux`"),
        (lambda s: s.objects.add("mug", mass=1), sf.SimfoundryError, "an object named `mug` already exists"),
        (lambda s: s.open("unity"), sf.SimfoundryError, "scenes cannot be run in `unity`; available simulators: "),
        (lambda s: s.judge("OnTop(mog, desk)"), sf.SimfoundryError, "there is no `mog` in this scene"),
        (
            lambda s: s.judge("OnTpo(mug, desk)"),
            sf.SimfoundryError,
            "`OnTpo` is not a predicate; did you mean `OnTop`?",
        ),
        (lambda s: s.judge("Foo(mug)"), sf.SimfoundryError, "`Foo` is not a predicate; valid: `Above`, `At`"),
        (lambda s: s.open().judge("Foo(mug)"), sf.SimfoundryError, "`Foo` is not a predicate; valid: `Above`"),
        (lambda s: s.judge("At(mug, 1e400, 0)"), sf.SimfoundryError, "`1e400` is out of range"),
        (lambda s: s.judge({"foo": 1}), sf.SimfoundryError, "one of the keys `all`, `any` and `not`"),
        (lambda s: s.judge({"all": ["Upright(mug)"], "any": []}), sf.SimfoundryError, "one of the keys `all`"),
        (lambda s: s.judge(5), sf.SimfoundryError, "`5` is not a condition; write a predicate, such as `OnTop("),
        (lambda s: s.judge({"all": []}), sf.SimfoundryError, "`all` without conditions is invalid"),
        (lambda s: s.compile("mujocoo", out="x"), sf.SimfoundryError, "did you mean `mujoco`?"),
        (lambda s: sf.load("gone.scene.yaml"), sf.SpecError, "No such file"),
        (lambda s: getattr(sf, "nothing"), AttributeError, "it has"),  # noqa: B009
    ],
)
def test_errors_name_what_there_is(scene: sf.SceneDocument, edit: object, kind: type[Exception], said: str) -> None:
    assert callable(edit)
    with pytest.raises(kind) as caught:
        edit(scene)
    assert said in str(caught.value)
    assert scene.text == TEXT


def test_an_edit_that_leaves_an_error_is_not_saved(scene: sf.SceneDocument) -> None:
    scene.objects["mug"].update(mass=0.2, density=500.0)
    with pytest.raises(sf.SpecError, match="mass"):
        scene.save()
    assert scene.path.read_text() == TEXT
    assert any(d.code == "SF107" for d in scene.check())
    del scene.objects["mug"].mass
    assert not [d for d in scene.check() if d.severity == "error"]


def test_models_are_made_in_memory(scene: sf.SceneDocument, tmp_path: Path) -> None:
    scene.objects["mug"].mass = 0.25
    model = scene.to_mujoco()
    assert model.body("mug").mass == pytest.approx(0.25)
    spec = scene.to_mujoco_spec()
    assert isinstance(spec, mujoco.MjSpec) and spec.body("mug") is not None
    stage = scene.to_usd()
    assert [p.GetPath().pathString for p in stage.Traverse() if p.GetName() == "mug"]
    assert sorted(tmp_path.iterdir()) == [tmp_path / "desk.scene.yaml"]


def test_a_scene_that_mujoco_refuses_is_named_with_its_reason() -> None:
    with pytest.raises(InvalidSceneError, match=r"^MuJoCo cannot load scene `desk`: .*size"), naming_scene("desk"):
        mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='-1'/></worldbody></mujoco>")


def test_mujoco_takes_a_body_that_is_almost_a_plane(scene: sf.SceneDocument) -> None:
    """Its moments of inertia are rounded, and the largest may not exceed the sum of the others."""
    scene.objects["mug"].update(mass=1, shape={"box": [1e-9, 1, 1]})
    assert scene.to_mujoco().nbody > 1


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_world_judges_its_state(scene: sf.SceneDocument, engine: str) -> None:
    if engine == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    with scene.open(engine) as world:
        world.step(50)
        assert world.judge("OnTop(mug, desk)") == scene.judge("OnTop(mug, desk)", world.state())
    assert scene.judge().value


def test_an_overlay_is_edited_where_it_differs(tmp_path: Path) -> None:
    (tmp_path / "desk.scene.yaml").write_text(TEXT)
    text = "simfoundry: scene/1\nextends: desk.scene.yaml\nname: heavier   # a cousin\n"
    (tmp_path / "b.scene.yaml").write_text(text)
    other = sf.load(tmp_path / "b.scene.yaml")
    other.objects["mug"].mass = 0.6
    other.save()
    assert other.path.read_text() == text + "\nobjects:\n  mug:\n    mass: 0.6\n"
    assert sf.load(other.path).objects["mug"].mass == 0.6


def test_files_of_other_formats_load_and_are_saved_as_documents(scene: sf.SceneDocument, tmp_path: Path) -> None:
    build = scene.compile("mujoco", "usd", out=tmp_path / "build")
    imported = sf.load(build.entries["mujoco"])
    assert "mug" in imported.objects
    with pytest.raises(sf.SimfoundryError, match="imported from"):
        imported.save()
    again = sf.load(imported.save(tmp_path / "again.scene.yaml"))
    assert again.to_mujoco().body("mug").mass == pytest.approx(0.31)
    stage = sf.load(build.entries["usd"])
    assert stage.objects["mug"].pose.xyz == pytest.approx((0.42, 0.12, 0.0475))


def test_tasks_load_and_are_edited() -> None:
    task = sf.load_task("specs/tasks/cup_in_bowl.task.yaml")
    task.horizon = 77
    assert "horizon" in task.text and task.load_scene().objects
    assert all("horizon" in line for line in task.changes)


def test_importing_is_light() -> None:
    code = "import simfoundry, sys; simfoundry.SceneDocument; print(sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for heavy in ("mujoco", "pxr", "trimesh", "scipy", "pybullet", "numpy", "click"):
        assert f"'{heavy}'" not in loaded, heavy


def test_python_m_simfoundry_is_the_command_line() -> None:
    run = subprocess.run([sys.executable, "-m", "simfoundry", "--version"], capture_output=True, text=True)
    assert run.returncode == 0 and sf.__version__ in run.stdout
