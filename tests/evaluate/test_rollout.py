"""Rollouts: the same to the last bit, over when the goal has held, and failures written down."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import ImageSize, Observation, PolicyError
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.control import FARTHEST, Controller
from simfoundry.evaluate.rollouts.rollout import HOLD, Progress, RolloutEnd, Video, rollout
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge
from simfoundry.render.gl import Engine, choose_engine
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace, ImageKind
from simfoundry.worlds.base import Image
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.conftest import REPOSITORY


@dataclass
class Pusher:
    """Turns to the block and pushes it out to a reach [m], a little each step; eight actions an answer."""

    reach: float = 0.205
    name: str = "pusher"
    action_space: ActionSpace = ActionSpace.JOINT_POSITION
    cameras: Mapping[str, ImageSize] = field(default_factory=dict)
    control_hz: float | None = None
    image_kinds: tuple[ImageKind, ...] = (ImageKind.COLOR,)
    origin: Mapping[str, Any] = field(default_factory=dict)
    seen: list[Observation] = field(default_factory=list)
    told: str = ""

    def reset(self, instruction: str, seed: int) -> None:
        self.told, self.seen = instruction, []

    def infer(self, observation: Observation) -> Array:
        self.seen.append(observation)
        now = float(observation.robots["arm"].joints[1])
        x, y, _ = observation.state.poses["block"].p
        reach = np.minimum(now + 0.008 * np.arange(1, 9), self.reach)
        return np.column_stack([np.full(8, np.arctan2(y, x)), reach, np.zeros(8)])

    def close(self) -> None:
        pass


class CountingWorld(MujocoWorld):
    """Counts the pictures that are drawn."""

    drawn = 0

    def render(self, camera: str, width: int, height: int) -> Image:
        self.drawn += 1
        return super().render(camera, width, height)


def need_gl() -> None:
    if choose_engine() is Engine.RAYCAST:
        pytest.skip("no GL driver")


def test_a_policy_succeeds_and_its_steps_are_dated(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    policy = Pusher()
    done = rollout(push, push_starts[0], policy, push_world)
    assert done.success and done.end is RolloutEnd.SUCCESS and done.reason == ""
    touched, away = done.subtasks["touch"], done.subtasks["away"]
    assert touched is not None and away is not None and 0 < touched < away
    assert away == done.steps - HOLD + 1  # the goal is that of the last step: it ends when it has held
    assert done.actions.shape == (done.steps, 3) and done.chunks == -(-done.steps // 8) == len(policy.seen)
    assert policy.told == "Push the block away."
    assert [o.time for o in policy.seen] == [pytest.approx(8 * k / 15) for k in range(done.chunks)]
    assert Judge(push.scene)(push.goal, done.final).value
    np.testing.assert_allclose(policy.seen[0].robots["arm"].joints, [0, 0], atol=1e-3)
    assert done.timings.total >= done.timings.physics > 0


def test_the_same_start_and_policy_give_the_same_bits(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    first = rollout(push, push_starts[1], Pusher(), push_world)
    rollout(push, push_starts[2], Pusher(), push_world)  # leaves another state behind
    push_world.robot("arm").set_targets({"turn": 1.0})
    push_world.step(50)
    again = rollout(push, push_starts[1], Pusher(), push_world)
    with MujocoWorld(push.scene) as fresh:
        third = rollout(push, push_starts[1], Pusher(), fresh)
    assert first.digest == again.digest == third.digest
    np.testing.assert_array_equal(first.actions, third.actions)
    assert rollout(push, push_starts[2], Pusher(), push_world).digest != first.digest
    assert rollout(push, push_starts[1], Pusher(reach=0.2), push_world).digest != first.digest


def test_two_policies_begin_alike(push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld) -> None:
    seen = []
    for policy in (Pusher(), Pusher(reach=0.05)):
        for start in push_starts[:3]:
            rollout(push, start, policy, push_world)
            seen.append(np.concatenate([[*p.p, *p.q] for p in policy.seen[0].state.poses.values()]))
    np.testing.assert_array_equal(seen[:3], seen[3:])


def test_pictures_are_drawn_only_when_a_policy_looks_and_change_nothing(
    push: Task, push_starts: tuple[RolloutStart, ...]
) -> None:
    need_gl()
    eyes = {"front": ImageSize(32, 24), "tip": ImageSize(40, 30)}
    with CountingWorld(push.scene) as world:
        blind = rollout(push, push_starts[0], Pusher(), world)
        assert world.drawn == 0
        policy = Pusher(cameras=eyes)
        seeing = rollout(push, push_starts[0], policy, world)
        assert world.drawn == 2 * seeing.chunks < 2 * seeing.steps
        assert {n: i.shape for n, i in policy.seen[0].images.items()} == {"front": (24, 32, 3), "tip": (30, 40, 3)}
        assert seeing.digest == blind.digest
        filmed = rollout(push, push_starts[0], Pusher(), world, video=Video({"front": ImageSize(32, 24)}, every=4))
        assert filmed.digest == blind.digest and len(filmed.frames["front"]) == -(-filmed.steps // 4)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (
            np.zeros((4, 2)),
            r"actions must have shape \(horizon, 3\), for 2 joints and the gripper of `arm`; got \(4, 2\)",
        ),
        (np.zeros((0, 3)), r"got \(0, 3\)"),
        (
            np.array([[0, 0, 0], [0, np.nan, 0]]),
            r"actions must be finite; number 1 of action 1 \(joint 2 of `arm`\) is nan",
        ),
        ("open the gripper", r"actions must be an array of numbers, got str"),
        (np.zeros((1, 3), complex), r"an array of `complex128`"),
        ([["0", "0", "0"]], r"an array of `<U1`"),
        (PolicyError("the server went away"), r"the server went away"),
    ],
)
def test_a_policy_that_fails_ends_its_rollout(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld, answer: object, reason: str
) -> None:
    class Failing(Pusher):
        def infer(self, observation: Observation) -> Array:
            if not self.seen:
                return super().infer(observation)
            if isinstance(answer, PolicyError):
                raise answer
            return answer  # type: ignore[return-value] # what policies must not do

    failed = rollout(push, push_starts[0], Failing(), push_world)
    assert failed.end is (RolloutEnd.NO_ANSWER if isinstance(answer, PolicyError) else RolloutEnd.INVALID)
    assert not failed.success and failed.steps == 8 and len(failed.actions) == 8
    assert re.search(reason, failed.reason)


def test_the_horizon_ends_a_rollout(push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld) -> None:
    late = rollout(replace(push, horizon=11), push_starts[0], Pusher(reach=0.0), push_world)
    assert (late.end, late.steps, late.reason) == (RolloutEnd.HORIZON, 11, "not completed after 11 control steps")
    assert late.subtasks == {"touch": None, "away": None}


def test_what_falls_off_the_table_ends_a_rollout(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    state = push_starts[0].state
    over = replace(state.poses["block"], p=np.array([1.2, 0.0, 0.1]))
    start = replace(push_starts[0], state=SceneState.of({**state.poses, "block": over}, state.joints))
    fell = rollout(push, start, Pusher(reach=0.0), push_world)
    assert fell.end is RolloutEnd.FELL and fell.steps < 10 and "`block` fell to 0.4" in fell.reason
    other = replace(state.poses["crumb"], p=np.array([1.2, 0.0, 0.1]))
    start = replace(push_starts[0], state=SceneState.of({**state.poses, "crumb": other}, state.joints))
    assert rollout(push, start, Pusher(), push_world).success  # the goal does not speak of it


def test_a_simulation_that_diverges_ends_a_rollout(push: Task, push_starts: tuple[RolloutStart, ...]) -> None:
    with MujocoWorld(push.scene) as world:

        class Shaking(Pusher):
            def infer(self, observation: Observation) -> Array:
                world.data.qvel[:] = 1e9 if self.seen else 0.0
                return super().infer(observation)

        lost = rollout(push, push_starts[0], Shaking(), world)
        assert lost.end is RolloutEnd.DIVERGED and "diverged" in lost.reason and lost.steps == 9
        assert rollout(push, push_starts[0], Pusher(), world).success  # a reset mends it


def test_missing_cameras_are_said_before_anything_moves(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    policy = Pusher(cameras={"frnt": ImageSize(32, 24)})
    with pytest.raises(SimfoundryError, match=r"policy `pusher` requests camera `frnt`, .*; did you mean `front`"):
        rollout(push, push_starts[0], policy, push_world)


def test_pybullet_runs_the_same_task(push: Task, push_starts: tuple[RolloutStart, ...]) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    with PybulletWorld(push.scene) as world:
        assert rollout(push, push_starts[0], Pusher(), world).success


def test_velocities_add_up_and_do_not_wind_up(push: Task, push_starts: tuple[RolloutStart, ...]) -> None:
    with MujocoWorld(push.scene) as world:
        world.reset(push_starts[0].state)
        arm = world.robot("arm")
        control = Controller(world, ["arm"], ActionSpace.JOINT_VELOCITY, 15.0)
        for _ in range(15):
            control.begin(np.array([0.3, 0.0, 0.0]))
            control.move(1.0)
            world.step(33)
        assert arm.positions()["turn"] == pytest.approx(0.3, abs=0.05)
        for _ in range(60):
            control.begin(np.array([0.0, 30.0, 0.0]))  # far beyond its range
            control.move(1.0)
        assert world.data.ctrl[1] <= min(0.4, arm.positions()["reach"] + FARTHEST) + 1e-9


def test_a_step_that_holds_at_the_start_counts_once_it_has_been_undone() -> None:
    task = load_task(REPOSITORY / "specs" / "tasks" / "store_marker.task.yaml")
    judge = Judge(task.scene)
    task = replace(task, subtasks={n: task.subtasks[n] for n in ("open_drawer", "close_drawer")})
    closed = SceneState.initial(task.scene)
    opened = SceneState.of(closed.poses, {**closed.joints, "cabinet.drawer": 0.15})
    progress = Progress(task, judge, closed)
    for step, state in enumerate([closed, opened, opened, closed, opened], start=1):
        assert not progress.see(step, state)
    assert progress.subtasks == {"open_drawer": 2, "close_drawer": 4}


def test_a_goal_must_hold_before_it_counts(push: Task) -> None:
    start = SceneState.initial(push.scene)
    block = replace(start.poses["block"], p=np.array([0.45, 0.0, 0.025]))
    there = SceneState.of({**start.poses, "block": block}, start.joints)
    progress = Progress(push, Judge(push.scene), start)
    seen = [progress.see(k, s) for k, s in enumerate([there, there, start, there, there, there], start=1)]
    assert seen == [False] * 5 + [True] and HOLD == 3
    assert progress.subtasks["away"] == 1
