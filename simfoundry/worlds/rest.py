"""Does a scene stay as it is? Real dynamics for some seconds, and how far each object moved."""

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
"""What moves farther than this [m] does not stay."""

MAX_TURNED_DEG = 5.0
"""An object that turns by more does not stay; 5 degrees move the far side of a mug by about MAX_MOVED."""


def is_still(item: SceneObject, before: Pose, after: Pose, still_m: float, still_rad: float) -> bool:
    """Return whether an object moved and turned by no more than the bounds; a ball may turn in place."""
    if float(np.linalg.norm(after.p - before.p)) > still_m:
        return False
    return is_ball(item) or after.angle_to(before) <= still_rad


def is_confined(item: SceneObject, before: Pose, after: Pose) -> bool:
    """Return whether a ball released at rest has moved no farther than its diameter, as in a hollow that holds it.

    Without rolling resistance a ball in a hollow keeps moving, since a height difference of 0.1 mm drives it. On
    an open slope of only 0.1 degrees it rolls several times as far.
    """
    radius = ball_radius(item)
    return radius is not None and float(np.linalg.norm(after.p - before.p)) <= 2 * radius


@dataclass(frozen=True)
class ObjectMotion:
    """The motion of an object from where it started: displacement ``moved`` [m] and rotation ``turned_deg`` [deg]."""

    name: str
    moved: float
    turned_deg: float

    @property
    def stays(self) -> bool:
        """True if that is no more than what two simulators may disagree on."""
        return self.moved <= MAX_MOVED and self.turned_deg <= MAX_TURNED_DEG


def simulate(world: World, seconds: float = 2.0, state: SceneState | None = None) -> list[ObjectMotion]:
    """Run a world from ``state``, by default that of its scene, and report the motion of every free object."""
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
