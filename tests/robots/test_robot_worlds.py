"""Robots that move and grasp, in MuJoCo and in PyBullet."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import ModelFormat
from simfoundry.spec.models.robot_file import OWN_ROBOTS
from simfoundry.worlds.base import camera_now
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.conftest import REPOSITORY
from tests.robots.reach import Reach, grasp_and_lift, move

ONE_DEGREE = math.radians(1)


def test_the_2f85_lifts_a_cube_by_friction_in_mujoco(lift: Scene) -> None:
    world = MujocoWorld(lift)
    arm = world.robot("arm")
    assert arm.gripper() == pytest.approx(0, abs=0.01)
    p, targets = grasp_and_lift(world, grasp=0.185, rise=0.12)
    assert p[2] > 0.02 + 0.10
    assert np.hypot(*(p[:2] - [0.5, 0.0])) < 0.03
    assert 0.3 < arm.gripper() < 0.8  # held open by the cube
    touching = {frozenset((c.a, c.b)) for c in world.contacts()}
    assert frozenset(("arm", "cube")) in touching
    assert frozenset(("desk", "cube")) not in touching
    reached = arm.positions()
    assert max(abs(reached[name] - target) for name, target in targets.items()) < ONE_DEGREE


def test_the_panda_hand_lifts_a_cube_by_friction_in_pybullet(panda_lift: Scene) -> None:
    world = _pybullet(panda_lift)
    p, targets = grasp_and_lift(world, grasp=0.125, rise=0.15)
    arm = world.robot("arm")
    assert p == pytest.approx([0.5, 0.0, 0.17], abs=0.003)
    assert arm.gripper() == pytest.approx(0.5, abs=0.05)  # half open: the cube is 4 cm wide, the hand opens by 8
    reached = arm.positions()
    assert max(abs(reached[name] - target) for name, target in targets.items()) < ONE_DEGREE
    world.reset()
    assert world.state().poses["cube"].p == pytest.approx([0.5, 0.0, 0.02])
    assert arm.positions() == pytest.approx(dict(panda_lift.robot("arm").positions))
    assert arm.gripper() == pytest.approx(0, abs=1e-6)
    world.step(250)  # the motors hold it there again
    assert arm.positions() == pytest.approx(dict(panda_lift.robot("arm").positions), abs=1e-3)
    world.close()


@pytest.mark.parametrize("closed", [0.0, 0.35, 1.0])
def test_grippers_go_where_they_are_told_in_both_engines(lift: Scene, panda_lift: Scene, closed: float) -> None:
    for world in (MujocoWorld(lift), _pybullet(panda_lift)):
        arm = world.robot("arm")
        arm.set_gripper(closed)
        world.step(1000)
        assert arm.gripper() == pytest.approx(closed, abs=0.03)
        arm.set_gripper(7.0)  # more than closed is closed
        world.step(1000)
        assert arm.gripper() == pytest.approx(1.0, abs=0.03)
        world.close()


def test_fingers_of_the_converted_2f85_move_together_in_pybullet(lift: Scene) -> None:
    """The closed loops of the linkage are cut; what they do is done by gears."""
    world = _pybullet(lift)
    arm = world.robot("arm")
    arm.set_gripper(0.5)
    world.step(1000)
    body = world._robots["arm"]._body
    index = world._robots["arm"]._index
    at = {name: world._call("getJointState", body, k)[0] for name, k in index.items()}
    assert at["left_driver_joint"] == pytest.approx(0.41, abs=0.01)
    for name in ("right_driver_joint", "left_spring_link_joint", "right_follower_joint"):
        assert at[name] == pytest.approx(at["left_driver_joint"], abs=0.01), name
    world.close()


def test_what_stands_in_for_the_linkage_is_what_it_does(lift: Scene) -> None:
    world = MujocoWorld(lift)
    world.robot("arm").set_gripper(0.9)
    world.step(1500)
    gripper = lift.robot("arm").models[ModelFormat.MJCF].gripper
    assert gripper is not None
    for name, leader in gripper.follow.items():
        follower, lead = (world.data.joint(f"arm.{n}").qpos[0] for n in (name, leader.joint))
        assert lead > 0.6
        assert follower == pytest.approx(leader.multiplier * lead + leader.offset, abs=0.02), name


def test_both_engines_have_the_hand_where_kinematics_has_it(panda_lift: Scene) -> None:
    robot = panda_lift.robot("arm")
    reach, q = Reach(robot), {f"joint{k}": v for k, v in enumerate([0.3, -0.5, 0.2, -2.0, 0.4, 1.9, -0.6], 1)}
    expected = reach.hand(q)
    mujoco, bullet = MujocoWorld(panda_lift), _pybullet(panda_lift)
    for name, value in q.items():
        mujoco.data.joint(f"arm.panda_{name}").qpos[0] = value
        handle = bullet._robots["arm"]
        bullet._call("resetJointState", handle._body, handle._index[f"panda_{name}"], value, 0.0)
    for world in (mujoco, bullet):
        _same_pose(world.robot("arm").frame("hand"), expected)
        _same_pose(world.robot("arm").frame("base"), robot.X_WB)
    bullet.close()


def test_a_mounted_camera_is_where_the_hand_has_carried_it(panda_lift: Scene) -> None:
    mounted = panda_lift.mounted[0]
    q = {f"joint{k}": v for k, v in enumerate([0.3, -0.5, 0.2, -2.0, 0.4, 1.9, -0.6], 1)}
    for world in (MujocoWorld(panda_lift), _pybullet(panda_lift)):
        before = camera_now(world, mounted)
        move(world, q, 2.0)
        world.step(500)
        now, arm = camera_now(world, mounted), world.robot("arm")
        assert np.linalg.norm(now.X_WC.p - before.X_WC.p) > 0.1
        _same_pose(now.X_WC, Reach(panda_lift.robot("arm")).hand(arm.positions()) @ mounted.camera.X_WC)
        assert (now.name, now.fx, now.width) == ("wrist", 50, 64)
        world.close()


def test_the_page_s_python_runs(own_models: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    page = (REPOSITORY / "docs" / "robots.md").read_text()
    monkeypatch.setenv(OWN_ROBOTS, str(own_models))
    monkeypatch.chdir(REPOSITORY)
    for block in re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE):
        exec(compile(block, "docs/robots.md", "exec"), {})
    assert "'joint7'" in capsys.readouterr().out


def test_a_joint_that_is_not_there_is_named(lift: Scene, panda_lift: Scene) -> None:
    for world in (MujocoWorld(lift), _pybullet(panda_lift)):
        with pytest.raises(KeyError, match="robot 'arm' has no joint 'elbow'; available joints: joint1, joint2"):
            world.robot("arm").set_targets({"elbow": 0.0})
        with pytest.raises(KeyError, match=r"no robot 'leg'; .*: arm"):
            world.robot("leg")
        world.close()


def _pybullet(scene: Scene) -> Any:
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    from simfoundry.worlds.pybullet_world import PybulletWorld

    return PybulletWorld(scene)


def _same_pose(found: Pose, expected: Pose) -> None:
    assert found.p == pytest.approx(expected.p, abs=1e-5)
    assert found.angle_to(expected) < 1e-5


def test_the_2f85_presses_as_hard_in_pybullet_as_in_mujoco(lift: Scene) -> None:
    """Rotors are most of a finger's inertia; without them Bullet's contacts press with a hundredth of the force."""
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    forces = {}
    for world in (MujocoWorld(lift), _pybullet(lift)):
        p, _ = grasp_and_lift(world, grasp=0.185, rise=0.12, share=0.62)
        assert p[2] > 0.02 + 0.10, type(world).__name__
        forces[type(world).__name__] = _press_on_cube(world)
        world.close()
    # A third more: the gears that stand for the linkage yield less, so that the servo stays farther from its target.
    assert forces["PybulletWorld"] == pytest.approx(forces["MujocoWorld"], rel=0.4)


def test_rotors_are_bodies_that_bullet_accepts(lift: Scene) -> None:
    """Bullet takes an inertia that breaks the triangle inequality for zero, without a word that is heard."""
    world = _pybullet(lift)
    handle = world._robots["arm"]
    for joint, index in handle._index.items():
        if joint in lift.robot("arm").positions or joint in handle._gripper.joints:
            moments = sorted(world._call("getDynamicsInfo", handle._body, index)[2])
            assert moments[2] >= (0.005 if "driver" in joint else 0.1), joint
            assert moments[0] + moments[1] >= moments[2] * (1 - 1e-9), joint
    world.close()


def test_a_converted_arm_lags_behind_its_target_as_in_mujoco(lift: Scene) -> None:
    gone = {}
    for world in (MujocoWorld(lift), _pybullet(lift)):
        arm = world.robot("arm")
        start = arm.positions()["joint1"]
        arm.set_targets({"joint1": start + 0.1})
        world.step(round(0.1 / world.timestep))  # as long as the damping of its servo is of the stiffness
        gone[type(world).__name__] = arm.positions()["joint1"] - start
        world.close()
    assert gone["MujocoWorld"] == pytest.approx(0.1 * (1 - math.exp(-1)), rel=0.1)
    assert gone["PybulletWorld"] == pytest.approx(gone["MujocoWorld"], rel=0.1)


def test_a_converted_robot_grips_objects_of_one_friction_as_in_mujoco(lift: Scene) -> None:
    world = json.loads(compile_scene(lift, "pybullet").files["world.json"])
    pad = world["robots"]["arm"]["links"]["left_pad"]["lateral_friction"]
    (surface,) = world["objects"]["cube"]["links"].values()
    assert pad * surface["lateral_friction"] == pytest.approx(
        max(1.0, 0.6)
    )  # of the pad and of wood, of which MuJoCo takes the larger


def _press_on_cube(world: Any) -> float:
    """Sum of the normal forces [N] between the fingers and the cube."""
    if not isinstance(world, MujocoWorld):
        points = world._call("getContactPoints", bodyA=world.bodies["cube"])
        return math.fsum(float(point[9]) for point in points)
    total, force = 0.0, np.zeros(6)
    cube = world.model.body("cube").id
    for k in range(world.data.ncon):
        if cube in world.model.geom_bodyid[world.data.contact[k].geom]:
            mujoco.mj_contactForce(world.model, world.data, k, force)
            total += float(force[0])
    return total
