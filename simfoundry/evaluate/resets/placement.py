"""A single attempt at an initial state, in which objects are placed at random positions, checked and settled.

Each object is assigned a cell of its grid, drawn without replacement, and a random position within that cell.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.task import Reset, ResetRegion
from simfoundry.worlds.base import World
from simfoundry.worlds.rest import is_ball, restless
from simfoundry.worlds.settle import SettleOptions, settle

# The indices of a grid cell along x and y, counted from 0.
GridCell = tuple[int, int]


def deal(reset: Reset, seed: int, block: int) -> dict[str, list[GridCell]]:
    """Assign a grid cell to each object for each initial state in a block.

    A block has one initial state per cell of the grid, so the cells of an object are a random permutation of all cells.
    The cells of an object do not depend on the other objects.
    """
    along_x, along_y = reset.grid
    cells = [(i, j) for i in range(along_x) for j in range(along_y)]
    return {name: [cells[k] for k in _generator(seed, name, block).permutation(len(cells))] for name in reset.objects}


def draws(name: str, seed: int, start: int) -> np.random.Generator:
    """Return the random generator for an object's positions in all attempts at one initial state."""
    return _generator(seed, name, start, 1)


def sample(
    region: ResetRegion, grid: Sequence[int], cell: GridCell, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Uniformly sample a position x, y [m] within a cell and a rotation [deg] within the allowed range."""
    (low_x, high_x), (low_y, high_y) = bounds(region, grid, cell)
    share = rng.random(3)
    low_yaw, high_yaw = region.yaw_deg
    x, y, yaw = low_x + share[0] * (high_x - low_x), low_y + share[1] * (high_y - low_y), share[2]
    return float(x), float(y), float(low_yaw + yaw * (high_yaw - low_yaw))


def bounds(region: ResetRegion, grid: Sequence[int], cell: GridCell) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the range of x and the range of y that a cell covers [m]."""
    (low_x, high_x), (low_y, high_y) = region.x, region.y
    (i, j), wide, deep = cell, (high_x - low_x) / grid[0], (high_y - low_y) / grid[1]
    return (low_x + i * wide, low_x + (i + 1) * wide), (low_y + j * deep, low_y + (j + 1) * deep)


def _generator(seed: int, name: str, *more: int) -> np.random.Generator:
    # Use a checksum of the name, because Python's own hash differs between processes.
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *more])


# Settling limits for initial states: half the displacement allowed for scenes, and the default limits on the tilt and
# the overlap.
SETTLING = SettleOptions(max_drift_m=0.01)

# Maximum overlap [m] between an object and its support before settling; settling removes it within a few steps.
OVERLAP = 1e-3

# Maximum distance [m] between a settled object and its cell, which allows for rounding errors but not for sliding.
AGREES = 1e-4

# Number of decimals to which settled positions [m] and quaternions are rounded, so that different engine versions
# settle to the same initial state.
DIGITS = 5


@dataclass(frozen=True)
class Refusal:
    """The reason why an attempt failed.

    Attributes:
        object: The object that caused the failure.
        kind: The kind of failure, for statistics.
        why: A description of the failure that includes numbers.
        other: The object with which it collided, if that object is also placed at random, otherwise an empty string.
            Exchanging cells can help only if this is set, because every cell must be used by an initial state.
    """

    object: str
    kind: str
    why: str
    other: str = ""


# The placement of each object: x, y [m] and the rotation about z [deg] relative to the pose in the scene.
Spots = Mapping[str, tuple[float, float, float]]


def placed(task: Task, spots: Spots) -> SceneState:
    """Return the state with the objects at their sampled positions. Their heights are given by the scene.

    Objects that rest on or in a placed object move along with it. Joints keep their positions from the scene.
    """
    scene = task.scene
    poses = {item.name: item.X_WO for item in scene.objects}
    for name, (x, y, yaw_deg) in spots.items():
        before = poses[name]
        turn = Pose.of(q=quat_from_rpy(0.0, 0.0, float(np.radians(yaw_deg))))
        poses[name] = Pose.of((x, y, float(before.p[2])), (turn @ Pose.of(q=before.q)).q)
    for item in scene.objects:
        carrier = _moving_carrier(task, item.name, spots)
        if carrier is not None and item.name not in spots and not item.fixed:
            poses[item.name] = poses[carrier] @ scene.object(carrier).X_WO.inverse() @ item.X_WO
    return SceneState.of(poses, {}, {})


def _moving_carrier(task: Task, name: str, spots: Spots) -> str | None:
    """Return the closest object in the chain of supports that is placed at random.

    The result is None if there is no such object.
    """
    seen = {name}
    while (name := task.carriers.get(name, "")) and name not in seen:
        if name in spots:
            return name
        seen.add(name)
    return None


def clash(task: Task, world: World, spots: Spots, state: SceneState) -> Refusal | None:
    """Return a refusal for the deepest overlap of a moved object with anything other than its support.

    The result is None if there is no such overlap.
    """
    moved = {n for n in state.poses if n in spots or _moving_carrier(task, n, spots) is not None}
    world.reset(state)
    overlaps = [(c.depth, *pair) for c in world.contacts() for pair in ((c.a, c.b), (c.b, c.a)) if pair[0] in moved]
    related = task.carriers.items() | {(support, name) for name, support in task.carriers.items()}
    wrong = [each for each in overlaps if each[0] > (OVERLAP if each[1:] in related else 0.0)]
    if not wrong:
        return None
    depth, name, other = max(wrong, key=lambda each: each[0])
    blamed, met = (n if n in spots else _moving_carrier(task, n, spots) or "" for n in (name, other))
    return Refusal(blamed, f"it collided with `{other}`", f"`{name}` overlaps `{other}` by {depth * 1000:.1f} mm", met)


def settled(task: Task, world: World, state: SceneState) -> SceneState | Refusal:
    """Settle a state.

    Returns:
        The rounded state at rest, or the reason why settling failed.
    """
    result = settle(world, SETTLING, state=state)
    for report in result.objects:
        name, ball = report.name, is_ball(task.scene.object(report.name))
        for problem in report.problems:
            if not (ball and problem.startswith("tilted")):
                return Refusal(name, f"it {problem}", f"`{name}` {problem}")
    return rounded(result.state)


def rounded(state: SceneState) -> SceneState:
    """Round a state to :data:`DIGITS` decimals."""
    poses, motions = ({name: _rounded(pose) for name, pose in m.items()} for m in (state.poses, state.motions))
    return SceneState.of(poses, {name: round(v, DIGITS) + 0.0 for name, v in state.joints.items()}, motions)


def _rounded(pose: Pose) -> Pose:
    return Pose.of(np.round(pose.p, DIGITS) + 0.0, np.round(pose.q, DIGITS) + 0.0)


def left_cell(task: Task, cells: Mapping[str, GridCell], state: SceneState) -> Refusal | None:
    """Return a refusal if an object settled outside its cell, otherwise None."""
    for name, cell in cells.items():
        spans = bounds(task.reset.objects[name], task.reset.grid, cell)
        for (low, high), value, axis in zip(spans, state.poses[name].p[:2], "xy", strict=True):
            outside = max(low - float(value), float(value) - high)
            if outside > AGREES:
                why = f"`{name}` settled {outside * 1000:.1f} mm outside its cell along {axis}"
                return Refusal(name, "it settled outside its cell", why)
    return None


def not_at_rest(world: World, state: SceneState) -> Refusal | None:
    """Return a refusal if an object moves in a settled and rounded state, otherwise None."""
    world.reset(state)
    before = world.state()
    world.step(round(SETTLING.rest_s / world.timestep))
    for name in sorted(restless(world.scene, before, world.state())):
        return Refusal(name, "it does not stay at rest", f"`{name}` does not stay at rest for {SETTLING.rest_s:g} s")
    return None
