"""What stands around a point at its own height: the walls of bowls, drawers and boxes."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.scene.frames import Array
from simfoundry.scene.hulls import Hulls

DIRECTIONS = 16
"""In how many directions walls are looked for."""

WALLED = 8
"""Walls in at least this many of :data:`DIRECTIONS` make an inside."""

FOOT = 5e-4
"""How far above the lowest point of a thing walls are looked for [m]."""

LOW = 0.25
"""Where the middle of a hollow is measured, as a share of its depth from its floor."""


def surrounded(thing: Hulls, container: Hulls) -> bool:
    """Whether the lowest point of a thing has walls of the container on at least half its sides."""
    bottom = thing.corners[:, 2] - thing.radius[thing.part]
    lowest = thing.corners[bottom <= bottom.min() + 1e-6].mean(axis=0)
    foot = np.array([lowest[0], lowest[1], bottom.min() + FOOT])
    angle = (np.arange(DIRECTIONS) + 0.25) * (2 * math.pi / DIRECTIONS)
    rays = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)])
    return int(np.isfinite([_reach(container, foot, ray) for ray in rays]).sum()) >= WALLED


def hollow(container: Hulls, middle: Array, rotation: Array) -> Array:
    """The middle of the hollow [m] at ``middle``, between the walls along the container's axes; shape (3,).

    Without walls on both sides along an axis, and where there is no hollow, it stays in the ``middle`` given.
    """
    top = container.extent(np.array([0.0, 0.0, 1.0]))[1]
    floor = top - _reach(container, np.array([*middle[:2], top + 1e-6]), np.array([0.0, 0.0, -1.0]))
    if not math.isfinite(floor) or top - floor < 4 * FOOT:
        return middle
    point = np.array([*middle[:2], floor + LOW * (top - floor)])
    for _ in range(2):
        for axis in rotation.T[:2]:
            level = np.array([axis[0], axis[1], 0.0])
            length = math.hypot(*level)
            if length < 0.5:
                continue
            ahead, back = (_reach(container, point, sign * level / length) for sign in (1, -1))
            if math.isfinite(ahead + back):
                point = point + level / length * (ahead - back) / 2
    return point


def _reach(shape: Hulls, start: Array, ray: Array) -> float:
    """How far a ray goes before it meets a triangle [m]; inf where it meets none. Rounded parts are not seen."""
    a, b, c = (shape.corners[shape.triangles[:, k]] for k in range(3))
    u, v, w = b - a, c - a, start - a
    across = np.cross(ray, v)
    volume = (u * across).sum(axis=1)
    facing = np.abs(volume) > 1e-14
    volume = np.where(facing, volume, 1.0)
    s = (w * across).sum(axis=1) / volume
    turned = np.cross(w, u)
    t = (ray * turned).sum(axis=1) / volume
    far = (v * turned).sum(axis=1) / volume
    hit = facing & (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9) & (far > 0)
    return float(far[hit].min()) if hit.any() else math.inf
