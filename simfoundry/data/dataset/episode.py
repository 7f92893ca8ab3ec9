"""An episode of a dataset: arrays with one row per frame, and images that are rendered when they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

# The images of one frame, keyed by feature; the shape and type of each are those of the feature.
Images = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class EpisodeHeader:
    """The description of an episode.

    Attributes:
        index: The index of the episode in the dataset, counted from 0.
        first_frame: The index of its first frame among all frames of the dataset.
        length: The number of frames T.
        instruction: The instruction of the task.
        task_index: The index of the instruction in :attr:`DatasetInfo.instructions`.
        split: The split to which the episode belongs.
        weight: How often each frame is to be drawn in training, relative to the mean of all frames.
        success: True if the goal was reached.
        subtasks: The frame during which each sub-task was completed, or None if it was not completed.
        source: The origin as JSON: ``dataset`` (its folder), ``index``, ``trajectory`` (its digest), and ``pictures``
            (the index and digest of the variation of the pictures) if there is one.
    """

    index: int
    first_frame: int
    length: int
    instruction: str
    task_index: int = 0
    split: str = "train"
    weight: float = 1.0
    success: bool = True
    subtasks: Mapping[str, int | None] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GenerationData:
    """The quantities that MimicGen needs of an episode, in the world frame. T is the number of frames.

    Attributes:
        eef_pose: The pose of the hand of each robot, keyed by robot, float64, shape (T, 4, 4).
        target_pose: The pose at which each hand would be if the joints were at their targets, shape (T, 4, 4).
        gripper_action: The target of each gripper, from 0 (open) to 1 (closed), shape (T, 1).
        object_poses: The pose of each object, keyed by name, shape (T, 4, 4).
        subtask_term_signals: 1 from the frame on at which a sub-task is complete, else 0, keyed by sub-task, int64,
            shape (T,).
    """

    eef_pose: Mapping[str, Array]
    target_pose: Mapping[str, Array]
    gripper_action: Mapping[str, Array]
    object_poses: Mapping[str, Array]
    subtask_term_signals: Mapping[str, NDArray[np.int64]]


class FrameSource(Protocol):
    """The images of an episode, which are rendered or decoded when they are read."""

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of all features in each frame, in order. Each call starts with the first frame.

        Args:
            final: Whether to yield the images after the last action as well, as an additional last item.
        """


class NoImages:
    """The images of an episode without image features."""

    def __init__(self, length: int) -> None:
        self._length = length

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield an empty mapping for each frame."""
        yield from ({} for _ in range(self._length + final))


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode. The observation in row t precedes the action in row t.

    Attributes:
        header: The description of the episode.
        arrays: The values of each array feature, keyed by feature, with the type of the feature and the shape
            (T, *shape).
        final: The observation after the last action: the values of each observed array, keyed by feature, of the shape
            of the feature. Empty if it is unknown.
        images: The images. Writers read all of them in one pass (:meth:`frames`).
        rewards: 1 in the last frame of a success, else 0, float32, shape (T,).
        dones: True in the last frame, shape (T,).
        states: The state of the simulation in each frame, float64, shape (T, n); n is 0 if it is unknown.
        generation: The quantities that MimicGen needs, or None if they are unknown.
    """

    header: EpisodeHeader
    arrays: Mapping[str, NDArray[Any]]
    final: Mapping[str, NDArray[Any]]
    images: FrameSource
    rewards: NDArray[np.float32]
    dones: NDArray[np.bool_]
    states: Array
    generation: GenerationData | None = None

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame, keyed by feature, as :meth:`FrameSource.frames` does."""
        return self.images.frames(final)
