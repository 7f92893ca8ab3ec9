"""What stands while a layout is made: shadows to test many places at once, and solids to test one exactly."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from simfoundry.cousins.crowd import EACH, place_together
from simfoundry.cousins.outline import Outline
from simfoundry.cousins.placing import Allowed, Demands, Found, Region, There, find
from simfoundry.cousins.support import Support
from simfoundry.cousins.twin import Twin
from simfoundry.geometry.frames import Pose
from simfoundry.scene.place import CLEARANCE

GAP = 0.002
"""Free space between things that are not asked to touch [m]: what engines keep as a margin around shapes."""


@dataclass(frozen=True, eq=False)
class Thing:
    """What is placed: an object, what rides on it, how it stands before it is turned about z, and its shadow."""

    name: str
    riders: tuple[str, ...]
    upright: Pose
    outline: Outline
    _regions: dict[tuple[str, float], Region] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, twin: Twin, name: str, on: str, staying: Iterable[str] = ()) -> Thing:
        """A thing that is to stand on ``on``, with all that rides on it but what is ``staying``."""
        riders = twin.riders(name)
        if riders:
            riders = tuple(n for n in riders if n not in set(staying))
        key = ("thing", name, on, riders)
        if key not in twin.kept:
            upright = twin.upright(name, on)
            twin.kept[key] = cls(name, riders, upright, twin.outline(name, upright, riders))
        found: Thing = twin.kept[key]
        return found

    def height(self, support: Support) -> float:
        """Of the frame [m], so that the thing stands on a support."""
        return support.height - self.outline.low + CLEARANCE

    def anywhere(self, support: Support) -> Region:
        """All of a support, turned anyhow."""
        key = (support.name, support.height)
        if key not in self._regions:
            self._regions[key] = Region(*support.bounds, (-math.pi, math.pi), support, self.height(support))
        return self._regions[key]

    def pose(self, x: float, y: float, z: float, yaw: float) -> Pose:
        """Where its frame is when it is turned by ``yaw`` [rad]."""
        w, qx, qy, qz = self.upright.q.tolist()
        c, s = math.cos(yaw / 2), math.sin(yaw / 2)
        return Pose.of((x, y, z), (c * w - s * qz, c * qx - s * qy, c * qy + s * qx, c * qz + s * w))


class Table:
    """Everything that stands, while things are placed among it. A twin has one at a time: it poses its solids."""

    def __init__(self, twin: Twin, poses: Mapping[str, Pose], moving: Iterable[str]) -> None:
        """``poses`` differ from the twin's; what is ``moving``, and what rides on it, is not there yet."""
        self.twin, self.tries = twin, 0
        self.poses = dict(twin.state.poses) | dict(poses)
        self.moved: dict[str, Pose] = {}
        self.dropped: set[str] = set()
        self.there = There(2 * len(twin.scene.objects) + 64)
        waiting = set(moving) | (twin.absent - set(poses))
        for name in tuple(waiting):
            waiting |= {n for n in twin.riders(name) if n not in poses}
        self.solid: list[str] = []
        for item in twin.scene.objects:
            if item.name not in waiting:
                twin.solids.put(item.name, self.poses[item.name])
                self.solid.append(item.name)
                self._enter(item.name, twin.shadows(item.name, self.poses[item.name]))
        for item in twin.obstacles:
            self.solid.append(item.name)
            self._enter(item.name, twin.shadows(item.name, item.X_WO))

    def _enter(self, name: str, shadows: Iterable[Outline]) -> None:
        for outline in shadows:
            self.there.add(name, outline, 0.0, 0.0, 0.0, 0.0)

    def _stand_on(self, support: Support) -> None:
        """Leave the support out where nothing of it stands out: what is placed stands on it."""
        self.there.set_aside(support.name if support.plain else None)

    def find(
        self,
        thing: Thing,
        region: Region,
        rng: np.random.Generator,
        allowed: Allowed | None = None,
        also: Callable[[], bool] | None = None,
    ) -> Found:
        """A free place for a thing; ``also`` is asked with the thing posed among the solids."""
        owners, on = self.there.owners, region.support.name
        self._stand_on(region.support)

        def clear(x: float, y: float, yaw: float, met: tuple[int, ...]) -> bool:
            self.pose(thing, thing.pose(x, y, region.z, yaw))
            return not self.clashes(thing, sorted({owners[k] for k in met}), on)

        def last(x: float, y: float, yaw: float) -> bool:
            self.pose(thing, thing.pose(x, y, region.z, yaw))
            return also is None or also()

        demands = Demands(allowed, clear, None if also is None else last)
        found = find(thing.outline, region, self.there, rng, GAP, demands)
        self.tries += found.tried
        return found

    def put_all(
        self, things: Sequence[Thing], support: Support, rng: np.random.Generator
    ) -> tuple[Thing, Found] | None:
        """Let things stand anywhere on a support, one after another; the first that finds no place, and why."""
        owners = self.there.owners
        self._stand_on(support)
        placed = [(thing.outline, thing.anywhere(support)) for thing in things]
        self.tries += EACH * len(things)

        def clear(k: int, spot: tuple[float, float, float], met: tuple[int, ...]) -> bool:
            x, y, yaw = spot
            self.pose(things[k], things[k].pose(x, y, placed[k][1].z, yaw))
            return not self.clashes(things[k], sorted({owners[entry] for entry in met}), support.name)

        failed = place_together(
            placed,
            self.there,
            rng,
            GAP,
            clear,
            lambda k, spot: self.put(things[k], placed[k][1].z, spot),
            lambda k: self.find(things[k], placed[k][1], rng),
        )
        return None if failed is None else (things[failed[0]], failed[1])

    def clashes(self, thing: Thing, others: Iterable[str], on: str) -> bool:
        """Whether a thing or what rides on it is nearer to one of the others than it may; what carries it may touch."""
        solids = self.twin.solids
        return any(
            solids.meet(name, other, 0.0 if other == on else GAP)
            for other in others
            for name in (thing.name, *thing.riders)
        )

    def pose(self, thing: Thing, X_WO: Pose) -> dict[str, Pose]:
        """Pose a thing and its riders among the solids."""
        poses = {thing.name: X_WO}
        if thing.riders:
            before = self.twin.state.poses
            move = X_WO @ before[thing.name].inverse()
            poses |= {n: move @ before[n] for n in thing.riders}
        for name, pose in poses.items():
            self.twin.solids.put(name, pose)
        return poses

    def put(self, thing: Thing, z: float, spot: tuple[float, float, float], dropped: bool = False) -> None:
        """Let a thing stand at x, y [m] of its frame and a turn about z [rad]."""
        x, y, yaw = spot
        poses = self.pose(thing, thing.pose(x, y, z, yaw))
        for name in poses:  # the shadow of all of them, for each: where it is met, each is looked at
            self.there.add(name, thing.outline, x, y, z, yaw)
        self.solid += poses
        self.moved |= poses
        self.poses |= poses
        if dropped:
            self.dropped |= set(poses)
