"""States of scenes as plain data, which passes between processes without rounding."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simfoundry.evaluate.resets.starts import state_from_json, state_to_json
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import SceneState


def state_data(state: SceneState) -> dict[str, Any]:
    """Return a state, including that of the robots, as plain data."""
    robots = {name: dict(joints) for name, joints in state.robots.items()}
    return {**state_to_json(state), "robots": robots, "speeds": dict(state.speeds)}


def state_of(data: Mapping[str, Any]) -> SceneState:
    """Return the state that :func:`state_data` converted."""
    found = state_from_json(data)
    return SceneState.of(found.poses, found.joints, found.motions, data["robots"], data["speeds"])


def states_of_arrays(
    about: Mapping[str, Any], arrays: Mapping[str, Array], robots: Mapping[str, tuple[str, ...]]
) -> list[SceneState]:
    """Return the states of a demonstration.

    Args:
        about: The facts of its task, with the names of objects and joints.
        arrays: Its arrays, see :func:`simfoundry.data.attempt.state_arrays`.
        robots: The joint names of each robot, in the order of the arrays.

    Raises:
        ValueError: If names and arrays do not fit together.
    """
    names, joints, motions = about["objects"], about["joints"], about["motions"]
    found = []
    for k in range(len(arrays["objects"])):
        at = {
            robot: dict(zip(columns, arrays[f"{robot}/model"][k].tolist(), strict=True))
            for robot, columns in robots.items()
            if f"{robot}/model" in arrays
        }
        state = SceneState.of(
            {name: _pose(row) for name, row in zip(names, arrays["objects"][k], strict=True)},
            dict(zip(joints, arrays["joints"][k].tolist(), strict=True)),
            {name: _pose(row) for name, row in zip(motions, arrays["motions"][k], strict=True)},
            at,
        )
        found.append(state)
    return found


def _pose(row: Array) -> Pose:
    return Pose.of(row[:3], row[3:7])
