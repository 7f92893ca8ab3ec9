"""Fit boxes, cylinders and spheres to convex hulls of nearly that shape; primitives are cheaper in every engine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Kind = Literal["box", "cylinder", "sphere"]
KINDS: tuple[Kind, ...] = ("box", "cylinder", "sphere")

DIRECTIONS = 2000
"""Directions in which two convex bodies are compared; neighbors are 2.6 degrees apart."""


@dataclass(frozen=True, eq=False)
class Primitive:
    """Solid that replaces a mesh, in the frame of the mesh.

    ``size`` [m] are the full extents of a `box`, radius and height of a `cylinder` along its z, or the radius of a
    `sphere`; ``rotation`` (3, 3) has its axes as columns, ``center`` [m] is its middle.
    """

    kind: Kind
    size: tuple[float, ...]
    rotation: Array
    center: Array

    def support(self, directions: Array) -> Array:
        """Return the greatest coordinate [m] along each of n unit vectors, shape (n,)."""
        local = directions @ self.rotation
        middle = directions @ self.center
        if self.kind == "box":
            return np.asarray(middle + np.abs(local) @ np.array(self.size) / 2)
        if self.kind == "sphere":
            return np.asarray(middle + self.size[0])
        radius, height = self.size
        return np.asarray(middle + radius * np.hypot(local[:, 0], local[:, 1]) + height / 2 * np.abs(local[:, 2]))

    def corners(self, sides: int = 64) -> Array:
        """Return points on its surface [m], shape (n, 3), whose hull approximates it, or for a box equals it."""
        if self.kind == "box":
            signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
            local = signs * self.size
        elif self.kind == "sphere":
            local = self.size[0] * _directions(sides * 4)
        else:
            turn = np.arange(sides) * (2 * np.pi / sides)
            ring = self.size[0] * np.column_stack([np.cos(turn), np.sin(turn)])
            local = np.concatenate([np.column_stack([ring, np.full(sides, z * self.size[1])]) for z in (-0.5, 0.5)])
        return np.asarray(local @ self.rotation.T + self.center)


def fitted_primitives(corners: Array, within: float) -> list[Primitive]:
    """Return the nearest primitive of each kind to the convex hull of points [m], shape (n, 3), up to ``within`` [m].

    This is the Hausdorff distance: for convex bodies, the greatest difference of their support functions.
    """
    directions = _directions(DIRECTIONS)
    wanted = (corners @ directions.T).max(axis=0)
    nearest: dict[str, tuple[float, Primitive]] = {}
    for candidate in _candidates(corners):
        # Also along the axes of the candidate, where boxes and cylinders have their faces.
        own = np.concatenate([candidate.rotation.T, -candidate.rotation.T])
        apart = max(
            float(np.abs(candidate.support(directions) - wanted).max()),
            float(np.abs(candidate.support(own) - (corners @ own.T).max(axis=0)).max()),
        )
        if apart <= nearest.get(candidate.kind, (within, candidate))[0]:
            nearest[candidate.kind] = apart, candidate
    return [candidate for _, candidate in nearest.values()]


def _candidates(corners: Array) -> Iterator[Primitive]:
    """Yield a sphere, and in each frame a box and three cylinders; their mean error is zero."""
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    yield Primitive("sphere", (_mean_radius(corners - middle, _directions(200)),), np.eye(3), middle)
    for frame in _frames(corners):
        local = corners @ frame
        low, high = local.min(axis=0), local.max(axis=0)
        yield Primitive("box", tuple((high - low).tolist()), frame, frame @ ((low + high) / 2))
        for axis in range(3):
            turned = frame[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]  # its z is the axis, and it stays right-handed
            points = corners @ turned
            low, high = points.min(axis=0), points.max(axis=0)
            center = (low + high) / 2
            turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
            radius = _mean_radius(points[:, :2] - center[:2], np.column_stack([np.cos(turn), np.sin(turn)]))
            yield Primitive("cylinder", (radius, float(high[2] - low[2])), turned, turned @ center)


def _frames(corners: Array) -> list[Array]:
    """Return right-handed frames for boxes and cylinders: of the mesh, of its principal axes, of its smallest box."""
    import trimesh

    _, _, rows = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)
    to_box, _ = trimesh.bounds.oriented_bounds(corners)
    return [np.eye(3), *(frame * [1, 1, np.linalg.det(frame)] for frame in (rows.T, to_box[:3, :3].T))]


def _mean_radius(points: Array, directions: Array) -> float:
    """Return the mean of the least and greatest extent from the origin [m], which minimizes the greatest error."""
    reach = (points @ directions.T).max(axis=0)
    return float(reach.min() + reach.max()) / 2


def _directions(count: int) -> Array:
    """Return evenly distributed unit vectors, shape (count, 3): a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1 - z**2)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), z])
