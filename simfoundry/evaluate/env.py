"""A task as a Gymnasium environment, created with ``gymnasium.make("SimFoundry/Task-v0", task="my.task.yaml")``.

An observation is a dictionary of arrays:

- ``arm/joints`` [rad or m], ``arm/gripper`` (from 0, open, to 1, closed) and ``arm/hand`` (position [m] and wxyz
  quaternion in the world) for each robot, here named ``arm``
- ``objects``: the position [m] and wxyz quaternion of each object in the world, shape (objects, 7)
- ``joints``: the positions of the objects' joints [rad or m]
- ``image/camera`` for each requested camera, here named ``camera``

An action has the same layout as a policy's action: the joint positions or velocities of each robot, followed by the
position of its gripper.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, checked_actions
from simfoundry.evaluate.resets.starts import RolloutStart, starts
from simfoundry.evaluate.rollouts.control import Controller, check_cameras, physics_steps, pictures, readings
from simfoundry.evaluate.rollouts.rollout import Progress
from simfoundry.evaluate.task import Task, load_task, need_robots
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge
from simfoundry.scene.state import SceneState
from simfoundry.worlds import find_world, open_world
from simfoundry.worlds.base import Image, WorldRobot

# The maximum joint velocity in an action [rad/s or m/s]: DROID's 0.2 rad per step at 15 Hz.
FASTEST = 3.0

Observations = dict[str, NDArray[Any]]


class TaskEnv(gymnasium.Env[Any, Any]):
    """An environment that terminates once its goal has held, and truncates the episode at the task's horizon.

    The reward is 1 if the goal has held and 0 otherwise. ``info`` contains:

    - ``success``: True if the goal has held
    - ``subtasks``: the step at which each sub-task was completed, counted from 1, or 0 if it was not completed
    - ``start``: the index of the initial state
    - ``trouble``: the reason why the simulation diverged, or an empty string (divergence also truncates the episode)

    ``reset`` uses its seed to draw one of ``starts`` initial states. ``options={"start": k}`` selects initial state k
    instead. ``options={"subtask": name}`` starts at that step and uses the goal of that step.

    ``cameras`` maps names of cameras in the scene to (width, height). If it is empty, nothing is rendered.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012 - as Gymnasium has it

    action_space: spaces.Box
    observation_space: spaces.Dict
    _state: SceneState
    _controller: Controller
    _progress: Progress

    def __init__(
        self,
        task: str | Path | Task,
        engine: str = "mujoco",
        cameras: Mapping[str, tuple[int, int]] | None = None,
        action_space: str = "joint_position",
        starts: int = 25,
        seed: int = 0,
        render_mode: str | None = None,
        render_camera: str | None = None,
        render_size: tuple[int, int] = (640, 480),
        cache: bool = True,
    ) -> None:
        find_world(engine)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise SimfoundryError(f"unknown render mode `{render_mode}`; the only available mode is rgb_array")
        if action_space not in list(ActionSpace):
            raise SimfoundryError(f"unknown action space `{action_space}`; available: {', '.join(ActionSpace)}")
        self._cache = Cache.default() if cache else None
        self._whole = task if isinstance(task, Task) else load_task(Path(task), self._cache)
        need_robots(self._whole)
        self._engine, self._count, self._seed = engine, starts, seed
        self._cameras = {name: ImageSize(*size) for name, size in (cameras or {}).items()}
        check_cameras(self._whole.scene, self._cameras, "the environment")
        self._kind = ActionSpace(action_space)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(self._whole.control_hz)}
        self._picture = {} if render_mode is None else {self._watching(render_camera): ImageSize(*render_size)}
        check_cameras(self._whole.scene, self._picture, "the environment")
        self._scenes: dict[str, _Opened] = {}
        self._now = self._opened("")
        self.action_space = _actions(self._now.robots, self._kind)
        self._begin(RolloutStart(-1, seed, {}, self._now.world.state()))
        self.observation_space = spaces.Dict({k: _space(k, v) for k, v in self._observation().items()})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Reset to an initial state.

        The class docstring describes ``options``.
        """
        super().reset(seed=seed)
        options = options or {}
        unknown = sorted(set(options) - {"start", "subtask", "reset_mask"})
        if unknown:
            raise SimfoundryError(f"unknown reset option `{unknown[0]}`; available options: start, subtask")
        self._now = self._opened(str(options.get("subtask") or ""))
        k = options.get("start")
        k = int(self.np_random.integers(self._count)) if k is None else int(k)
        if not 0 <= k < self._count:
            raise SimfoundryError(f"start {k} does not exist; `start` must be between 0 and {self._count - 1}")
        self._begin(self._now.starts(self._count, self._seed, self._cache)[k])
        return self._observation(), self._info(False)

    def step(self, action: Array) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """Apply one action.

        Raises:
            SimfoundryError: If the action has the wrong length or is not finite.
        """
        now, task = self._now, self._now.task
        self._controller.apply(checked_actions(action, now.robots, "the action", single=True))
        now.world.step(physics_steps(self._steps, task.control_hz, now.world.timestep))
        self._steps += 1
        self._trouble = now.world.trouble()
        self._state = self._state if self._trouble else now.world.state()
        success = not self._trouble and self._progress.see(self._steps, self._state)
        cut = bool(self._trouble) or (not success and self._steps >= task.horizon)
        return self._observation(), float(success), success, cut, self._info(success)

    def render(self) -> Image | None:
        """Render the camera, and return a uint8 array of shape (h, w, 3), or None if no render mode is set."""
        return next(iter(pictures(self._now.world, self._picture).values()), None)

    def close(self) -> None:
        """Release the simulators."""
        for opened in self._scenes.values():
            opened.world.close()
        self._scenes.clear()

    def _begin(self, start: RolloutStart) -> None:
        now = self._now
        now.world.reset(start.state)
        self._start, self._steps, self._trouble = start, 0, ""
        self._state = now.world.state()
        self._controller = Controller(now.robots, self._kind, now.task.control_hz)
        self._progress = Progress(now.task, now.judge, self._state)

    def _observation(self) -> Observations:
        found: Observations = {}
        for name, reading in readings(self._now.world, self._now.robots).items():
            found[f"{name}/joints"] = np.array(reading.joints)
            found[f"{name}/gripper"] = np.array([reading.gripper])
            found[f"{name}/hand"] = np.concatenate([reading.X_WH.p, reading.X_WH.q])
        poses = self._state.poses.values()
        found["objects"] = np.array([(*pose.p.tolist(), *pose.q.tolist()) for pose in poses]).reshape(len(poses), 7)
        found["joints"] = np.array(list(self._state.joints.values()), dtype=np.float64)
        for name, image in pictures(self._now.world, self._cameras).items():
            found[f"image/{name}"] = image
        return found

    def _info(self, success: bool) -> dict[str, Any]:
        subtasks = dict.fromkeys(self._whole.subtasks, 0) | {n: s or 0 for n, s in self._progress.subtasks.items()}
        return {"success": success, "subtasks": subtasks, "start": self._start.index, "trouble": self._trouble}

    def _opened(self, step: str) -> _Opened:
        """Open the world for the whole task or for a single step.

        The scene of a step may have different joint targets.
        """
        if step not in self._scenes:
            task = self._whole.alone(step) if step else self._whole
            self._scenes[step] = _Opened(task, self._engine)
        return self._scenes[step]

    def _watching(self, camera: str | None) -> str:
        scene = self._whole.scene
        names = [c.name for c in scene.cameras] + [m.camera.name for m in scene.mounted]
        if camera is None and not names:
            raise SimfoundryError(f"scene `{scene.name}` has no camera to render from")
        return camera or names[0]


class _Opened:
    """A task with its world and its judge."""

    def __init__(self, task: Task, engine: str) -> None:
        self.task, self.world, self.judge = task, open_world(task.scene, engine), Judge(task.scene)
        self.robots: dict[str, WorldRobot] = {name: self.world.robot(name) for name in task.robots}
        self.starts = cache(partial(starts, task))


def _actions(robots: Mapping[str, WorldRobot], kind: ActionSpace) -> spaces.Box:
    """Return the action space.

    It consists of the position limits or maximum velocities of the joints and the range of each gripper.
    """
    rows: list[tuple[float, float]] = []
    for robot in robots.values():
        limits = robot.limits().values()
        rows += limits if kind is ActionSpace.JOINT_POSITION else [(-FASTEST, FASTEST)] * len(limits)
        rows.append((0.0, 1.0))
    low, high = np.array(rows).T
    return spaces.Box(low, high, dtype=np.float64)


def _space(key: str, value: NDArray[Any]) -> spaces.Box:
    """Return the observation space for a single entry of an observation.

    Positions are unbounded because engines slightly exceed joint limits.
    """
    if value.dtype == np.uint8:
        return spaces.Box(0, 255, value.shape, np.uint8)
    low, high = (0.0, 1.0) if key.endswith("/gripper") else (-np.inf, np.inf)
    return spaces.Box(low, high, value.shape, np.float64)
