"""Stability of a scene: simulate it for a few seconds and measure the motion of each object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import World
from simfoundry.worlds.footing import ball_radius, is_ball

MAX_MOVED = 0.01
"""An object that moves farther than this [m] is not stable."""

MAX_TURNED_DEG = 5.0
"""An object that rotates by more than this [deg] is not stable; 5 degrees move the rim of a mug by about MAX_MOVED."""


def is_still(item: SceneObject, before: Pose, after: Pose, still_m: float, still_rad: float) -> bool:
    """Return true if an object moved and rotated within the bounds; a ball may rotate in place."""
    if float(np.linalg.norm(after.p - before.p)) > still_m:
        return False
    return is_ball(item) or after.angle_to(before) <= still_rad


def is_confined(item: SceneObject, before: Pose, after: Pose) -> bool:
    """Return true if a ball released at rest moved at most its diameter, as in a bowl that confines it.

    Without rolling resistance, a ball in a bowl keeps moving, driven by a height difference of only 0.1 mm. On an open
    slope of just 0.1 degrees it rolls several times as far.
    """
    radius = ball_radius(item)
    return radius is not None and float(np.linalg.norm(after.p - before.p)) <= 2 * radius


@dataclass(frozen=True)
class ObjectMotion:
    """The motion of an object from its start: displacement ``moved`` [m] and rotation ``turned_deg`` [deg]."""

    name: str
    moved: float
    turned_deg: float

    @property
    def stays(self) -> bool:
        """True if the motion is within the expected difference between two simulators."""
        return self.moved <= MAX_MOVED and self.turned_deg <= MAX_TURNED_DEG


def simulate(world: World, seconds: float = 2.0, state: SceneState | None = None) -> list[ObjectMotion]:
    """Simulate a world from ``state``, by default the scene's, and return the motion of every free object."""
    world.reset(state)
    before = world.state()
    world.step(round(seconds / world.timestep))
    after = world.state()
    out = []
    for item in world.scene.objects:
        if not item.fixed:
            start, end = before.poses[item.name], after.poses[item.name]
            moved = float(np.linalg.norm(end.p - start.p))
            out.append(ObjectMotion(item.name, moved, math.degrees(start.angle_to(end))))
    return out
