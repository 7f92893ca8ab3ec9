"""MJCF in and out: counts, motion and settings come back; edits take effect; other formats say what they lose."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from simfoundry.backends import compile_scene
from simfoundry.backends.names import InvalidSceneError
from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.importer import import_file
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.load import load
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.corpora.mjcf_scenes import apart, counts, trajectory
from tests.targets.everything import write_everything

HOPPER = """<mujoco model="hopper">
  <option timestep="0.004" integrator="RK4" iterations="50"><flag energy="enable"/></option>
  <default><joint damping="0.1" armature="0.01"/><geom condim="1" solref="0.01 1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" condim="3"/>
    <site name="goal" pos="1 0 0"/>
    <body name="Torso" pos="0 0 1.25">
      <joint name="slide x" type="slide" axis="1 0 0"/>
      <joint name="slide_z" type="slide" axis="0 0 1" ref="1.25"/>
      <joint name="turn" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0.2 0 0 -0.2" size="0.05"/>
      <site name="imu" pos="0 0 0.1" size="0.02"/>
      <body name="leg" pos="0 0 -0.2">
        <joint name="knee" axis="0 -1 0" pos="0 0 0.01" range="-150 0" stiffness="3" springref="-20"/>
        <geom type="ellipsoid" size="0.04 0.05 0.3" pos="0 0 -0.3" friction="0.9 0.1 0.1"/>
        <body name="mark" pos="0 0 -0.6"><site name="sole"/></body>
      </body>
      <body name="tail" pos="-0.05 0 0.1">
        <joint name="tail" axis="0 1 0" range="-60 60"/>
        <geom type="box" size="0.1 0.02 0.02" pos="-0.1 0 0" contype="0" conaffinity="2"/>
      </body>
    </body>
    <body name="ball" pos="0.5 0 0.3"><joint type="free" damping="0.2"/><geom size="0.1" mass="0.3"/></body>
    <body name="hand" mocap="true" pos="0 1 1"><geom size="0.02" contype="0" conaffinity="0"/></body>
  </worldbody>
  <contact><exclude body1="leg" body2="ball"/></contact>
  <tendon>
    <fixed name="pull"><joint joint="knee" coef="0.5"/><joint joint="tail" coef="-1"/></fixed>
    <spatial name="rope" stiffness="4" limited="true" range="0 2"><site site="imu"/><site site="goal"/></spatial>
  </tendon>
  <equality><joint joint1="tail" joint2="knee" polycoef="0.1 0.2 0.3 0 0" active="false"/>
    <weld body1="hand" body2="Torso" solref="0.1 1" active="false"/></equality>
  <actuator>
    <motor name="hop" joint="knee" gear="40" ctrlrange="-1 1"/>
    <muscle name="string" tendon="pull" ctrlrange="0 1" lengthrange="-3 3"/>
    <position name="wag" joint="tail" kp="8" kv="0.3" ctrlrange="-1 1" forcerange="-4 4"/>
  </actuator>
  <sensor><gyro name="spin" site="imu" noise="0.01"/><jointpos joint="knee"/><tendonpos tendon="pull"/>
    <framepos objtype="site" objname="sole" reftype="body" refname="leg"/><subtreecom body="Torso"/></sensor>
  <keyframe><key qpos="0 1.2 0.1 -0.3 0.1 0.5 0 0.3 1 0 0 0" qvel="0 0 0 1 0 0 0 0 0 0 0" ctrl="0.1 0.2 0.3"/>
    <key name="Other" qpos="0 1.3 0 0 0 0.5 0 0.3 1 0 0 0"/></keyframe>
</mujoco>"""


@pytest.fixture
def imported(tmp_path: Path) -> tuple[Path, Scene]:
    """The document of the model and its scene."""
    (tmp_path / "hopper.xml").write_text(HOPPER)
    document = tmp_path / "hopper.scene.yaml"
    import_file(tmp_path / "hopper.xml", document, ImportOptions())
    return document, lower_file(document)


def compiled(scene: Scene, folder: Path) -> mujoco.MjModel:
    """The model of a scene's build."""
    compile_scene(scene, "mjcf").write(folder / "build")
    return mujoco.MjModel.from_xml_path(str(folder / "build" / "scene.xml"))


def test_counts_and_motion_come_back(imported: tuple[Path, Scene], tmp_path: Path) -> None:
    original, model = mujoco.MjModel.from_xml_string(HOPPER), compiled(imported[1], tmp_path)
    assert counts(model) == counts(original) == [7, 6, 3, 5, 3, 2, 2]
    assert (model.nkey, model.nmocap, model.ngeom) == (2, 1, original.ngeom)
    position, angle = apart(trajectory(original, 0.0), trajectory(model, 0.0))
    assert position < 1e-6 and angle < 1e-4
    for name in ("timestep", "integrator", "iterations", "enableflags"):
        assert getattr(model.opt, name) == getattr(original.opt, name)
    for name in ("geom_type", "geom_condim", "geom_solref", "geom_contype", "jnt_stiffness", "qpos_spring", "qpos0"):
        assert np.allclose(getattr(model, name), getattr(original, name), atol=1e-12), name
    assert model.key_qvel[0].tolist() == original.key_qvel[0].tolist()
    assert [model.actuator(k).name for k in range(3)] == ["torso.hop", "string", "torso.wag"]
    assert model.sensor_type.tolist() == original.sensor_type.tolist()


def test_what_the_language_has_is_in_its_words(imported: tuple[Path, Scene]) -> None:
    torso = imported[1].object("torso")
    actuators = [(a.name, a.type, a.joint) for a in torso.actuators]
    assert actuators == [("hop", "motor", "knee"), ("wag", "position", "tail")]
    assert [s.type for s in torso.sensors] == ["gyro", "joint_position"]
    assert [(s.name, s.link) for s in torso.sites] == [("imu", "torso"), ("sole", "mark")]
    tail = next(j for j in torso.joints if j.name == "tail")
    assert tail.drive is not None and (tail.drive.stiffness, tail.drive.force_limit) == (8.0, 4.0)
    assert imported[1].options.timestep == 0.004


def test_edits_of_the_document_take_effect(imported: tuple[Path, Scene], tmp_path: Path) -> None:
    document, _ = imported
    asset = document.parent / "hopper_files" / "torso.asset.yaml"
    text = asset.read_text()
    assert "gear: 40" in text and "limits_deg: [-150, 0]" in text
    asset.write_text(text.replace("gear: 40", "gear: 20").replace("limits_deg: [-150, 0]", "limits_deg: [-90, 0]"))
    document.write_text(document.read_text().replace("timestep: 0.004", "timestep: 0.002"))
    model = compiled(lower_file(document), tmp_path)
    assert model.actuator("torso.hop").gear[0] == 20
    assert model.joint("torso.knee").range[0] == pytest.approx(np.radians(-90))
    assert model.opt.timestep == 0.002


TURNED = """<mujoco><worldbody><body pos="0.1 0 0.3" euler="20 -30 77"><freejoint/>
  <geom type="box" size="0.03 0.05 0.0333333333333333" euler="11 22 33" pos="0.01 0.02 0.123456789012345"/>
  <geom type="sphere" size="0.02"/>
  <body pos="0 0 0.1" euler="5 6 7">
    <joint name="hinge" axis="1 2 3" pos="0.01 0.02 0.123456789012345" range="-33.3333 77.7777"
      damping="0.123456789012345678"/>
    <geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.02"/><site euler="1 2 3"/>
  </body></body></worldbody>
  <actuator><motor joint="hinge"/></actuator></mujoco>"""


def test_values_come_back_to_the_last_bit(tmp_path: Path) -> None:
    (tmp_path / "turned.xml").write_text(TURNED)
    document = tmp_path / "turned.scene.yaml"
    import_file(tmp_path / "turned.xml", document, ImportOptions())
    original, model = mujoco.MjModel.from_xml_string(TURNED), compiled(lower_file(document), tmp_path)
    for name in (
        *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "geom_pos", "geom_quat"),
        *("geom_size", "site_quat", "jnt_pos", "jnt_axis", "jnt_range", "dof_damping", "dof_M0"),
    ):
        assert np.array_equal(getattr(model, name), getattr(original, name)), name
    (asset,) = (tmp_path / "turned_files").glob("*.asset.yaml")
    asset.write_text(re.sub(r"(?<=mass: )[0-9.e-]+", "2", asset.read_text(), count=1))
    mass = compiled(lower_file(document), tmp_path / "edited").body_mass
    assert 2.0 in mass.tolist() and not np.array_equal(mass, original.body_mass)


@pytest.mark.parametrize(
    "value", ["{pos: [x, y, z]}", "{pos: [0.1]}", "{quat: 3}", "{inertial: {mass: 2}}", "{axis: []}"]
)
def test_exact_values_that_disagree_are_not_written(value: str, tmp_path: Path) -> None:
    (tmp_path / "a.asset.yaml").write_text(
        "simfoundry: asset/1\nname: a\nlinks:\n  base:\n    mass: 1\n    parts: {ball: {shape: {sphere: 0.1}}}\n"
        f"    native: {{mjcf: {{exact: {value}}}}}\n"
    )
    document = tmp_path / "s.scene.yaml"
    document.write_text(
        "simfoundry: scene/1\nname: s\nobjects:\n  a: {asset: a.asset.yaml, pose: {xyz: [0, 0, 1]}}\n"
        "native: {mjcf: {option: {cone: elliptic}}}\n"
    )
    model = compiled(lower_file(document), tmp_path)
    assert (model.body_pos[1].tolist(), model.body_mass[1]) == ([0, 0, 1], 1)


def test_native_data_without_effect_is_reported(imported: tuple[Path, Scene], tmp_path: Path) -> None:
    (loss,) = [k for k in compile_scene(replace(imported[1], native=None), "mjcf").losses if k.feature == "native"]
    assert "parts take effect only in a scene with `native: {mjcf: …}` of its own" in loss.reason
    pull = '<tendon><fixed name="pull"><joint joint="hinge" coef="1"/></fixed></tendon>'
    (tmp_path / "turned.xml").write_text(TURNED.replace("<actuator>", f"{pull}<actuator>"))
    report = import_file(tmp_path / "turned.xml", tmp_path / "turned.asset.yaml", ImportOptions())
    (note,) = [note for note in report.notes if note.what == "native data of the scene"]
    assert (note.kind, note.detail) == ("dropped", "1 tendon")


def test_attachments_of_compiled_scenes_are_restored(tmp_path: Path) -> None:
    scene = replace(lower_file(write_everything(tmp_path, "attachments")), native=None)
    compile_scene(scene, "mjcf").write(tmp_path / "build")
    report = import_file(tmp_path / "build" / "scene.xml", tmp_path / "again.scene.yaml", ImportOptions())
    assert not [note for note in report.notes if note.kind == "dropped"]
    old, new = scene.object("cabinet"), lower_file(tmp_path / "again.scene.yaml").object("cabinet")
    assert [(s.name, s.link) for s in new.sites] == [(s.name, s.link) for s in old.sites]
    assert list(map(vars, new.actuators)) == list(map(vars, old.actuators))
    assert [(s.name, s.type, s.target, s.noise) for s in new.sensors] == [
        (s.name, s.type, s.target, s.noise) for s in old.sensors
    ]


def test_other_formats_say_what_they_lose(imported: tuple[Path, Scene]) -> None:
    for target in ("urdf", "usd", "pybullet"):
        losses = {loss.feature: loss for loss in compile_scene(imported[1], target).losses}
        assert {"sites", "sensors", "actuators", "native"} <= losses.keys()
        assert "2 tendons" in losses["native"].reason and losses["native"].path == "native.mjcf"
    assert not any(loss.feature == "native" for loss in compile_scene(imported[1], "mjcf").losses)


def test_a_reference_to_nothing_is_named(imported: tuple[Path, Scene]) -> None:
    document, _ = imported
    document.write_text(document.read_text().replace("joint: torso.knee", "joint: torso.neck"))
    with pytest.raises(InvalidSceneError, match=r"`pull` of `native.mjcf.tendon` refers to the joint `torso.neck`"):
        compile_scene(lower_file(document), "mjcf")


def test_worlds_keep_every_body_of_the_scene(imported: tuple[Path, Scene]) -> None:
    world = MujocoWorld(imported[1])
    world.step(5)
    assert set(world.state().poses) == {o.name for o in imported[1].objects}


@pytest.mark.parametrize(
    ("native", "words"),
    [
        ("{mesh: {file: /etc/passwd}}", "no section `mesh`"),
        ("{tendon: [{fixed: {name: t, class: x}}]}", "`class` is not an attribute of `fixed`"),
        ("{actuator: [{plugin: {plugin: x}}]}", "no element `plugin`"),
        ("{tendon: [{fixed: {path: [{file: {file: a}}]}}]}", "must be one of `joint`"),
        ("{option: {timestep: 1}}", "`timestep` is not an attribute of `option`"),
        ('{option: {cone: "a\\nb"}}', "must be a finite number"),
        ("{sensor: 3}", "must be a list of elements"),
    ],
)
def test_native_data_is_checked(native: str, words: str, tmp_path: Path) -> None:
    document = tmp_path / "a.scene.yaml"
    document.write_text(f"simfoundry: scene/1\nname: a\nnative:\n  mjcf: {native}\n")
    (error,) = load(document).errors
    assert words in error.message and error.line == 4


@pytest.mark.parametrize("suffix", ["stl", "obj"])
def test_meshes_come_back_to_the_last_bit(suffix: str, tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (60, 3)) + (0.3, 0.2, 0.1)
    trimesh.convex.convex_hull(points).export(tmp_path / f"stone.{suffix}")
    text = f"""<mujoco><asset><mesh name="stone" file="stone.{suffix}"/></asset><worldbody>
      <body><freejoint/><geom type="mesh" mesh="stone"/></body></worldbody></mujoco>"""
    (tmp_path / "stone.xml").write_text(text)
    document = tmp_path / "again.scene.yaml"
    import_file(tmp_path / "stone.xml", document, ImportOptions())
    original = mujoco.MjModel.from_xml_path(str(tmp_path / "stone.xml"))
    model = compiled(lower_file(document), tmp_path)
    for name in ("mesh_vert", "mesh_face", "mesh_pos", "mesh_quat", "geom_pos", "geom_quat", "body_inertia"):
        assert np.array_equal(getattr(model, name), getattr(original, name)), name


def test_textured_primitives_stay_primitives(tmp_path: Path) -> None:
    text = """<mujoco><asset><texture name="t" type="2d" builtin="checker" width="8" height="8" rgb1="1 0 0"/>
      <material name="m" texture="t"/></asset><worldbody><geom type="plane" size="0 0 1" material="m"/>
      <body pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1" material="m"/></body></worldbody></mujoco>"""
    (tmp_path / "tiles.xml").write_text(text)
    document = tmp_path / "again.scene.yaml"
    import_file(tmp_path / "tiles.xml", document, ImportOptions())
    original, model = mujoco.MjModel.from_xml_string(text), compiled(lower_file(document), tmp_path)
    for name in ("geom_type", "geom_pos", "geom_size"):
        assert np.array_equal(getattr(model, name), getattr(original, name)), name
