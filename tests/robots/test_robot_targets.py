"""Robots in USD, URDF and PyBullet's files: native where there is a model, else converted."""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

from simfoundry.backends import compile_scene
from simfoundry.backends.robot_models.mujoco_robot import read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.geometry.frames import Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import ModelFormat, Robot

HAND_USD = """\
simfoundry: scene/1
name: hand
robots:
  hand:
    model: {usd: robot/Robotiq_2F85_newton.usda}
    pose: {xyz: [0.1, 0.2, 0.3], rpy_deg: [10, 20, 30]}
    joints: {finger_joint: 0.4}
cameras:
  palm: {size: [64, 48], fx: 50, fy: 50, pose: {xyz: [0.07, 0, 0.02], look_at: [0, 0, 0.2]}, mount: hand.base}
"""


def written(scene: Scene, target: str, folder: Path) -> Path:
    """The target's files, moved after they were written."""
    compile_scene(scene, target).write(folder / "built")
    return Path(shutil.move(folder / "built", folder / "moved"))


@pytest.mark.parametrize("name", ["lift", "yam", "panda_lift", "demo_lift"])
def test_a_converted_robot_moves_like_its_model(request: pytest.FixtureRequest, name: str) -> None:
    scene: Scene = request.getfixturevalue(name)
    for robot in scene.robots:
        for native in robot.models.values():
            read = read_robot(robot, native, f"{robot.name}.")
            made, data = as_object(robot, read), mujoco.MjData(read.model)
            rng = np.random.default_rng(7)
            for _ in range(5):
                data.qpos[:] = rng.uniform(-1, 1, read.model.nq)
                mujoco.mj_kinematics(read.model, data)
                positions = {made.joints[n]: float(data.joint(f"{robot.name}.{n}").qpos[0]) for n in made.joints}
                poses = link_poses(made.item, positions)
                for link, plain in made.links.items():
                    body = data.body(f"{robot.name}.{link}")
                    expected = robot.X_WB @ Pose.of(body.xpos, body.xquat)
                    found = made.item.X_WO @ poses[plain]
                    assert found.p == pytest.approx(expected.p, abs=1e-9), (native.file.name, link)
                    assert found.angle_to(expected) < 1e-7
            total = sum(link.mass for link in made.item.links)
            assert total == pytest.approx(float(read.model.body_mass.sum()), rel=1e-4)


@pytest.mark.parametrize("name", ["lift", "yam", "demo_lift"])
def test_a_stage_holds_a_converted_robot(request: pytest.FixtureRequest, tmp_path: Path, name: str) -> None:
    scene: Scene = request.getfixturevalue(name)
    stage = Usd.Stage.Open(str(written(scene, "usd", tmp_path) / "scene.usda"))
    assert _validated(stage) == []
    for robot in scene.robots:
        native = robot.models[ModelFormat.MJCF]
        made = as_object(robot, read_robot(robot, native, f"{robot.name}."))
        prim = stage.GetPrimAtPath(f"/World/Robots/{robot.name}")
        _same_place(_pose(prim), robot.X_WB)
        X_OL = link_poses(made.item)
        for link in made.item.links:
            _same_place(_pose(stage.GetPrimAtPath(f"{prim.GetPath()}/{link.name}")), made.item.X_WO @ X_OL[link.name])
        for joint, position in robot.positions.items():
            found = stage.GetPrimAtPath(f"{prim.GetPath()}/Joints/{made.joints[native.joints[joint]]}")
            assert found.IsA(UsdPhysics.RevoluteJoint)
            drive = UsdPhysics.DriveAPI.Get(found, "angular")
            assert drive.GetStiffnessAttr().Get() > 0.05
            assert drive.GetTargetPositionAttr().Get() == pytest.approx(np.degrees(position), abs=1e-4)
        mounted = next(m for m in scene.mounted if m.carrier == robot.name)
        hand = native.links["hand"]
        camera = stage.GetPrimAtPath(f"{prim.GetPath()}/{made.links[hand.link]}/{mounted.camera.name}")
        assert camera.IsA(UsdGeom.Camera)
        flip = Pose.of(q=(0.0, 1.0, 0.0, 0.0))  # USD's camera looks along -z
        X_WH = made.item.X_WO @ X_OL[made.links[hand.link]] @ hand.X_LF
        _same_place(_pose(camera), X_WH @ mounted.camera.X_WC @ flip)


def test_a_stage_refers_to_a_robot_s_own_usd(robot_data: Path, tmp_path: Path) -> None:
    shutil.copytree(robot_data / "robotiq_2f85_usd", tmp_path / "robot")
    (tmp_path / "hand.scene.yaml").write_text(HAND_USD)
    scene = lower_file(tmp_path / "hand.scene.yaml")
    folder = written(scene, "usd", tmp_path)
    shutil.move(tmp_path / "robot", tmp_path / "away")  # the build needs no file of the source
    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    own = Usd.Stage.Open(str(robot_data / "robotiq_2f85_usd" / "Robotiq_2F85_newton.usda"))
    assert [e.split()[0] for e in _validated(stage)] == [e.split()[0] for e in _validated(own)]  # layers it lacks
    model = stage.GetPrimAtPath("/World/Robots/hand/Model")
    every = [p for p in Usd.PrimRange(model) if p.IsA(UsdPhysics.Joint)]
    joints = {p.GetName(): p for p in every}
    assert len(every) == 22
    _same_place(_pose(model), scene.robot("hand").X_WB)
    state = joints["finger_joint"].GetAttribute("state:angular:physics:position").Get()
    assert state == pytest.approx(np.degrees(0.4))
    shutil.move(tmp_path / "away", tmp_path / "robot")
    cameras = [p for p in Usd.PrimRange(model) if p.IsA(UsdGeom.Camera)]
    assert [p.GetName() for p in cameras] == ["palm"]
    assert cameras[0].GetParent().GetName() == "base"
    reasons = {loss.path: loss.reason for loss in compile_scene(scene, "usd").losses}
    assert reasons["hand"].startswith("The robot's file refers to 14 layers that do not exist, such as base.usd.")
    for target in ("mjcf", "urdf", "pybullet"):
        reasons = {loss.path: loss.reason for loss in compile_scene(scene, target).losses}
        assert "The robot has no MJCF or URDF model" in reasons["hand"], target


@pytest.mark.parametrize(
    ("name", "robot"), [("panda_lift", "arm"), ("yam", "right"), ("lift", "arm"), ("demo_lift", "arm")]
)
def test_a_folder_of_urdfs_holds_the_robot(
    request: pytest.FixtureRequest, tmp_path: Path, name: str, robot: str
) -> None:
    scene: Scene = request.getfixturevalue(name)
    folder = written(scene, "urdf", tmp_path)
    entry = json.loads((folder / "poses.json").read_text())[robot]
    assert entry["fixed"]
    assert entry["p"] == pytest.approx(scene.robot(robot).X_WB.p)
    root = ET.parse(folder / entry["urdf"]).getroot()
    for mesh in root.iter("mesh"):
        assert ((folder / entry["urdf"]).parent / mesh.attrib["filename"]).is_file(), mesh.attrib
    assert set(entry["joints"]) <= {joint.get("name") for joint in root.findall("joint")}
    expected = _arm(scene.robot(robot))
    assert {k: v for k, v in entry["joints"].items() if k in expected} == pytest.approx(expected)
    if name == "lift":
        mimics = {str(j.get("name")): m.attrib for j in root.findall("joint") if (m := j.find("mimic")) is not None}
        assert mimics["right_follower_joint"]["joint"] == "left_driver_joint"


def _arm(robot: Robot) -> dict[str, float]:
    native = robot.best(ModelFormat.URDF, ModelFormat.MJCF)
    assert native is not None
    return {native.joints[name]: position for name, position in robot.positions.items()}


def test_a_robot_s_urdf_keeps_its_text_but_for_the_names_of_files(panda_lift: Scene, tmp_path: Path) -> None:
    native = panda_lift.robot("arm").models[ModelFormat.URDF]
    folder = written(panda_lift, "pybullet", tmp_path)
    entry = json.loads((folder / "world.json").read_text())["robots"]["arm"]
    copy = (folder / entry["urdf"]).read_text().splitlines()
    for line, own in zip(copy, native.file.read_text().splitlines(), strict=True):
        assert line == own.replace("package://meshes/", "meshes/")
    assert entry["motors"]["panda_joint1"] == {"target": 0.0, "force": 87.0}
    assert entry["follow"] == {
        "panda_finger_joint2": {"joint": "panda_finger_joint1", "multiplier": 1.0, "offset": 0.0}
    }


@pytest.mark.parametrize("target", ["mjcf", "pybullet", "urdf", "usd"])
def test_targets_are_the_same_twice(panda_lift: Scene, target: str) -> None:
    read_robot.cache_clear()
    first = compile_scene(panda_lift, target)
    read_robot.cache_clear()
    as_object.cache_clear()
    assert compile_scene(panda_lift, target).files == first.files


def test_what_a_target_cannot_keep_of_a_robot_is_said(lift: Scene) -> None:
    losses = {target: compile_scene(lift, target).losses for target in ("mjcf", "pybullet", "usd")}

    def reasons(target: str, feature: str) -> str:
        return " ".join(loss.reason for loss in losses[target] if loss.feature == feature)

    assert "its MJCF is converted" in reasons("pybullet", "robots")
    assert "2 closed loops are cut" in reasons("usd", "robots") and not reasons("mjcf", "robots")
    assert "contacts of its fingers have a time constant of 4 ms" in reasons("mjcf", "robot_contacts")
    assert "are static" in reasons("pybullet", "mounted_cameras")
    assert not reasons("mjcf", "mounted_cameras") + reasons("usd", "mounted_cameras")


def _validated(stage: Any) -> list[str]:
    """Errors of USD's own validators."""
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    return sorted(f"{e.GetName()} {e.GetMessage()}" for e in context.Validate(stage) if "Error" in str(e.GetType()))


def _pose(prim: Any) -> Pose:
    matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    return Pose.from_matrix(np.array(matrix).T)


def _same_place(found: Pose, expected: Pose) -> None:
    assert found.p == pytest.approx(expected.p, abs=1e-6)
    assert found.angle_to(expected) < 1e-6
