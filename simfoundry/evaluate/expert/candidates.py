"""Candidate grasps of an object by parallel jaws, and candidate poses for releasing it on or in a target.

Grasps and poses are computed from collision geometry.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, islice, product

import numpy as np

from simfoundry.geometry.crossings import HalfSpaces, Span, bounds, crossings, met
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.vertical_contact import heights
from simfoundry.geometry.walls import LEVEL_RAYS, WALLED, hollow
from simfoundry.robots.arm import Jaws
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.object_shapes import hulls, solid
from simfoundry.scene.state import SceneState, object_at

# Number of closing directions about the approach direction over half a turn; the flipped hand doubles this number.
YAWS = 12

# Maximum ratio of the two principal variances of a round shape.
ROUND = 1.2

# Cost of turning a hand [1/rad] and of moving it [1/m]: a quarter turn costs as much as a fifth of the contact area,
# and the far wall of a cup a little more than the near one.
TURNED, MOVED = 0.12, 0.5

# Maximum number of rays across the hand and along its approach direction.
ACROSS, ALONG = 17, 12

# Minimum spacing of rays across the hand and along its approach direction [m].
SPACING, FINE = 0.006, 0.0025

# Number of best grasps to keep.
MOST = 300

# Minimum cosine of the angle between a finger's closing direction and the surface normal, which keeps the contact force
# within the friction cone.
FACING = 0.92

# Clearance beside each finger during the approach [m].
CLEARANCE = 0.004

# Additional finger opening on each side of the object [m], if the gripper is wide enough.
PRELOAD = 0.012

# Minimum distance between the object and the tips of the pads [m].
TIP = 0.005

# Maximum difference between the spans of neighboring rays for which they count as a single contact surface [m].
ALIKE = 0.004


@dataclass(frozen=True, eq=False)
class Grasp:
    """A grasp by a parallel gripper.

    Attributes:
        X_WH: The pose of the hand when it closes.
        width: The width of the object between the fingers [m].
        open: The fraction by which the gripper is closed during the approach, from 0 (open) to 1 (closed).
        cost: The cost of the grasp. Better grasps have a lower cost.
    """

    X_WH: Pose
    width: float
    open: float
    cost: float


def down(tilts: tuple[float, ...] = (0.0,)) -> list[Array]:
    """Return approach directions that point straight down or are tilted by the given angles [rad].

    For each nonzero tilt angle, there are eight directions, tilted toward eight evenly spaced sides. Each direction is
    an array of shape (3,).
    """
    angles = [(tilt, side * math.pi / 4) for tilt in tilts for side in range(8 if tilt else 1)]
    return [np.array([math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), -math.cos(t)]) for t, a in angles]


def rotations(shape: HalfSpaces, approach: Array, X_WH: Pose | None = None) -> Iterator[Array]:
    """Yield hand rotations whose z axis is ``approach`` and whose closing directions (y) are spread over half a turn.

    The closing directions are measured from the shape's longest extent, as seen along the approach direction. One
    closing direction is therefore exactly perpendicular to that extent, so long objects can be grasped across their
    width. A round shape has no longest extent; its closing directions are measured from that of the hand at ``X_WH``.
    """
    side = np.cross(approach, [1.0, 0.0, 0.0] if abs(approach[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(approach, side)
    spread, axes = np.linalg.eigh(np.cov((shape.corners @ np.column_stack([side, other])).T))
    first = axes[:, 1]
    if X_WH is not None and spread[1] < ROUND * spread[0]:
        first = np.array([side @ X_WH.rotation[:, 1], other @ X_WH.rotation[:, 1]])
    for angle in math.atan2(first[1], first[0]) + np.arange(YAWS) * math.pi / YAWS:
        y = math.cos(angle) * side + math.sin(angle) * other
        yield np.column_stack([np.cross(y, approach), y, approach])


def grasps(
    shape: HalfSpaces, center: Array, jaws: Jaws, approaches: list[Array], X_WH: Pose | None = None
) -> list[Grasp]:
    """Return the best grasps of a shape, in order of increasing cost.

    Grasps with the hand flipped are included.

    Args:
        shape: The shape to grasp.
        center: The center of mass [m], shape (3,).
        jaws: The geometry of the fingers.
        approaches: The approach directions to consider.
        X_WH: A pose of the hand. Of grasps that are as good, those near it are preferred, so that the same shape is
            grasped in the same way wherever its vertices are.
    """
    flip = Pose.of(q=[0.0, 0.0, 0.0, 1.0])
    turns = (R_WH for approach in approaches for R_WH in rotations(shape, approach, X_WH))
    found = (grasp for R_WH in turns for grasp in _along(shape, center, jaws, R_WH))
    both = [turned for g in found for turned in (g, Grasp(g.X_WH @ flip, g.width, g.open, g.cost + 1e-3))]
    if X_WH is not None:
        both = [replace(g, cost=g.cost + _effort(g.X_WH, X_WH)) for g in both]
    return sorted(both, key=lambda g: g.cost)[:MOST]


def _effort(X_WH: Pose, start: Pose) -> float:
    """Return the cost of moving a hand to a grasp."""
    return TURNED * X_WH.angle_to(start) + MOVED * float(np.linalg.norm(X_WH.p - start.p))


def _along(shape: HalfSpaces, center: Array, jaws: Jaws, R_WH: Array) -> Iterator[Grasp]:
    """Yield the grasps for which the hand has the rotation R_WH."""
    low, high = bounds(shape, R_WH)
    across = _grid(low[0], high[0], ACROSS, SPACING)
    along = _grid(low[2], high[2], ALONG, FINE)
    a, h = np.meshgrid(across, along, indexing="ij")
    y = (low[1] + high[1]) / 2
    starts = np.column_stack([a.ravel(), np.full(a.size, y), h.ravel()]) @ R_WH.T
    rays = list(product(range(len(across)), range(len(along))))
    lines = zip(rays, crossings(shape, starts, R_WH[:, 1]), strict=True)
    spans = {ray: _holdable(found, jaws) for ray, found in lines}
    tilt = math.acos(min(1.0, max(-1.0, -float(R_WH[2, 2]))))
    for i, j in rays:
        for span in spans[i, j]:
            middle = R_WH @ np.array([across[i], y + (span.start + span.end) / 2, along[j]])
            area = _area(spans, i, j, span)
            _, first, tip = jaws.at_width(span.width)
            opened = jaws.at_width(min(span.width + 2 * PRELOAD, jaws.opening))[0]
            aside = middle - center
            off = float(np.linalg.norm(aside - (aside @ R_WH[:, 2]) * R_WH[:, 2]))
            tight = max(0.0, 0.008 - (jaws.opening - span.width) / 2) / 0.008
            for depth in ((first + tip) / 2, tip - TIP):
                shallow = 0.15 if depth > (first + tip) / 2 else 0.0
                cost = (1 - area) + 5 * off + 0.5 * tilt + 0.5 * tight + shallow + 2 * (1 - span.facing)
                yield Grasp(Pose.of(middle - R_WH[:, 2] * depth, quat_from_matrix(R_WH)), span.width, opened, cost)


def _grid(low: float, high: float, most: int, spacing: float) -> Array:
    """Return evenly spaced coordinates between ``low`` and ``high``.

    The outermost coordinates are slightly inside this range. The spacing is at least ``spacing``.
    """
    count = int(np.clip((high - low) / spacing, 1, most))
    return low + (np.arange(count) + 0.5) * (high - low) / count


def _holdable(spans: list[Span], jaws: Jaws) -> list[Span]:
    """Return the spans, or sequences of consecutive spans, that the fingers can hold from both ends."""
    pairs = combinations_with_replacement(spans, 2)
    found = (Span(first.start, last.end, min(first.facing, last.facing)) for first, last in pairs)
    return [span for span in found if span.width <= jaws.opening - 2 * CLEARANCE and span.facing >= FACING]


def _area(spans: dict[tuple[int, int], list[Span]], i: int, j: int, span: Span) -> float:
    """Return the fraction of neighboring rays that hit the same surfaces.

    This is a measure of the contact area of the finger pads.
    """
    around = [(i + di, j + dj) for di, dj in product((-1, 0, 1), repeat=2) if di or dj]
    near = ([max(abs(o.start - span.start), abs(o.end - span.end)) for o in spans.get(ray, ())] for ray in around)
    return sum(min(off, default=math.inf) < ALIKE for off in near) / len(around)


# Number of rotations about the vertical axis to try.
TURNS = 8

# Maximum number of positions along each side of the target, and their minimum spacing [m].
GRID, GRID_SPACING = 7, 0.012

# Minimum depth of an object's lowest point below the rim of a cavity [m].
SUNK = 0.008

UP = np.array([0.0, 0.0, 1.0])

# Number of placements of each kind to find, and maximum number of upended poses to try.
ENOUGH, LOOKED_AT = 48, 400

# Cost per meter of distance from the center [1/m].
FAR = 10.0

# Minimum ratio of the two largest extents for an object to count as long; a long object may also be placed on end.
LONG = 1.8

# Tilt angles to try when a long object is placed in a cavity [rad].
LEANS = (0.0, 0.3, 0.6)


@dataclass(frozen=True, eq=False)
class PlaceAt:
    """A pose in which an object touches its support.

    Better placements have a lower ``cost``.
    """

    X_WO: Pose
    cost: float


class _Target:
    """A support for an object, and the other movable objects around it.

    The support is an object or one of its links.
    """

    def __init__(self, scene: Scene, state: SceneState, name: str, target: str, inside: bool) -> None:
        owner, _, link = target.partition(".")
        item = object_at(scene.object(owner), state)
        self._whole, self._inside = hulls(item), inside
        self._link = [each.name for each in item.links].index(link) if link else None
        self._part = self._whole if self._link is None else self._whole.of_link(self._link)
        self._R_WC = (item.X_WO @ link_poses(item)[link] if link else item.X_WO).rotation
        self._top = self._part.extent(UP)[1]
        self._walls = solid(item, state, [link] if link else None)
        others = (o for o in scene.objects if o.name not in (name, owner) and not o.fixed)
        self._others = [hulls(object_at(o, state)) for o in others]

    def spots(self) -> list[tuple[Array, float]]:
        """Return horizontal positions above the support and their distances from its center, closest first.

        All values are in meters.
        """
        middle = self._part.middle(self._R_WC)
        middle = hollow(self._part, middle, self._R_WC) if self._inside else middle
        axes = self._R_WC[:, :2]
        half = [(high - low) / 2 for low, high in (self._part.extent(axes[:, k]) for k in range(2))]
        rows, columns = (np.linspace(-0.8, 0.8, _odd(1.6 * h / GRID_SPACING)) * h for h in half)
        spots = [((middle + axes @ np.array([a, b]))[:2], math.hypot(a, b)) for a in rows for b in columns]
        return sorted(spots, key=lambda s: s[1])

    def place(self, turn: Pose, shape: Hulls, spot: Array, cost: float) -> PlaceAt | None:
        """Lower an object onto the support at a given position.

        Returns:
            The placement, or None if the object hits another object first or does not end up inside as required.
        """
        at = np.array([*(spot - shape.middle(np.eye(3))[:2]), 0.0])
        held = shape.moved(at)
        touching = heights(held, self._whole)
        lift = float(touching.max())
        first = self._whole.link[np.unravel_index(int(touching.argmax()), touching.shape)[1]]
        if not math.isfinite(lift) or (self._link is not None and first != self._link):
            return None
        foot = lift + shape.extent(UP)[0]
        if self._inside and not (foot < self._top - SUNK and self._walled(np.array([*spot, foot]))):
            return None
        if any(float(heights(held, other).max()) > lift for other in self._others):
            return None
        return PlaceAt(Pose.of(at + lift * UP, turn.q), cost)

    def _walled(self, foot: Array) -> bool:
        """Return True if a point at or slightly above an object's base has walls on most sides."""
        return any(met(self._walls, foot + height * UP, LEVEL_RAYS).sum() >= WALLED for height in (0.001, 0.01, 0.02))


def places(scene: Scene, state: SceneState, name: str, target: str, inside: bool) -> list[PlaceAt]:
    """Return poses of an object on or inside a target, in order of increasing cost.

    The current orientation at the center of the free area is preferred. Inside a target, long objects may also be
    placed on end.

    Args:
        scene: The scene.
        state: The current state.
        name: The object to place.
        target: The name of an object or a link.
        inside: If true, the object is placed in a cavity of the target.
    """
    item, support = scene.object(name), _Target(scene, state, name, target, inside)
    spots = support.spots()
    lying = [(turn, 0.0) for turn in _turned(state.poses[name])]
    found = _central([p for place in _tried(item, lying, spots) if (p := support.place(*place)) is not None])
    if inside:
        on_end = _tried(item, _on_end(item, state), spots)[:LOOKED_AT]
        found += islice((p for place in on_end if (p := support.place(*place)) is not None), ENOUGH)
    return sorted(found, key=lambda p: p.cost)


def _tried(
    item: SceneObject, turns: Iterable[tuple[Pose, float]], spots: list[tuple[Array, float]]
) -> list[tuple[Pose, Hulls, Array, float]]:
    """Return all combinations of rotation and position, along with the rotated shape and the cost.

    The combinations are in order of increasing cost.
    """
    turned = [(turn, hulls(replace(item, X_WO=turn)), penalty) for turn, penalty in turns]
    every = [(turn, shape, spot, penalty + FAR * off) for turn, shape, penalty in turned for spot, off in spots]
    return sorted(every, key=lambda each: each[3])


def _central(found: list[PlaceAt]) -> list[PlaceAt]:
    """Return the placements closest to the center of all placements found.

    For example, for a support that is half covered by a lid, this is the center of the open half.
    """
    if not found:
        return []
    middle = np.mean([place.X_WO.p[:2] for place in found], axis=0)
    off = [float(np.linalg.norm(place.X_WO.p[:2] - middle)) for place in found]
    central = [PlaceAt(place.X_WO, FAR * distance) for place, distance in zip(found, off, strict=True)]
    return sorted(central, key=lambda place: place.cost)[:ENOUGH]


def _odd(count: float) -> int:
    """Round to an odd number of positions, so that one of them is at the center.

    The result is at most :data:`GRID`.
    """
    return 2 * (int(np.clip(count, 3, GRID)) // 2) + 1


def _turned(pose: Pose) -> list[Pose]:
    """Return the rotations of a pose after turning it about the vertical axis by evenly spaced angles."""
    now = Pose.of(q=pose.q)
    return [Pose.of(q=quat_from_rpy(0.0, 0.0, 2 * math.pi * k / TURNS)) @ now for k in range(TURNS)]


def _on_end(item: SceneObject, state: SceneState) -> Iterator[tuple[Pose, float]]:
    """Yield rotations that place a long object on end with a tilt of up to :data:`LEANS`, along with their costs."""
    axis = _long_axis(item)
    if axis is None:
        return
    now = Pose.of(q=state.poses[item.name].q)
    level = now.rotation[:, axis]
    heading = math.atan2(level[1], level[0]) + math.pi / 2
    for lean, sign in product(LEANS, (1, -1)):
        # Rotate about the horizontal axis perpendicular to the object until it points down or up.
        half = sign * (math.pi / 2 - lean) / 2
        q = [math.cos(half), math.sin(half) * math.cos(heading), math.sin(half) * math.sin(heading), 0.0]
        yield from ((turn, 0.3 + 0.1 * lean) for turn in _turned(Pose.of(q=q) @ now))


def _long_axis(item: SceneObject) -> int | None:
    """Return the index of the axis along which the object is long.

    The result is None if the object is not long.
    """
    size = hulls(replace(item, X_WO=Pose.of())).size()
    axis = int(size.argmax())
    return axis if size[axis] > LONG * float(np.delete(size, axis).max()) else None
