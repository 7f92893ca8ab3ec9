"""Fit boxes, cylinders and spheres to convex hulls, because primitives are cheaper to simulate in every engine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from simfoundry.assets.mass import Array

Kind = Literal["box", "cylinder", "sphere"]
KINDS: tuple[Kind, ...] = ("box", "cylinder", "sphere")

# Number of directions in which two convex bodies are compared; neighboring directions are 2.6 degrees apart.
DIRECTIONS = 2000


@dataclass(frozen=True, eq=False)
class Primitive:
    """A primitive shape that replaces a mesh, posed in the mesh frame.

    ``size`` [m] contains the full extents of a `box`, the radius and height of a `cylinder` along its z axis, or the
    radius of a `sphere`. The columns of ``rotation``, shape (3, 3), are the axes of the primitive, and ``center`` [m]
    is its center.
    """

    kind: Kind
    size: tuple[float, ...]
    rotation: Array
    center: Array

    def support(self, directions: Array) -> Array:
        """Return the value of the support function [m] for each of n unit vectors, as an array of shape (n,)."""
        local = directions @ self.rotation
        middle = directions @ self.center
        if self.kind == "box":
            return np.asarray(middle + np.abs(local) @ np.array(self.size) / 2)
        if self.kind == "sphere":
            return np.asarray(middle + self.size[0])
        radius, height = self.size
        return np.asarray(middle + radius * np.hypot(local[:, 0], local[:, 1]) + height / 2 * np.abs(local[:, 2]))

    def corners(self, sides: int = 64) -> Array:
        """Return surface points whose convex hull approximates the primitive.

        For boxes, the hull is exact.

        Returns:
            Points [m], shape (n, 3).
        """
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
    """Return the best-fitting primitive of each kind for the convex hull of n points.

    Primitives farther than ``within`` [m] from the hull are omitted. The metric is the Hausdorff distance, which, for
    convex bodies, is the maximum difference between their support functions.
    """
    directions = _directions(DIRECTIONS)
    wanted = (corners @ directions.T).max(axis=0)
    nearest: dict[str, tuple[float, Primitive]] = {}
    for candidate in _candidates(corners):
        # Also compare along the axes of the candidate, which are the face normals of boxes and cylinders.
        own = np.concatenate([candidate.rotation.T, -candidate.rotation.T])
        around = np.abs(candidate.support(directions) - wanted).max()
        along = np.abs(candidate.support(own) - (corners @ own.T).max(axis=0)).max()
        apart = float(max(around, along))
        if apart <= nearest.get(candidate.kind, (within, candidate))[0]:
            nearest[candidate.kind] = apart, candidate
    return [candidate for _, candidate in nearest.values()]


def _candidates(corners: Array) -> Iterator[Primitive]:
    """Yield a sphere, plus a box and three cylinders for each candidate frame.

    All sizes are chosen for a mean error of zero.
    """
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    yield Primitive("sphere", (_mean_radius(corners - middle, _directions(200)),), np.eye(3), middle)
    for frame in _frames(corners):
        local = corners @ frame
        low, high = local.min(axis=0), local.max(axis=0)
        yield Primitive("box", tuple((high - low).tolist()), frame, frame @ ((low + high) / 2))
        for axis in range(3):
            turned = frame[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]  # z is the axis; right-handed
            points = corners @ turned
            low, high = points.min(axis=0), points.max(axis=0)
            center = (low + high) / 2
            turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
            radius = _mean_radius(points[:, :2] - center[:2], np.column_stack([np.cos(turn), np.sin(turn)]))
            yield Primitive("cylinder", (radius, float(high[2] - low[2])), turned, turned @ center)


def _frames(corners: Array) -> list[Array]:
    """Return right-handed candidate frames: the mesh frame, its principal axes, and its minimum bounding box."""
    import trimesh

    _, _, rows = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)
    to_box, _ = trimesh.bounds.oriented_bounds(corners)
    return [np.eye(3), *(frame * [1, 1, np.linalg.det(frame)] for frame in (rows.T, to_box[:3, :3].T))]


def _mean_radius(points: Array, directions: Array) -> float:
    """Return the mean of the minimum and maximum extents from the origin [m], which minimizes the maximum error."""
    reach = (points @ directions.T).max(axis=0)
    return float(reach.min() + reach.max()) / 2


def _directions(count: int) -> Array:
    """Return unit vectors that are evenly distributed on a Fibonacci lattice, as an array of shape (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1 - z**2)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), z])
