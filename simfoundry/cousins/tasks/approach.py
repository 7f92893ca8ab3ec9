"""From where a hand can come to a thing: from above, or, where something is over it, from an open side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.walls import free_distance

if TYPE_CHECKING:
    from simfoundry.cousins.tasks.setting import Setting
    from simfoundry.scene.state import SceneState

UP = np.array([0.0, 0.0, 1.0])

ROOM = 0.3
"""So much must be free behind a thing [m]: a hand and the wrist that follows it, 0.25 m of a Panda."""

LIFT = 0.01
"""How high a thing is lifted on its way in or out [m]: above what a board sags, and the lip of a board."""

FINGERS = 0.04
"""How far fingers stand out of a hand [m]: the shortest of the known ones, those of a Panda, 0.045 m."""

HALF_THICK, HALF_WIDE = 0.035, 0.1
"""Half of a hand across its fingers' way and along it [m]: a Panda's hand is 63 mm thick and 204 mm wide."""

TURNS, TILTS = 12, (0.0, math.radians(30.0))
"""Directions around a thing, and how far a hand that comes from the side looks down [rad]: level, or a little, so that
it clears the board on which something low lies."""


@dataclass(frozen=True, eq=False)
class Approach:
    """How a hand comes to a thing: from ``side``, and leaves along ``way``; unit vectors away from it, shape (3,)."""

    side: Array
    way: Array

    @property
    def upright(self) -> Pose:
        """The turn of the world that has the hand come from above."""
        x, y, _ = self.side.tolist()
        lean = math.atan2(math.hypot(x, y), float(self.side[2]))
        turn = math.atan2(y, x)
        return Pose.of(q=quat_from_rpy(0.0, -lean, 0.0)) @ Pose.of(q=quat_from_rpy(0.0, 0.0, -turn))


ABOVE = Approach(UP, UP)


def approaches(setting: Setting, name: str, state: SceneState) -> tuple[Approach, ...]:
    """How a hand can come to a thing in a state: from above, or else from each open side; none where it is shut in."""
    low, high = setting.bounds(name, state)
    own = {name, *setting.twin.riders(name)}
    near = _obstacles(setting, own, low, high, state)
    middle, half = (low + high) / 2, (high - low) / 2
    over = [np.array([middle[0] + a * half[0], middle[1] + b * half[1], high[2]]) for a, b in _CROSS]
    if _are_free(near, over, UP):
        return (ABOVE,)
    found = []
    for turn in np.arange(TURNS) * (2 * math.pi / TURNS):
        way = np.array([math.cos(turn), math.sin(turn), 0.0])
        if not _are_free(near, _outline(low, high, way), way):
            continue
        for tilt in TILTS:
            side = math.cos(tilt) * way + math.sin(tilt) * UP
            if _are_free(near, _back_of_hand(middle, half, side, way), side):
                found.append(Approach(side, way))
                break
    return tuple(found)


_CROSS = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))
"""The middle of a top and four points around it, as shares of its half sides."""


def _outline(low: Array, high: Array, way: Array) -> list[Array]:
    """Points of a box, lifted a little, that lead along a level way [m]: its middle and its ends across and upwards."""
    middle, half = (low + high) / 2 + LIFT * UP, (high - low) / 2
    across = np.array([-way[1], way[0], 0.0])
    wide = float(np.abs(across) @ half)
    tall = half[2] * UP
    return [middle + a * wide * across + b * tall for a in (-1.0, 0.0, 1.0) for b in (-0.9, 0.0, 1.0)]


def _back_of_hand(middle: Array, half: Array, side: Array, way: Array) -> list[Array]:
    """Where the middle and the edges of the hand are that takes a box from a side [m]."""
    palm = middle + side * max(float(np.abs(side) @ half), FINGERS)
    across = np.array([-way[1], way[0], 0.0])
    thick = np.cross(side, across)
    return [palm + a * HALF_WIDE * across + b * HALF_THICK * thick for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]


def _obstacles(setting: Setting, own: set[str], low: Array, high: Array, state: SceneState) -> list[Hulls]:
    """All other objects that are near enough to be in the way."""
    from simfoundry.cousins.tasks.trial import item_in
    from simfoundry.scene.object_shapes import hulls

    twin = setting.twin
    found = []
    for item in twin.scene.objects:
        if item.name in own or item.name in twin.absent:
            continue
        moved = setting.joints(item.name) and state.joints != twin.state.joints
        shape = hulls(item_in(setting, item.name, state)) if moved else twin.shape(item.name, state.poses[item.name])
        if not len(shape.corners):
            continue
        ends = np.array([shape.extent(axis) for axis in np.eye(3)])
        if (ends[:, 0] < high + ROOM + HALF_WIDE).all() and (ends[:, 1] > low - ROOM - HALF_WIDE).all():
            found.append(shape)
    return found


def _are_free(obstacles: Sequence[Hulls], points: Sequence[Array], way: Array) -> bool:
    return all(free_distance(shape, point, way) > ROOM for shape in obstacles for point in points)
