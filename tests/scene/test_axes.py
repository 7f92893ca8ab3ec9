"""Joints with several axes: names, kinematics, light links, and their motion in both worlds."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.light_links import SHARE, with_light_links
from simfoundry.predicates import Judge, StateBatch
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.predicates.judging.view import View
from simfoundry.scene.kinematics import contact_pairs, effective_inertias, link_poses, trees
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load_scene
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld

ASSET = """\
simfoundry: asset/1
name: stand
links:
  base: {mass: 2, parts: {b: {shape: {box: [0.1, 0.1, 0.1]}}}}
  arm: {mass: 1, parts: {b: {shape: {box: [0.03, 0.04, 0.3]}, pose: {xyz: [0.01, 0, -0.15]}}}}
  plate: {mass: 0.5, parts: {b: {shape: {box: [0.1, 0.08, 0.02]}}}}
joints:
  universal: {parent: base, child: arm, pose: {xyz: [0, 0, -0.1], rpy_deg: [0, 20, 0]}, axes: {
    bend: {type: revolute, axis: [1, 0, 0], limits_deg: [-60, 60], damping: 0.05},
    tilt: {type: revolute, axis: [0, 1, 0], limits_deg: [-70, 60], damping: 0.05}}}
  planar: {parent: base, child: plate, pose: {xyz: [0.3, 0, 0.1]}, axes: {
    px: {type: prismatic, axis: [1, 0, 0], limits: [-0.1, 0.1], damping: 2,
         drive: {stiffness: 50, damping: 3, target: 0}},
    py: {type: prismatic, axis: [0, 1, 0], limits: [-0.2, 0.2], damping: 2, mimic: {joint: px, multiplier: 2}},
    yaw: {type: continuous, axis: [0, 0, 1], damping: 0.01}}}
"""
SCENE = """\
simfoundry: scene/1
name: room
objects:
  stand: {asset: stand.asset.yaml, fixed: true, pose: {xyz: [0.1, 0.2, 1], yaw_deg: 30},
          joints: {bend: {deg: 20}, tilt: {deg: -10}, px: 0.05, yaw: {deg: 40}}}
relations: [Open(stand.tilt)]
"""


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "stand.asset.yaml").write_text(ASSET)
    (tmp_path / "room.scene.yaml").write_text(SCENE)
    return lower(load_scene(tmp_path / "room.scene.yaml"))


def test_each_axis_is_a_joint_with_its_own_position(scene: Scene) -> None:
    item = scene.object("stand")
    joints = {joint.name: joint for joint in item.joints}
    assert list(joints) == ["bend", "tilt", "px", "py", "yaw"]
    assert {n: j.position for n, j in joints.items()} == pytest.approx(
        {"bend": math.radians(20), "tilt": math.radians(-10), "px": 0.05, "py": 0.1, "yaw": math.radians(40)}
    )
    assert [joint.name for joint in item.joints_above["plate"]] == ["px", "py", "yaw"]
    assert joints["tilt"].X_PC.is_identity and not joints["bend"].X_PC.is_identity
    assert contact_pairs(item) == (("arm", "plate"),)  # connected links do not collide, and these two are not connected


def test_poses_agree_with_mujoco_and_with_light_links(scene: Scene) -> None:
    item, split = scene.object("stand"), with_light_links(scene).object("stand")
    files = compile_scene(scene, "mjcf").files
    assets = {name.rpartition("/")[2]: data for name, data in files.items()}
    model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), assets)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    ours, theirs = link_poses(item), link_poses(split)
    for link in ("arm", "plate"):
        body = model.body(f"stand.{link}").id
        X_WL = item.X_WO @ ours[link]
        assert X_WL.p == pytest.approx(data.xpos[body], abs=1e-9)
        assert X_WL.rotation == pytest.approx(data.xmat[body].reshape(3, 3), abs=1e-9)
        np.testing.assert_allclose(theirs[link].matrix, ours[link].matrix, atol=1e-12)


def test_light_links_weigh_next_to_nothing_and_touch_nothing(scene: Scene) -> None:
    split = with_light_links(scene).object("stand")
    assert [link.name for link in split.links] == ["base", "arm_bend", "arm", "plate_px", "plate_py", "plate"]
    assert [link.mass for link in split.links][1::2][:1] == [SHARE * 1.0]
    assert contact_pairs(split) == (("arm", "plate"),)
    (before,), (after,) = (trees(item) for item in (scene.object("stand"), split))
    assert effective_inertias(after) == pytest.approx(effective_inertias(before), rel=1e-3)
    losses = {loss.path: loss.size for loss in compile_scene(scene, "urdf").losses if loss.feature == "several_axes"}
    assert {path: size.value for path, size in losses.items() if size} == pytest.approx(
        {"stand.bend.axes": 1e-4, "stand.px.axes": 5e-5, "stand.py.axes": 5e-5}
    )
    assert not [loss for loss in compile_scene(scene, "mjcf").losses if loss.feature == "several_axes"]


def test_predicates_address_an_axis_and_know_its_link(scene: Scene) -> None:
    state = SceneState.initial(scene)
    assert Judge(scene)("Open(stand.bend)", state).value
    assert not Judge(scene)("Open(stand.tilt)", state).value
    item, view = scene.object("stand"), View(Bodies(scene), StateBatch.of(scene, [state]))
    for k, link in enumerate(item.links):
        X_WL = item.X_WO @ link_poses(item)[link.name]
        poses = view.link("stand", k)
        assert poses.p[0] == pytest.approx(X_WL.p) and poses.R[0] == pytest.approx(X_WL.rotation)


@pytest.mark.parametrize("engine", [MujocoWorld, PybulletWorld])
def test_worlds_move_all_axes_alike(scene: Scene, engine: type[MujocoWorld] | type[PybulletWorld]) -> None:
    with MujocoWorld(scene) as reference, engine(scene) as world:
        reference.step(round(0.4 / reference.timestep))
        world.step(round(0.4 / world.timestep))
        expected, found = dict(reference.state().joints), dict(world.state().joints)
    assert found == pytest.approx(expected, abs=0.01)
    assert abs(found["stand.bend"] - math.radians(20)) > 0.1  # it has moved
