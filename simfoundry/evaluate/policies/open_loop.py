"""Open-loop policies, which are a random walk that serves as a baseline and the replay of a recorded rollout."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.evaluate.actions import action_size, columns, rotation_numbers
from simfoundry.evaluate.policies.base import InvalidAnswerError, Observation, Policy, PolicyError
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ActionSpace, RotationForm

# Maximum joint motion per control step in either direction [rad or m]; equals 1.5 rad/s at 15 Hz.
STEP = 0.1
# Number of actions per request, the same as for the policies in the paper.
HORIZON = 8


class RandomPolicy(Policy):
    """A random walk of the joints from their current positions, with steps of up to :data:`STEP`.

    For each request, the gripper is set to open or closed at random.
    """

    name = "random"
    action_space = ActionSpace.JOINT_POSITION

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout. The same seed always produces the same walk."""
        self._rng = np.random.default_rng(seed)

    def infer(self, observation: Observation) -> Array:
        """Return joint positions, as an array of shape (HORIZON, action size)."""
        columns: list[Array] = []
        for robot in observation.robots.values():
            steps = self._rng.uniform(-STEP, STEP, (HORIZON, len(robot.joints)))
            columns.append(np.asarray(robot.joints) + np.cumsum(steps, axis=0))
            columns.append(np.full((HORIZON, 1), float(self._rng.integers(2))))
        return np.concatenate(columns, axis=1) if columns else np.zeros((HORIZON, 0))


# Maximum size of a recording [bytes].
LARGEST = 256 * 2**20


class ReplayPolicy(Policy):
    """A policy that replays recorded actions in order and then repeats the last action indefinitely.

    Every rollout starts with the first action. If actions specify motions, the last one is replaced by no motion.
    """

    def __init__(
        self,
        actions: Array,
        action_space: ActionSpace = ActionSpace.JOINT_POSITION,
        name: str = "replay",
        control_hz: float | None = None,
    ) -> None:
        self.name, self.action_space, self.control_hz = name, action_space, control_hz
        self._actions, self._played = actions, False

    def reset(self, instruction: str, seed: int) -> None:
        """Restart the replay from the first action."""
        self._played = False

    def infer(self, observation: Observation) -> Array:
        """Return all actions on the first call, and only the last action on every later call.

        Returns:
            Array of shape (steps, action size).
        """
        recorded, width = self._actions.shape[1], action_size(observation.robots, self.action_space)
        if recorded != width:
            raise InvalidAnswerError(f"{self.name} has {recorded} numbers per action, but the robots need {width}")
        chunk = self._actions[-1:].copy() if self._played else self._actions.copy()
        if self._played and self.action_space.is_relative:
            for _, arm, _ in columns(observation.robots, self.action_space):  # the grippers keep their position
                chunk[:, arm] = no_motion(self.action_space, arm.stop - arm.start)
        self._played = True
        return chunk


def no_motion(space: ActionSpace, size: int) -> Array:
    """Return the arm values that stop a robot, for an action space whose actions specify motions."""
    if space.of_hand and space.rotation in (RotationForm.QUAT_WXYZ, RotationForm.ROT6D):
        identity = rotation_numbers(np.array([1.0, 0.0, 0.0, 0.0]), space.rotation)
        return np.concatenate([np.zeros(3), identity])
    return np.zeros(size)


def load_replay(path: Path) -> ReplayPolicy:
    """Load a recording as a policy.

    A ``.npy`` file contains only the actions, as an array of shape (steps, action size). A ``.npz`` or ``.json`` file
    contains the entry ``actions`` and optionally the entries ``action_space`` and ``control_hz``. The defaults are
    joint positions and the control frequency of the task.

    Raises:
        PolicyError: If the file is invalid.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise PolicyError(f"{path} is larger than {LARGEST // 2**20} MiB, the limit for recorded actions")
        actions, text, rate = _read(path)
        space = ActionSpace.parse(text)
    except (OSError, ValueError, KeyError, EOFError, RecursionError, MemoryError, zipfile.BadZipFile) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise PolicyError(f"{path} does not contain recorded actions: {why}") from None
    if actions.ndim != 2 or not actions.size:
        raise PolicyError(f"{path} contains an array of shape {actions.shape}, but actions have shape (steps, numbers)")
    if not np.isfinite(actions).all():
        raise PolicyError(f"{path} contains actions that are not finite numbers")
    return ReplayPolicy(actions, space, f"replay:{path.name}", rate)


def _read(path: Path) -> tuple[Array, str, float | None]:
    """Read the actions, their action space and their frequency [Hz].

    Various exceptions are raised if the file is not a recording.
    """
    default, rate = str(ActionSpace.JOINT_POSITION), None
    match path.suffix.lower():
        case ".npy":
            # Memory-mapping verifies the size in the header without allocating it.
            return _numbers(np.lib.format.open_memmap(path, mode="r")), default, rate
        case ".npz":
            with zipfile.ZipFile(path) as files:
                if sum(file.file_size for file in files.infolist()) > LARGEST:
                    raise ValueError(f"its uncompressed size exceeds {LARGEST // 2**20} MiB")
            with np.load(path, allow_pickle=False) as stored:
                space = str(stored["action_space"]) if "action_space" in stored else default
                rate = float(stored["control_hz"]) if "control_hz" in stored else rate
                return _numbers(stored["actions"]), space, rate
        case ".json":
            found = json.loads(path.read_text(encoding="utf-8"))
            found = found if isinstance(found, dict) else {"actions": found}
            rate = float(found["control_hz"]) if "control_hz" in found else rate
            return _numbers(np.array(found["actions"])), str(found.get("action_space", default)), rate
    raise ValueError("the name of a recording must end with .npy, .npz or .json")


def _numbers(array: np.ndarray[Any, Any]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError(f"it is an array of `{array.dtype}`")
    return np.array(array, dtype=np.float64)
