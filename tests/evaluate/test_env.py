"""The Gymnasium environment: by its checkers, alone and many at once."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.task import Task
from simfoundry.render.gl import Engine, choose_engine
from simfoundry.spec.models.disturbances import ActionDisturbances, Disturbances, ObservationDisturbances

gymnasium = pytest.importorskip("gymnasium", reason="the environment needs the extra `gymnasium`")

from simfoundry.evaluate.env import TaskEnv  # noqa: E402
from simfoundry.evaluate.gym import ENV_ID as ENV  # noqa: E402 - registers it


@pytest.fixture(scope="module")
def env(push: Task) -> Iterator[TaskEnv]:
    made = TaskEnv(push, starts=3, cache=False)
    yield made
    made.close()


def push_out(env: TaskEnv) -> tuple[float, bool, bool, dict[str, object], int]:
    """Turn to the block and push it slowly to where the goal wants it."""
    observation, _ = env.reset(options={"start": 0})
    x, y, *_ = observation["objects"][1]
    for k in range(60):
        action = np.array([np.arctan2(y, x), min(0.008 * max(0, k - 5), 0.205), 0.0])
        observation, reward, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            return reward, terminated, truncated, info, k + 1
    raise AssertionError("neither done nor cut off")


@pytest.mark.slow  # 3 s: its checker
def test_gymnasium_finds_no_fault(push_file: Path) -> None:
    from gymnasium.utils.env_checker import check_env

    cameras = {"front": (32, 24)} if choose_engine() is not Engine.RAYCAST else {}
    made = gymnasium.make(
        ENV, task=str(push_file), cameras=cameras, starts=2, cache=False, render_mode="rgb_array" if cameras else None
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(made.unwrapped)
    # Positions in the world have no bounds, and actions are in radians and meters, as the robots take them.
    usual = ("infinity", "symmetric and normalized")
    assert [str(w.message) for w in caught if not any(part in str(w.message) for part in usual)] == []
    made.close()


@pytest.mark.parametrize(
    "options",
    [
        {"flat": True, "normalize": True, "reward": "dense"},
        {"action_space": "joint_delta", "control_hz": 5.0},
        {"action_space": "joint_velocity:normalized"},
    ],
)
@pytest.mark.filterwarnings("ignore:.*(infinity|symmetric and normalized)")
def test_gymnasium_finds_no_fault_in_variants(push: Task, options: dict[str, object]) -> None:
    from gymnasium.utils.env_checker import check_env

    made = TaskEnv(push, starts=1, cache=False, **options)  # type: ignore[arg-type]
    check_env(made, skip_render_check=True)
    observation, _ = made.reset(seed=1)
    arrays = observation.values() if isinstance(observation, dict) else [observation]
    assert {array.dtype for array in arrays} == {np.dtype(np.float32)} and made.action_space.dtype == np.float32
    made.close()


def test_an_episode_ends_with_the_goal_or_at_the_horizon(env: TaskEnv) -> None:
    reward, terminated, truncated, info, steps = push_out(env)
    assert (reward, terminated, truncated) == (1.0, True, False) and info["success"] is True
    subtasks = info["subtasks"]
    assert isinstance(subtasks, dict) and 0 < subtasks["touch"] < subtasks["away"] == steps - 2
    env.reset(options={"start": 1})
    for k in range(1, 46):
        _, reward, terminated, truncated, info = env.step(np.zeros(3))
        assert (reward, terminated, truncated) == (0.0, False, k == 45)
    assert info == {"success": False, "subtasks": {"touch": 0, "away": 0}, "start": 1, "trouble": ""}


def test_a_dense_reward_grows_as_the_block_moves_and_ends_with_one(push: Task) -> None:
    dense = TaskEnv(push, starts=1, cache=False, reward="dense")
    _, info = dense.reset(options={"start": 0})
    assert info["scores"].keys() == {"touch", "away"} and info["scores"]["touch"] < 0
    observation, _ = dense.reset(options={"start": 0})
    (x, y, *_), rewards, at = observation["objects"][1], [], []
    for k in range(60):
        action = np.array([np.arctan2(y, x), min(0.008 * max(0, k - 5), 0.205), 0.0])
        observation, reward, terminated, *_ = dense.step(action)
        rewards.append(reward)
        at.append(float(np.hypot(observation["objects"][1][0] - 0.45, observation["objects"][1][1])))
        if terminated:
            break
    assert terminated and rewards[-1] == 1.0 and rewards[0] < -0.4
    order = np.argsort(at[:-1])  # the nearer the block, the greater the reward
    assert (np.diff(np.array(rewards[:-1])[order]) <= 1e-6).all()
    dense.close()
    with pytest.raises(SimfoundryError, match="unknown reward `shaped`; available: sparse, dense"):
        TaskEnv(push, reward="shaped")


def test_resets_are_the_starts_of_rollouts_and_repeat(env: TaskEnv, push_starts: tuple[RolloutStart, ...]) -> None:
    for k in (2, 0):
        observation, info = env.reset(options={"start": k})
        assert info["start"] == k
        poses = [[*p.p, *p.q] for p in push_starts[k].state.poses.values()]
        np.testing.assert_allclose(observation["objects"], poses, atol=1e-12)
    drawn = [env.reset(seed=s)[1]["start"] for s in (5, 5, 6, 7, 8, 9, 10)]
    assert drawn[0] == drawn[1] and len(set(drawn)) > 1
    first, again = (trajectory(env) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def trajectory(env: TaskEnv) -> list[np.ndarray]:
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    low, high = (np.asarray(end, dtype=np.float64) for end in (env.action_space.low, env.action_space.high))
    return [env.step(low + rng.random(3) * (high - low))[0]["objects"] for _ in range(12)]


def test_a_step_can_be_done_alone(env: TaskEnv) -> None:
    observation, info = env.reset(options={"start": 1, "subtask": "away"})
    assert observation["objects"][1][0] == pytest.approx(0.4, abs=1e-3)
    assert info["subtasks"] == {"touch": 0, "away": 0}
    observation, _ = env.reset(options={"start": 1})
    assert observation["objects"][1][0] < 0.34


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": 3}, "start 3 does not exist; `start` must be between 0 and 2"),
        ({"subtask": "awy"}, "did you mean `away`"),
        ({"cell": 3}, "unknown reset option `cell`; available options: start, subtask"),
        ({"start": "first"}, "`start` must be a whole number, not 'first'"),
        ({"start": 1.5}, "`start` must be a whole number, not 1.5"),
    ],
)
def test_options_that_mean_nothing_are_refused(env: TaskEnv, options: dict[str, object], message: str) -> None:
    with pytest.raises(SimfoundryError, match=message):
        env.reset(options=options)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.array([0.0, np.nan, 0.0]), r"the action must be finite; number 1 \(joint 2 of `arm`\) is nan"),
        (np.array([np.inf, 0.0, 0.0]), r"number 0 \(joint 1 of `arm`\) is inf"),
        (np.zeros(2), r"must have shape \(3,\), for 2 joints and the gripper of `arm`; got \(2,\)"),
        (np.zeros((1, 3)), r"got \(1, 3\)"),
        ("up", "must be an array of numbers, got str"),
        (None, "must be an array of numbers, got NoneType"),
    ],
)
def test_an_action_that_is_none_moves_nothing(env: TaskEnv, action: np.ndarray, message: str) -> None:
    env.reset(options={"start": 0})
    before = env.step(np.zeros(3))[0]["arm/joints"]
    with pytest.raises(SimfoundryError, match=message):
        env.step(action)
    np.testing.assert_allclose(env.step(np.zeros(3))[0]["arm/joints"], before, atol=1e-3)


def test_slips_in_making_one_are_refused(push: Task) -> None:
    with pytest.raises(SimfoundryError, match="scenes cannot be run in `mujuco`; available simulators: "):
        TaskEnv(push, engine="mujuco")
    with pytest.raises(SimfoundryError, match="unknown render mode `human`"):
        TaskEnv(push, render_mode="human")
    with pytest.raises(SimfoundryError, match=r"requests camera `frnt`.*did you mean `front`"):
        TaskEnv(push, cameras={"frnt": (8, 8)})
    with pytest.raises(
        SimfoundryError, match=r"unknown action space `torque`; available: joint_position, joint_velocity"
    ):
        TaskEnv(push, action_space="torque")
    for options, message in (
        ({"cameras": "front"}, "`cameras` must map names of cameras to sizes, such as {'front': (320, 240)}"),
        ({"cameras": {"front": 64}}, "the size of `front` must be (width, height), such as (320, 240), not 64"),
        ({"cameras": {"front": (3.5, 3)}}, "the size of `front` must be a whole number, not 3.5"),
        ({"starts": 0}, "`starts` must be a whole number of at least 1, not 0"),
        ({"seed": None}, "`seed` must be a whole number of at least 0, not None"),
    ):
        with pytest.raises(SimfoundryError, match=re.escape(message)):
            TaskEnv(push, **options)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_many_run_side_by_side_and_reset_one_by_one(push_file: Path, mode: str) -> None:
    from gymnasium.vector import AutoresetMode

    many = gymnasium.make_vec(
        ENV,
        num_envs=2,
        vectorization_mode=mode,
        vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED},
        task=str(push_file),
        starts=2,
        cache=False,
    )
    first, info = many.reset(seed=[1, 2], options={"start": 1})
    np.testing.assert_array_equal(first["objects"][0], first["objects"][1])
    assert info["start"].tolist() == [1, 1] and first["arm/joints"].shape == (2, 2)
    moved, *_ = many.step(np.array([[0.5, 0.1, 0.0], [0.0, 0.0, 0.0]]))
    assert abs(moved["arm/joints"][0, 0]) > 0.01 > abs(moved["arm/joints"][1, 0])
    again, _ = many.reset(options={"start": 1, "reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(again["objects"][0], first["objects"][0])
    np.testing.assert_array_equal(again["arm/joints"][1], moved["arm/joints"][1])
    many.close()


def test_the_registration_loads_no_simulator() -> None:
    code = (
        "import sys, gymnasium, simfoundry.evaluate.gym;"
        "print([m for m in ('mujoco', 'pybullet', 'scipy', 'pydantic') if m in sys.modules],"
        "'SimFoundry/Task-v0' in gymnasium.registry)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] True"


def test_the_seed_of_an_episode_decides_its_noise(push: Task) -> None:
    about = Disturbances(
        action=ActionDisturbances(latency=0.03, joint_noise=0.02),
        observation=ObservationDisturbances(latency=0.1, joint_noise=0.01, object_noise=0.01, gripper_noise=0.2),
    )
    made = TaskEnv(replace(push, disturbances=about), starts=2, cache=False)
    try:

        def episode(seed: int | None) -> np.ndarray:
            seen, _ = made.reset(seed=seed, options={"start": 1})
            rows = [seen]
            for k in range(6):
                seen, *_ = made.step(np.array([0.1 * k, 0.05, 1.0], np.float32))
                rows.append(seen)
            assert all(row in made.observation_space for row in rows)
            return np.array(
                [np.concatenate([row["arm/joints"], row["objects"].ravel(), row["arm/gripper"]]) for row in rows]
            )

        first, second, again = episode(5), episode(None), episode(5)
        np.testing.assert_array_equal(first, again)
        assert np.abs(first - second).min(axis=0).max() > 0
        assert np.abs(first[0] - second[0]).max() > 1e-3  # also before the first action
    finally:
        made.close()
