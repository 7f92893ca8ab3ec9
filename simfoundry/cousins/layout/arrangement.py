"""Keep track of the objects in a scene, and add more objects to it, individually or in batches."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from simfoundry.cousins.layout.rejection_sampling import GAP, Allowed, Batch, Found, Occupancy, Region, Rng, Spot, find
from simfoundry.cousins.layout.supports import Outline, Support
from simfoundry.cousins.layout.twin import Twin
from simfoundry.geometry.frames import Pose
from simfoundry.scene.place import CLEARANCE

# Maximum number of objects in a batch; the pairwise tables of a batch fit into the processor cache.
TOGETHER = 24


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
        """Prepare an object for placement.

        Args:
            twin: The twin.
            name: Name of the object.
            on: Name of the object on which it will be placed.
            staying: Names of riders that do not move along with it.
        """
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
        """Return the region that covers an entire support and allows any yaw."""
        key = (support.name, support.height)
        if key not in self._regions:
            self._regions[key] = Region(*support.bounds, (-math.pi, math.pi), support, self.height(support))
        return self._regions[key]

    def pose(self, x: float, y: float, z: float, yaw: float) -> Pose:
        """Return the pose of the object for a given position and yaw.

        Args:
            x: x coordinate of the object's frame [m].
            y: y coordinate of the object's frame [m].
            z: Height of the object's frame [m].
            yaw: Rotation about z [rad].
        """
        w, qx, qy, qz = self.upright.q.tolist()
        c, s = math.cos(yaw / 2), math.sin(yaw / 2)
        return Pose.of((x, y, z), (c * w - s * qz, c * qx - s * qy, c * qy + s * qx, c * qz + s * w))


def by_area(areas: Mapping[str, float]) -> tuple[str, ...]:
    """Return object names in order of decreasing shadow area [m^2]. Objects with equal areas are sorted by name."""
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
        """Exclude a support from overlap tests if nothing protrudes above its level.

        Placed objects touch the support.
        """
        self.there.set_aside(support.name if support.plain else None)

    def find(
        self,
        thing: Placeable,
        region: Region,
        rng: Rng,
        allowed: Allowed | None = None,
        also: Callable[[], bool] | None = None,
    ) -> Found:
        """Find a free placement for an object.

        Args:
            thing: The object.
            region: Region from which placements are drawn.
            rng: Random generator.
            allowed: Additional test that is applied to many candidates at once.
            also: Additional test that is applied once the object has been posed among the twin's solids.
        """
        self._stand_on(region.support)

        def last(x: float, y: float, yaw: float) -> bool:
            self.pose(thing, thing.pose(x, y, region.z, yaw))
            return also is None or also()

        clear = partial(self._is_clear, thing, region)
        return find(thing.outline, region, self.there, rng, GAP, allowed, clear, None if also is None else last)

    def put_all(self, things: Sequence[Placeable], support: Support, rng: Rng) -> tuple[Placeable, Found] | None:
        """Place objects anywhere on a support, one after another.

        Returns:
            None if all objects were placed, otherwise the first object that could not be placed and its search result.
        """
        self._stand_on(support)
        for first in range(0, len(things), TOGETHER):
            some = [(thing, thing.anywhere(support)) for thing in things[first : first + TOGETHER]]
            batch = Batch([(thing.outline, region) for thing, region in some], self.there, rng)
            for t, (thing, region) in enumerate(some):
                count = self.there.count
                chosen = batch.first_clear(t, partial(self._is_clear, thing, region))
                found = self.find(thing, region, rng) if chosen is None else Found(batch.spots[chosen])
                if found.spot is None:
                    return thing, found
                self.put(thing, region.z, found.spot)
                batch.entered(range(count, self.there.count), chosen)
        return None

    def _is_clear(self, thing: Placeable, region: Region, x: float, y: float, yaw: float, met: tuple[int, ...]) -> bool:
        """Return True if an object does not actually collide with the entries ``met``, whose rectangles it overlaps."""
        self.pose(thing, thing.pose(x, y, region.z, yaw))
        return not self.clashes(thing, sorted({self.there.owners[k] for k in met}), region.support.name)

    def clashes(self, thing: Placeable, others: Iterable[str], on: str) -> bool:
        """Return True if an object or one of its riders is too close to any of the ``others``.

        The required clearance does not apply to the object named ``on``. That object may be touched but not penetrated.
        """
        solids = self.twin.solids
        return any(
            solids.meet(name, other, 0.0 if other == on else GAP)
            for other in others
            for name in (thing.name, *thing.riders)
        )

    def pose(self, thing: Placeable, X_WO: Pose) -> dict[str, Pose]:
        """Pose an object and its riders among the twin's solids and return their poses X_WO."""
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
        for name in poses:  # all of them share the combined shadow; each is tested if that shadow overlaps
            self.there.add(name, thing.outline, x, y, z, yaw)
        self.solid += poses
        self.moved |= poses
        self.poses |= poses
        if dropped:
            self.dropped |= set(poses)
