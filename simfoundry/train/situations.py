"""The input of the baseline: the state of a moment as one vector.

The vector describes objects relative to the hands and to each other, together with their sizes, so that one network
can act in scenes in which the same objects stand elsewhere or have other shapes. Training and rollouts both compute it
here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.rollouts.control import check_cameras
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array, Index, Poses
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.models.predicate import Condition, parse_call, texts


@dataclass(frozen=True)
class InputLayout:
    """The entries of the input vector.

    Attributes:
        robots: The robots that act, in the order of an action.
        objects: The objects whose poses are inputs: those that the sub-tasks and the goal name, in this order.
        joints: The joints of these objects whose positions are inputs, such as ``cabinet.drawer``.
        words: The words that distinguish the instructions, sorted; empty if there is only one instruction.
        cameras: The cameras whose images are inputs instead of the true poses of objects and the positions of joints.
        width: The width of the images [px], or 0 without cameras.
        height: The height of the images [px], or 0 without cameras.
    """

    robots: tuple[str, ...]
    objects: tuple[str, ...]
    joints: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    width: int = 0
    height: int = 0

    @property
    def size(self) -> int:
        """The length of the vector."""
        objects = len(self.objects)
        per_robot, per_object, pairs = 10 + 6 * objects, 12, objects * (objects - 1) // 2
        return len(self.robots) * per_robot + per_object * objects + 3 * pairs + len(self.joints) + len(self.words)


@dataclass(frozen=True, eq=False)
class Situations:
    """The states of n moments, in the base frame B of the first robot.

    Attributes:
        hands: The poses X_BH of the hands, keyed by robot.
        grippers: The positions of the grippers, from 0 (open) to 1 (closed), shape (n,), keyed by robot.
        objects: The poses X_BO of the objects, keyed by object.
        boxes: The center and the extents of each object's bounding box in its own frame [m], shape (n, 6).
        joints: The positions of the objects' joints [rad or m], shape (n,), keyed by joint.
        words: 1 for each word of the layout that the instruction contains, otherwise 0, shape (n, words).
    """

    hands: Mapping[str, Poses]
    grippers: Mapping[str, Array]
    objects: Mapping[str, Poses]
    boxes: Mapping[str, Array]
    joints: Mapping[str, Array]
    words: Array

    def at(self, index: Index) -> Situations:
        """Select moments by index."""
        return Situations(
            hands={name: poses.at(index) for name, poses in self.hands.items()},
            grippers={name: values[index] for name, values in self.grippers.items()},
            objects={name: poses.at(index) for name, poses in self.objects.items()},
            boxes={name: values[index] for name, values in self.boxes.items()},
            joints={name: values[index] for name, values in self.joints.items()},
            words=self.words[index],
        )

    def with_robots(self, hands: Mapping[str, Poses], grippers: Mapping[str, Array]) -> Situations:
        """Return the same moments with other poses of the hands, and other positions of the grippers."""
        return replace(self, hands=hands, grippers=grippers)

    @staticmethod
    def joined(parts: Sequence[Situations]) -> Situations:
        """Concatenate moments."""
        first = parts[0]
        return Situations(
            hands={name: _joined([part.hands[name] for part in parts]) for name in first.hands},
            grippers={name: np.concatenate([part.grippers[name] for part in parts]) for name in first.grippers},
            objects={name: _joined([part.objects[name] for part in parts]) for name in first.objects},
            boxes={name: np.concatenate([part.boxes[name] for part in parts]) for name in first.boxes},
            joints={name: np.concatenate([part.joints[name] for part in parts]) for name in first.joints},
            words=np.concatenate([part.words for part in parts]),
        )


def _joined(poses: Sequence[Poses]) -> Poses:
    return Poses(np.concatenate([one.p for one in poses]), np.concatenate([one.R for one in poses]))


def input_vectors(layout: InputLayout, now: Situations) -> Array:
    """Return the input vectors, shape (n, layout.size).

    For each robot: the position of its hand [m], two axes of the hand, the gripper, and for each object its position
    relative to the hand, once along the axes of the base and once along those of the hand [m]. For each object: two of
    its axes, its bounding box [m], and its position relative to the objects before it [m]. Then the joints [rad or m]
    and the words.
    """
    parts: list[Array] = []
    for robot in layout.robots:
        hand = now.hands[robot]
        parts += [hand.p, hand.R[:, :, 0], hand.R[:, :, 2], now.grippers[robot][:, None]]
        for name in layout.objects:
            away = now.objects[name].p - hand.p
            parts += [away, np.einsum("nij,ni->nj", hand.R, away)]
    for k, name in enumerate(layout.objects):
        pose = now.objects[name]
        parts += [pose.R[:, :, 0], pose.R[:, :, 2], now.boxes[name]]
        parts += [pose.p - now.objects[other].p for other in layout.objects[:k]]
    parts += [now.joints[name][:, None] for name in layout.joints]
    return np.concatenate([*parts, now.words], axis=1)


def box_numbers(task: Task, name: str) -> Array:
    """Return the center and the extents of an object's bounding box in its own frame [m], shape (6,)."""
    low, high = bounds(task.scene.object(name))
    return np.concatenate([(low + high) / 2, high - low])


def input_layout(tasks: Sequence[Task], cameras: Sequence[str] = (), width: int = 0) -> InputLayout:
    """Return the layout for tasks with the same robots and the same objects in their goals.

    Args:
        tasks: The tasks.
        cameras: The cameras whose images are inputs, or none for true poses as inputs.
        width: The width of the images [px]. Their height follows from the first camera.

    Raises:
        SimfoundryError: If the tasks differ in more than the scene and the instruction.
    """
    first = tasks[0]
    layout = InputLayout(first.robots, _objects(first), _joints(first))
    for task in tasks[1:]:
        other = InputLayout(task.robots, _objects(task), _joints(task))
        if other != layout:
            raise SimfoundryError(
                f"one baseline cannot learn task `{first.name}` and task `{task.name}`: their robots are "
                f"{', '.join(layout.robots)} and {', '.join(other.robots)}, and the objects in their goals "
                f"{', '.join((*layout.objects, *layout.joints))} and {', '.join((*other.objects, *other.joints))}; "
                "train a policy for each of them"
            )
    layout = replace(layout, words=_distinct_words(task.instruction for task in tasks))
    return layout if not cameras else _with_cameras(layout, first, tuple(cameras), width)


def _with_cameras(layout: InputLayout, task: Task, cameras: tuple[str, ...], width: int) -> InputLayout:
    """Return a layout with images instead of true poses."""
    scene = task.scene
    check_cameras(scene, {name: ImageSize(width, 1) for name in cameras}, "the training")
    known = {camera.name: camera for camera in (*scene.cameras, *(mounted.camera for mounted in scene.mounted))}
    heights = {name: max(1, round(width * known[name].height / known[name].width)) for name in cameras}
    if len(set(heights.values())) > 1:
        listed = ", ".join(f"{name} has {width} x {height}" for name, height in heights.items())
        raise SimfoundryError(f"the images of all cameras must have the same proportions, but {listed} pixels")
    height = heights[cameras[0]]
    return replace(layout, objects=(), joints=(), cameras=cameras, width=width, height=height)


def check_fits(layout: InputLayout, task: Task, who: str) -> None:
    """Check that a task has the robots, objects and joints of a layout.

    Raises:
        SimfoundryError: If something is missing.
    """
    names = {item.name for item in task.scene.objects}
    joints = {item.qualified(joint.name) for item in task.scene.objects for joint in item.joints}
    lost = [f"object `{name}`" for name in layout.objects if name not in names]
    lost += [f"joint `{name}`" for name in layout.joints if name not in joints]
    if layout.robots != task.robots:
        lost.insert(0, f"the robots {', '.join(layout.robots)} (it has {', '.join(task.robots) or 'none'})")
    if lost:
        raise SimfoundryError(f"{who} was trained with {' and '.join(lost)}, which task `{task.name}` does not have")


def word_flags(layout: InputLayout, instruction: str) -> Array:
    """Return 1 for each word of the layout that an instruction contains, otherwise 0, shape (words,)."""
    said = _words(instruction)
    return np.array([float(word in said) for word in layout.words])


def _objects(task: Task) -> tuple[str, ...]:
    goals: list[Condition] = [*(step.goal for step in task.subtasks.values()), task.goal]
    named = [arg.partition(".")[0] for goal in goals for text, _ in texts(goal) for arg in parse_call(text).args]
    known = {item.name for item in task.scene.objects}
    return tuple(dict.fromkeys(name for name in named if name in known))


def _joints(task: Task) -> tuple[str, ...]:
    items = [task.scene.object(name) for name in _objects(task)]
    return tuple(item.qualified(joint.name) for item in items for joint in item.joints if joint.has_axis)


def _words(instruction: str) -> frozenset[str]:
    return frozenset("".join(c if c.isalnum() else " " for c in instruction.lower()).split())


def _distinct_words(instructions: Iterable[str]) -> tuple[str, ...]:
    sets = [_words(text) for text in dict.fromkeys(instructions)]
    return tuple(sorted(frozenset().union(*sets) - frozenset.intersection(*sets)))
