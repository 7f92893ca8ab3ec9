"""Fingers of a gripper: the free space between them, measured on the model by ray casting."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, read_robot
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.scene.robot import Gripper, Robot, mujoco_model

if TYPE_CHECKING:
    import mujoco

SHARES = 21
"""Number of openings at which the fingers are measured."""

STEP, DEEPEST = 0.001, 0.3
"""Spacing of the rays along the hand [m], and maximum depth from the hand frame [m]."""

WIDEST = 0.12
"""Hits beyond this distance [m] are not fingers."""

PAD = 0.002
"""Pads extend over the depths at which the gap exceeds its minimum by at most this much [m]."""

HIDDEN = 5
FINGERS = np.array([1, 0, 0, 0, 0, 0], np.uint8)
"""The geom group that rays ignore, and the mask of groups that they may hit: moving collision geoms."""


@dataclass(frozen=True, eq=False)
class Jaws:
    """The finger geometry at each closed ``share``, from 0 (open) to 1, shape (k,), in the hand frame.

    ``width`` [m] is the gap between the pads, which extend from ``low`` to ``tip`` along the hand's z axis [m]; shapes
    (k,). Fingers close along y.
    """

    share: Array
    width: Array
    low: Array
    tip: Array

    @property
    def opening(self) -> float:
        """The maximum gap [m]."""
        return float(self.width.max())

    def at_width(self, width: float) -> tuple[float, float, float]:
        """Return the closed share and the low and tip of the pads [m] at a gap of ``width`` [m]."""
        order = np.argsort(self.width)
        narrow = self.width[order]
        return (
            float(np.interp(width, narrow, self.share[order])),
            float(np.interp(width, narrow, self.low[order])),
            float(np.interp(width, narrow, self.tip[order])),
        )


@lru_cache(maxsize=8)
def jaws(robot: Robot) -> Jaws | None:
    """Measure the fingers of a robot; None without a gripper or if its fingers do not face each other along y."""
    native = mujoco_model(robot)
    if native is None or native.gripper is None:
        return None
    read = read_robot(robot, native, f"{robot.name}.")
    share = np.linspace(0.0, 1.0, SHARES)
    posed = [_posed(read, native.gripper, float(s)) for s in share]
    frame = native.frame("hand")
    body = read.model.body(read.prefix + frame.link).id
    X_WH = Pose.of(posed[0].xpos[body], posed[0].xquat[body]) @ frame.X_LF
    model, felt = copy.copy(read.model), (read.model.geom_contype != 0) | (read.model.geom_conaffinity != 0)
    moving = np.linalg.norm(posed[0].geom_xpos - posed[-1].geom_xpos, axis=1) > STEP
    model.geom_group[:] = np.where(felt & moving, 0, HIDDEN)
    rows = [_measure(model, data, X_WH) for data in posed]
    found = [(s, *row) for s, row in zip(share, rows, strict=True) if row is not None]
    if len(found) < 2:
        return None
    return Jaws(*(frozen_array(column) for column in zip(*found, strict=True)))


def finger_positions(gripper: Gripper, share: float) -> dict[str, float]:
    """Return the positions [rad or m] of all gripper joints, closed by ``share``, by the model's names."""
    positions = {name: start + share * (end - start) for name, (start, end) in gripper.joints.items()}
    for name, leader in gripper.follow.items():
        positions.setdefault(name, leader.multiplier * positions[leader.joint] + leader.offset)
    return positions


def _posed(read: MujocoRobot, gripper: Gripper, share: float) -> mujoco.MjData:
    import mujoco

    data = mujoco.MjData(read.model)
    data.qpos[:] = read.qpos
    for name, position in finger_positions(gripper, share).items():
        data.qpos[read.model.joint(read.prefix + name).qposadr[0]] = position
    mujoco.mj_kinematics(read.model, data)
    return data


def _measure(model: mujoco.MjModel, data: mujoco.MjData, X_WH: Pose) -> tuple[float, float, float] | None:
    """Return gap, low and tip of the pads; None if no ray hits two fingers."""
    depth = np.arange(0.0, DEEPEST, STEP)
    free = np.array([_free(model, data, X_WH, z) for z in depth])
    met = np.isfinite(free)
    if not met.any():
        return None
    width = float(free[met].min())
    flat = np.flatnonzero(met & (free <= width + PAD))
    breaks = np.flatnonzero(np.diff(flat) > 1)
    foremost = flat[breaks[-1] + 1 :] if len(breaks) else flat
    return max(width, 0.0), float(depth[foremost[0]]), float(depth[foremost[-1]])


def _free(model: mujoco.MjModel, data: mujoco.MjData, X_WH: Pose, z: float) -> float:
    """Return the gap between the fingers at depth ``z`` of the hand [m]; inf if a finger is not hit."""
    import mujoco

    start = X_WH.apply(np.array([0.0, 0.0, z]))
    hit = np.zeros(1, np.int32)
    sides = []
    for sign in (1.0, -1.0):
        far = mujoco.mj_ray(model, data, start, sign * X_WH.rotation[:, 1], FINGERS, 1, -1, hit)
        sides.append(far if 0 <= far < WIDEST else np.inf)
    return float(sum(sides))
