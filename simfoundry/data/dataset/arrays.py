"""The array features of a demonstration, and the quantities of an episode that are not features."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.action_conversion import ActionConverter, ConvertedActions
from simfoundry.data.dataset.contents import ActionColumns, DatasetContents, ImageView
from simfoundry.data.dataset.episode import GenerationData
from simfoundry.data.dataset.features import DatasetFeature, FeatureKind, FeaturePart, FeatureRole
from simfoundry.data.state_entries import entry_values
from simfoundry.data.trajectory import ROUNDING, Trajectory, TrajectorySampler
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import Scene
from simfoundry.spec.models.signals import ACTIONS, ActionSpace, ImageKind

# The types of images, and their numbers of channels.
_IMAGES: Mapping[ImageKind, tuple[str, int]] = {
    ImageKind.COLOR: ("uint8", 3),
    ImageKind.DEPTH: ("float32", 1),
    ImageKind.MASK: ("int32", 1),
}

# What separates the name of a robot or of a kind of action from that of a value.
_JOIN = "_"


@dataclass(frozen=True, eq=False)
class ArrayValues:
    """The array features of one demonstration.

    Attributes:
        features: The description of each feature, in order: observations, then actions.
        arrays: The values in each frame, in float32, keyed by feature.
        final: The observations after the last action, keyed by feature.
        losses: The reasons why actions differ from the recorded ones, as clauses, by feature.
    """

    features: tuple[DatasetFeature, ...]
    arrays: Mapping[str, NDArray[Any]]
    final: Mapping[str, NDArray[Any]]
    losses: Mapping[str, str]


def array_values(contents: DatasetContents, trajectory: Trajectory, sampler: TrajectorySampler) -> ArrayValues:
    """Return the array features of a demonstration."""
    features: list[DatasetFeature] = []
    arrays: dict[str, NDArray[Any]] = {}
    final: dict[str, NDArray[Any]] = {}
    losses: dict[str, str] = {}
    for key, entries in contents.state.items():
        values, feature = _state(key, entries, contents, trajectory, sampler.task.scene)
        features.append(feature)
        arrays[key], final[key] = values[:-1], values[-1]
    converted: dict[ActionSpace, ConvertedActions] = {}
    for key, columns in contents.actions.items():
        if columns.space not in converted:
            converted[columns.space] = ActionConverter(sampler, columns.space).convert(trajectory)
        actions = converted[columns.space]
        arrays[key], feature = _actions(key, columns, contents, trajectory, actions.values)
        features.append(feature)
        if actions.loss and columns.part != "gripper":
            losses[key] = actions.loss
    return ArrayValues(tuple(features), arrays, final, losses)


def image_features(contents: DatasetContents) -> tuple[DatasetFeature, ...]:
    """Return the image features."""
    return tuple(_image(key, view, contents.is_video) for key, view in contents.views.items())


def _image(key: str, view: ImageView, is_video: bool) -> DatasetFeature:
    dtype, channels = _IMAGES[view.kind]
    kind = FeatureKind.VIDEO if is_video and view.kind is ImageKind.COLOR else FeatureKind.IMAGE
    shape, names = (view.size.height, view.size.width, channels), ("height", "width", "channels")
    return DatasetFeature(key, FeatureRole.OBSERVATION, kind, dtype, shape, names, (), view.camera, view.kind)


def _state(
    key: str, entries: tuple[str, ...], contents: DatasetContents, trajectory: Trajectory, scene: Scene
) -> tuple[NDArray[Any], DatasetFeature]:
    """Return the values of an observed array in T + 1 rows, and its description."""
    rows, names, parts, start = [], list[str](), list[FeaturePart](), 0
    for entry in entries:
        found = entry_values(entry, trajectory, scene, contents.gripper)
        stop = start + found.values.shape[1]
        rows.append(found.values)
        names += found.names
        parts.append(FeaturePart(contents.parts.get(entry, entry), start, stop, found.unit, entry))
        start = stop
    values = np.concatenate(rows, axis=1).astype(np.float32)
    if not values.shape[1]:
        raise SimfoundryError(
            f"`{key}` would be empty, because scene `{scene.name}` has no {' and no '.join(entries)}; remove it"
        )
    return values, _array(key, FeatureRole.OBSERVATION, values, names, parts)


def _actions(
    key: str, columns: ActionColumns, contents: DatasetContents, trajectory: Trajectory, actions: Array
) -> tuple[NDArray[Any], DatasetFeature]:
    """Return the values of an action feature, and its description."""
    space, gripper = columns.space, contents.gripper
    signal = ACTIONS[space.kind]
    rows, names, parts = [], list[str](), list[FeaturePart]()
    start, column = 0, 0
    for robot in trajectory.robots:
        joints = trajectory.observations[f"{robot}/joints"].shape[1]
        size = space.arm_size(joints)
        head = f"{robot}{_JOIN}" if len(trajectory.robots) > 1 else ""
        if columns.part != "gripper":
            rows.append(actions[:, column : column + size])
            names += [head + space.column(k, joints).replace(" ", _JOIN) for k in range(size)]
            unit = "-1 to 1" if space.normalized else signal.unit
            parts.append(FeaturePart(head + space.kind, start, start + size, unit, str(space)))
            start += size
        if columns.part != "arm":
            rows.append(gripper.open + (gripper.closed - gripper.open) * trajectory.grippers[robot][:, None])
            names.append(f"{head}gripper")
            unit = f"{gripper.open:g} open, {gripper.closed:g} closed"
            parts.append(
                FeaturePart(head + contents.parts.get("gripper", "gripper"), start, start + 1, unit, "gripper")
            )
            start += 1
        column += size + 1
    values = np.concatenate(rows, axis=1).astype(np.float32)
    return values, _array(key, FeatureRole.ACTION, values, names, parts)


def _array(
    key: str, role: FeatureRole, values: NDArray[Any], names: list[str], parts: list[FeaturePart]
) -> DatasetFeature:
    return DatasetFeature(key, role, FeatureKind.ARRAY, "float32", values.shape[1:], tuple(names), tuple(parts))


def simulation_states(trajectory: Trajectory) -> Array:
    """Return all recorded positions in each frame, shape (T, n): objects, joints, motions, and models of robots."""
    keys = ["objects", "joints", "motions", *(k for k in trajectory.observations if k.endswith("/model"))]
    rows = trajectory.length
    return np.concatenate([trajectory.observations[k][:-1].reshape(rows, -1) for k in keys], axis=1)


def completed_frames(
    subtasks: Mapping[str, int | None], control_hz: float, hz: float, length: int
) -> dict[str, int | None]:
    """Return the frame at whose end each sub-task is complete, from the control steps counted from 1."""
    return {
        name: None if step is None else min(length, max(1, math.ceil(step * hz / control_hz - ROUNDING))) - 1
        for name, step in subtasks.items()
    }


def generation_data(
    trajectory: Trajectory, sampler: TrajectorySampler, objects: tuple[str, ...], subtasks: Mapping[str, int | None]
) -> GenerationData:
    """Return the quantities that MimicGen needs.

    Args:
        trajectory: The trajectory.
        sampler: The sampler of its task.
        objects: The names of the objects, in the order of the observations.
        subtasks: The frame at whose end each sub-task is complete.
    """
    length = trajectory.length
    targets = ActionConverter(sampler, ActionSpace.JOINT_POSITION).hand_targets(trajectory)
    poses = trajectory.observations["objects"]
    signals = {
        name: (np.arange(length) > (length if frame is None else frame)).astype(np.int64)
        for name, frame in subtasks.items()
    }
    return GenerationData(
        eef_pose={name: _matrices(trajectory.observations[f"{name}/hand"][:-1]) for name in trajectory.robots},
        target_pose={name: np.array([pose.matrix for pose in rows[1:]]) for name, rows in targets.items()},
        gripper_action={name: trajectory.grippers[name][:, None] for name in trajectory.robots},
        object_poses={name: _matrices(poses[:-1, k]) for k, name in enumerate(objects)},
        subtask_term_signals=signals,
    )


def _matrices(poses: Array) -> Array:
    """Return homogeneous matrices, shape (n, 4, 4), for positions and quaternions, shape (n, 7)."""
    return np.array([Pose.of(row[:3], row[3:]).matrix for row in poses])
