"""Training examples: the moments of demonstrations, each with the actions that follow it.

An example is a situation and a chunk of actions. Actions are targets of the hands, expressed relative to the hand at
the start of the chunk. If the hand of an example is displaced, the same targets are therefore actions that correct the
displacement; :func:`displaced` uses this to teach the baseline to return to the demonstrated motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.action_conversion import ActionConverter
from simfoundry.data.dataset.contents import ImageView
from simfoundry.data.dataset.rendering import RenderedFrames
from simfoundry.data.demonstrations import Demonstration
from simfoundry.data.trajectory import Trajectory, TrajectorySampler
from simfoundry.evaluate.actions import rotation_numbers, rotation_quat
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array, Index, Pose, Poses
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace, RotationForm
from simfoundry.train.situations import InputLayout, Situations, box_numbers, word_flags

# The action space of the baseline: targets of the hands, whose rotation is two rows of a matrix, which is continuous.
ACTION_SPACE = ActionSpace.parse("hand_pose:world:rot6d")

# The number of values per robot in an action: position [m], two rows of the rotation matrix, gripper target.
ROBOT_SIZE = 10


@dataclass(frozen=True, eq=False)
class Examples:
    """N examples.

    Attributes:
        now: The situations.
        targets: The targets X_BT of the hands for all frames of the demonstrations, keyed by robot, N poses.
        closings: The targets of the grippers, from 0 (open) to 1 (closed), shape (N,), keyed by robot.
        last: The index of the last frame of each frame's demonstration, shape (N,). After it, its target is repeated.
        episode: The number of each frame's demonstration, shape (N,).
        images: The images of the cameras, shape (N, cameras, height, width, 3), without cameras (N, 0, 0, 0, 3).
    """

    now: Situations
    targets: Mapping[str, Poses]
    closings: Mapping[str, Array]
    last: Index
    episode: Index
    images: NDArray[np.uint8]

    def __len__(self) -> int:
        """Return the number of examples."""
        return len(self.last)

    @staticmethod
    def joined(parts: Sequence[Examples]) -> Examples:
        """Concatenate the examples of several demonstrations."""
        first, starts = parts[0], np.cumsum([0, *(len(part) for part in parts)])
        return Examples(
            now=Situations.joined([part.now for part in parts]),
            targets={
                name: Poses(*(np.concatenate(arrays) for arrays in zip(*(p.targets[name] for p in parts), strict=True)))
                for name in first.targets
            },
            closings={name: np.concatenate([part.closings[name] for part in parts]) for name in first.closings},
            last=np.concatenate([part.last + start for part, start in zip(parts, starts, strict=False)]),
            episode=np.concatenate([np.full(len(part), k) for k, part in enumerate(parts)]),
            images=np.concatenate([part.images for part in parts]),
        )

    def chunks(self, index: Index, hands: Mapping[str, Poses], length: int) -> Array:
        """Return the actions of frames and of those that follow, relative to the given hands.

        Args:
            index: The frames, shape (n,).
            hands: The poses X_BH of the hands to which targets are relative, keyed by robot.
            length: The number of actions in a chunk.

        Returns:
            The chunks, shape (n, length, robots * ROBOT_SIZE).
        """
        frames = np.minimum(index[:, None] + np.arange(length), self.last[index][:, None])
        columns: list[Array] = []
        for name, targets in self.targets.items():
            hand = hands[name]
            turned = targets.R[frames] @ hand.R.transpose(0, 2, 1)[:, None]
            away = targets.p[frames] - hand.p[:, None]
            columns += [away, turned[:, :, :2].reshape(*frames.shape, 6), self.closings[name][frames][..., None]]
        return np.concatenate(columns, axis=2)


def absolute_actions(chunk: Array, hands: Mapping[str, Pose], X_WB: Pose) -> Array:
    """Convert a chunk back to actions in :data:`ACTION_SPACE`.

    Args:
        chunk: Actions relative to the hands, shape (length, robots * ROBOT_SIZE).
        hands: The poses X_BH of the hands at the start of the chunk, keyed by robot.
        X_WB: The pose of the first robot's base.

    Returns:
        The actions, shape (length, action size).
    """
    rows = []
    for numbers in chunk:
        row: list[Array] = []
        for k, hand in enumerate(hands.values()):
            one = numbers[k * ROBOT_SIZE : (k + 1) * ROBOT_SIZE]
            turn = rotation_quat(one[3:9], RotationForm.ROT6D)
            X_WT = X_WB @ Pose.of(hand.p + one[:3], (Pose.of(q=turn) @ Pose.of(q=hand.q)).q)
            row += [X_WT.p, rotation_numbers(X_WT.q, RotationForm.ROT6D), np.clip(one[9:], 0.0, 1.0)]
        rows.append(np.concatenate(row))
    return np.array(rows)


class ExampleReader:
    """Reads the examples of the demonstrations of one task."""

    def __init__(self, task: Task, layout: InputLayout, sampler: TrajectorySampler, hz: float | None) -> None:
        self._task, self._layout, self._sampler, self._hz = task, layout, sampler, hz
        self._converter = ActionConverter(sampler, ACTION_SPACE)
        self._boxes = {name: box_numbers(task, name) for name in layout.objects}
        self._words = word_flags(layout, task.instruction)
        initial = SceneState.initial(task.scene)
        self._objects = {name: k for k, name in enumerate(initial.poses)}
        self._joints = {name: k for k, name in enumerate(initial.joints)}
        names = {"objects": initial.poses, "joints": initial.joints, "motions": initial.motions}
        self._names = {key: tuple(found) for key, found in names.items()}
        self._X_WB = task.scene.robot(layout.robots[0]).X_WB

    def read(self, demonstration: Demonstration) -> Examples:
        """Return an example for each frame of a demonstration."""
        trajectory = self._sampler.sample(demonstration, self._hz)
        actions, n = self._converter.convert(trajectory).values, trajectory.length
        targets, closings = {}, {}
        for k, name in enumerate(trajectory.robots):
            one = actions[:, k * ROBOT_SIZE : (k + 1) * ROBOT_SIZE]
            q = np.array([rotation_quat(row[3:9], RotationForm.ROT6D) for row in one])
            targets[name], closings[name] = self._in_base(np.column_stack([one[:, :3], q])), one[:, 9]
        last = np.full(n, n - 1)
        images = self._images(trajectory, n)
        return Examples(self._situations(trajectory, n), targets, closings, last, np.zeros(n, np.int64), images)

    def _images(self, trajectory: Trajectory, n: int) -> NDArray[np.uint8]:
        """Render the images of each frame."""
        layout = self._layout
        images = np.zeros((n, len(layout.cameras), layout.height, layout.width, 3), np.uint8)
        if not layout.cameras:
            return images
        size = ImageSize(layout.width, layout.height)
        views = {name: ImageView(name, size, size) for name in layout.cameras}
        frames = RenderedFrames(views, trajectory, lambda: self._sampler.world, self._names)
        for k, found in enumerate(frames.frames()):
            images[k] = [found[name] for name in layout.cameras]
        return images

    def _situations(self, trajectory: Trajectory, n: int) -> Situations:
        seen = trajectory.observations
        return Situations(
            hands={name: self._in_base(seen[f"{name}/hand"][:n]) for name in trajectory.robots},
            grippers={name: seen[f"{name}/gripper"][:n, 0] for name in trajectory.robots},
            objects={name: self._in_base(seen["objects"][:n, self._objects[name]]) for name in self._layout.objects},
            boxes={name: np.tile(box, (n, 1)) for name, box in self._boxes.items()},
            joints={name: seen["joints"][:n, self._joints[name]] for name in self._layout.joints},
            words=np.tile(self._words, (n, 1)),
        )

    def _in_base(self, numbers: Array) -> Poses:
        """Convert poses in the world, shape (n, 7), to the base frame of the first robot."""
        X_BW = Poses.constant(self._X_WB.inverse(), len(numbers))
        return X_BW @ Poses.of(numbers[:, :3], numbers[:, 3:])


def displaced(hands: Mapping[str, Poses], shift: float, turn: float, rng: np.random.Generator) -> dict[str, Poses]:
    """Displace hands at random: each by a vector and by a rotation whose standard deviations differ between examples.

    Args:
        hands: The poses X_BH, keyed by robot.
        shift: The largest standard deviation of the position, along each axis [m].
        turn: The largest standard deviation of the rotation vector, along each axis [rad].
        rng: The source of randomness.
    """
    found = {}
    for name, hand in hands.items():
        n = len(hand.p)
        scale = rng.uniform(0.0, 1.0, (n, 1))
        p = hand.p + rng.normal(0.0, shift, (n, 3)) * scale
        vectors = rng.normal(0.0, turn, (n, 3)) * scale
        found[name] = Poses(p, _rotation_matrices(vectors) @ hand.R)
    return found


def _rotation_matrices(vectors: Array) -> Array:
    """Return the rotation matrices of rotation vectors [rad], shape (n, 3, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, :, 0], 1e-12)).T
    zero = np.zeros_like(x)
    skew = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew))
