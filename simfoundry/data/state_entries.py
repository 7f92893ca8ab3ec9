"""Low-dimensional observations of a trajectory, by the names that policy documents and datasets use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np

from simfoundry.data.action_conversion import ActionConverter
from simfoundry.data.demonstrations import Demonstration
from simfoundry.data.trajectory import Trajectory, TrajectorySampler
from simfoundry.evaluate.policies.remote import reading
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.dataset import StateEntry
from simfoundry.spec.models.policy import GripperConvention
from simfoundry.spec.models.signals import GRIPPER, HAND_READINGS, OBSERVATIONS, ROTATION_ORDER, ActionSpace

# The names of the entries.
STATE_ENTRIES: tuple[str, ...] = get_args(StateEntry)


@dataclass(frozen=True, eq=False)
class EntryValues:
    """The values of one entry over time.

    Attributes:
        values: The values at the start of each frame and after the last one, float64, shape (T + 1, n).
        names: The name of each value, such as ``joint_1`` or ``cup_x``. With several robots, the name of the robot
            precedes it.
        unit: The unit of the values.
    """

    values: Array
    names: tuple[str, ...]
    unit: str


def entry_values(
    entry: str, trajectory: Trajectory, scene: Scene, gripper: GripperConvention | None = None
) -> EntryValues:
    """Return an entry in :data:`STATE_ENTRIES` over time.

    Args:
        entry: The name of the entry.
        trajectory: The trajectory.
        scene: The scene of the task.
        gripper: The values of the gripper; by default, 0 is open and 1 is closed.
    """
    if entry in ("objects", "object_joints"):
        return _object_values(entry, trajectory, scene)
    convention = gripper or GripperConvention()
    rows = [reading(entry, robots, convention) for robots in trajectory.readings(scene)]
    names: list[str] = []
    for robot in trajectory.robots:
        joints = trajectory.observations[f"{robot}/joints"].shape[1]
        head = f"{robot}_" if len(trajectory.robots) > 1 else ""
        names += [head + name for name in _reading_names(entry, joints)]
    return EntryValues(np.array(rows), tuple(names), _reading_unit(entry))


def action_names(trajectory: Trajectory, space: ActionSpace) -> tuple[str, ...]:
    """Return the name of each value in an action, such as ``joint_1``, ``hand_x`` or ``gripper``."""
    names: list[str] = []
    for robot in trajectory.robots:
        joints = trajectory.observations[f"{robot}/joints"].shape[1]
        head = f"{robot}_" if len(trajectory.robots) > 1 else ""
        size = space.arm_size(joints) + 1
        names += [head + space.column(k, joints).replace(" ", "_") for k in range(size)]
    return tuple(names)


def _object_values(entry: str, trajectory: Trajectory, scene: Scene) -> EntryValues:
    initial = SceneState.initial(scene)
    if entry == "object_joints":
        names = [name.replace(".", "_") for name in initial.joints]
        return EntryValues(trajectory.observations["joints"], tuple(names), OBSERVATIONS["joints"].unit)
    poses = trajectory.observations["objects"]
    names = [f"{item}_{axis}" for item in initial.poses for axis in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    return EntryValues(poses.reshape(len(poses), -1), tuple(names), OBSERVATIONS["objects"].unit)


def _reading_names(entry: str, joints: int) -> list[str]:
    if entry in HAND_READINGS:
        return [f"hand_{axis}" for axis in (*"xyz", *ROTATION_ORDER[HAND_READINGS[entry][1]])]
    arm = [f"joint_{k + 1}" for k in range(joints)]
    return {"joints": arm, "gripper": ["gripper"], "joints_gripper": [*arm, "gripper"]}[entry]


def _reading_unit(entry: str) -> str:
    if entry in HAND_READINGS:
        return OBSERVATIONS["ROBOT/hand"].unit
    joints = OBSERVATIONS["ROBOT/joints"].unit
    return {"joints": joints, "gripper": GRIPPER.unit, "joints_gripper": f"{joints}; {GRIPPER.unit}"}[entry]


@dataclass(frozen=True, eq=False)
class LowDimensional:
    """The states and actions of a demonstration as two arrays.

    Attributes:
        states: The values of the entries, joined, at the start of each frame and after the last one, float32, shape
            (T + 1, n).
        actions: The action of each frame, float32, shape (T, m).
        state_names: The name of each value of a state.
        action_names: The name of each value of an action.
        loss: The reason why the actions differ from the recorded ones, as in :class:`ConvertedActions`.
    """

    states: Array
    actions: Array
    state_names: tuple[str, ...]
    action_names: tuple[str, ...]
    loss: str


def low_dimensional(
    sampler: TrajectorySampler,
    demonstration: Demonstration,
    entries: tuple[str, ...] = ("joints_gripper", "objects", "object_joints"),
    space: ActionSpace | None = None,
    hz: float | None = None,
) -> LowDimensional:
    """Return a demonstration as arrays of states and actions.

    Args:
        sampler: A sampler for the task of the demonstration; reuse it for all demonstrations.
        demonstration: The demonstration.
        entries: The entries of a state, as in :data:`STATE_ENTRIES`.
        space: The action space; by default, that of the demonstration.
        hz: The number of frames per second [Hz]; by default, the control frequency of the task.
    """
    trajectory = sampler.sample(demonstration, hz)
    space = space or demonstration.action_space
    converted = ActionConverter(sampler, space).convert(trajectory)
    found = [entry_values(entry, trajectory, sampler.task.scene) for entry in entries]
    return LowDimensional(
        states=np.concatenate([one.values for one in found], axis=1).astype(np.float32),
        actions=converted.values.astype(np.float32),
        state_names=tuple(name for one in found for name in one.names),
        action_names=action_names(trajectory, space),
        loss=converted.loss,
    )
