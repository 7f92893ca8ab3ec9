"""Bounds on the signed distance between two links, computed without MuJoCo.

The bounds are nearly always tight enough to determine if the distance exceeds a threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array
from simfoundry.geometry.hulls import PROUD
from simfoundry.geometry.shapes import Box

# Allowance for rounding errors in coordinates of a few meters [m].
ROUNDING = 1e-9

# Maximum total number of edges in two parts for which cross products of edges are tested; a box has twelve edges.
FEW_EDGES = 24

# Maximum number of steps in Wolfe's algorithm; faces with a hundred corners need about twenty.
STEPS = 64


class Interval(NamedTuple):
    """Lower and upper bounds on a signed distance [m].

    For overlapping parts with sharp edges, the upper bound is about 0.
    """

    lower: float
    upper: float


class _Part(NamedTuple):
    """A convex part in the world frame.

    Attributes:
        corners: Corners [m], shape (n, 3).
        radius: Rounding radius [m].
        normals: Unit face normals, shape (m, 3).
        edges: Unit edge directions, shape (k, 3).
    """

    corners: Array
    radius: float
    normals: Array
    edges: Array


def distance_bounds(a: Form, b: Form, X_WA: tuple[Array, Array], X_WB: tuple[Array, Array], limit: float) -> Interval:
    """Return bounds on the signed distance between two links.

    Args:
        a: First link.
        b: Second link.
        X_WA: Position [m], shape (3,), and rotation, shape (3, 3), of the first link in the world.
        X_WB: Position and rotation of the second link.
        limit: Distance [m] at which the search ends. Parts whose bounding boxes are farther apart are treated as if
            they were exactly this far apart.
    """
    lower, upper = limit, math.inf
    boxes_a, boxes_b = _boxes(a, X_WA), _boxes(b, X_WB)
    gaps = np.maximum(boxes_a[0][:, None] - boxes_b[1], boxes_b[0] - boxes_a[1][:, None]).max(axis=2)
    for i, j in zip(*(index.tolist() for index in np.nonzero(gaps <= limit)), strict=True):
        if gaps[i, j] >= min(lower, upper) > 0:
            continue
        found = _part_bounds(_part(a, i, X_WA), _part(b, j, X_WB))
        lower, upper = min(lower, found.lower), min(upper, found.upper)
    return Interval(lower, upper)


def _boxes(form: Form, X_WF: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the minimum and maximum corners of the bounding box around each part, as arrays of shape (parts, 3)."""
    low, high, _, _ = form.pieces
    middle, half = (low + high) / 2 @ X_WF[1].T + X_WF[0], (high - low) / 2 @ np.abs(X_WF[1]).T
    return middle - half, middle + half


def _part(form: Form, number: int, X_WF: tuple[Array, Array]) -> _Part:
    p, turn = X_WF
    corners, normals, edges = form.part_shape(number)
    return _Part(corners @ turn.T + p, float(form.parts.radius[number]), normals @ turn.T, edges @ turn.T)


def _part_bounds(a: _Part, b: _Part) -> Interval:
    rounding = a.radius + b.radius
    nearest = _nearest(a.corners, b.corners)
    apart = float(np.linalg.norm(nearest))
    axes = [a.normals, -b.normals]
    if len(a.edges) + len(b.edges) <= FEW_EDGES:
        across = np.cross(a.edges[:, None], b.edges[None]).reshape(-1, 3)
        size = np.linalg.norm(across, axis=1)
        across = across[size > 1e-6] / size[size > 1e-6, None]
        axes += [across, -across]
    if apart > ROUNDING:
        axes.append(-nearest[None] / apart)
    ways = np.concatenate(axes)
    if not len(ways):  # two points or line segments in contact
        return Interval(-rounding, apart - rounding)
    along = (b.corners @ ways.T).min(axis=0) - (a.corners @ ways.T).max(axis=0)
    slack = PROUD * ((len(a.corners) > 8) + (len(b.corners) > 8))  # prisms around cylinders protrude by this much
    return Interval(float(along.max()) - rounding - ROUNDING, max(apart - rounding, -rounding) + slack + ROUNDING)


def _nearest(a: Array, b: Array) -> Array:
    """Use Wolfe's algorithm to compute the shortest vector from the hull of ``b`` to the hull of ``a``.

    Returns:
        The vector [m], shape (3,).
    """
    middle = a.mean(axis=0) - b.mean(axis=0)
    corral = _support(a, b, middle)[None]
    weights = np.ones(1)
    point = corral[0]
    for _ in range(STEPS):
        new = _support(a, b, point)
        if point @ point - point @ new <= 1e-12 * max(1.0, float(point @ point)):
            return np.asarray(point)
        corral, weights = np.vstack([corral, new]), np.append(weights, 0.0)
        while True:
            wanted = _affine(corral)
            if (wanted > 1e-12).all():
                weights = wanted
                break
            falling = wanted < weights
            share = np.where(falling & (wanted <= 1e-12), weights / np.maximum(weights - wanted, 1e-300), np.inf).min()
            weights = weights + min(share, 1.0) * (wanted - weights)
            kept = weights > 1e-12
            if kept.all():
                break
            corral, weights = corral[kept], weights[kept] / weights[kept].sum()
        point = weights @ corral
    return np.asarray(point)


def _support(a: Array, b: Array, way: Array) -> Array:
    """Return the support point of the difference of two hulls, which is its lowest point along a direction."""
    return np.asarray(a[(a @ way).argmin()] - b[(b @ way).argmax()])


def _affine(points: Array) -> Array:
    """Return the weights of the point nearest the origin in the affine hull of ``points``. The weights sum to 1."""
    k = len(points)
    system = np.ones((k + 1, k + 1))
    system[0, 0], system[1:, 1:] = 0.0, points @ points.T
    right = np.zeros(k + 1)
    right[0] = 1.0
    return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0][1:])


# Upper bound on single-precision rounding errors [m].
BOX_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class BoxField:
    """The distance field of a box.

    ``middle`` [m] and ``axes`` are the position and the rotation of the box in the link frame. ``half`` [m] contains
    the half extents.
    """

    middle: NDArray[np.float32]
    axes: NDArray[np.float32]
    half: NDArray[np.float32]

    def local(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Transform points of shape (..., 3) from the link frame to the box frame."""
        return np.asarray((points - self.middle) @ self.axes)

    def lower(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> Array:
        """Return a lower bound on the distance to axis-aligned regions in the box frame.

        The bound is the largest gap across a face of the box.

        Args:
            low: Minimum corners of the regions [m], shape (n, 3).
            high: Maximum corners of the regions [m], shape (n, 3).

        Returns:
            Lower bounds [m], shape (n,).
        """
        return np.asarray(np.maximum(low - self.half, -self.half - high).max(axis=1) - np.float32(BOX_ROUNDING))

    def upper(self, local: NDArray[np.float32], radius: NDArray[np.float32]) -> Array:
        """Return an upper bound on the distance [m], which is the distance to the nearest of m balls.

        The bound is an array of shape (n,). ``local`` [m], shape (n, m, 3), contains the centers of the balls in the
        box frame.
        """
        off = np.abs(local) - self.half
        outside = np.maximum(off, 0)
        away = np.sqrt(np.einsum("...i,...i->...", outside, outside)) + np.minimum(off.max(axis=-1), 0) - radius
        return np.asarray(away.min(axis=1) + np.float32(BOX_ROUNDING))


@lru_cache(maxsize=256)
def box_field(form: Form) -> BoxField | None:
    """Return the distance field of a link that consists of a single box, or None for any other link."""
    if not form.solid or len(form.shapes) != 1 or not isinstance(box := form.shapes[0][0], Box):
        return None
    pose = form.shapes[0][1]
    return BoxField(*(np.asarray(v, dtype=np.float32) for v in (pose.p, pose.rotation, np.asarray(box.size) / 2)))
