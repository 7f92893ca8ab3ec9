"""What a gripper's fingers leave free between them, measured on its model by rays."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, read_robot
from simfoundry.geometry.crossings import Solid, Span, bounds, crossings
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.scene.robot import Gripper, Robot, mujoco_model

if TYPE_CHECKING:
    import mujoco

SHARES = 21
"""At how many openings the fingers are measured."""

STEP, DEEPEST = 0.001, 0.3
"""Between rays, along the hand [m], and how far from its frame they are looked for."""

WIDEST = 0.12
"""What a ray meets further away than this [m] is no finger."""

PAD = 0.002
"""Where fingers leave at most this much more room than at their narrowest [m], they are flat enough to hold."""

HIDDEN = 5
FINGERS = np.array([1, 0, 0, 0, 0, 0], np.uint8)
"""The group of geoms that no ray is to meet, and the mask of those that they may: what moves and is felt."""


@dataclass(frozen=True, eq=False)
class Jaws:
    """The fingers at each closed ``share``, from 0 open to 1, shape (k,), in the hand's frame.

    ``width`` [m] is free between the pads, which reach from ``low`` to ``tip`` along the hand's z [m]; shapes (k,).
    Fingers close along y.
    """

    share: Array
    width: Array
    low: Array
    tip: Array

    @property
    def opening(self) -> float:
        """The greatest width [m]."""
        return float(self.width.max())

    def at_width(self, width: float) -> tuple[float, float, float]:
        """Share, and low and tip of the pads [m], where the pads are ``width`` [m] apart."""
        order = np.argsort(self.width)
        narrow = self.width[order]
        return (
            float(np.interp(width, narrow, self.share[order])),
            float(np.interp(width, narrow, self.low[order])),
            float(np.interp(width, narrow, self.tip[order])),
        )


@lru_cache(maxsize=8)
def jaws(robot: Robot) -> Jaws | None:
    """The fingers of a robot; None where it has no gripper or its fingers do not face each other along y."""
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
    """Positions [rad or m] of all joints of a gripper by the model's names, closed by ``share``."""
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
    """Width, low and tip of the pads; None where no ray meets two fingers."""
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
    """Room between the fingers at a depth ``z`` of the hand [m]; inf where one of them is not there."""
    import mujoco

    start = X_WH.apply(np.array([0.0, 0.0, z]))
    hit = np.zeros(1, np.int32)
    sides = []
    for sign in (1.0, -1.0):
        far = mujoco.mj_ray(model, data, start, sign * X_WH.rotation[:, 1], FINGERS, 1, -1, hit)
        sides.append(far if 0 <= far < WIDEST else np.inf)
    return float(sum(sides))


YAWS = 12
"""Directions of closing about the direction of approach, over half a turn; each counts twice, with the hand turned."""

ACROSS, ALONG = 17, 12
"""Most lines across the hand and along its approach."""

SPACING, FINE = 0.006, 0.0025
"""Least distance between lines across the hand, and along its approach [m]."""

MOST = 300
"""The best so many are enough to choose from."""

FACING = 0.92
"""Fingers meet surfaces that face them at least this much: the cosine, within the cone of friction."""

CLEARANCE = 0.004
"""Room left beside each finger when it comes [m]."""

PRELOAD = 0.012
"""How much wider than the thing the open fingers come, on each side [m], where the gripper is that wide."""

TIP = 0.005
"""How far behind the tip of the pads what is taken lies at least [m]."""

ALIKE = 0.004
"""Neighbouring lines whose spans differ by less than this [m] are one surface for the pads."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A hand about to close: ``X_WH`` when closed; it comes with its fingers at share ``open`` and closes on ``width``.

    ``cost`` is smaller for better ones.
    """

    X_WH: Pose
    width: float
    open: float
    cost: float


def down(tilts: tuple[float, ...] = (0.0,)) -> list[Array]:
    """Directions of approach, shape (3,): straight down, and tilted by angles [rad] towards eight sides."""
    found = []
    for tilt in tilts:
        for side in range(8 if tilt else 1):
            angle = side * math.pi / 4
            found.append(_tilted(tilt, angle))
    return found


def _tilted(tilt: float, angle: float) -> Array:
    return np.array([math.sin(tilt) * math.cos(angle), math.sin(tilt) * math.sin(angle), -math.cos(tilt)])


def rotations(shape: Solid, approach: Array) -> Iterator[Array]:
    """Rotations of the hand whose z is ``approach``, with closing directions y all around.

    They start from the direction in which the shape is longest, seen along the approach: what is long is taken across.
    """
    side = np.array([1.0, 0.0, 0.0]) if abs(approach[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    side = np.cross(approach, side)
    side /= np.linalg.norm(side)
    other = np.cross(approach, side)
    flat = shape.corners @ np.column_stack([side, other])
    _, axes = np.linalg.eigh(np.cov(flat.T))
    start = math.atan2(axes[1, 1], axes[0, 1])
    for k in range(YAWS):
        angle = start + k * math.pi / YAWS
        y = math.cos(angle) * side + math.sin(angle) * other
        yield np.column_stack([np.cross(y, approach), y, approach])


def grasps(shape: Solid, center: Array, jaws: Jaws, approaches: list[Array]) -> list[Grasp]:
    """All grasps of a shape whose mass is centred at ``center`` [m], from the best; both turns of the hand."""
    found: list[Grasp] = []
    for approach in approaches:
        for R_WH in rotations(shape, approach):
            found += _along(shape, center, jaws, R_WH)
    flip = Pose.of(q=[0.0, 0.0, 0.0, 1.0])
    both = [turned for g in found for turned in (g, Grasp(g.X_WH @ flip, g.width, g.open, g.cost + 1e-3))]
    return sorted(both, key=lambda g: g.cost)[:MOST]


def _along(shape: Solid, center: Array, jaws: Jaws, R_WH: Array) -> Iterator[Grasp]:
    """Grasps with the hand turned by R_WH."""
    low, high = bounds(shape, R_WH)
    across = _grid(low[0], high[0], ACROSS, SPACING)
    along = _grid(low[2], high[2], ALONG, FINE)
    a, h = np.meshgrid(across, along, indexing="ij")
    y = (low[1] + high[1]) / 2
    starts = np.column_stack([a.ravel(), np.full(a.size, y), h.ravel()]) @ R_WH.T
    lines = crossings(shape, starts, R_WH[:, 1])
    spans = [
        [_holdable(spans, jaws) for spans in lines[k * len(along) : (k + 1) * len(along)]] for k in range(len(across))
    ]
    tilt = math.acos(min(1.0, max(-1.0, -float(R_WH[2, 2]))))
    for i in range(len(across)):
        for j in range(len(along)):
            for span in spans[i][j]:
                middle = R_WH @ np.array([across[i], y + (span.start + span.end) / 2, along[j]])
                area = _area(spans, i, j, span)
                _, first, tip = jaws.at_width(span.width)
                opened = jaws.at_width(min(span.width + 2 * PRELOAD, jaws.opening))[0]
                aside = middle - center
                aside = aside - (aside @ R_WH[:, 2]) * R_WH[:, 2]
                off = float(np.linalg.norm(aside))
                tight = max(0.0, 0.008 - (jaws.opening - span.width) / 2) / 0.008
                for depth in ((first + tip) / 2, tip - TIP):
                    shallow = 0.15 if depth > (first + tip) / 2 else 0.0
                    cost = (1 - area) + 5 * off + 0.5 * tilt + 0.5 * tight + shallow + 2 * (1 - span.facing)
                    yield Grasp(_pose(R_WH, middle - R_WH[:, 2] * depth), span.width, opened, cost)


def _grid(low: float, high: float, most: int, spacing: float) -> Array:
    """Coordinates from a little inside ``low`` to a little inside ``high``, at least ``spacing`` apart."""
    count = int(np.clip((high - low) / spacing, 1, most))
    return low + (np.arange(count) + 0.5) * (high - low) / count


def _holdable(spans: list[Span], jaws: Jaws) -> list[Span]:
    """Single pieces and runs of pieces that the fingers can close on from both ends."""
    widest = jaws.opening - 2 * CLEARANCE
    found = []
    for i, first in enumerate(spans):
        for last in spans[i:]:
            facing = min(first.facing, last.facing)
            if last.end - first.start <= widest and facing >= FACING:
                found.append(Span(first.start, last.end, facing))
    return found


def _area(spans: list[list[list[Span]]], i: int, j: int, span: Span) -> float:
    """Share of the lines around one that meet the same surfaces: how much of the pads will touch."""
    around = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1) if di or dj]
    alike = 0
    for k, m in around:
        if 0 <= k < len(spans) and 0 <= m < len(spans[k]):
            near = (max(abs(other.start - span.start), abs(other.end - span.end)) for other in spans[k][m])
            alike += min(near, default=math.inf) < ALIKE
    return alike / len(around)


def _pose(R_WH: Array, p: Array) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R_WH, p
    return Pose.from_matrix(matrix)
