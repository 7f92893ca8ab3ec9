"""Walls that surround a point at the same height, for example the sides of bowls, drawers and boxes."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.geometry.frames import Array, cross
from simfoundry.geometry.hulls import Hulls

# Number of horizontal directions in which to look for walls.
DIRECTIONS = 16

# Angles [rad] that avoid the axes, along which rays would graze the edges of axis-aligned boxes.
_ANGLES = (np.arange(DIRECTIONS) + 0.25) * (2 * math.pi / DIRECTIONS)
# Unit vectors in the horizontal directions, shape (DIRECTIONS, 3).
LEVEL_RAYS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(DIRECTIONS)])

# Minimum number of :data:`DIRECTIONS` with a wall for a point to count as inside.
WALLED = 8

# Height above an object's lowest point at which its base is measured [m].
FOOT = 5e-4

# Heights at which to look for walls, as fractions of the object's height; rails may leave a gap at the base.
LEVELS = (0.0, 0.25, 0.5)

# Height above the floor of a cavity at which its middle is measured, as a fraction of the cavity's depth.
LOW = 0.25


def surrounded(thing: Hulls, container: Hulls) -> bool:
    """Return True if the container has walls on at least half of an object's sides, at its base or higher up."""
    bottom, top = thing.extent(np.array([0.0, 0.0, 1.0]))
    lowest = thing.corners[thing.corners[:, 2] - thing.radius[thing.part] <= bottom + 1e-6].mean(axis=0)
    for share in LEVELS:
        start = np.array([lowest[0], lowest[1], bottom + FOOT + share * (top - bottom)])
        if np.isfinite(free_distances(container, start, LEVEL_RAYS)).sum() >= WALLED:
            return True
    return False


def hollow(container: Hulls, middle: Array, rotation: Array) -> Array:
    """Return the center of the cavity near ``middle`` [m], halfway between the walls along the container's axes.

    The coordinate along an axis stays unchanged unless there are walls on both sides. If there is no cavity, ``middle``
    is returned unchanged.
    """
    top = container.extent(np.array([0.0, 0.0, 1.0]))[1]
    floor = top - free_distance(container, np.array([*middle[:2], top + 1e-6]), np.array([0.0, 0.0, -1.0]))
    if not math.isfinite(floor) or top - floor < 4 * FOOT:
        return middle
    point = np.array([*middle[:2], floor + LOW * (top - floor)])
    for _ in range(2):
        for axis in rotation.T[:2]:
            level = np.array([axis[0], axis[1], 0.0])
            length = math.hypot(*level)
            if length < 0.5:
                continue
            ahead, back = (free_distance(container, point, sign * level / length) for sign in (1, -1))
            if math.isfinite(ahead + back):
                point = point + level / length * (ahead - back) / 2
    return point


def free_distance(shape: Hulls, start: Array, ray: Array) -> float:
    """Return the distance [m] along a ray to the first part, or inf if the ray hits nothing."""
    return float(free_distances(shape, start, ray[None])[0])


def free_distances(shape: Hulls, start: Array, rays: Array) -> Array:
    """Return the distance along each ray from one point to the first part.

    Args:
        shape: Convex parts that the rays may hit.
        start: Origin of all rays [m], shape (3,).
        rays: Unit directions of the rays, shape (n, 3).

    Returns:
        Distances [m], shape (n,), which are inf for rays that hit nothing.
    """
    rounded = [_to_rounded(shape, start, ray) for ray in rays] if (shape.radius > 0).any() else math.inf
    return np.asarray(np.minimum(_to_triangles(shape, start, rays), rounded))


def _to_triangles(shape: Hulls, start: Array, rays: Array) -> Array:
    triangles = shape.triangles
    if not rays[:, 2].any():  # horizontal rays pass most triangles above or below
        z = shape.corners[triangles, 2]
        triangles = triangles[(z.min(axis=1) <= start[2] + FOOT) & (z.max(axis=1) >= start[2] - FOOT)]
    a, b, c = (shape.corners[triangles[:, k]] for k in range(3))
    u, v, w = b - a, c - a, start - a
    across = cross(rays[:, None], v)
    volume = (u * across).sum(axis=-1)
    facing = np.abs(volume) > 1e-14
    volume = np.where(facing, volume, 1.0)
    s = (w * across).sum(axis=-1) / volume
    turned = cross(w, u)
    t = (rays[:, None] * turned).sum(axis=-1) / volume
    far = (v * turned).sum(axis=-1) / volume
    hit = facing & (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9) & (far > 0)
    return np.asarray(np.where(hit, far, math.inf).min(axis=1, initial=math.inf))


def _to_rounded(shape: Hulls, start: Array, ray: Array) -> float:
    """Return the distance [m] along a ray to the first sphere or capsule, or inf if the ray does not hit any.

    A capsule is represented by an edge: a tube between the spheres at its two ends.
    """
    radius = shape.radius[shape.part]
    ball = radius > 0
    tube = radius[shape.edges[:, 0]] > 0
    if not ball.any():
        return math.inf
    foot, end = (shape.corners[shape.edges[tube, k]] for k in range(2))
    length = np.linalg.norm(end - foot, axis=1)
    along = (end - foot) / length[:, None]
    from_foot = start - foot
    aside = from_foot - (from_foot * along).sum(axis=1, keepdims=True) * along
    far = _entry(aside, ray - (along @ ray)[:, None] * along, radius[shape.edges[tube, 0]])
    with np.errstate(invalid="ignore"):
        height = (from_foot * along).sum(axis=1) + far * (along @ ray)
        on = (height >= 0) & (height <= length)
    to_ball = _entry(start - shape.corners[ball], np.broadcast_to(ray, (int(ball.sum()), 3)), radius[ball])
    return float(min(far[on].min(initial=math.inf), to_ball.min(initial=math.inf)))


def _entry(offset: Array, ray: Array, radius: Array) -> Array:
    """Return the distances at which rays from ``offset`` come within ``radius`` of the origin.

    A distance is inf if the ray never comes that close.
    """
    square = (ray * ray).sum(axis=1)
    half = (offset * ray).sum(axis=1)
    inside = half**2 - square * ((offset * offset).sum(axis=1) - radius**2)
    met = (inside >= 0) & (square > 1e-12)
    far = (-half - np.sqrt(np.where(met, inside, 0.0))) / np.where(met, square, 1.0)
    return np.where(met & (far > 0), far, math.inf)
