"""The support of an object, and whether it stands there or would topple."""

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
"""A contact carries what lies above it if its normal points up by at least this much."""

STEEP = 0.02
"""Contacts that point up by at least this much hold a thing where none carries it: between the walls of a vessel."""

NUDGE_DEG = 0.5
"""Tilt of an object to see if it stays: less than the lean of any shelf or hand-set table."""

NUDGE_S = 1.5
"""Seconds that a nudged object has to fall: more than a pencil on its tip needs."""

TOPPLED = 0.1
"""A nudged thing topples if its centre of mass loses this share of its height over the lowest point."""

FOOT = 0.001
"""Contacts nearer to the centre of mass than this [m], seen from above, give no foothold."""


def supporters(name: str, contacts: list[Contact], upward: float = UPWARD) -> tuple[str, ...]:
    """The objects that carry ``name``: those it touches from above, at normals that point up by ``upward``."""
    below = {c.a for c in contacts if c.b == name and c.normal[2] >= upward}
    below |= {c.b for c in contacts if c.a == name and c.normal[2] <= -upward}
    return tuple(sorted(below))


def center_of_mass(item: SceneObject, X_WO: Pose) -> Array:
    """In the world [m], shape (3,), with the joints as the scene has them."""
    poses = link_poses(item)
    masses = np.array([link.mass for link in item.links])
    centers = np.array([poses[link.name].apply(link.com) for link in item.links])
    return X_WO.apply(masses @ centers / masses.sum())


def has_foot(item: SceneObject, X_WO: Pose, contacts: list[Contact]) -> bool:
    """Return true if contacts from below lie all around the center of mass."""
    center = center_of_mass(item, X_WO)
    below = [c.position for c in contacts if item.name in (c.a, c.b) and (c.normal[2] > 0) == (c.b == item.name)]
    offsets = np.array([p - center for p in below]).reshape(-1, 3)[:, :2]
    offsets = offsets[np.linalg.norm(offsets, axis=1) > FOOT]
    if len(offsets) < 3:
        return False
    angles = np.sort(np.arctan2(offsets[:, 1], offsets[:, 0]))
    return float(np.diff(angles, append=angles[0] + 2 * np.pi).max()) < np.pi


def topples(world: World, state: SceneState, item: SceneObject) -> bool:
    """Return true if an object falls over when it is let go slightly tilted to either of two sides; it may roll."""
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
    """The radius [m] of what is one sphere about its frame, and has no up side; None for anything else."""
    parts = [c for link in item.links for c in link.colliders]
    if len(parts) != 1 or not isinstance(parts[0].geometry, Sphere) or parts[0].X_LG.p.any():
        return None
    return parts[0].geometry.radius


def is_ball(item: SceneObject) -> bool:
    """Return true if an object is one sphere about its frame, which has no up side."""
    return ball_radius(item) is not None
