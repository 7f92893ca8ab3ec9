"""The project's own arm: what the language says of it is what its model does, in each engine, with nothing fetched."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

import simfoundry
from simfoundry.backends.robot_models.mujoco_robot import read_robot
from simfoundry.geometry.frames import Pose
from simfoundry.robots.arm import Arm, jaws
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import mujoco_model
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.worlds import open_world
from tests.robots.reach import grasp_and_lift

KNOWN = RobotSpec(model="demo_arm").known() or pytest.fail("demo_arm is not known")
DOWN = [0.0, 1.0, 0.0, 0.0]
"""The gripper points down [quaternion, wxyz]."""


def test_it_opens_as_wide_as_is_said_and_closes_fully(demo_lift: Scene) -> None:
    measured = jaws(demo_lift.robot("arm"))
    assert measured is not None
    assert measured.opening == pytest.approx(KNOWN.opening, abs=1e-4)
    assert measured.width.min() < 1e-4


def test_it_reaches_as_far_as_is_said_and_hardly_further(demo_lift: Scene) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    robot = demo_lift.robot("arm")
    arm, fingers = Arm(robot), jaws(robot)
    assert fingers is not None
    height = 0.01 + float(fingers.tip[0])  # of the hand, whose pads are a centimeter above the ground
    q, reached = arm.home, []
    for x in np.arange(0.40, 0.90, 0.02):
        solved = arm.solve_any(robot.X_WB @ Pose.of([x, 0.0, height], DOWN), q, np.random.default_rng(0))
        if solved is not None:
            q = solved
            reached.append(round(float(x), 2))
    assert reached == [round(0.40 + 0.02 * k, 2) for k in range(len(reached))]
    assert reached[-1] == pytest.approx(KNOWN.reach, abs=0.021)


def test_only_hand_and_wrist_can_touch_the_foot_and_neighbors_never_do(demo_lift: Scene) -> None:
    native = mujoco_model(demo_lift.robot("arm"))
    assert native is not None
    read = read_robot(demo_lift.robot("arm"), native, "arm.")
    model = read.model
    link = {model.body(f"arm.link{k}").id: k for k in range(8)}
    number = [next((link[b] for b in _upward(model, int(body)) if b in link), 0) for body in model.geom_bodyid]
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for k in range(2000):
        data.qpos[:] = read.qpos if k == 0 else rng.uniform(model.jnt_range[:, 0], model.jnt_range[:, 1])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        assert k > 0 or data.ncon == 0
        for contact in data.contact:
            low, high = sorted(number[g] for g in contact.geom)
            assert (low, high) == (7, 7) or (low <= 2 and high >= 5)  # the fingers meet each other


def _upward(model: mujoco.MjModel, body: int) -> Iterator[int]:
    while body:
        yield body
        body = int(model.body_parentid[body])


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_it_holds_its_posture_and_lifts_a_cube(demo_lift: Scene, engine: str) -> None:
    pytest.importorskip(engine, reason=f"{engine} is not installed")
    with open_world(demo_lift, engine) as world:
        arm = world.robot("arm")
        world.step(round(0.5 / world.timestep))
        hung = [abs(arm.positions()[name] - home) for name, home in KNOWN.home.items()]
        assert max(hung) < 0.005  # rad: under its own weight
        hand = demo_lift.robot("arm").X_WB @ Pose.of([0.3819, 0.0, 0.4852], DOWN)
        assert arm.frame("hand").p == pytest.approx(hand.p, abs=0.004)
        assert arm.frame("hand").angle_to(hand) < 0.02
        p, _ = grasp_and_lift(world, grasp=0.12, rise=0.12)
        assert p[2] > 0.02 + 0.10
        assert arm.gripper() == pytest.approx(1 - 0.04 / KNOWN.opening, abs=0.03)  # held open by the cube


def test_it_is_in_the_package_and_names_no_other_file(demo_lift: Scene) -> None:
    native = mujoco_model(demo_lift.robot("arm"))
    assert native is not None and native.file.parent == Path(simfoundry.__file__).parent / "robots"
    assert "file=" not in native.file.read_text(encoding="utf-8")
