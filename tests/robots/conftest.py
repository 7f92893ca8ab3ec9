"""Robots whose models lie in the development data, and scenes with them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.models.robot_file import OWN_ROBOTS
from tests.conftest import REPOSITORY

FRANKA_ROBOTIQ = """\
mjcf:
  file: {robots}/panda_robotiq_2f85/panda_wt_2f85.xml
  links: {{base: {{link: link0}}, hand: {{link: base, pose: {{yaw_deg: -90}}}}}}
  joints: [joint1, joint2, joint3, joint4, joint5, joint6, joint7]
  gripper:
    command: {{fingers_actuator: [0, 0.82]}}
    joints: {{left_driver_joint: [0, 0.82], right_driver_joint: [0, 0.82]}}
    follow:
      right_driver_joint: {{joint: left_driver_joint}}
      left_spring_link_joint: {{joint: left_driver_joint}}
      left_follower_joint: {{joint: left_driver_joint}}
      right_spring_link_joint: {{joint: left_driver_joint}}
      right_follower_joint: {{joint: left_driver_joint}}
"""

YAM = """\
mjcf:
  file: {robots}/i2rt_yam_menagerie/yam.xml
  links: {{base: {{link: arm}}, hand: {{link: link_6, pose: {{yaw_deg: 90}}}}}}
  joints: [joint1, joint2, joint3, joint4, joint5, joint6]
  gripper:
    command: {{gripper: [0.041, 0]}}
    joints: {{left_finger: [0.0375, 0], right_finger: [-0.0375, 0]}}
    follow: {{right_finger: {{joint: left_finger, multiplier: -1}}}}
urdf:
  file: {robots}/i2rt_yam_official/arm/yam/yam.urdf
  links: {{base: {{link: base}}, hand: {{link: gripper, pose: {{rpy_deg: [0, 180, 0]}}}}}}
  joints: [joint1, joint2, joint3, joint4, joint5, joint6]
  gripper:
    joints: {{joint7: [0, -0.044], joint8: [0, -0.044]}}
    follow: {{joint8: {{joint: joint7}}}}
  effort: {{joint1: 28, joint2: 28, joint3: 28, joint4: 10, joint5: 10, joint6: 10, joint7: 50, joint8: 50}}
"""

LIFT = """\
simfoundry: scene/1
name: lift
materials:
  wood: {{density: 500, friction: 0.6}}
objects:
  desk: {{fixed: true, shape: {{box: [1.1, 1.3, 0.04]}}, material: wood, pose: {{xyz: [0.35, 0, -0.02]}}}}
  cube: {{shape: {{box: [0.04, 0.04, 0.04]}}, material: wood, pose: {{xyz: [0.5, 0, 0.02]}}}}
robots:
  arm: {{model: {model}, pose: {{xyz: [0.02, 0.01, 0], yaw_deg: 10}}}}
cameras:
  wrist:
    size: [64, 48]
    fx: 50
    fy: 50
    pose: {{xyz: [0.07, 0.01, 0.03], quat_wxyz: [0.8, 0.2, 0.4, 0.4]}}
    mount: arm.hand
"""


@pytest.fixture(scope="session")
def robot_data(shared_data: Path) -> Path:
    folder = shared_data / "robots"
    if not folder.is_dir():
        pytest.skip(f"needs the robots' models in {folder}")
    return folder


@pytest.fixture(scope="session")
def own_models(robot_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of robot files that name the models in the development data."""
    folder = tmp_path_factory.mktemp("own_robots")
    (folder / "franka_robotiq.yaml").write_text(FRANKA_ROBOTIQ.format(robots=robot_data))
    (folder / "yam.yaml").write_text(YAM.format(robots=robot_data))
    return folder


def lowered(file: Path, own: Path) -> Scene:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(OWN_ROBOTS, str(own))
        return lower_file(file)


def lift_file(folder: Path, model: str) -> Path:
    file = folder / f"{model}.scene.yaml"
    file.write_text(LIFT.format(model=model))
    return file


@pytest.fixture(scope="session")
def droid(own_models: Path) -> Scene:
    return lowered(REPOSITORY / "specs" / "scenes" / "droid.scene.yaml", own_models)


@pytest.fixture(scope="session")
def yam(own_models: Path) -> Scene:
    return lowered(REPOSITORY / "specs" / "scenes" / "yam.scene.yaml", own_models)


@pytest.fixture(scope="session")
def lift(own_models: Path, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The DROID arm, turned and moved, before a cube."""
    return lowered(lift_file(tmp_path_factory.mktemp("lift"), "franka_robotiq"), own_models)


@pytest.fixture(scope="session")
def demo_lift(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The project's own arm, which is always here, before a cube."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(OWN_ROBOTS, raising=False)
        for package in ("mujoco_menagerie", "robot_descriptions"):
            patch.setitem(sys.modules, package, None)
        return lower_file(lift_file(tmp_path_factory.mktemp("demo_lift"), "demo_arm"))


@pytest.fixture(scope="session")
def panda_lift(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The Panda with its own hand, which comes with PyBullet, before a cube."""
    pytest.importorskip("pybullet_data", reason="the Panda's URDF comes with PyBullet")
    folder = tmp_path_factory.mktemp("panda_lift")
    return lowered(lift_file(folder, "franka_panda"), folder)
