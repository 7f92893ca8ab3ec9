"""Does a scene stay as it is? Real dynamics for some seconds, and how far each object moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simfoundry.scene.frames import Pose
from simfoundry.scene.model import SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import World
from simfoundry.worlds.footing import ball_radius, is_ball

MAX_MOVED = 0.01
"""What moves farther than this [m] does not stay."""

MAX_TURNED_DEG = 5.0


def is_still(item: SceneObject, before: Pose, after: Pose, still_m: float, still_rad: float) -> bool:
    """Whether an object neither moved nor turned by more between two poses; a ball may turn where it lies."""
    if float(np.linalg.norm(after.p - before.p)) > still_m:
        return False
    return is_ball(item) or after.angle_to(before) <= still_rad


def is_confined(item: SceneObject, before: Pose, after: Pose) -> bool:
    """Whether a ball that was let go at rest for seconds is still within its diameter, as in a hollow that holds it.

    Without rolling resistance it never comes to rest there, since every tenth of a millimetre of slope moves it. Where
    nothing holds it, a slope of 0.1 degrees takes it several times as far.
    """
    radius = ball_radius(item)
    return radius is not None and float(np.linalg.norm(after.p - before.p)) <= 2 * radius


@dataclass(frozen=True)
class Motion:
    """How far an object got from where it started: displacement ``moved`` [m] and rotation ``turned_deg`` [deg]."""

    name: str
    moved: float
    turned_deg: float

    @property
    def stays(self) -> bool:
        """Whether that is no more than what two simulators may disagree on."""
        return self.moved <= MAX_MOVED and self.turned_deg <= MAX_TURNED_DEG


def simulate(world: World, seconds: float = 2.0, state: SceneState | None = None) -> list[Motion]:
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
            out.append(Motion(item.name, moved, math.degrees(start.angle_to(end))))
    return out
