"""Open-loop policies, which are a random walk that serves as a baseline and the replay of a recorded rollout."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import (
    ActionSpace,
    InvalidAnswerError,
    Observation,
    Policy,
    PolicyError,
    action_size,
)
from simfoundry.geometry.frames import Array

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

    Every rollout starts with the first action.
    """

    def __init__(self, actions: Array, action_space: ActionSpace = ActionSpace.JOINT_POSITION, name: str = "replay"):
        self.name, self.action_space = name, action_space
        self._actions, self._played = actions, False

    def reset(self, instruction: str, seed: int) -> None:
        """Restart the replay from the first action."""
        self._played = False

    def infer(self, observation: Observation) -> Array:
        """Return all actions on the first call, and only the last action on every later call.

        Returns:
            Array of shape (steps, action size).
        """
        recorded, width = self._actions.shape[1], action_size(observation.robots)
        if recorded != width:
            raise InvalidAnswerError(f"{self.name} has {recorded} numbers per action, but the robots need {width}")
        chunk = self._actions[-1:].copy() if self._played else self._actions.copy()
        if self._played and self.action_space is ActionSpace.JOINT_VELOCITY:
            at = 0
            for robot in observation.robots.values():  # stop all motion; the grippers keep their position
                chunk[:, at : at + len(robot.joints)] = 0.0
                at += len(robot.joints) + 1
        self._played = True
        return chunk


def load_replay(path: Path) -> ReplayPolicy:
    """Load a recording as a policy.

    A ``.npy`` file contains only the actions, as an array of shape (steps, action size). A ``.npz`` or ``.json`` file
    contains the entry ``actions`` and optionally the entry ``action_space``. The default action space is joint
    positions.

    Raises:
        PolicyError: If the file is invalid.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise PolicyError(f"{path} is larger than {LARGEST // 2**20} MiB, the limit for recorded actions")
        actions, space = _read(path)
    except (OSError, ValueError, KeyError, EOFError, RecursionError, MemoryError, zipfile.BadZipFile) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise PolicyError(f"{path} does not contain recorded actions: {why}") from None
    if actions.ndim != 2 or not actions.size:
        raise PolicyError(f"{path} contains an array of shape {actions.shape}, but actions have shape (steps, numbers)")
    if not np.isfinite(actions).all():
        raise PolicyError(f"{path} contains actions that are not finite numbers")
    if space not in tuple(ActionSpace):
        raise PolicyError(f"{path} has the unknown action space `{space}`; available: {', '.join(ActionSpace)}")
    return ReplayPolicy(actions, ActionSpace(space), f"replay:{path.name}")


def _read(path: Path) -> tuple[Array, str]:
    """Read the actions and their action space.

    Various exceptions are raised if the file is not a recording.
    """
    default = str(ActionSpace.JOINT_POSITION)
    match path.suffix.lower():
        case ".npy":
            # Memory-mapping verifies the size in the header without allocating it.
            return _numbers(np.lib.format.open_memmap(path, mode="r")), default
        case ".npz":
            with zipfile.ZipFile(path) as files:
                if sum(file.file_size for file in files.infolist()) > LARGEST:
                    raise ValueError(f"its uncompressed size exceeds {LARGEST // 2**20} MiB")
            with np.load(path, allow_pickle=False) as stored:
                space = str(stored["action_space"]) if "action_space" in stored else default
                return _numbers(stored["actions"]), space
        case ".json":
            found = json.loads(path.read_text(encoding="utf-8"))
            found = found if isinstance(found, dict) else {"actions": found}
            return _numbers(np.array(found["actions"])), str(found.get("action_space", default))
    raise ValueError("the name of a recording must end with .npy, .npz or .json")


def _numbers(array: np.ndarray[Any, Any]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError(f"it is an array of `{array.dtype}`")
    return np.array(array, dtype=np.float64)
