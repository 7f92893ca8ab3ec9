"""A task as a Gymnasium environment, created with ``gymnasium.make("SimFoundry/Task-v0", task="my.task.yaml")``.

Observations and actions have the entries, units and frames of :mod:`simfoundry.spec.models.signals`, like those of
policies. ``docs/signals.md`` lists them.
"""

from __future__ import annotations

from collections.abc import ItemsView, Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from numbers import Integral
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.actions import action_limits, checked_actions
from simfoundry.evaluate.observations import ObservationLayout, image_kinds
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.resets.starts import RolloutStart, starts
from simfoundry.evaluate.rollouts.control import check_cameras, pictures
from simfoundry.evaluate.rollouts.execution import Execution, check_rate
from simfoundry.evaluate.rollouts.rollout import Progress
from simfoundry.evaluate.rollouts.sensors import Sensors
from simfoundry.evaluate.task import Task, load_task, need_robots
from simfoundry.predicates import Judge
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.disturbances import Disturbances
from simfoundry.spec.models.signals import ActionSpace, ImageKind
from simfoundry.worlds import find_world, open_world
from simfoundry.worlds.base import Image


def _integer(name: str, value: Any, low: int | None) -> int:
    """Return an option that must be a whole number, of at least ``low`` if that is given."""
    if isinstance(value, bool) or not isinstance(value, Integral) or (low is not None and value < low):
        bound = "" if low is None else f" of at least {low}"
        raise SimfoundryError(f"{name} must be a whole number{bound}, not {value!r}")
    return int(value)


def _items(cameras: Any) -> ItemsView[str, Any]:
    if not isinstance(cameras, Mapping):
        example = "{'front': (320, 240)}"
        raise SimfoundryError(f"`cameras` must map names of cameras to sizes, such as {example}, not {cameras!r}")
    return cameras.items()


def _image_size(name: str, size: Any) -> ImageSize:
    """Return the size of an image [px]."""
    try:
        width, height = size
    except (TypeError, ValueError):
        message = f"the size of `{name}` must be (width, height), such as (320, 240), not {size!r}"
        raise SimfoundryError(message) from None
    return ImageSize(*(_integer(f"the size of `{name}`", number, None) for number in (width, height)))


class TaskEnv(gymnasium.Env[Any, Any]):
    """An environment that terminates once its goal has held, and truncates the episode at the task's horizon.

    The reward is 1 if the goal has held and 0 otherwise. With ``reward="dense"``, it is the score of the goal in the
    current state, from -1 to 1 (:meth:`simfoundry.predicates.Judge.score`), 1 if the goal has held, and -1 if the
    simulation diverged. ``info`` contains:

    - ``success``: True if the goal has held
    - ``subtasks``: the step at which each sub-task was completed, counted from 1, or 0 if it was not completed
    - ``start``: the index of the initial state
    - ``scores``: the scores of the sub-tasks, only with ``reward="dense"``
    - ``trouble``: the reason why the simulation diverged, or an empty string (divergence also truncates the episode)

    ``reset`` uses its seed to draw one of ``starts`` initial states. ``options={"start": k}`` selects initial state k
    instead. If the task has ``disturbances``, the seed also determines the noise of the episode.
    ``options={"subtask": name}`` starts at that step and uses the goal of that step.

    ``cameras`` maps names of cameras in the scene to (width, height). If it is empty, nothing is rendered. ``images``
    lists the kinds of images of each camera: ``image`` (color), ``depth`` and ``mask``.

    ``action_space`` is the text form of an :class:`~simfoundry.spec.models.signals.ActionSpace`. One step of the
    environment is one action. ``control_hz`` is the number of actions per second, by default that of the task. The goal
    is evaluated at each control step of the task.

    If ``normalize`` is set, actions range from -1 to 1, and observed joints and grippers are mapped from their limits
    to this range. If ``flat`` is set, an observation is one float32 vector that contains all entries except images, in
    the order of the keys of ``layout.limits``; it cannot be combined with cameras.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012 - as Gymnasium has it

    action_space: spaces.Box
    observation_space: spaces.Space[Any]
    _state: SceneState
    _execution: Execution
    _sensors: Sensors
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
        control_hz: float | None = None,
        images: Iterable[str] = (ImageKind.COLOR,),
        normalize: bool = False,
        flat: bool = False,
        reward: str = "sparse",
    ) -> None:
        find_world(engine)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise SimfoundryError(f"unknown render mode `{render_mode}`; the only available mode is rgb_array")
        if reward not in ("sparse", "dense"):
            raise SimfoundryError(f"unknown reward `{reward}`; available: sparse, dense")
        check_rate(control_hz, "the environment")
        if flat and cameras:
            raise SimfoundryError("a flat observation cannot contain images; remove `cameras` or `flat`")
        try:
            self._space = ActionSpace.parse(action_space)
        except ValueError as error:
            raise SimfoundryError(str(error)) from None
        if normalize:
            self._space = replace(self._space, normalized=True)
        self._images, self._normalize, self._flat = image_kinds(images, "the environment"), normalize, flat
        self._rate, self._is_dense = control_hz, reward == "dense"
        self._cache = Cache.default() if cache else None
        self._whole = task if isinstance(task, Task) else load_task(Path(task), self._cache)
        need_robots(self._whole)
        self._engine = engine
        self._count, self._seed = _integer("`starts`", starts, 1), _integer("`seed`", seed, 0)
        self._cameras = {name: _image_size(name, size) for name, size in _items(cameras or {})}
        check_cameras(self._whole.scene, self._cameras, "the environment")
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(control_hz or self._whole.control_hz)}
        self._picture = (
            {} if render_mode is None else {self._watching(render_camera): _image_size("render_size", render_size)}
        )
        check_cameras(self._whole.scene, self._picture, "the environment")
        self._scenes: dict[str, _Opened] = {}
        self._now = self._opened("")
        self._begin(RolloutStart(-1, seed, {}, self._now.world.state()), 0)
        self.layout = self._laid_out(self._now)
        self.action_space = self._actions()
        self.observation_space = self._observed()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
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
        k = int(self.np_random.integers(self._count)) if k is None else _integer("`start`", k, None)
        if not 0 <= k < self._count:
            raise SimfoundryError(f"start {k} does not exist; `start` must be between 0 and {self._count - 1}")
        is_disturbed = self._whole.disturbances != Disturbances()
        noise = int(self.np_random.integers(2**32)) if is_disturbed else 0
        self._begin(self._now.starts(self._count, self._seed, self._cache)[k], noise)
        return self._observation(), self._info(False)

    def step(self, action: NDArray[Any]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Apply one action.

        Raises:
            SimfoundryError: If the action has the wrong type or length, is not finite, or contains an invalid rotation.
                The world then does not change.
        """
        now, success = self._now, False
        checked = checked_actions(action, self._execution.controller.robots, self._space, "the action", single=True)
        for steps in self._execution.act(checked):
            self._steps = steps
            if trouble := now.world.trouble():
                self._trouble = trouble
                break
            self._state = now.world.state()
            success = self._progress.see(self._steps, self._state)
            if success or self._steps >= now.task.horizon:
                break
        if not self._trouble:
            self._state = now.world.state()
        cut = bool(self._trouble) or (not success and self._steps >= now.task.horizon)
        return self._observation(), self._reward(success), success, cut, self._info(success)

    def render(self) -> Image | None:
        """Render the camera, and return a uint8 array of shape (h, w, 3), or None if no render mode is set."""
        return next(iter(pictures(self._now.world, self._picture).values()), None)

    def close(self) -> None:
        """Release the simulators."""
        for opened in self._scenes.values():
            opened.world.close()
        self._scenes.clear()

    def _begin(self, start: RolloutStart, noise: int) -> None:
        now = self._now
        now.world.reset(start.state)
        self._start, self._steps, self._trouble = start, 0, ""
        self._state = now.world.state()
        about, seed, rates = now.task.disturbances, (noise, start.index), (now.task.control_hz, self._rate)
        self._execution = Execution(now.world, now.task.robots, self._space, *rates, about.action, seed)
        self._sensors = Sensors(now.world, self._execution, self._cameras, self._images, about.observation, seed)
        self._progress = Progress(now.task, now.judge, self._state)

    def _observation(self) -> Any:
        sensed = self._sensors.observe(self._state)
        found = self._laid_out(self._now).arrays(sensed.robots, sensed.state, sensed.images)
        return np.concatenate([value.ravel() for value in found.values()]) if self._flat else found

    def _laid_out(self, opened: _Opened) -> ObservationLayout:
        if opened.layout is None:
            robots, cameras = opened.task.robots, self._cameras
            opened.layout = ObservationLayout(opened.world, robots, cameras, self._images, self._normalize)
        return opened.layout

    def _actions(self) -> spaces.Box:
        limits = action_limits(self._space, self._now.world.scene, self._execution.controller.robots)
        low, high = (np.full_like(limits, [-1.0, 1.0]) if self._space.normalized else limits).T.astype(np.float32)
        return spaces.Box(low, high, dtype=np.float32)

    def _observed(self) -> spaces.Space[Any]:
        limits = self.layout.limits
        if self._flat:
            low, high = (np.concatenate([ends[k].ravel() for ends in limits.values()]) for k in (0, 1))
            return spaces.Box(low, high, dtype=np.float32)
        return spaces.Dict({key: spaces.Box(low, high, dtype=low.dtype.type) for key, (low, high) in limits.items()})

    def _reward(self, success: bool) -> float:
        if not self._is_dense or success:
            return float(success)
        return -1.0 if self._trouble else self._now.judge.score(self._now.task.goal, self._state)

    def _info(self, success: bool) -> dict[str, Any]:
        subtasks = dict.fromkeys(self._whole.subtasks, 0) | {n: s or 0 for n, s in self._progress.subtasks.items()}
        info = {"success": success, "subtasks": subtasks, "start": self._start.index, "trouble": self._trouble}
        if self._is_dense:
            scores = {n: self._now.judge.score(s.goal, self._state) for n, s in self._now.task.subtasks.items()}
            info["scores"] = dict.fromkeys(self._whole.subtasks, 0.0) | scores
        return info

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
        self.layout: ObservationLayout | None = None
        self.starts = cache(partial(starts, task))
