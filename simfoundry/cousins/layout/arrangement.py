"""Keep track of the objects in a scene, and place more objects among them, individually or in batches.

In a batch, each object gets the first of its candidate poses that is clear of all previous objects, as if the objects
were placed individually by :func:`simfoundry.cousins.layout.rejection_sampling.find`. For speed, a few candidates per
object are drawn and tested together. Only an object without a free candidate in the batch requires an individual
search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from simfoundry.cousins.layout.rejection_sampling import (
    Allowed,
    Clear,
    Found,
    Mask,
    Occupancy,
    Region,
    find,
    rectangles_meet,
)
from simfoundry.cousins.layout.supports import Complex, Outline, Support
from simfoundry.cousins.layout.twin import Twin
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.place import CLEARANCE

# Clearance between objects that should not touch [m]; equal to the contact margin of the engines.
GAP = 0.002

# Number of candidates per object in a batch.
EACH = 4

# Maximum number of objects in a batch; the pairwise tables of a batch fit into the processor cache.
TOGETHER = 24

# Position x and y [m] of an object's frame, and its rotation about z [rad].
Spot = tuple[float, float, float]


class _Block:
    """A batch of candidate placements, with :data:`EACH` candidates per object.

    The batch records which candidates overlap each other or objects that have already been placed.
    """

    def __init__(self, things: Sequence[tuple[Outline, Region]], there: Occupancy, rng: np.random.Generator) -> None:
        self._there = there
        outlines, regions = [o for o, _ in things], [r for _, r in things]
        low, span = (np.repeat(np.array([r.span[k] for r in regions]), EACH, axis=0) for k in (0, 1))
        drawn = rng.random((len(things) * EACH, 3)) * span + low
        turn = np.exp(1j * drawn[:, 2])
        self._center = drawn[:, 0] + 1j * drawn[:, 1]
        frame = self._center - turn * _each([o.middle for o in outlines])
        self.spots: list[Spot] = list(zip(frame.real.tolist(), frame.imag.tolist(), drawn[:, 2].tolist(), strict=True))
        self._side = turn * _each([o.turn for o in outlines])
        self._half = _each([o.half for o in outlines])
        self._low = _each([r.z + o.low for o, r in things]).real
        self._high = _each([r.z + o.high for o, r in things]).real
        self._boxy = [o.boxy for o in outlines]
        stands = regions[0].support.holds(drawn[:, :2], turn, np.repeat(_spreads(outlines), EACH, axis=0))
        self._dead: list[bool] = (~stands).tolist()
        self._doubts: dict[int, list[int]] = {}
        self._meets: dict[int, list[int]] = {}
        self._meet_each_other(stands)
        self._meet_entries(range(there.count))

    def _meet_each_other(self, standing: Mask) -> None:
        live = np.flatnonzero(standing)
        p, size = self._center[live], np.abs(self._half[live])
        dx, dy = p.real - p.real[:, None], p.imag - p.imag[:, None]
        reach = size + (size[:, None] + GAP)
        close = dx * dx + dy * dy < reach * reach
        i, j = close.nonzero()
        i, j = live[i], live[j]
        other = (i // EACH < j // EACH) & (self._low[i] < self._high[j] + GAP)
        other &= self._low[j] < self._high[i] + GAP
        i, j = i[other], j[other]
        met = rectangles_meet(
            self._center[j] - self._center[i], self._side[i], self._half[i], self._side[j], self._half[j], GAP
        )
        for a, b in zip(i[met].tolist(), j[met].tolist(), strict=True):
            self._meets.setdefault(a, []).append(b)

    def _meet_entries(self, entries: range) -> None:
        """Record which candidates overlap the given entries."""
        rectangles = self._center, self._side, self._half, self._low, self._high
        for c, met in self._there.overlaps(entries, *rectangles, GAP).items():
            self._doubt(c, met)

    def _doubt(self, c: int, met: Iterable[int]) -> None:
        """Record that candidate ``c`` overlaps the entries ``met``."""
        if self._boxy[c // EACH] and self._there.any_boxy(met):
            self._dead[c] = True
        else:
            self._doubts.setdefault(c, []).extend(met)

    def first_clear(self, t: int, clear: Clear) -> int | None:
        """Return the index of the first candidate of object ``t`` that is clear of all placed objects, or None."""
        for c in range(EACH * t, EACH * (t + 1)):
            doubts = tuple(self._doubts.get(c, ()))
            if not self._dead[c] and (not doubts or clear(*self.spots[c], doubts)):
                return c
        return None

    def entered(self, entries: range, chosen: int | None) -> None:
        """Record that an object was placed at candidate ``chosen``, or elsewhere, and occupies the given entries."""
        if chosen is None:
            self._meet_entries(entries)
            return
        for c in self._meets.get(chosen, ()):
            self._doubt(c, entries)


def _spreads(outlines: Sequence[Outline]) -> Array:
    """Return the corners of the shadows [m], shape (n, 2, m), padded to equal length by repeating the last corner."""
    out = np.empty((len(outlines), 2, max(o.spread.shape[1] for o in outlines)))
    for row, outline in zip(out, outlines, strict=True):
        count = outline.spread.shape[1]
        row[:, :count] = outline.spread
        row[:, count:] = outline.spread[:, -1:]
    return out


def _each(values: Sequence[complex]) -> Complex:
    """Repeat each object's value for all of its candidates."""
    return np.repeat(np.array(values, dtype=np.complex128), EACH)


@dataclass(frozen=True, eq=False)
class Placeable:
    """An object to be placed.

    Attributes:
        name: Name of the object.
        riders: Names of the objects that move along with it.
        upright: Orientation before the rotation about z.
        outline: Shadow of the object and its riders.
    """

    name: str
    riders: tuple[str, ...]
    upright: Pose
    outline: Outline
    _regions: dict[tuple[str, float], Region] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, twin: Twin, name: str, on: str, staying: Iterable[str] = ()) -> Placeable:
        """Return the object ``name`` to be placed on ``on``, with all its riders except for those in ``staying``."""
        riders = tuple(n for n in twin.riders(name) if n not in set(staying))
        key = (name, on, riders)
        if key not in twin.placeables:
            upright = twin.upright(name, on)
            twin.placeables[key] = cls(name, riders, upright, twin.outline(name, upright, riders))
        return twin.placeables[key]

    def height(self, support: Support) -> float:
        """Return the height [m] of the object's frame when it stands on a support."""
        return support.height - self.outline.low + CLEARANCE

    def anywhere(self, support: Support) -> Region:
        """Return the region that covers an entire support, with any yaw."""
        key = (support.name, support.height)
        if key not in self._regions:
            self._regions[key] = Region(*support.bounds, (-math.pi, math.pi), support, self.height(support))
        return self._regions[key]

    def pose(self, x: float, y: float, z: float, yaw: float) -> Pose:
        """Return the pose of the object when its frame is at x, y, z [m] and it is rotated by ``yaw`` [rad] about z."""
        w, qx, qy, qz = self.upright.q.tolist()
        c, s = math.cos(yaw / 2), math.sin(yaw / 2)
        return Pose.of((x, y, z), (c * w - s * qz, c * qx - s * qy, c * qy + s * qx, c * qz + s * w))


def by_area(areas: Mapping[str, float]) -> tuple[str, ...]:
    """Return object names sorted by decreasing shadow area [m^2], and alphabetically if areas are equal."""
    return tuple(sorted(areas, key=lambda name: (-round(areas[name], 9), name)))


class Arrangement:
    """The objects in a scene, among which more objects are placed.

    An arrangement poses the twin's solids, so only one arrangement per twin can be in use at a time.
    """

    def __init__(self, twin: Twin, poses: Mapping[str, Pose], moving: Iterable[str]) -> None:
        """Create an arrangement of the objects that have already been placed.

        Args:
            twin: The twin.
            poses: Poses X_WO of the objects that have been moved in the twin.
            moving: Names of objects that have not been placed yet. Their riders have not been placed either.
        """
        self.twin = twin
        self.poses = dict(twin.state.poses) | dict(poses)
        self.moved: dict[str, Pose] = {}
        self.dropped: set[str] = set()
        self.there = Occupancy(2 * len(twin.scene.objects) + 64)
        waiting = set(moving) | (twin.absent - set(poses))
        for name in tuple(waiting):
            waiting |= {n for n in twin.riders(name) if n not in poses}
        self.solid: list[str] = []
        for item in twin.scene.objects:
            if item.name not in waiting:
                twin.solids.put(item.name, self.poses[item.name])
                self.solid.append(item.name)
                self._enter(item.name, twin.shadows(item.name, self.poses[item.name]))
        for name, shadows in twin.robots.shadows.items():
            self.solid.append(name)
            self._enter(name, shadows)

    def _enter(self, name: str, shadows: Iterable[Outline]) -> None:
        for outline in shadows:
            self.there.add(name, outline, 0.0, 0.0, 0.0, 0.0)

    def _stand_on(self, support: Support) -> None:
        """Ignore the support in overlap tests if no part of it is above its level, because placed objects touch it."""
        self.there.set_aside(support.name if support.plain else None)

    def find(
        self,
        thing: Placeable,
        region: Region,
        rng: np.random.Generator,
        allowed: Allowed | None = None,
        also: Callable[[], bool] | None = None,
    ) -> Found:
        """Find a free placement for an object.

        Args:
            thing: The object.
            region: Region from which placements are drawn.
            rng: Random generator.
            allowed: Additional test of many candidates at once.
            also: Additional test that is called with the object posed among the twin's solids.
        """
        self._stand_on(region.support)

        def last(x: float, y: float, yaw: float) -> bool:
            self.pose(thing, thing.pose(x, y, region.z, yaw))
            return also is None or also()

        clear = partial(self._is_clear, thing, region)
        return find(thing.outline, region, self.there, rng, GAP, allowed, clear, None if also is None else last)

    def put_all(
        self, things: Sequence[Placeable], support: Support, rng: np.random.Generator
    ) -> tuple[Placeable, Found] | None:
        """Place objects anywhere on a support, one after another.

        Returns:
            None if all objects were placed; otherwise the first object that could not be placed and its search result.
        """
        self._stand_on(support)
        for first in range(0, len(things), TOGETHER):
            batch = [(thing, thing.anywhere(support)) for thing in things[first : first + TOGETHER]]
            block = _Block([(thing.outline, region) for thing, region in batch], self.there, rng)
            for t, (thing, region) in enumerate(batch):
                count = self.there.count
                chosen = block.first_clear(t, partial(self._is_clear, thing, region))
                found = self.find(thing, region, rng) if chosen is None else Found(block.spots[chosen])
                if found.spot is None:
                    return thing, found
                self.put(thing, region.z, found.spot)
                block.entered(range(count, self.there.count), chosen)
        return None

    def _is_clear(self, thing: Placeable, region: Region, x: float, y: float, yaw: float, met: tuple[int, ...]) -> bool:
        """Return True if an object is clear of the entries ``met``, whose rectangles it overlaps."""
        self.pose(thing, thing.pose(x, y, region.z, yaw))
        return not self.clashes(thing, sorted({self.there.owners[k] for k in met}), region.support.name)

    def clashes(self, thing: Placeable, others: Iterable[str], on: str) -> bool:
        """Return True if an object or one of its riders is closer to one of the ``others`` than the clearance.

        Contact with the object named ``on`` is allowed, but overlap is not.
        """
        solids = self.twin.solids
        return any(
            solids.meet(name, other, 0.0 if other == on else GAP)
            for other in others
            for name in (thing.name, *thing.riders)
        )

    def pose(self, thing: Placeable, X_WO: Pose) -> dict[str, Pose]:
        """Pose an object and its riders among the twin's solids, and return their poses X_WO."""
        poses = {thing.name: X_WO}
        if thing.riders:
            before = self.twin.state.poses
            move = X_WO @ before[thing.name].inverse()
            poses |= {n: move @ before[n] for n in thing.riders}
        for name, pose in poses.items():
            self.twin.solids.put(name, pose)
        return poses

    def put(self, thing: Placeable, z: float, spot: Spot, dropped: bool = False) -> None:
        """Place an object and its riders.

        Args:
            thing: The object.
            z: Height of its frame [m].
            spot: x and y [m] of its frame, and its rotation about z [rad].
            dropped: True if the object may move while it comes to rest.
        """
        x, y, yaw = spot
        poses = self.pose(thing, thing.pose(x, y, z, yaw))
        for name in poses:  # all of them share the combined shadow; if it overlaps, each is tested
            self.there.add(name, thing.outline, x, y, z, yaw)
        self.solid += poses
        self.moved |= poses
        self.poses |= poses
        if dropped:
            self.dropped |= set(poses)
