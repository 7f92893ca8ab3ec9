"""Demonstrations at the frames of a dataset, and their actions in every action space."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.data.action_conversion import ActionConverter
from simfoundry.data.attempt import state_arrays
from simfoundry.data.demonstrations import Demonstration
from simfoundry.data.state_entries import entry_values, low_dimensional
from simfoundry.data.trajectory import TrajectorySampler, frame_count
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.open_loop import ReplayPolicy
from simfoundry.evaluate.policies.remote import reading
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.rollout import rollout
from simfoundry.evaluate.task import load_task
from simfoundry.geometry.frames import Pose
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.policy import GripperConvention
from simfoundry.spec.models.signals import ActionSpace

SCENE = """\
simfoundry: scene/1
name: cell
objects:
  desk: {fixed: true, shape: {box: [1.4, 1.4, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, density: 500, pose: {xyz: [0.6, 0.3, 0.02]}}
robots:
  arm: {model: demo_arm, pose: {xyz: [0, 0, 0], yaw_deg: 30}, joints: home}
"""
TASK = """\
simfoundry: task/1
name: wave
scene: cell.scene.yaml
instruction: Wave.
goal: Lifted(cube)
horizon: 60
"""


@pytest.fixture(scope="module")
def wave(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TrajectorySampler, Demonstration]]:
    """An arm of seven joints that waves, as if it were a demonstration, in a base that is turned."""
    folder = tmp_path_factory.mktemp("wave")
    (folder / "cell.scene.yaml").write_text(SCENE)
    (folder / "wave.task.yaml").write_text(TASK)
    task = load_task(folder / "wave.task.yaml")
    with TrajectorySampler(task) as sampler:
        home = np.array(list(sampler.world.robot("arm").positions().values()))
        phase = np.arange(30)[:, None] / 30 * np.pi
        arm = home + 0.3 * np.sin(phase) * np.array([1, -0.5, 0.4, 0.6, -0.8, 0.5, 0.7])
        actions = np.column_stack([arm, np.arange(30) > 15])
        yield sampler, demonstration_of(sampler, actions, ActionSpace.JOINT_POSITION, 15.0)


def demonstration_of(
    sampler: TrajectorySampler, actions: np.ndarray, space: ActionSpace, hz: float
) -> Demonstration:  # fmt: skip
    task = sampler.task
    start = RolloutStart(0, 0, {}, SceneState.initial(task.scene))
    horizon = round(len(actions) * task.control_hz / hz)
    policy = ReplayPolicy(actions, space, "wave", hz)
    done = rollout(replace(task, horizon=horizon), start, policy, sampler.world, trace=True)
    states = state_arrays(done.trace)
    return Demonstration(
        0, Path(), {}, 0, start, done.actions, space, hz, states, done.steps, done.subtasks, done.digest
    )


def test_recorded_states_are_those_of_a_replay(demos: Path) -> None:
    found = sf.demonstrations(demos)
    with TrajectorySampler(found.task) as sampler:
        stored, replayed = sampler.sample(found[0]), sampler._replayed(found[0], found.task.control_hz)
        fast, slow = sampler.sample(found[0], 30.0), sampler.sample(found[0], 5.0)
    assert stored.length == replayed.length == found[0].steps
    for key, values in stored.observations.items():
        np.testing.assert_array_equal(values, replayed.observations[key])
        np.testing.assert_array_equal(values, fast.observations[key][::2])
        np.testing.assert_array_equal(values[:-1:3], slow.observations[key][:-1])
        np.testing.assert_array_equal(values[-1], slow.observations[key][-1])
    np.testing.assert_array_equal(stored.targets["arm"], replayed.targets["arm"])
    np.testing.assert_array_equal(stored.targets["arm"][1:], fast.targets["arm"][2::2])
    np.testing.assert_array_equal(stored.grippers["arm"], replayed.grippers["arm"])


@pytest.mark.parametrize(("steps", "hz", "frames"), [(30, 15, 30), (30, 30, 60), (31, 5, 11), (1, 5, 1), (3, 50, 10)])
def test_the_last_frame_ends_with_the_demonstration(steps: int, hz: float, frames: int) -> None:
    assert frame_count(steps, 15.0, hz) == frames


def test_a_rate_out_of_range_is_refused(demos: Path) -> None:
    found = sf.demonstrations(demos)
    with TrajectorySampler(found.task) as sampler, pytest.raises(SimfoundryError, match="at most 1000"):
        sampler.sample(found[0], 5000.0)


# The greatest distance [m] and angle [rad] between the hands if the converted actions are executed in float32. Joint
# spaces lose only the digits of float32; for the hand, the tolerance of inverse kinematics and its effect in motion.
SPACES = {
    "joint_position": (1e-6, 1e-5),
    "joint_delta": (1e-6, 1e-5),
    "joint_delta:normalized": (1e-6, 1e-5),
    "joint_velocity": (1e-2, 3e-2),
    "joint_velocity:normalized": (1e-2, 3e-2),
    "hand_pose": (2e-3, 6e-3),
    "hand_pose:world:rot6d": (2e-3, 6e-3),
    "hand_pose:rpy": (2e-3, 6e-3),
    "hand_delta": (2e-3, 6e-3),
    "hand_delta:world": (2e-3, 6e-3),
    "hand_delta:hand:rpy": (2e-3, 6e-3),
    "hand_delta:normalized": (2e-3, 6e-3),
}


@pytest.mark.parametrize("text", SPACES)
def test_converted_actions_lead_to_the_same_motion(
    wave: tuple[TrajectorySampler, Demonstration], text: str
) -> None:  # fmt: skip
    sampler, demonstration = wave
    converter = ActionConverter(sampler, ActionSpace.parse(text))
    found = converter.convert(sampler.sample(demonstration))
    error = converter.replay_error(demonstration, found.values.astype(np.float32).astype(np.float64), 15.0)
    distance, angle = SPACES[text]
    assert error.hand_m < distance and error.hand_rad < angle
    assert bool(found.loss) == text.startswith(("joint_velocity", "hand"))


@pytest.mark.parametrize("text", ["joint_position", "joint_delta", "hand_delta:world"])
def test_every_recorded_space_leads_to_the_same_targets(
    wave: tuple[TrajectorySampler, Demonstration], text: str
) -> None:
    """What was recorded in one space is converted back to joint positions through the executed targets."""
    sampler, demonstration = wave
    space = ActionSpace.parse(text)
    trajectory = sampler.sample(demonstration)
    actions = ActionConverter(sampler, space).convert(trajectory).values
    other = demonstration_of(sampler, actions, space, 15.0)
    again = sampler.sample(other)
    assert again.recorded is not None
    back = ActionConverter(sampler, ActionSpace.JOINT_POSITION)
    error = back.replay_error(other, back.convert(again).values, 15.0)
    assert error.is_identical and back.convert(again).loss == ""
    np.testing.assert_array_equal(ActionConverter(sampler, space).convert(again).values, actions)


def test_a_slower_rate_is_stated_as_a_loss_and_its_error_measured(
    wave: tuple[TrajectorySampler, Demonstration],
) -> None:
    sampler, demonstration = wave
    converter = ActionConverter(sampler, ActionSpace.JOINT_POSITION)
    found = converter.convert(sampler.sample(demonstration, 5.0))
    assert "changed within frames of 0.2 s" in found.loss
    assert 1e-3 < converter.replay_error(demonstration, found.values, 5.0).hand_m < 0.1
    exact = converter.convert(sampler.sample(demonstration, 30.0))
    assert exact.loss == "" and converter.replay_error(demonstration, exact.values, 30.0).hand_m == 0.0


def test_actions_out_of_the_limits_are_clipped_and_reported(wave: tuple[TrajectorySampler, Demonstration]) -> None:
    sampler, demonstration = wave
    trajectory = sampler.sample(demonstration)
    wide = replace(trajectory, targets={"arm": trajectory.targets["arm"] * np.linspace(0, 5, 31)[:, None]})
    found = ActionConverter(sampler, ActionSpace.parse("joint_delta:normalized")).convert(wide)
    assert np.abs(found.values).max() == 1.0 and "exceed the limits by up to" in found.loss


def test_targets_of_the_hand_are_its_poses_at_rest(wave: tuple[TrajectorySampler, Demonstration]) -> None:
    sampler, demonstration = wave
    trajectory = sampler.sample(demonstration)
    (poses,) = ActionConverter(sampler, ActionSpace.JOINT_POSITION).hand_targets(trajectory).values()
    start = trajectory.observations["arm/hand"][0]
    np.testing.assert_allclose(poses[0].p, start[:3], atol=1e-9)
    assert poses[0].angle_to(Pose.of(start[:3], start[3:])) < 1e-6


def test_states_are_what_a_policy_receives(wave: tuple[TrajectorySampler, Demonstration]) -> None:
    sampler, demonstration = wave
    trajectory, scene = sampler.sample(demonstration), sampler.task.scene
    gripper = GripperConvention(open=-1.0, closed=2.0)
    for entry in ("joints", "gripper", "joints_gripper", "hand", "hand_quat", "hand_rotvec", "hand_rot6d"):
        found = entry_values(entry, trajectory, scene, gripper)
        assert found.values.shape == (31, len(found.names)) and found.unit
        np.testing.assert_array_equal(found.values[17], reading(entry, trajectory.readings(scene)[17], gripper))
    objects = entry_values("objects", trajectory, scene)
    assert objects.names[7:10] == ("cube_x", "cube_y", "cube_z") and objects.values[0, 7] == pytest.approx(0.6)


def test_low_dimensional_arrays(wave: tuple[TrajectorySampler, Demonstration]) -> None:
    sampler, demonstration = wave
    found = low_dimensional(sampler, demonstration, space=ActionSpace.JOINT_DELTA, hz=30.0)
    assert (found.states.shape, found.actions.shape) == ((61, 22), (60, 8))
    assert found.states.dtype == found.actions.dtype == np.float32
    assert found.action_names[:2] == ("joint_1", "joint_2") and found.action_names[-1] == "gripper"
    assert found.state_names[7:9] == ("gripper", "desk_x") and found.loss == ""
