"""Scene to MJCF or URDF and back is the same scene, but for what the loss report says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.light_links import with_light_links
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import import_file
from simfoundry.frontends.usd.reader import read_usd
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import JointType, Scene, SceneObject
from tests.corpora.roundtrip import MAINS, trip_by_scene
from tests.mechanisms import mechanisms
from tests.scenes_apart import apart
from tests.specs.documents import SPECS
from tests.targets.everything import LIGHTS, write_everything


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The scene that says all there is, its loose lid and nodding head moved."""
    path = write_everything(tmp_path_factory.mktemp("everything"), *LIGHTS, "background_mesh")
    text = path.read_text().replace(
        "hinge: 0.3}", "hinge: 0.3, nod: {rpy_deg: [10, 20, 30]}, loose: {xyz: [0, 0.3, 0.1]}}"
    )
    path.write_text(text)
    return lower_file(path)


def test_mjcf_gives_everything_back_but_the_other_variants(everything: Scene, tmp_path: Path) -> None:
    said, unsaid = trip_by_scene(everything, "mjcf", tmp_path)
    assert not unsaid
    assert [d.path for d in said] == ["cup.variants"]


def test_a_motor_that_only_damps_comes_back_from_mjcf(tmp_path: Path) -> None:
    compile_scene(mechanisms(), "mjcf").write(tmp_path / "build")
    report = import_file(tmp_path / "build/scene.xml", tmp_path / "back.scene.yaml")
    assert not [note for note in report.notes if "actuator" in note.what]
    hinge = next(j for j in lower_file(tmp_path / "back.scene.yaml").object("pot").joints if j.name == "hinge")
    assert hinge.drive is not None and (hinge.drive.stiffness, hinge.drive.damping) == (0.0, 0.05)


def test_urdf_gives_everything_back_that_it_can_hold(everything: Scene, tmp_path: Path) -> None:
    said, unsaid = trip_by_scene(with_light_links(everything), "urdf", tmp_path)  # as URDF has to write it
    assert not unsaid
    dropped = {"armature", "background_mesh", "ball", "cameras", "drive", "friction", "no_contact", "relations"}
    dropped |= {"restitution", "rolling_friction", "torsional_friction", "variants", "distant_lights"}
    assert {d.feature for d in said} <= dropped


def test_a_stage_says_at_which_limit_a_joint_is_closed(everything: Scene, tmp_path: Path) -> None:
    compile_scene(everything, "usd").write(tmp_path)
    joints = [joint for body in read_usd(tmp_path / "scene.usda").bodies for joint in body.joints]
    assert {joint.name: joint.closed for joint in joints if joint.closed} == {"hinge": "upper"}


@pytest.mark.parametrize("name", ["pot_on_stove", "serve_fruits"])
@pytest.mark.parametrize("target", sorted(MAINS))
def test_scenes_of_specs_come_back(name: str, target: str, tmp_path: Path) -> None:
    _, unsaid = trip_by_scene(lower_file(SPECS / "scenes" / f"{name}.scene.yaml"), target, tmp_path)
    assert not unsaid


def changed(scene: Scene, item: SceneObject) -> Scene:
    return dataclasses.replace(scene, objects=tuple(item if o.name == item.name else o for o in scene.objects))


def test_the_comparison_sees_each_kind_of_change(everything: Scene) -> None:
    assert apart(everything, everything) == []
    cup, cabinet = everything.object("cup"), everything.object("cabinet")
    heavy = dataclasses.replace(cup.root, mass=cup.root.mass * 1.00001)
    slick = dataclasses.replace(cup.root.colliders[0], friction=0.30001)
    moved = cup.X_WO @ Pose.of([0, 0, 2e-6])
    joint = next(j for j in cabinet.joints if j.type is JointType.PRISMATIC and j.limits is not None)
    assert joint.limits is not None
    longer = dataclasses.replace(joint, limits=(joint.limits[0], joint.limits[1] + 1e-5))
    joints = tuple(longer if j.name == joint.name else j for j in cabinet.joints)
    ajar = tuple(dataclasses.replace(j, closed="lower" if j.closed else None) for j in cabinet.joints)
    for item, feature in (
        (dataclasses.replace(cup, links=(heavy,)), "mass"),
        (dataclasses.replace(cup, links=(dataclasses.replace(cup.root, colliders=(slick,)),)), "friction"),
        (dataclasses.replace(cup, X_WO=moved), "pose"),
        (dataclasses.replace(cabinet, joints=joints), "joint_limits"),
        (dataclasses.replace(cabinet, joints=ajar), "joint_closed"),
        (dataclasses.replace(cup, labels=("mug",)), "labels"),
    ):
        assert [d.feature for d in apart(everything, changed(everything, item))] == [feature]
    fallen = dataclasses.replace(everything, gravity=frozen_array(np.array([0, 0, -9.8])))
    assert [d.feature for d in apart(everything, fallen)] == ["gravity"]


def test_an_edited_mjcf_says_what_was_edited(everything: Scene, tmp_path: Path) -> None:
    compile_scene(everything, "mjcf").write(tmp_path / "build")
    file = tmp_path / "build" / "scene.xml"
    text = file.read_text()
    assert text.count('mass="0.05"') == 1
    file.write_text(text.replace('mass="0.05"', 'mass="0.06"'))
    import_file(file, tmp_path / "everything.scene.yaml")
    found = [d for d in apart(everything, lower_file(tmp_path / "everything.scene.yaml")) if d.feature != "variants"]
    assert [d.path for d in found] == ["ball.base.mass"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"cup": {"urdf": "../cup.urdf", "fixed": true}}', "`cup` refers to the file"),
        ('{"cup": {"urdf": "cup.urdf", "fixed": true}}', "`cup` has invalid data for a compiled file"),
    ],
)
def test_poses_that_name_no_urdf_are_refused(text: str, reason: str, tmp_path: Path) -> None:
    folder = tmp_path / "urdf"
    folder.mkdir()
    (folder / "cup.urdf").write_text('<robot name="cup"><link name="base"/></robot>')
    (folder / "poses.json").write_text(text)
    with pytest.raises(ImportRefusedError, match=reason):
        import_file(folder / "poses.json", tmp_path / "a.scene.yaml")
