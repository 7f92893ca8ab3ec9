"""A policy that repeats the actions of a rollout that was recorded."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, InvalidAnswerError, Observation, PolicyError
from simfoundry.geometry.frames import Array

LARGEST = 256 * 2**20
"""Bytes of the largest recording that is read."""


class ReplayPolicy:
    """Recorded actions, one after another; at their end the last one is held. Every rollout begins with the first."""

    cameras: Mapping[str, ImageSize] = MappingProxyType({})

    def __init__(self, actions: Array, action_space: ActionSpace = ActionSpace.JOINT_POSITION, name: str = "replay"):
        self.name, self.action_space = name, action_space
        self._actions, self._played = actions, False

    def reset(self, instruction: str, seed: int) -> None:
        """Begin with the first action."""
        self._played = False

    def infer(self, observation: Observation) -> Array:
        """All actions at once, then the last again, shape (steps, numbers of an action)."""
        width = sum(len(robot.joints) + 1 for robot in observation.robots.values())
        if self._actions.shape[1] != width:
            recorded = self._actions.shape[1]
            raise InvalidAnswerError(f"{self.name} has {recorded} numbers for each action, and the robots take {width}")
        chunk = self._actions[-1:].copy() if self._played else self._actions.copy()
        if self._played and self.action_space is ActionSpace.JOINT_VELOCITY:
            at = 0
            for robot in observation.robots.values():  # nothing moves on; the grippers stay as they were
                chunk[:, at : at + len(robot.joints)] = 0.0
                at += len(robot.joints) + 1
        self._played = True
        return chunk

    def close(self) -> None:
        """Nothing is held."""


def load_replay(path: Path) -> ReplayPolicy:
    """The policy of a recording; raises :class:`PolicyError`.

    ``.npy`` holds the actions alone, shape (steps, numbers of an action); ``.npz`` has them as ``actions`` and
    ``.json`` as ``actions`` too, where ``action_space`` may say what they mean: joint positions, if nothing does.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise PolicyError(f"{path} is larger than {LARGEST // 2**20} MiB, which no recorded actions are")
        actions, space = _read(path)
    except (OSError, ValueError, KeyError, EOFError, RecursionError, MemoryError, zipfile.BadZipFile) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise PolicyError(f"{path} holds no recorded actions: {why}") from None
    if actions.ndim != 2 or not actions.size:
        raise PolicyError(f"{path} holds an array of shape {actions.shape}, not actions of (steps, numbers)")
    if not np.isfinite(actions).all():
        raise PolicyError(f"{path} holds actions that are not finite numbers")
    if space not in tuple(ActionSpace):
        raise PolicyError(f"{path} has actions of `{space}`; known are {', '.join(ActionSpace)}")
    return ReplayPolicy(actions, ActionSpace(space), f"replay:{path.name}")


def _read(path: Path) -> tuple[Array, str]:
    """Actions and what they mean; raises in as many ways as there are of being no recording."""
    default = str(ActionSpace.JOINT_POSITION)
    match path.suffix.lower():
        case ".npy":
            return _numbers(_mapped(path)), default
        case ".npz":
            _expansion(path)
            with np.load(path, allow_pickle=False) as stored:
                space = str(stored["action_space"]) if "action_space" in stored else default
                return _numbers(stored["actions"]), space
        case ".json":
            found = json.loads(path.read_text(encoding="utf-8"))
            actions = found["actions"] if isinstance(found, dict) else found
            space = found.get("action_space", default) if isinstance(found, dict) else default
            return _numbers(np.array(actions)), str(space)
    raise ValueError("a recording ends with .npy, .npz or .json")


def _mapped(path: Path) -> np.ndarray[Any, Any]:
    """The array of a file without setting aside what its header claims: mapped, it must be as long as it says."""
    stored: np.ndarray[Any, Any] = np.lib.format.open_memmap(path, mode="r")
    return stored


def _expansion(path: Path) -> None:
    """Raise where a compressed file would unpack to more than recordings have."""
    with zipfile.ZipFile(path) as files:
        total = math.fsum(file.file_size for file in files.infolist())
    if total > LARGEST:
        raise ValueError(f"it unpacks to more than {LARGEST // 2**20} MiB")


def _numbers(array: np.ndarray[Any, Any]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError(f"an array of `{array.dtype}`")
    return np.array(array, dtype=np.float64)
