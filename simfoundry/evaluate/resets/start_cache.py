"""Disk cache of starts, keyed by the content that they depend on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter

from simfoundry.assets.cache import Cache, key_of
from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.evaluate.resets.grid import GridCell
from simfoundry.evaluate.tasks.task import Task
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.expressions import Condition

VERSION = "starts/1"
"""Cache version; incremented when the same task and seed would give other starts."""

Known = tuple[dict[str, list[GridCell]], list[SceneState]]
"""The cells of each object in all starts of a deal, and the states of the first starts."""


def key_of_starts(task: Task, seed: int) -> str:
    """Return the cache key of a task's starts: the world that they are settled in, the reset, the goal, and the seed.

    The engine's version is not included: starts stay the same after an update.
    """
    files = compile_mjcf(task.scene).files
    goal: bytes = TypeAdapter(Condition).dump_json(task.goal)
    reset = task.reset.model_dump_json()
    carriers = json.dumps(dict(task.carriers), sort_keys=True)
    content = [part for name in sorted(files) for part in (name, files[name])]
    return key_of(VERSION, str(seed), reset, goal, carriers, *content)


def read_block(cache: Cache, key: str) -> Known | None:
    """Read the stored part of a deal; None if there is none or if it is damaged."""
    data = cache.get(key_of(key))
    if data is None:
        return None
    try:
        entry = json.loads(data)
        cells = {name: [(int(i), int(j)) for i, j in one] for name, one in entry["cells"].items()}
        return cells, [state_from_json(state) for state in entry["states"]]
    except (ValueError, KeyError, TypeError):
        return None


def write_block(cache: Cache, key: str, cells: Mapping[str, list[GridCell]], states: list[SceneState]) -> None:
    """Store a deal and the states found so far."""
    entry = {"cells": dict(cells), "states": [state_to_json(state) for state in states]}
    cache.put(key_of(key), json.dumps(entry).encode())


def state_to_json(state: SceneState) -> dict[str, Any]:
    """Serialize a state without rounding: positions [m], quaternions (wxyz), joints [rad or m]."""
    return {
        "poses": {name: _numbers(pose) for name, pose in state.poses.items()},
        "joints": dict(state.joints),
        "motions": {name: _numbers(pose) for name, pose in state.motions.items()},
    }


def state_from_json(data: Mapping[str, Any]) -> SceneState:
    """Restore the exact state serialized by :func:`state_to_json`."""
    return SceneState.of(
        {name: _pose(numbers) for name, numbers in data["poses"].items()},
        {name: float(position) for name, position in data["joints"].items()},
        {name: _pose(numbers) for name, numbers in data["motions"].items()},
    )


def _numbers(pose: Pose) -> list[float]:
    return [*pose.p.tolist(), *pose.q.tolist()]


def _pose(numbers: list[float]) -> Pose:
    # Pose.of would normalize again and change the last bit.
    return Pose(frozen_array(numbers[:3], (3,)), frozen_array(numbers[3:7], (4,)))
