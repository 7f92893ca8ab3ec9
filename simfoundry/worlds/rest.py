"""Tests for rest and stability, which simulate until nothing moves or for a few seconds and measure object motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.shapes import Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import Contact, World

# Minimum upward component of the contact normal for a contact that supports an object.
UPWARD = 0.5

# Minimum upward component if an object has no such contact, for example because it is held between a container's walls.
STEEP = 0.02

# Tilt for the stability test [deg], which is at most the slope of real shelves and tables.
NUDGE_DEG = 0.5

# Time for a nudged object to fall [s], which is longer than a pencil balanced on its tip needs.
NUDGE_S = 1.5

# Time window in which an object that is tilted as much moves by more than the creep of an object at rest, unless it
# stands [s]: a pencil turns by 6e-3 rad. It first falls onto its base, which takes less than NUDGE_LEAST_S [s].
NUDGE_WINDOW_S, NUDGE_LEAST_S = 0.1, 0.2

# An object topples if its center of mass drops by this fraction of the center's height above the object's lowest point.
TOPPLED = 0.1

# Horizontal distance from the center of mass [m] within which contacts do not stabilize an object.
FOOT = 0.001


def supporters(name: str, contacts: list[Contact], upward: float = UPWARD) -> tuple[str, ...]:
    """Return the objects that support ``name`` from below.

    An object counts if one of its contacts with ``name`` has a normal that points up, with a z component of at least
    ``upward``.
    """
    below = {c.a for c in contacts if c.b == name and c.normal[2] >= upward}
    below |= {c.b for c in contacts if c.a == name and c.normal[2] <= -upward}
    return tuple(sorted(below))


def center_of_mass(item: SceneObject, X_WO: Pose) -> Array:
    """Return an object's center of mass in the world frame, for a given pose and the joint positions in the scene.

    Returns:
        The center of mass [m], shape (3,).
    """
    poses = link_poses(item)
    masses = np.array([link.mass for link in item.links])
    centers = np.array([poses[link.name].apply(link.com) for link in item.links])
    return X_WO.apply(masses @ centers / masses.sum())


def has_foot(item: SceneObject, X_WO: Pose, contacts: list[Contact]) -> bool:
    """Return True if the object's contacts from below surround its center of mass horizontally."""
    center = center_of_mass(item, X_WO)
    below = [c.position for c in contacts if item.name in (c.a, c.b) and (c.normal[2] > 0) == (c.b == item.name)]
    offsets = np.array([p - center for p in below]).reshape(-1, 3)[:, :2]
    offsets = offsets[np.linalg.norm(offsets, axis=1) > FOOT]
    if len(offsets) < 3:
        return False
    angles = np.sort(np.arctan2(offsets[:, 1], offsets[:, 0]))
    return float(np.diff(angles, append=angles[0] + 2 * np.pi).max()) < np.pi


def topples(world: World, state: SceneState, item: SceneObject) -> bool:
    """Return True if an object falls over when released with a slight tilt about either axis. Rolling is ignored.

    The simulation ends early if the object is at rest again, which takes a tenth of the time that a fall may take.
    """
    X_WO = state.poses[item.name]
    low, high = world_bounds(item, X_WO)
    height = float(center_of_mass(item, X_WO)[2])
    angle = math.radians(NUDGE_DEG)
    lift = float(np.linalg.norm((high - low)[:2])) / 2 * math.sin(angle)
    fell, others = False, {other.name for other in world.scene.objects} - {item.name}
    for roll, pitch in ((angle, 0.0), (0.0, angle)):
        if fell:
            break
        turned = Pose.of(q=quat_from_rpy(roll, pitch, 0.0)) @ Pose.of(q=X_WO.q)
        tilted = Pose.of(X_WO.p + np.array([0.0, 0.0, lift]), turned.q)
        world.reset(SceneState.of({**state.poses, item.name: tilted}, state.joints))
        run_to_rest(world, NUDGE_WINDOW_S, NUDGE_LEAST_S, NUDGE_S, lambda _: others)
        after = float(center_of_mass(item, world.state().poses[item.name])[2])
        fell = height - after > TOPPLED * (height - float(low[2]))
    world.reset(state)
    return fell


def ball_radius(item: SceneObject) -> float | None:
    """Return the radius [m] of an object that is a single sphere at its frame, or None for any other object."""
    parts = [c for link in item.links for c in link.colliders]
    if len(parts) != 1 or not isinstance(parts[0].geometry, Sphere) or parts[0].X_LG.p.any():
        return None
    return parts[0].geometry.radius


def is_ball(item: SceneObject) -> bool:
    """Return True if an object is a single sphere at its frame, whose orientation does not matter."""
    return ball_radius(item) is not None


# Maximum displacement [m] of a stable object.
MAX_MOVED = 0.01

# Maximum rotation [deg] of a stable object; 5 degrees move the rim of a mug by about MAX_MOVED.
MAX_TURNED_DEG = 5.0

# Maximum displacement [m] and rotation [rad] over a window for an object at rest, because bodies on soft contacts creep
# by hundredths of a millimeter.
STILL_M, STILL_RAD = 1e-4, 1e-3


def restless(scene: Scene, before: SceneState, after: SceneState) -> set[str]:
    """Return the objects whose pose or joints changed between two states, except for balls that rotate in place."""
    poses = before.poses.items()
    moving = {n for n, start in poses if _differ(start, after.poses[n], turns=not is_ball(scene.object(n)))}
    joints = [joint for joint, start in before.joints.items() if abs(after.joints[joint] - start) > STILL_RAD]
    joints += [joint for joint, start in before.motions.items() if _differ(start, after.motions[joint])]
    return moving | {joint.partition(".")[0] for joint in joints}


def _differ(start: Pose, end: Pose, turns: bool = True) -> bool:
    """Return True if two poses differ by more than the creep of an object at rest.

    If ``turns`` is set, rotations are compared as well.
    """
    return float(np.linalg.norm(end.p - start.p)) > STILL_M or (turns and end.angle_to(start) > STILL_RAD)


def run_to_rest(
    world: World,
    window_s: float,
    least_s: float,
    most_s: float,
    ignored: Callable[[SceneState], Collection[str]],
    watch: Callable[[float, set[str]], object] = lambda elapsed, moving: None,
    halt_s: float | None = None,
) -> set[str]:
    """Simulate until nothing moves within a time window, and return the objects that still move at the end.

    Args:
        world: The world to simulate.
        window_s: The time window over which motion is measured [s].
        least_s: The minimum simulated time [s].
        most_s: The maximum simulated time [s].
        ignored: A function that returns the objects in a state that are allowed to move.
        watch: A function that is called with the elapsed time [s] and the moving objects after each window. It ends the
            run by returning true.
        halt_s: An optional interval [s], of at least one step, at which all velocities are set to zero. This slows down
            falls and stops rolling.
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
    """Return the angle [deg] between the vertical and the body axis that was vertical before."""
    up = before.rotation[2]
    return math.degrees(math.acos(float(np.clip((after.rotation @ up)[2], -1.0, 1.0))))


def is_confined(item: SceneObject, before: Pose, after: Pose) -> bool:
    """Return True if a ball that was released at rest moved by at most its diameter, like a ball in a bowl.

    Without rolling resistance, a height difference of only 0.1 mm keeps a ball in a bowl moving. On an open slope of
    just 0.1 degrees, a ball rolls several times as far.
    """
    radius = ball_radius(item)
    return radius is not None and float(np.linalg.norm(after.p - before.p)) <= 2 * radius


@dataclass(frozen=True)
class ObjectMotion:
    """The motion of an object from its initial pose.

    It consists of the displacement ``moved`` [m] and the rotation ``turned_deg`` [deg].
    """

    name: str
    moved: float
    turned_deg: float

    @property
    def stays(self) -> bool:
        """True if the motion is no larger than the expected difference between two simulators."""
        return self.moved <= MAX_MOVED and self.turned_deg <= MAX_TURNED_DEG


def simulate(world: World, seconds: float = 2.0, state: SceneState | None = None) -> list[ObjectMotion]:
    """Simulate a world from ``state``, or from its initial state, and return the motion of every free object."""
    world.reset(state)
    before = world.state()
    world.step(round(seconds / world.timestep))
    after = world.state()
    names = [item.name for item in world.scene.objects if not item.fixed]
    ends = ((name, before.poses[name], after.poses[name]) for name in names)
    return [ObjectMotion(n, float(np.linalg.norm(b.p - a.p)), math.degrees(a.angle_to(b))) for n, a, b in ends]
