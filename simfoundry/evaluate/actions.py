"""Validation, limits and conversion of actions, for the action spaces in :mod:`simfoundry.spec.models.signals`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.evaluate.policies.base import InvalidAnswerError, RobotReading
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix, quat_from_rpy, rpy_from_quat
from simfoundry.scene.model import Scene
from simfoundry.spec.models.signals import (
    MAX_JOINT_DELTA,
    MAX_TRANSLATION,
    MAX_VELOCITY,
    ActionKind,
    ActionSpace,
    HandFrame,
    RotationForm,
)

if TYPE_CHECKING:
    from simfoundry.worlds.base import WorldRobot

# Distance [m] from the base within which hand poses are expected if the reach of a robot is unknown; table-top arms
# reach 0.5 to 1.8 m.
UNKNOWN_REACH = 2.0

# Length below which a quaternion or a row of a rotation matrix has no direction.
NO_DIRECTION = 1e-6

# Largest number in an action that is executed [m, rad, or one of these per second], as in a scene; larger ones are
# clipped, because their squares overflow.
FARTHEST_NUMBER = 1e6

Robots = Mapping[str, "RobotReading | WorldRobot"]


def action_size(robots: Robots, space: ActionSpace) -> int:
    """Return the length of an action, which consists of the arm values and the gripper target of each robot."""
    return sum(space.arm_size(len(robot.joints)) + 1 for robot in robots.values())


def columns(robots: Robots, space: ActionSpace) -> Iterator[tuple[str, slice, int]]:
    """Yield the name of each robot with the columns of its arm values and the column of its gripper target."""
    start = 0
    for name, robot in robots.items():
        end = start + space.arm_size(len(robot.joints))
        yield name, slice(start, end), end
        start = end + 1


def checked_actions(
    actions: object, robots: Robots, space: ActionSpace, subject: str = "actions", single: bool = False
) -> Array:
    """Validate the response from a policy and return it as an array of finite actions.

    Args:
        actions: The response, which may be any object.
        robots: The robots to be controlled.
        space: The meaning of the numbers.
        subject: A description of the response for error messages.
        single: If true, a single action is expected instead of a sequence of actions.

    Returns:
        The actions in float64, as an array of shape (horizon, action size), or (action size,) if ``single`` is set.

    Raises:
        InvalidAnswerError: If the response is not such an array.
    """
    size = action_size(robots, space)
    try:
        if np.ma.is_masked(actions):
            raise TypeError("some of its values are masked")
        array = np.asarray(actions)
        if array.dtype.kind not in "fiu":  # NumPy would convert booleans, complex numbers, objects and text
            raise TypeError(f"it is an array of `{array.dtype}`")
        array = np.array(array, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:  # tensors that require gradients raise the last one
        message = f"{subject} must be an array of numbers, got {type(actions).__name__}: {error}"
        raise InvalidAnswerError(message) from None
    if array.ndim != (1 if single else 2) or array.shape[-1] != size or not len(array):
        shape = f"({size},)" if single else f"(horizon, {size})"
        words = " + ".join(f"{_arm_words(space, len(r.joints))} and the gripper of `{n}`" for n, r in robots.items())
        raise InvalidAnswerError(f"{subject} must have shape {shape}, for {words}; got {array.shape}")
    for *row, column in np.argwhere(~np.isfinite(array)).tolist():
        where = _place(robots, space, row, column)
        raise InvalidAnswerError(f"{subject} must be finite; {where} is {array[*row, column]}")
    if space.of_hand:
        # Quaternions and rows of matrices are the same if they are normalized, apart from the clipping.
        bound = 1.0 if space.normalized else FARTHEST_NUMBER
        _check_rotations(np.clip(array, -bound, bound), robots, space, subject)
    return array


def _arm_words(space: ActionSpace, joints: int) -> str:
    return f"the {space.arm_size(joints)} values of `{space}`" if space.of_hand else f"{joints} joints"


def _place(robots: Robots, space: ActionSpace, row: list[int], column: int) -> str:
    name, arm, _ = next(entry for entry in columns(robots, space) if column <= entry[2])
    label = space.column(column - arm.start, len(robots[name].joints))
    return f"number {column}" + "".join(f" of action {k}" for k in row) + f" ({label} of `{name}`)"


def _check_rotations(actions: Array, robots: Robots, space: ActionSpace, subject: str) -> None:
    for name, arm, _ in columns(robots, space):
        for k, numbers in enumerate(np.atleast_2d(actions)[:, arm.start + 3 : arm.stop]):
            try:
                rotation_quat(numbers, space.rotation)
            except ValueError as error:
                where = f"action {k} for the hand of `{name}`"
                raise InvalidAnswerError(f"{subject} must contain valid rotations; in {where}, {error}") from None


def rotation_quat(numbers: Array, form: RotationForm) -> Array:
    """Convert a rotation to a unit wxyz quaternion, shape (4,).

    Raises:
        ValueError: If the numbers do not describe a rotation.
    """
    match form:
        case RotationForm.QUAT_WXYZ:
            length = float(np.linalg.norm(numbers))
            if length < NO_DIRECTION:
                raise ValueError("the quaternion has length 0")
            return numbers / length
        case RotationForm.ROTVEC:
            angle = float(np.linalg.norm(numbers))
            # sinc is smooth at angle 0: sin(angle / 2) / angle = sinc(angle / 2 / pi) / 2
            return np.concatenate([[math.cos(angle / 2)], np.sinc(angle / 2 / math.pi) / 2 * numbers])
        case RotationForm.RPY:
            return quat_from_rpy(*map(float, numbers))
        case RotationForm.ROT6D:
            first, second = numbers[:3], numbers[3:]
            length = float(np.linalg.norm(first))
            x = first / max(length, NO_DIRECTION)
            rest = second - (second @ x) * x
            if min(length, float(np.linalg.norm(rest))) < NO_DIRECTION:
                raise ValueError("the rows of the rotation matrix are zero or parallel")
            y = rest / np.linalg.norm(rest)
            return quat_from_matrix(np.array([x, y, np.cross(x, y)]))


def rotation_numbers(q: Array, form: RotationForm) -> Array:
    """Convert a unit wxyz quaternion to another representation, an array of shape (3,), (4,) or (6,).

    The sign of a quaternion is chosen such that its first number is not negative.
    """
    match form:
        case RotationForm.QUAT_WXYZ:
            return q if q[0] >= 0 else -q
        case RotationForm.ROTVEC:
            w, v = (q[0], q[1:]) if q[0] >= 0 else (-q[0], -q[1:])
            half = math.atan2(float(np.linalg.norm(v)), float(w))
            return np.asarray(v * 2 / np.sinc(half / math.pi))
        case RotationForm.RPY:
            return rpy_from_quat(q)
        case RotationForm.ROT6D:
            return np.asarray(Pose.of(q=q).rotation[:2].ravel())


def action_limits(space: ActionSpace, scene: Scene, robots: Mapping[str, WorldRobot]) -> Array:
    """Return the range of each value in an action that is not normalized, as an array of shape (action size, 2).

    The limits of joints that turn without end are infinite.
    """
    rows: list[tuple[float, float]] = []
    for name, robot in robots.items():
        limits = list(robot.limits().values())
        match space.kind:
            case ActionKind.JOINT_POSITION:
                rows += limits
            case ActionKind.JOINT_VELOCITY:
                rows += [(-MAX_VELOCITY, MAX_VELOCITY)] * len(limits)
            case ActionKind.JOINT_DELTA:
                rows += [(-MAX_JOINT_DELTA, MAX_JOINT_DELTA)] * len(limits)
            case ActionKind.HAND_POSE:
                known = scene.robot(name)
                reach = known.reach or UNKNOWN_REACH
                middle = known.X_WB.p if space.frame is HandFrame.WORLD else np.zeros(3)
                rows += [(float(at) - reach, float(at) + reach) for at in middle] + space.rotation_limits()
            case ActionKind.HAND_DELTA:
                rows += [(-MAX_TRANSLATION, MAX_TRANSLATION)] * 3 + space.rotation_limits()
        rows.append((0.0, 1.0))
    return np.array(rows)


def finite_limits(limits: Array) -> Array:
    """Replace the infinite limits of joints that turn without end by half a turn in each direction."""
    return np.where(np.isfinite(limits), limits, [-math.pi, math.pi])


def denormalized(values: Array, limits: Array) -> Array:
    """Map values from -1 to 1 to the limits. Other values are clipped."""
    low, high = finite_limits(limits).T
    return np.asarray(low + (np.clip(values, -1.0, 1.0) + 1.0) / 2.0 * (high - low))


def normalized(values: Array, limits: Array) -> Array:
    """Map values within the limits to the range from -1 to 1."""
    low, high = finite_limits(limits).T
    return np.asarray((values - low) / np.maximum(high - low, NO_DIRECTION) * 2.0 - 1.0)
