"""The supports of an object, and its stability on them."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.shapes import Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import Contact, World

UPWARD = 0.5
"""Minimum upward component of the normal of a contact that supports an object."""

STEEP = 0.02
"""Minimum upward component if no contact is steeper than that: an object held between the walls of a container."""

NUDGE_DEG = 0.5
"""Tilt for the stability test [deg]: less than the slope of any shelf or hand-set table."""

NUDGE_S = 1.5
"""Time for a nudged object to fall [s]: more than a pencil balanced on its tip needs."""

TOPPLED = 0.1
"""Fraction of its height above the lowest point that the center of mass of a toppling object loses."""

FOOT = 0.001
"""Contacts within this horizontal distance of the center of mass [m] do not stabilize an object."""


def supporters(name: str, contacts: list[Contact], upward: float = UPWARD) -> tuple[str, ...]:
    """Return the objects that support ``name``: those below it with contact normals whose z is at least ``upward``."""
    below = {c.a for c in contacts if c.b == name and c.normal[2] >= upward}
    below |= {c.b for c in contacts if c.a == name and c.normal[2] <= -upward}
    return tuple(sorted(below))


def center_of_mass(item: SceneObject, X_WO: Pose) -> Array:
    """Return the center of mass in the world [m], shape (3,), with the joint positions of the scene."""
    poses = link_poses(item)
    masses = np.array([link.mass for link in item.links])
    centers = np.array([poses[link.name].apply(link.com) for link in item.links])
    return X_WO.apply(masses @ centers / masses.sum())


def has_foot(item: SceneObject, X_WO: Pose, contacts: list[Contact]) -> bool:
    """Return true if the contacts from below surround the center of mass."""
    center = center_of_mass(item, X_WO)
    below = [c.position for c in contacts if item.name in (c.a, c.b) and (c.normal[2] > 0) == (c.b == item.name)]
    offsets = np.array([p - center for p in below]).reshape(-1, 3)[:, :2]
    offsets = offsets[np.linalg.norm(offsets, axis=1) > FOOT]
    if len(offsets) < 3:
        return False
    angles = np.sort(np.arctan2(offsets[:, 1], offsets[:, 0]))
    return float(np.diff(angles, append=angles[0] + 2 * np.pi).max()) < np.pi


def topples(world: World, state: SceneState, item: SceneObject) -> bool:
    """Return true if an object falls over when released with a slight tilt about either axis; rolling is allowed."""
    X_WO = state.poses[item.name]
    low, high = world_bounds(item, X_WO)
    height = float(center_of_mass(item, X_WO)[2])
    angle = math.radians(NUDGE_DEG)
    lift = float(np.linalg.norm((high - low)[:2])) / 2 * math.sin(angle)
    fell = False
    for roll, pitch in ((angle, 0.0), (0.0, angle)):
        turned = Pose.of(q=quat_from_rpy(roll, pitch, 0.0)) @ Pose.of(q=X_WO.q)
        tilted = Pose.of(X_WO.p + np.array([0.0, 0.0, lift]), turned.q)
        world.reset(SceneState.of({**state.poses, item.name: tilted}, state.joints))
        world.step(round(NUDGE_S / world.timestep))
        after = float(center_of_mass(item, world.state().poses[item.name])[2])
        fell = fell or height - after > TOPPLED * (height - float(low[2]))
    world.reset(state)
    return fell


def ball_radius(item: SceneObject) -> float | None:
    """Return the radius [m] of an object that is a single sphere at its frame; None for any other object."""
    parts = [c for link in item.links for c in link.colliders]
    if len(parts) != 1 or not isinstance(parts[0].geometry, Sphere) or parts[0].X_LG.p.any():
        return None
    return parts[0].geometry.radius


def is_ball(item: SceneObject) -> bool:
    """Return true if an object is a single sphere at its frame, which has no up side."""
    return ball_radius(item) is not None
