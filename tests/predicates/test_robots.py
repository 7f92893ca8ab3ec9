"""What robots do: touch, hold and let go; and states that carry where they are and how fast things move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.backends.robot_models.mujoco_robot import read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.geometry.frames import Pose
from simfoundry.predicates import PredicateError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import LeftOut
from simfoundry.scene.robot import mujoco_model
from simfoundry.scene.state import SceneState
from simfoundry.worlds import open_world
from tests.predicates.conftest import Setting, changed, posed

SCENE = """\
simfoundry: scene/1
name: held
viewpoint: arm
materials: {wood: {density: 500, friction: 0.6}}
objects:
  desk: {fixed: true, shape: {box: [1.1, 1.3, 0.04]}, material: wood, pose: {xyz: [0.35, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, material: wood, pose: {xyz: [0.5, 0.2, 0.02]}}
  bowl:
    shape: {lathe: {profile: [[0, 0], [0.05, 0], [0.12, 0.08], [0.116, 0.08], [0.048, 0.006], [0, 0.006]]}}
    material: wood
    pose: {xyz: [0.5, -0.3, 0]}
robots:
  arm: {model: franka_panda, pose: {xyz: [0.02, 0.01, 0], yaw_deg: 10}}
"""

POSITIONS = [0.2, -0.5, 0.1, -2.2, 0.15, 1.8, 0.6]


class Hand:
    """The Panda with its hand somewhere, and the pose of that."""

    def __init__(self, one: Setting) -> None:
        self.one, robot = one, one.scene.robots[0]
        native = mujoco_model(robot)
        assert native is not None
        self.item = as_object(robot, read_robot(robot, native, "arm.")).item
        self.arm = {f"panda_joint{k}": q for k, q in enumerate(POSITIONS, 1)}
        self.X_WH = self.item.X_WO @ link_poses(self.item, self.arm)["panda_hand"]

    def at(self, width: float, **poses: Pose) -> SceneState:
        """The state with either finger ``width`` [m] from the middle."""
        fingers = {f"panda_finger_joint{k}": width for k in (1, 2)}
        start = self.one.start
        return SceneState.of({**start.poses, **poses}, start.joints, None, {"arm": self.arm | fingers})

    def holds(self, condition: str, width: float, **poses: Pose) -> bool:
        """Whether a condition holds."""
        return self.one.judge(condition, self.at(width, **poses)).value


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    pytest.importorskip("pybullet_data", reason="the Panda's URDF comes with PyBullet")
    file = tmp_path_factory.mktemp("held") / "held.scene.yaml"
    file.write_text(SCENE)
    return Hand(Setting(lower_file(file)))


HELD = posed(0.002, 0.0, 0.105, 0, 0, 0)


def test_held_between_both_fingers(hand: Hand) -> None:
    cube = hand.X_WH @ HELD
    assert hand.holds("Grasped(cube)", 0.0202, cube=cube)
    assert hand.holds("Grasped(cube, arm)", 0.0202, cube=cube)
    assert not hand.holds("Grasped(cube)", 0.03, cube=cube)
    assert hand.holds("Touching(arm, cube)", 0.0202, cube=cube)
    assert not hand.holds("Touching(arm, cube)", 0.03, cube=cube)
    assert not hand.holds("Released(cube)", 0.0202, cube=cube)
    assert hand.holds("Released(cube)", 0.03, cube=cube)


def test_the_grasp_ends_where_a_finger_no_longer_touches(hand: Hand) -> None:
    cube = hand.X_WH @ HELD
    low, high = 0.019, 0.03
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if hand.holds("Grasped(cube)", middle, cube=cube) else (low, middle)
    sides = [f"Touching(arm.panda_{side}finger, cube)" for side in ("left", "right")]
    assert all(hand.holds(side, low - 1e-4, cube=cube) for side in sides)
    assert not all(hand.holds(side, high + 1e-4, cube=cube) for side in sides)


def test_one_finger_alone_holds_nothing(hand: Hand) -> None:
    assert not hand.holds("Grasped(cube)", 0.04, cube=hand.X_WH @ posed(0, 0.0203, 0.105))


def test_finger_tips_on_top_hold_nothing(hand: Hand) -> None:
    """Both fingers touch the cube from above, and closing them would not press into it."""
    low, high = 0.1, 0.2
    for _ in range(20):
        middle = (low + high) / 2
        touches = hand.holds("Touching(arm, cube)", 0.012, cube=hand.X_WH @ posed(0, 0, middle))
        low, high = (middle, high) if touches else (low, middle)
    tip = hand.X_WH @ posed(0, 0, low - 2e-4)
    assert all(hand.holds(f"Touching(arm.panda_{side}finger, cube)", 0.012, cube=tip) for side in ("left", "right"))
    assert not hand.holds("Grasped(cube)", 0.012, cube=tip)


def test_what_is_held_is_neither_inside_nor_on_top(hand: Hand) -> None:
    cube = hand.X_WH @ HELD
    low, high = 0.0, 0.1  # how far the bowl is below the middle of the cube where that touches its floor
    for _ in range(20):
        middle = (low + high) / 2
        touches = hand.holds("Touching(cube, bowl)", 0.04, cube=cube, bowl=Pose.of(cube.p - [0, 0, middle]))
        low, high = (middle, high) if touches else (low, middle)
    bowl = Pose.of(cube.p - [0, 0, low])
    for condition in ("Inside(cube, bowl)", "OnTop(cube, bowl)"):
        free, held = (hand.one.judge(condition, hand.at(w, cube=cube, bowl=bowl)) for w in (0.04, 0.0202))
        assert free.value, free
        assert not held.value
        assert held.why == "a robot holds `cube`"


def test_left_and_right_are_seen_from_the_robot(hand: Hand) -> None:
    """The viewpoint is the arm, which is turned by 10 degrees."""
    forward, left = (hand.one.scene.robots[0].X_WB.rotation[:, k] for k in (0, 1))
    middle = np.array([0.5, 0.0, 0.1])
    at = {"bowl": Pose.of(middle), "cube": Pose.of(middle + 0.2 * left + 0.01 * forward)}
    state = changed(hand.one.start, poses=at)
    sides = ("LeftOf", "RightOf", "Behind", "InFrontOf")
    assert [side for side in sides if hand.one.judge(f"{side}(cube, bowl)", state).value] == ["LeftOf"]


def test_unknown_robots_are_named(hand: Hand) -> None:
    with pytest.raises(
        PredicateError, match="there is no `leg` in this scene; available objects and robots: desk, cube, bowl, arm"
    ):
        hand.one.judge("Touching(leg, cube)", hand.one.start)
    with pytest.raises(PredicateError, match="`bowl` is not a robot with a gripper"):
        hand.one.judge("Grasped(cube, bowl)", hand.one.start)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_states_carry_the_robot(hand: Hand, engine: str) -> None:
    state = hand.at(0.0212, cube=hand.X_WH @ HELD)
    with open_world(hand.one.scene, engine) as world:
        world.reset(state)
        read = world.state()
        assert read.robots["arm"] == pytest.approx(dict(state.robots["arm"]), abs=1e-9)
        assert world.robot("arm").gripper() == pytest.approx(1 - 0.0212 / 0.04, abs=1e-6)
        world.step(round(0.5 / world.timestep))
        after = world.state().robots["arm"]
        assert after == pytest.approx(dict(state.robots["arm"]), abs=0.02)  # its motors hold it there
        world.reset()
        assert world.state().robots["arm"]["panda_joint4"] == pytest.approx(-2.356194)
        bad = SceneState.of({}, {}, None, {"arm": {"elbow": 0.0}})
        with pytest.raises(KeyError, match="robot 'arm' has no joint 'elbow'"):
            world.reset(bad)
        with pytest.raises(KeyError, match="no robot 'leg'"):
            world.reset(SceneState.of({}, {}, None, {"leg": {}}))


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_states_carry_speeds(hand: Hand, engine: str) -> None:
    with open_world(hand.one.scene, engine) as world:
        world.reset(changed(hand.one.start, cube=posed(0.5, 0.2, 1.0)))
        assert world.state().speeds["cube"] == 0.0
        world.step(round(0.2 / world.timestep))
        assert world.state().speeds["cube"] == pytest.approx(9.81 * 0.2, rel=0.02)
        assert "desk" not in world.state().speeds


def test_a_robot_without_a_model_is_named(hand: Hand) -> None:
    """Its shape is unknown, which is said; things are judged all the same."""
    lost = LeftOut("robots.arm", "no model found")
    one = Setting(replace(hand.one.scene, robots=(), left_out=(lost,)))
    with pytest.raises(PredicateError, match="no model of robot `arm` was found"):
        one.judge("Touching(arm, cube)", one.start)
    assert one.judge("OnTop(cube, desk)", one.start).value
