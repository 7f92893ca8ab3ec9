"""Validation of servers' answers, which are untrusted, and their conversion to actions in our units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import InvalidAnswerError, RobotReading
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.policy import PolicySpec


def actions_of(spec: PolicySpec, answer: Any, robots: Mapping[str, RobotReading]) -> Array:
    """Return the first ``horizon`` actions of an answer, shape (horizon, numbers of an action).

    Joints are in rad, m, rad/s or m/s; grippers from 0 open to 1 closed. Raises :class:`InvalidAnswerError` if the
    answer is not such an array.
    """
    width = sum(len(robot.joints) + 1 for robot in robots.values())
    chunk = _checked(spec, answer, width, _words(robots))
    out = np.array(chunk[: spec.horizon], dtype=np.float64)
    at = 0
    for robot in robots.values():
        joints = slice(at, at + len(robot.joints))
        if spec.velocity_unit is not None:
            out[:, joints] = np.clip(out[:, joints], -1, 1) * spec.velocity_unit
        out[:, joints.stop] = gripper_of(spec, out[:, joints.stop])
        at = joints.stop + 1
    return out


def gripper_of(spec: PolicySpec, numbers: Array) -> Array:
    """Convert the policy's gripper numbers to 0 open to 1 closed, shape (n,)."""
    convention = spec.gripper
    closed = np.clip((numbers - convention.open) / (convention.closed - convention.open), 0.0, 1.0)
    return closed if convention.threshold is None else (closed > convention.threshold).astype(np.float64)


def _checked(spec: PolicySpec, answer: Any, width: int, words: str) -> Array:
    if not isinstance(answer, np.ndarray):
        raise InvalidAnswerError(f"{spec.name} answered with a `{type(answer).__name__}`, not with an array of actions")
    if answer.dtype.kind not in "fiu":
        raise InvalidAnswerError(f"{spec.name} answered with an array of `{answer.dtype}`, not of numbers")
    if answer.ndim != 2:
        raise InvalidAnswerError(f"{spec.name} answered with an array of {_shape(answer)}, not of (steps, {width})")
    if answer.shape[1] != width:
        message = f"{spec.name} answered with {answer.shape[1]} numbers per action, but the robots take {width}"
        raise InvalidAnswerError(f"{message}: {words}")
    if len(answer) < spec.horizon:
        message = f"{spec.name} answered with {len(answer)} actions, but its `horizon` is {spec.horizon}"
        raise InvalidAnswerError(f"{message}; lower it to {len(answer)}" if len(answer) else message)
    wrong = np.argwhere(~np.isfinite(answer))
    if len(wrong):
        step, column = (int(v) for v in wrong[0])
        raise InvalidAnswerError(
            f"{spec.name} answered with `{answer[step, column]}` in action {step}, number {column}"
        )
    return answer


def _shape(array: np.ndarray[Any, Any]) -> str:
    return f"({', '.join(map(str, array.shape))})"


def _words(robots: Mapping[str, RobotReading]) -> str:
    return ", ".join(f"{len(robot.joints)} joints and a gripper of `{name}`" for name, robot in robots.items())
