"""Latency and noise: what acts, what is observed, and that the same seed gives the same bits."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from simfoundry.evaluate.policies.base import ImageSize, Observation
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.execution import Execution
from simfoundry.evaluate.rollouts.noise import SensorNoise
from simfoundry.evaluate.rollouts.rollout import Rollout, rollout
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.render.gl import Engine, choose_engine
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.disturbances import ActionDisturbances, Disturbances, ObservationDisturbances
from simfoundry.spec.models.signals import ActionSpace, ImageKind
from simfoundry.worlds.base import Image, World, WorldRobot
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.cli.command import run
from tests.conftest import REPOSITORY

# Control steps in the rollouts below, unless the goal is reached before.
STEPS = 24


@dataclass
class Swing:
    """Turns the arm to and fro with actions that do not depend on what it sees; some actions an answer."""

    chunk: int = 4
    space: str = "joint_position"
    cameras: Mapping[str, ImageSize] = field(default_factory=dict)
    image_kinds: tuple[ImageKind, ...] = (ImageKind.COLOR,)
    origin: Mapping[str, Any] = field(default_factory=dict)
    control_hz: float | None = None
    name: str = "swing"
    seen: list[Observation] = field(default_factory=list)
    asked: int = 0

    def __post_init__(self) -> None:
        self.action_space = ActionSpace.parse(self.space)

    def reset(self, instruction: str, seed: int) -> None:
        self.seen, self.asked = [], 0

    def infer(self, observation: Observation) -> Array:
        self.seen.append(observation)
        k = self.asked + np.arange(self.chunk)
        self.asked += self.chunk
        return np.column_stack([0.3 * np.sin(0.4 * k), 0.02 * np.ones(self.chunk), 0.5 + 0.4 * np.cos(k)])

    def close(self) -> None:
        pass


def disturbed(task: Task, action: Mapping[str, float] = MappingProxyType({}), **observation: float) -> Task:
    about = Disturbances(action=ActionDisturbances(**action), observation=ObservationDisturbances(**observation))
    return replace(task, disturbances=about, horizon=STEPS)


def swing(task: Task, start: RolloutStart, world: World, **more: object) -> tuple[Rollout, Swing]:
    policy = Swing(**more)  # type: ignore[arg-type]
    return rollout(task, start, policy, world, trace=True), policy


def joints(done: Rollout) -> Array:
    return np.array([robots["arm"].joints for _, robots in done.trace])


@pytest.fixture(scope="module")
def start(push_starts: tuple[RolloutStart, ...]) -> RolloutStart:
    return push_starts[1]


@pytest.mark.parametrize("space", ["joint_position", "joint_velocity", "joint_delta"])
def test_without_disturbances_nothing_changes_and_with_them_the_seed_decides(
    push: Task, start: RolloutStart, push_world: MujocoWorld, space: str
) -> None:
    plain, _ = swing(replace(push, horizon=STEPS), start, push_world, space=space)
    assert swing(disturbed(push), start, push_world, space=space)[0].digest == plain.digest
    noisy = disturbed(push, {"latency": 0.05, "joint_noise": 0.01, "gripper_noise": 0.1}, latency=0.1, joint_noise=0.1)
    first, _ = swing(noisy, start, push_world, space=space)
    with MujocoWorld(push.scene) as fresh:  # other answers, other queries, and another world
        again, _ = swing(noisy, start, fresh, space=space, chunk=7)
    np.testing.assert_array_equal(first.actions, again.actions)
    np.testing.assert_array_equal(joints(first), joints(again))
    assert first.digest == again.digest != plain.digest
    for other in (replace(start, seed=start.seed + 1), replace(start, index=start.index + 1)):
        assert swing(noisy, other, push_world, space=space)[0].digest != first.digest
    for less in ({"joint_noise": 0.01, "gripper_noise": 0.1}, {"latency": 0.05, "gripper_noise": 0.1}):
        assert swing(disturbed(push, less), start, push_world, space=space)[0].digest != first.digest


def test_an_action_takes_effect_after_its_latency(push: Task, start: RolloutStart, push_world: MujocoWorld) -> None:
    plain, _ = swing(replace(push, horizon=STEPS), start, push_world)
    period = 1 / push.control_hz
    late, _ = swing(disturbed(push, {"latency": 3 * period}), start, push_world)
    # The arm does what it did, three control steps later; a control step has 33 or 34 physics steps.
    np.testing.assert_allclose(joints(late)[3:], joints(plain)[:-3], atol=0.01)
    assert np.abs(joints(late)[2] - joints(late)[0]).max() < 1e-3 < np.abs(joints(plain)[2] - joints(plain)[0]).max()
    np.testing.assert_array_equal(late.actions, plain.actions)  # the record contains what the policy wanted


@pytest.mark.parametrize("engine", [MujocoWorld, PybulletWorld])
def test_errors_of_targets_have_their_deviation_and_do_not_add_up(
    push: Task, start: RolloutStart, engine: type[MujocoWorld | PybulletWorld]
) -> None:
    with engine(push.scene) as world:
        world.reset(start.state)
        about = ActionDisturbances(joint_noise=0.01)
        execution = Execution(world, push.robots, ActionSpace.JOINT_DELTA, 15.0, 15.0, about, (0, 1))
        robot, wanted = world.robot("arm"), list[float]()
        set_targets = type(robot).set_targets

        def noted(self: WorldRobot, targets: Mapping[str, float]) -> None:
            wanted.append(targets["turn"])
            set_targets(self, targets)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(type(robot), "set_targets", noted)
            for _ in range(150):
                list(execution.act(np.zeros(3)))
    errors = np.array(wanted) - np.mean(wanted)
    assert 0.008 < errors.std() < 0.012 and abs(np.mean(wanted)) < 0.005
    assert abs(np.corrcoef(errors[:-1], errors[1:])[0, 1]) < 0.25  # errors that add up would be correlated


class CountingWorld(MujocoWorld):
    """Counts the images that are rendered."""

    drawn = 0

    def render(self, camera: str, width: int, height: int) -> Image:
        self.drawn += 1
        return super().render(camera, width, height)


class DenseWorld(MujocoWorld):
    """Notes the joints of the arm after each physics step."""

    dense: list[Array]

    def reset(self, state: SceneState | None = None) -> None:
        super().reset(state)
        self.dense = [self.data.qpos[-2:].copy()]

    def step(self, n: int = 1) -> None:
        for _ in range(n):
            super().step()
            self.dense.append(self.data.qpos[-2:].copy())


@pytest.mark.parametrize("latency", [0.02, 0.1, 0.5])
def test_an_observation_is_as_old_as_its_latency(push: Task, start: RolloutStart, latency: float) -> None:
    with DenseWorld(push.scene) as world:
        done, policy = swing(disturbed(push, latency=latency), start, world, chunk=3)
        dense = list(world.dense)
        digest = swing(replace(push, horizon=STEPS), start, world, chunk=3)[0].digest
    for k, seen in enumerate(policy.seen):
        step = max(0, round(3 * k / push.control_hz / 0.002) - round(latency / 0.002))
        np.testing.assert_array_equal(seen.robots["arm"].joints, dense[step])
        assert seen.true_robots is not None and seen.sensed is not None
        np.testing.assert_array_equal(seen.true_robots["arm"].joints, joints(done)[3 * k])
        np.testing.assert_array_equal(seen.privileged().robots["arm"].joints, joints(done)[3 * k])
    assert done.digest == digest  # looking back does not change what happens


def test_noise_of_readings_and_poses_has_its_deviation(
    push: Task, start: RolloutStart, push_world: MujocoWorld
) -> None:
    deviations = {"joint_noise": 0.02, "gripper_noise": 0.05, "hand_noise": 0.01, "hand_noise_deg": 2.0,
                  "object_noise": 0.004, "object_noise_deg": 5.0}  # fmt: skip
    done, policy = swing(replace(disturbed(push, {}, **deviations), horizon=120), start, push_world, chunk=1)
    errors: dict[str, list[float]] = {key: [] for key in ("joints", "hand", "hand turn", "object", "object turn")}
    for seen, (state, robots) in zip(policy.seen, done.trace, strict=False):
        one, truth = seen.robots["arm"], robots["arm"]
        errors["joints"] += (one.joints - truth.joints).tolist()
        errors["hand"] += (one.X_WH.p - truth.X_WH.p).tolist()
        errors["hand turn"].append(one.X_WH.angle_to(truth.X_WH))
        X_WB = push.scene.robot("arm").X_WB
        np.testing.assert_allclose((X_WB @ one.X_BH).p, one.X_WH.p, atol=1e-9)
        errors["object"] += (seen.objects["block"].p - state.poses["block"].p).tolist()
        errors["object turn"].append(seen.objects["block"].angle_to(state.poses["block"]))
        assert seen.state.poses["block"].p.tolist() == state.poses["block"].p.tolist() and 0 <= one.gripper <= 1
    for key, deviation in (("joints", 0.02), ("hand", 0.01), ("object", 0.004)):
        assert np.std(errors[key]) == pytest.approx(deviation, rel=0.15) and abs(np.mean(errors[key])) < deviation / 3
    for key, deviation in (("hand turn", 2.0), ("object turn", 5.0)):  # the angle of three components
        assert np.sqrt(np.mean(np.square(errors[key])) / 3) == pytest.approx(np.radians(deviation), rel=0.15)


def test_noise_of_images() -> None:
    image, steps = np.full((120, 160, 3), 100, np.uint8), range(5)
    noise = SensorNoise(ObservationDisturbances(image_noise=0.02, exposure_noise=0.5), (0, 3))
    seen = [noise.image(image, "front", step).astype(float) for step in steps]
    assert all(one.std() == pytest.approx(5.1, rel=0.05) for one in seen) and not np.array_equal(seen[0], seen[1])
    assert np.ptp([one.mean() for one in seen]) < 0.2  # the exposure of a camera stays during a rollout
    assert abs(seen[0].mean() - noise.image(image, "wrist", 0).mean()) > 1
    brighter = SensorNoise(ObservationDisturbances(exposure=1.0), (0, 3)).image(image, "front", 0)
    assert brighter.flat[0] == 138  # twice the light of sRGB 100: ((100/255 + 0.055)/1.055)^2.4 * 2, encoded again
    depth = np.tile(np.linspace(0.0, 3.0, 160, dtype=np.float32), (120, 1))
    near_far = SensorNoise(ObservationDisturbances(depth_noise=0.01, depth_dropout=0.1), (0, 3)).depth(
        depth, "front", 0
    )
    assert near_far.dtype == np.float32 and not near_far[:, 0].any() and near_far.min() == 0
    holes = (near_far[:, 1:] == 0).mean()
    assert holes == pytest.approx(0.1, abs=0.01)
    for column in (53, 106, 159):
        errors = (near_far - depth)[:, column][near_far[:, column] > 0]
        assert errors.std() == pytest.approx(0.01 * depth[0, column] ** 2, rel=0.25)


def test_late_images_show_the_past_and_are_rendered_only_on_demand(
    push: Task, start: RolloutStart, push_world: MujocoWorld
) -> None:
    if choose_engine() is Engine.RAYCAST:
        pytest.skip("no GL driver")
    cameras, kinds = {"front": ImageSize(64, 48)}, (ImageKind.COLOR, ImageKind.MASK)
    period = 1 / push.control_hz
    now = swing(replace(push, horizon=12), start, push_world, chunk=1, cameras=cameras, image_kinds=kinds)[1]
    task = replace(disturbed(push, image_latency=2 * period), horizon=12)
    late = swing(task, start, push_world, chunk=1, cameras=cameras, image_kinds=kinds)[1]
    for k in range(2, 12):
        changed = np.abs(late.seen[k].images["front"].astype(int) - now.seen[k - 2].images["front"])
        assert (
            changed.mean() < np.abs(late.seen[k].images["front"].astype(int) - now.seen[k].images["front"]).mean() + 1
        )
        assert np.mean(late.seen[k].masks["front"] != now.seen[k - 2].masks["front"]) < 0.01
        np.testing.assert_array_equal(late.seen[k].robots["arm"].joints, now.seen[k].robots["arm"].joints)
    with CountingWorld(push.scene) as world:
        chunks = swing(task, start, world, chunk=4, cameras=cameras)[1]
        drawn = world.drawn
    # One for each observation, and one for each that could have followed within the latency.
    assert len(chunks.seen) == 3 and drawn < 12


def test_states_of_another_task_are_untouched() -> None:
    state = SceneState.of({}, {"drawer.slide": 0.1})
    noise = SensorNoise(ObservationDisturbances(object_joint_noise=0.01), (0, 0))
    seen = noise.state(state, 7)
    assert seen.joints["drawer.slide"] != 0.1 and noise.state(state, 7).joints == seen.joints
    assert noise.state(state, 8).joints != seen.joints and state.joints["drawer.slide"] == 0.1


def test_the_page(push_file: Path, tmp_path: Path) -> None:
    page = (REPOSITORY / "docs" / "rollouts.md").read_text()
    block = page.partition("## Latency and noise")[2].partition("```yaml\n")[2].partition("```")[0]
    shutil.copytree(push_file.parent, tmp_path / "bench")
    document = tmp_path / "bench" / push_file.name
    document.write_text(push_file.read_text() + block)
    assert run("check", document).code == 0
    about = load_task(document).disturbances
    assert about.action.latency == 0.03 and about.observation.image_latency == 0.08
    assert run("fmt", document).code == 0 and load_task(document).disturbances == about
    told = run("diff", push_file, document).out
    assert "disturbances action latency 0 (default) → 0.03 s; " in told and "image_latency now 0.08 s" in told
    flat = run("flatten", document).out
    assert "disturbances:" in flat and "exposure_noise: 0.3" in flat
