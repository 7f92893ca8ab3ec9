"""Rest and stability: run a world until nothing moves, or for a few seconds, and measure the motion of each object."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import World
from simfoundry.worlds.footing import ball_radius, is_ball

MAX_MOVED = 0.01
"""An object that moves farther than this [m] is not stable."""

MAX_TURNED_DEG = 5.0
"""An object that rotates by more than this [deg] is not stable; 5 degrees move the rim of a mug by about MAX_MOVED."""


STILL_M, STILL_RAD = 1e-4, 1e-3
"""An object that moves [m] and rotates [rad] at most this much over a window is at rest: bodies that engines hold up by
soft contacts creep by hundredths of a millimeter.
"""


def restless(scene: Scene, before: SceneState, after: SceneState) -> set[str]:
    """Return the objects that moved, rotated, or moved a joint between two states; a ball may rotate in place."""
    moving = set()
    for name, start in before.poses.items():
        end = after.poses[name]
        turns = not is_ball(scene.object(name)) and end.angle_to(start) > STILL_RAD
        if turns or float(np.linalg.norm(end.p - start.p)) > STILL_M:
            moving.add(name)
    joints = [joint for joint, start in before.joints.items() if abs(after.joints[joint] - start) > STILL_RAD]
    for joint, motion in before.motions.items():
        now = after.motions[joint]
        if float(np.linalg.norm(now.p - motion.p)) > STILL_M or now.angle_to(motion) > STILL_RAD:
            joints.append(joint)
    return moving | {joint.partition(".")[0] for joint in joints}


def run_to_rest(
    world: World,
    window_s: float,
    least_s: float,
    most_s: float,
    ignored: Callable[[SceneState], Collection[str]],
    watch: Callable[[float, set[str]], object] = lambda elapsed, moving: None,
    halt_s: float | None = None,
) -> set[str]:
    """Simulate until nothing moves over a window; return the objects that still move after ``most_s``.

    The objects that ``ignored`` returns for a state may move. ``watch`` receives the elapsed time [s] and the moving
    objects after each window, and ends the run if it returns true. With ``halt_s``, all velocities are set to zero
    every ``halt_s``, at least one step apart: falls are then slow, and rolling stops.
    """
    steps = max(1, round((window_s if halt_s is None else halt_s) / world.timestep))
    repeats = max(1, round(window_s / (steps * world.timestep)))
    elapsed, last, moving = 0.0, world.state(), set[str]()
    while elapsed < most_s:
        for _ in range(repeats):
            world.step(steps)
            if halt_s is not None:
                world.halt()
        elapsed += window_s
        now = world.state()
        moving = restless(world.scene, last, now) - set(ignored(now))
        last = now
        if watch(elapsed, moving) or (elapsed >= least_s and not moving):
            break
    return moving


def tilt_deg(before: Pose, after: Pose) -> float:
    """Angle between the vertical and the axis of the body that pointed up before [deg]."""
    up = before.rotation[2]
    return math.degrees(math.acos(float(np.clip((after.rotation @ up)[2], -1.0, 1.0))))


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
