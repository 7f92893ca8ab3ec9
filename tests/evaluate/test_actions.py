"""Actions of every space, at every rate, with one arm and with two, and what is no action."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product

import numpy as np
import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.actions import (
    action_limits,
    action_size,
    checked_actions,
    denormalized,
    normalized,
    rotation_numbers,
    rotation_quat,
)
from simfoundry.evaluate.observations import ObservationLayout, checked_observation
from simfoundry.evaluate.policies.base import ImageSize, InvalidAnswerError, Observation, Policy
from simfoundry.evaluate.policies.open_loop import ReplayPolicy, no_motion
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.control import FARTHEST, HAND_AHEAD
from simfoundry.evaluate.rollouts.execution import Execution
from simfoundry.evaluate.rollouts.rollout import Rollout, RolloutEnd, rollout
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array, Pose
from simfoundry.predicates import Judge
from simfoundry.render.gl import Engine, choose_engine
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ACTIONS, ActionKind, ActionSpace, ImageKind, RotationForm
from simfoundry.worlds.base import World, instances
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld

CELL = """\
simfoundry: scene/1
name: cell
objects:
  desk: {fixed: true, shape: {box: [2, 2, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, density: 500, place: {on: desk, xy: [0.45, 0]}}
robots:
  left: {model: demo_arm, pose: {xyz: [0, 0.5, 0], yaw_deg: -30}, joints: home}
  right: {model: demo_arm, pose: {xyz: [0, -0.5, 0], yaw_deg: 40}, joints: home}
cameras:
  top: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [0.45, 0.001, 1.0], look_at: [0.45, 0, 0]}}
"""
TASK = """\
simfoundry: task/1
name: wave
scene: cell.scene.yaml
instruction: Wave.
goal: At(cube, 5, 0)
reset: {objects: {cube: {x: [0.4, 0.5], y: [-0.05, 0.05]}}}
horizon: 30
"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Task:
    folder = tmp_path_factory.mktemp("cell")
    (folder / "cell.scene.yaml").write_text(CELL)
    (folder / "wave.task.yaml").write_text(TASK)
    return load_task(folder / "wave.task.yaml")


@pytest.fixture
def world(cell: Task) -> Iterator[MujocoWorld]:
    with MujocoWorld(cell.scene) as opened:
        yield opened


def hands(world: World, frame: str = "hand") -> list[Pose]:
    return [world.robot(name).frame(frame) for name in ("left", "right")]


def carry_out(world: World, space: str, action: Array, count: int = 20) -> None:
    execution = Execution(world, ("left", "right"), ActionSpace.parse(space), 15.0)
    for _ in range(count):
        list(execution.act(action))


@pytest.mark.parametrize("form", RotationForm)
def test_rotations_survive_a_round_trip(form: RotationForm) -> None:
    rng = np.random.default_rng(0)
    for q in [
        *rng.normal(size=(20, 4)),
        np.array([1.0, 0, 0, 0]),
        np.array([1.0, 1e-9, 0, 0]),
        np.array([0, 0, 0, 1.0]),
    ]:
        pose = Pose.of(q=q)
        back = Pose.of(q=rotation_quat(rotation_numbers(pose.q, form), form))
        assert pose.angle_to(back) < 1e-6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("torque", "unknown action space `torque`; available: joint_position"),
        ("joint_delta:hand", "does not apply to joint_delta"),
        ("hand_pose:hand", "does not apply to hand_pose"),
        ("hand_delta:rpi", "did you mean `rpy`"),
        ("hand_delta:base:world", "states the same property twice"),
    ],
)
def test_a_text_that_names_no_space_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ActionSpace.parse(text)


def test_every_space_has_a_text_a_definition_and_limits(cell: Task, world: MujocoWorld) -> None:
    robots = {name: world.robot(name) for name in cell.robots}
    texts = [f"{k}{n}" for k in ActionKind for n in ("", ":normalized")]
    texts += [f"{k}:{f}:{r}" for k, f, r in product(("hand_pose", "hand_delta"), ("base", "world"), RotationForm)]
    for text in texts:
        space = ActionSpace.parse(text)
        assert ActionSpace.parse(str(space)) == space and ACTIONS[space.kind].name == space.kind
        limits = action_limits(space, world.scene, robots)
        assert limits.shape == (action_size(robots, space), 2) and (limits[:, 0] < limits[:, 1]).all()
        values = denormalized(np.linspace(-1, 1, len(limits)), limits)
        np.testing.assert_allclose(normalized(values, limits), np.linspace(-1, 1, len(limits)), atol=1e-9)


def test_delta_in_three_frames_moves_the_hands_as_said(world: MujocoWorld) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    step = np.array([0.004, 0.0, 0.002])
    turn = rotation_quat(np.array([0.0, 0.0, 0.02]), RotationForm.ROTVEC)
    for frame in ("base", "world", "hand"):
        world.reset()
        before, bases = hands(world), hands(world, "base")
        carry_out(world, f"hand_delta:{frame}", np.array([*step, 0, 0, 0.02, 0.0] * 2), 10)
        carry_out(world, f"hand_delta:{frame}", np.zeros(14), 15)
        for start, base, end in zip(before, bases, hands(world), strict=True):
            R_WF = {"base": Pose.of(q=base.q), "world": Pose.of(), "hand": Pose.of(q=start.q)}[frame]
            expected = start
            for _ in range(10):
                axes = Pose.of(q=expected.q) if frame == "hand" else R_WF
                turned = axes @ Pose.of(q=turn) @ axes.inverse() @ Pose.of(q=expected.q)
                expected = Pose.of(expected.p + axes.apply(step), turned.q)
            assert np.linalg.norm(end.p - expected.p) < 0.012  # servos sag
            assert end.angle_to(expected) < 0.05
            assert np.linalg.norm(end.p - start.p) > 0.03


@pytest.mark.parametrize("form", RotationForm)
def test_poses_are_reached_in_base_and_world(world: MujocoWorld, form: RotationForm) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    targets = [Pose.of(X.p + [0.05, 0.02, 0.05], X.q) for X in hands(world)]
    for frame in ("base", "world"):
        world.reset()
        bases = hands(world, "base") if frame == "base" else [Pose.of()] * 2
        told = [X_WF.inverse() @ X_WT for X_WF, X_WT in zip(bases, targets, strict=True)]
        action = np.concatenate([[*X.p, *rotation_numbers(X.q, form), 0.0] for X in told])
        carry_out(world, f"hand_pose:{frame}:{form}", action)
        for X_WH, X_WT in zip(hands(world), targets, strict=True):
            assert np.linalg.norm(X_WH.p - X_WT.p) < 0.012 and X_WH.angle_to(X_WT) < 0.05


def test_a_pose_out_of_reach_is_approached_and_a_delta_does_not_wind_up(world: MujocoWorld) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    (before, _) = hands(world)
    far = np.array([5.0, 0.0, 0.3, 1, 0, 0, 0, 0.0] * 2)
    carry_out(world, "hand_pose", far)
    for space in ("hand_pose", "hand_delta:hand:quat_wxyz"):
        carry_out(world, space, np.where(far == 5.0, 1e300, far), 2)
    assert np.isfinite(world.data.qpos).all() and np.linalg.norm(hands(world)[0].p - before.p) > 0.1
    world.reset()
    execution = Execution(world, ("left", "right"), ActionSpace.parse("hand_delta:world"), 15.0)
    for _ in range(60):
        list(execution.act(np.array([0, 0, -0.05, 0, 0, 0, 0.0] * 2)))  # into the desk
    down = hands(world)[0]
    list(execution.act(np.array([0, 0, 0.05, 0, 0, 0, 0.0] * 2)))
    for _ in range(6):
        list(execution.act(np.array([0, 0, 0.05, 0, 0, 0, 0.0] * 2)))
    assert hands(world)[0].p[2] > down.p[2] + HAND_AHEAD


def test_the_score_of_a_grasp_grows_as_the_hand_comes_near(cell: Task, world: MujocoWorld) -> None:
    state, judge, X_WH = world.state(), Judge(cell.scene), hands(world)[0]
    scores = []
    for away in np.linspace(1.0, 0.1, 10):
        pose = Pose.of(X_WH.p + away * np.array([0.3, -0.2, 0.5]))
        near = SceneState.of({**state.poses, "cube": pose}, state.joints, state.motions, state.robots)
        scores.append(judge.score("Grasped(cube, left)", near))
    assert all(-1 < a < b < 0 for a, b in pairwise(scores))


def test_joint_deltas_add_up(world: MujocoWorld) -> None:
    arm = world.robot("left")
    before = np.array(list(arm.positions().values()))
    action = np.zeros(16)
    action[0] = 0.02
    carry_out(world, "joint_delta", action, 10)
    moved = np.array(list(arm.positions().values())) - before
    assert moved[0] == pytest.approx(0.2, abs=0.03) and np.abs(moved[1:]).max() < 0.03
    action[0] = 100.0
    carry_out(world, "joint_delta:normalized", np.clip(action, -1, 1) * 0 + action, 1)
    assert world.data.ctrl[0] <= arm.positions()["joint1"] + FARTHEST + 0.05


class Scripted(Policy):
    """Turns the bench's arm at a steady speed, whatever the rate and the space."""

    def __init__(self, space: str, control_hz: float | None, chunk: int = 3) -> None:
        self.name, self.action_space, self.control_hz = "scripted", ActionSpace.parse(space), control_hz
        self.chunk, self.times = chunk, list[float]()

    def reset(self, instruction: str, seed: int) -> None:
        self.times = []

    def infer(self, observation: Observation) -> Array:
        self.times.append(observation.time)
        hz = self.control_hz or 15.0
        value = {
            ActionKind.JOINT_VELOCITY: 0.5 + np.zeros(self.chunk),
            ActionKind.JOINT_DELTA: 0.5 / hz + np.zeros(self.chunk),
            ActionKind.JOINT_POSITION: 0.5 * (observation.time + np.arange(1, self.chunk + 1) / hz),
        }[self.action_space.kind]
        return np.column_stack([value, np.zeros(self.chunk), np.zeros(self.chunk)])


@pytest.mark.parametrize("hz", [None, 15.0, 5.0, 10.0, 30.0, 50.0, 7.3])
@pytest.mark.parametrize("kind", ["joint_velocity", "joint_delta", "joint_position"])
def test_a_policy_has_a_rate_of_its_own(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld, hz: float | None, kind: str
) -> None:
    policy = Scripted(kind, hz)
    done = rollout(push, push_starts[0], policy, push_world)
    assert (done.end, done.steps) == (RolloutEnd.HORIZON, 45)  # three seconds of the task's clock
    rate = hz or 15.0
    assert done.action_hz == rate and len(done.actions) == pytest.approx(3 * rate, abs=1.01)
    np.testing.assert_allclose(policy.times, np.arange(len(policy.times)) * 3 / rate)
    turned = done.final.robots["arm"]
    assert turned[next(iter(turned))] == pytest.approx(1.5, abs=0.15)
    again = rollout(push, push_starts[0], replayed(done, policy), push_world)
    assert again.digest == done.digest and len(again.actions) == len(done.actions)


def replayed(done: Rollout, policy: Policy) -> ReplayPolicy:
    return ReplayPolicy(done.actions, policy.action_space, "replay", done.action_hz)


def test_the_tasks_own_rate_changes_nothing(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    same = {rollout(push, push_starts[1], Scripted("joint_velocity", hz), push_world).digest for hz in (None, 15.0)}
    chunks = {rollout(push, push_starts[1], Scripted("joint_velocity", None, n), push_world).digest for n in (1, 7)}
    assert same == chunks and len(same) == 1


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e4, True, "fast"])
def test_a_rate_that_is_none_is_refused(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld, rate: float
) -> None:
    with pytest.raises(
        SimfoundryError, match=r"policy `scripted` has `control_hz` .*; it must be the number of actions"
    ):
        rollout(push, push_starts[0], Scripted("joint_velocity", rate), push_world)


@pytest.mark.parametrize(
    ("space", "change", "words"),
    [
        ("hand_pose", {3: 0.0}, "in action 0 for the hand of `right`, the quaternion has length 0"),
        ("hand_pose:normalized", {3: 0.0}, "for the hand of `right`, the quaternion has length 0"),
        ("hand_pose:rot6d", {3: 0.0}, "in action 0 for the hand of `right`, the rows of the rotation matrix are zero"),
        ("hand_delta", {2: np.nan}, "(hand z of `right`) is nan"),
        ("hand_delta", {6: np.inf}, "(gripper of `right`) is inf"),
        ("joint_position", {1: np.nan}, "(joint 2 of `right`) is nan"),
    ],
)
def test_what_is_no_action_is_said_by_name(
    world: MujocoWorld, space: str, change: dict[int, float], words: str
) -> None:
    robots, parsed = {name: world.robot(name) for name in ("left", "right")}, ActionSpace.parse(space)
    size = parsed.arm_size(7) + 1
    action = np.tile(np.append(np.eye(1, size - 1, 3 if parsed.of_hand else 0)[0], 0.0), 2)
    if parsed.rotation is RotationForm.ROT6D:
        action[[7, size + 7]] = 1.0
    checked_actions(action, robots, parsed, single=True)
    for column, value in change.items():
        action[size + column] = value
    with pytest.raises(InvalidAnswerError) as raised:
        checked_actions(action, robots, parsed, "the action", single=True)
    assert words in str(raised.value)
    with pytest.raises(InvalidAnswerError, match=r"must have shape \(.*\), for .* and the gripper of `left` \+"):
        checked_actions(action[1:], robots, parsed, single=True)


@pytest.mark.parametrize("space", ["joint_position", "hand_pose:rot6d", "hand_delta:world:quat_wxyz"])
def test_huge_numbers_are_clipped(world: MujocoWorld, space: str) -> None:
    if space.startswith("hand"):
        pytest.importorskip("mink", reason="the extra `expert` is not installed")
    robots, parsed = {name: world.robot(name) for name in ("left", "right")}, ActionSpace.parse(space)
    execution = Execution(world, ("left", "right"), parsed, 15.0)
    signs = np.resize([1.0, -1.0, 1.0, 1.0, 1.0], action_size(robots, parsed))
    with np.errstate(all="raise"):
        for size in (1e8, 1e39, 1e308):
            action = signs * size
            if parsed.rotation is RotationForm.ROT6D:
                with pytest.raises(InvalidAnswerError, match="rows of the rotation matrix are zero or parallel"):
                    checked_actions(np.full_like(action, size), robots, parsed, single=True)
            list(execution.act(checked_actions(action, robots, parsed, single=True)))
    assert np.isfinite(world.data.qpos).all() and np.abs(world.data.ctrl).max() < 10


def test_masked_values_are_no_actions(world: MujocoWorld) -> None:
    robots, size = {"left": world.robot("left")}, 8
    action = np.ma.masked_array(np.zeros(size), [False] * (size - 1) + [True])
    with pytest.raises(InvalidAnswerError, match="got MaskedArray: some of its values are masked"):
        checked_actions(action, robots, ActionSpace.parse("joint_position"), single=True)


@pytest.mark.parametrize("kind", ActionKind)
def test_a_replay_ends_without_motion(kind: ActionKind) -> None:
    space = ActionSpace.parse(kind)
    if space.is_relative:
        rest = no_motion(space, space.arm_size(3))
        assert not rest.any()
    turned = ActionSpace.parse("hand_delta:rot6d")
    assert rotation_quat(no_motion(turned, 9)[3:], turned.rotation).tolist() == [1, 0, 0, 0]


@pytest.mark.skipif(choose_engine() is Engine.RAYCAST, reason="no GL driver")
@pytest.mark.parametrize("engine", [MujocoWorld, PybulletWorld])
def test_depths_and_masks_are_of_what_is_seen(cell: Task, engine: type[MujocoWorld] | type[PybulletWorld]) -> None:
    if engine is PybulletWorld:
        pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    with engine(cell.scene) as opened:
        layout = ObservationLayout(opened, cell.robots, {"top": ImageSize(64, 48)}, tuple(ImageKind))
        found = layout.read(opened.state())
    depth, mask, names = found["depth/top"], found["mask/top"], instances(cell.scene)
    assert names == ("desk", "cube", "left", "right") and depth.shape == mask.shape == (48, 64)
    cube = mask == names.index("cube") + 1
    assert depth[cube] == pytest.approx(0.96, abs=2e-3) and 2 <= cube.sum() <= 12
    assert depth[mask == 1] == pytest.approx(1.0, abs=2e-3)
    assert {*np.unique(mask).tolist()} <= {0, 1, 2, 3, 4} and (depth[mask == 0] == 0).all()
    for key, value in found.items():
        assert checked_observation(key, value, value.shape) is value


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("left/joints", np.zeros(7), "`left/joints` must be an array of `float32`, not of `float64`"),
        ("left/joints", np.zeros(6, np.float32), r"must have shape \(7,\); got \(6,\)"),
        ("left/hand", np.full(7, np.nan, np.float32), r"`left/hand` must be finite; number \[0\] is nan"),
        ("image/top", None, "`image/top` must be an array of `uint8`, but it is a `NoneType`"),
        ("left/elbow", np.zeros(7), "no observation is called `left/elbow`"),
    ],
)
def test_what_is_no_observation_is_said_by_name(key: str, value: np.ndarray, words: str) -> None:
    with pytest.raises(SimfoundryError, match=words):
        checked_observation(key, value, (7,))


def test_environment_spaces_hold_what_is_in_them(cell: Task) -> None:
    pytest.importorskip("gymnasium", reason="the environment needs the extra `gymnasium`")
    from simfoundry.evaluate.env import TaskEnv

    for options in ({"normalize": True}, {"flat": True}, {"control_hz": 5.0}, {"action_space": "joint_delta"}):
        env = TaskEnv(cell, starts=1, cache=False, **options)
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation) and env.action_space.dtype == np.float32
        for _ in range(3):
            observation, *_ = env.step(env.action_space.sample())
            assert env.observation_space.contains(observation), options
        if "flat" in options:
            assert observation.shape == (2 * (7 + 1 + 7) + 2 * 7,)
        if "normalize" in options:
            assert np.abs(observation["left/joints"]).max() < 1.1 and env.action_space.high.max() == 1.0
        env.close()


def test_the_page_is_generated() -> None:
    from simfoundry.spec.editor.signals_page import signals_page

    assert all(f"`{kind}`" in signals_page() for kind in (*ActionKind, *RotationForm))
