"""Candidate motions of a part with one degree of freedom.

A drawer slides along the normal of its front. A door or a lid turns about an edge of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, cross
from simfoundry.scene.model import JointType

# Amounts of motion to try: refinement finds the rest. Slides to half a meter [m], in steps in which a front comes near
# enough to where it is, and turns to 150 degrees [rad], in steps in which the far edge of a door of 0.6 m does.
SLIDES = tuple(k / 100 for k in range(1, 51))
TURNS = tuple(math.radians(angle) for angle in range(10, 151, 5))

# Initial value of the thickness of doors and lids [m].
TYPICAL_BACK = 0.015

# Maximum number of planes in a set of points, and the fewest points of one.
PLANES, FEWEST = 5, 60

# Width of the rim of a patch in which normals are blurred [m]: six pixels of 640 at 1 m, and noise.
RIM = 0.015

# Points of a front outside of these quantiles are taken for noise.
QUANTILES = (0.01, 0.99)

# Number of hypotheses for each plane, and the maximum distance [m] and angle (cosine of 20 degrees) of its points.
HYPOTHESES, THICKNESS, ALIGNED = 200, 0.006, 0.94


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion with one degree of freedom.

    Attributes:
        kind: ``prismatic`` or ``revolute``.
        axis: The unit direction of the motion, or of its axis, in the world frame, shape (3,).
        pivot: A point on the axis [m], shape (3,).
        q: The amount of motion from the first view to the second [m or rad], positive.
        back: The thickness of the part [m] if the second view shows its back, otherwise 0.
        edge: A point on the edge of the part [m] that a hinge should be near, shape (3,), or None.
        outward: The unit direction out of the part at this edge, shape (3,), or None.
    """

    kind: JointType
    axis: Array
    pivot: Array
    q: float
    back: float = 0.0
    edge: Array | None = None
    outward: Array | None = None

    def moved(self, points: Array) -> Array:
        """Return points [m], shape (n, 3), after the motion."""
        if self.kind is JointType.PRISMATIC:
            return points + self.q * self.axis
        return np.asarray((points - self.pivot) @ self.rotation.T + self.pivot)

    def sources(self, points: Array) -> Array:
        """Return where points [m], shape (n, 3), were before the motion."""
        if self.kind is JointType.PRISMATIC:
            return points - self.q * self.axis
        return np.asarray((points - self.pivot) @ self.rotation + self.pivot)

    @property
    def rotation(self) -> Array:
        """The rotation matrix of the motion."""
        from scipy.spatial.transform import Rotation

        angle = 0.0 if self.kind is JointType.PRISMATIC else self.q
        return np.asarray(Rotation.from_rotvec(angle * self.axis).as_matrix())


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat part of a surface: its unit normal toward the camera, its centroid [m], and its points [m], (n, 3)."""

    normal: Array
    center: Array
    points: Array


@dataclass(frozen=True, eq=False)
class FrontOutline:
    """The rectangle around a front.

    Attributes:
        center: A point of its plane [m], shape (3,).
        basis: The unit directions of its edges, shape (3, 2).
        low: The lowest coordinates along the edges, relative to the center [m], shape (2,).
        high: The highest ones.
    """

    center: Array
    basis: Array
    low: Array
    high: Array


def patches(points: Array, normals: Array, rng: np.random.Generator) -> list[Patch]:
    """Return the largest flat patches of points with normals, both of shape (n, 3), the largest first."""
    found: list[Patch] = []
    usable = np.isfinite(normals).all(axis=1)
    points, normals = points[usable], normals[usable]
    while len(found) < PLANES and len(points) >= FEWEST:
        seeds = rng.integers(len(points), size=HYPOTHESES)
        counts = [int(_on(points, normals, normals[k], float(normals[k] @ points[k])).sum()) for k in seeds]
        k = seeds[int(np.argmax(counts))]
        normal, offset = normals[k], float(normals[k] @ points[k])
        for _ in range(4):
            on = _on(points, normals, normal, offset)
            if on.sum() < FEWEST:
                return found
            center = points[on].mean(axis=0)
            fitted = np.linalg.svd(points[on] - center, full_matrices=False)[2][2]
            normal = fitted * math.copysign(1.0, float(fitted @ normal))
            offset = float(normal @ center)
        # Normals near the edge of a patch are blurred, so that its points there are known by their place only.
        around = ((points > points[on].min(axis=0) - RIM) & (points < points[on].max(axis=0) + RIM)).all(axis=1)
        whole = around & (np.abs(points @ normal - offset) < THICKNESS)
        found.append(Patch(normal, center, points[whole]))
        points, normals = points[~(on | whole)], normals[~(on | whole)]
    return found


def _on(points: Array, normals: Array, normal: Array, offset: float) -> np.ndarray:
    return (np.abs(points @ normal - offset) < THICKNESS) & (normals @ normal > ALIGNED)


def within_outline(front: Patch, points: Array) -> NDArray[np.bool_]:
    """Return True for points [m], shape (n, 3), that are in front of or behind a front, within its outline."""
    u = cross(front.normal, np.eye(3)[int(np.argmin(np.abs(front.normal)))])
    basis = np.column_stack([u / np.linalg.norm(u), cross(front.normal, u / np.linalg.norm(u))])
    low, high = np.quantile((front.points - front.center) @ basis, QUANTILES, axis=0)
    flat = (points - front.center) @ basis
    return np.asarray(((flat > low - RIM) & (flat < high + RIM)).all(axis=1))


def height_above(front: Patch, points: Array) -> Array:
    """Return the distances of points [m], shape (n, 3), from the plane of a front, positive in front of it."""
    return np.asarray((points - front.center) @ front.normal)


def candidate_motions(fronts: Sequence[Patch], axes: Sequence[Array]) -> Iterator[list[Motion]]:
    """Yield motions of flat fronts: slides along their normals, and turns about their edges.

    Each item contains the motions of a front along one axis, which differ in their amount.

    Args:
        fronts: Patches of the part in the first view.
        axes: Unit directions of the object's box, of which the edges of a front are two.
    """
    for front in fronts:
        outline = _outline(front, axes)
        yield [Motion(JointType.PRISMATIC, front.normal, front.center, q) for q in SLIDES]
        for (pivot, axis, outward), back in product(_edges(front, outline), (0.0, TYPICAL_BACK)):
            yield [Motion(JointType.REVOLUTE, axis, pivot, q, back, pivot, outward) for q in TURNS]


def _outline(front: Patch, axes: Sequence[Array]) -> FrontOutline:
    """Return the rectangle around a front whose edges are along the object's box."""
    flat = [axis - (axis @ front.normal) * front.normal for axis in axes]
    along = max(flat, key=lambda axis: float(np.linalg.norm(axis)))
    along = along / np.linalg.norm(along)
    basis = np.column_stack([along, cross(front.normal, along)])
    low, high = np.quantile((front.points - front.center) @ basis, QUANTILES, axis=0)
    return FrontOutline(front.center, basis, np.asarray(low), np.asarray(high))


def _edges(front: Patch, outline: FrontOutline) -> Iterator[tuple[Array, Array, Array]]:
    """Yield a point on each edge of a front [m], the direction about which it opens there, and that out of it."""
    inside = front.center - TYPICAL_BACK / 2 * front.normal  # hinges are rather in the panel than on its surface
    for k in (0, 1):
        side = outline.basis[:, k]
        turn = cross(front.normal, side)
        # From the edge at `high`, the front extends toward -side; it opens toward the normal by a turn about `turn`.
        yield inside + outline.high[k] * side, turn, side
        yield inside + outline.low[k] * side, -turn, -side
