"""What stands while a layout is made: shadows to test many places at once, and solids to test one exactly."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from simfoundry.cousins.outline import Outline
from simfoundry.cousins.placing import TRIES, Found, Mask, Region, There, find
from simfoundry.cousins.support import Support
from simfoundry.cousins.twin import Twin
from simfoundry.scene.frames import Array, Pose, quat_from_rpy, quat_multiply
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

    @classmethod
    def of(cls, twin: Twin, name: str, on: str, staying: Iterable[str] = ()) -> Thing:
        """A thing that is to stand on ``on``, with all that rides on it but what is ``staying``."""
        riders = tuple(n for n in twin.riders(name) if n not in set(staying))
        upright = twin.upright(name, on)
        return cls(name, riders, upright, twin.outline(name, upright, riders))

    def height(self, support: Support) -> float:
        """Of the frame [m], so that the thing stands on a support."""
        return support.height - self.outline.low + CLEARANCE

    def pose(self, x: float, y: float, z: float, yaw: float) -> Pose:
        """Where its frame is when it is turned by ``yaw`` [rad]."""
        return Pose.of((x, y, z), quat_multiply(quat_from_rpy(0.0, 0.0, yaw), self.upright.q))


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
        for item in twin.scene.objects:
            if item.name not in waiting:
                twin.solids.put(item.name, self.poses[item.name])
                self._enter(item.name, twin.shadows(item.name, self.poses[item.name]))
        for item in twin.robot_items:
            self._enter(item.name, twin.shadows(item.name, item.X_WO))

    def _enter(self, name: str, shadows: Iterable[Outline]) -> None:
        for outline in shadows:
            self.there.add(name, outline, 0.0, 0.0, 0.0, 0.0)

    def find(
        self,
        thing: Thing,
        region: Region,
        rng: np.random.Generator,
        allowed: Callable[[Array, Array, Array], Mask] | None = None,
        also: Callable[[], bool] | None = None,
    ) -> Found:
        """A free place for a thing; ``also`` is asked with the thing posed among the solids."""
        owners, plain = self.there.owners, region.support.plain
        self.there.passed = [k for k, name in enumerate(owners) if plain and name == region.support.name]

        def clear(x: float, y: float, yaw: float, met: tuple[int, ...]) -> bool:
            others = sorted({owners[k] for k in met})
            if not others and also is None:
                return True
            self.pose(thing, thing.pose(x, y, region.z, yaw))
            return (also is None or also()) and not self.clashes(thing, others, region.support.name)

        found = find(thing.outline, region, self.there, rng, GAP, allowed, clear, TRIES)
        self.tries += found.tried
        return found

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
        before = self.twin.state.poses
        move = X_WO @ before[thing.name].inverse()
        poses = {thing.name: X_WO} | {n: move @ before[n] for n in thing.riders}
        for name, pose in poses.items():
            self.twin.solids.put(name, pose)
        return poses

    def put(self, thing: Thing, z: float, spot: tuple[float, float, float], dropped: bool = False) -> None:
        """Let a thing stand at x, y [m] of its frame and a turn about z [rad]."""
        x, y, yaw = spot
        poses = self.pose(thing, thing.pose(x, y, z, yaw))
        for name in poses:  # the shadow of all of them, for each: where it is met, each is looked at
            self.there.add(name, thing.outline, x, y, z, yaw)
        self.moved |= poses
        self.poses |= poses
        if dropped:
            self.dropped |= set(poses)


def anywhere(thing: Thing, support: Support) -> Region:
    """All of a support, turned anyhow."""
    low, high = support.corners.min(axis=0), support.corners.max(axis=0)
    return Region(low, high, (-math.pi, math.pi), support, thing.height(support))
