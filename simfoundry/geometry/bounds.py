"""Bounds on the signed distance of two links, without MuJoCo; they decide nearly every threshold."""

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

ROUNDING = 1e-9
"""Rounding errors of coordinates of a few meters [m]."""

FEW_EDGES = 24
"""Total number of edges of both parts up to which cross products of edges are tested; a box has twelve."""

STEPS = 64
"""Step limit of Wolfe's algorithm; faces with a hundred corners need about twenty steps."""


class Interval(NamedTuple):
    """Bounds of a distance [m]: at least ``lower``, at most ``upper``, which is 0 for overlapping parts."""

    lower: float
    upper: float


class _Part(NamedTuple):
    """Convex part in the world: corners (n, 3), rounding [m], unit normals (m, 3) and edge directions (k, 3)."""

    corners: Array
    radius: float
    normals: Array
    edges: Array


def distance_bounds(a: Form, b: Form, X_WA: tuple[Array, Array], X_WB: tuple[Array, Array], limit: float) -> Interval:
    """Return bounds of the distance of two links, each at a position (3,) and rotation (3, 3).

    Parts whose boxes are farther apart than ``limit`` [m] count as exactly that far apart.
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
    """Low and high corners of the box around each part, (parts, 3) each."""
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
    if not len(ways):  # two points or rods in contact
        return Interval(-rounding, apart - rounding)
    along = (b.corners @ ways.T).min(axis=0) - (a.corners @ ways.T).max(axis=0)
    slack = PROUD * ((len(a.corners) > 8) + (len(b.corners) > 8))  # prisms around cylinders protrude by this much
    return Interval(float(along.max()) - rounding - ROUNDING, max(apart - rounding, -rounding) + slack + ROUNDING)


def _nearest(a: Array, b: Array) -> Array:
    """Shortest vector from the hull of ``b`` to the hull of ``a``, (3,), by Wolfe's algorithm."""
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
    """Support point of the difference of two hulls: the point least far along a direction."""
    return np.asarray(a[(a @ way).argmin()] - b[(b @ way).argmax()])


def _affine(points: Array) -> Array:
    """Weights, with sum 1, of the point nearest to the origin in the affine hull of points."""
    k = len(points)
    system = np.ones((k + 1, k + 1))
    system[0, 0], system[1:, 1:] = 0.0, points @ points.T
    right = np.zeros(k + 1)
    right[0] = 1.0
    return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0][1:])


BOX_ROUNDING = 1e-6
"""Upper bound on single-precision rounding errors [m]."""


@dataclass(frozen=True, eq=False)
class BoxField:
    """Distance field of a box.

    ``middle`` and ``axes`` are its pose in the link, ``half`` its half extents.
    """

    middle: NDArray[np.float32]
    axes: NDArray[np.float32]
    half: NDArray[np.float32]

    def local(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Transform points in the link's frame, (..., 3), to the frame of the box."""
        return np.asarray((points - self.middle) @ self.axes)

    def lower(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> Array:
        """Lower bound [m], (n,), of the distance to regions from ``low`` to ``high`` in the box frame, (n, 3) each.

        It is the largest gap across a face of the box.
        """
        return np.asarray(np.maximum(low - self.half, -self.half - high).max(axis=1) - np.float32(BOX_ROUNDING))

    def upper(self, local: NDArray[np.float32], radius: NDArray[np.float32]) -> Array:
        """Upper bound [m], (n,): distance of the nearest of the balls at points in the box frame, (n, m, 3)."""
        off = np.abs(local) - self.half
        outside = np.maximum(off, 0)
        away = np.sqrt(np.einsum("...i,...i->...", outside, outside)) + np.minimum(off.max(axis=-1), 0) - radius
        return np.asarray(away.min(axis=1) + np.float32(BOX_ROUNDING))


@lru_cache(maxsize=256)
def box_field(form: Form) -> BoxField | None:
    """Return the distance field of a link that is a single box, or None for any other link."""
    if not form.solid or len(form.shapes) != 1 or not isinstance(box := form.shapes[0][0], Box):
        return None
    pose = form.shapes[0][1]
    return BoxField(*(np.asarray(v, dtype=np.float32) for v in (pose.p, pose.rotation, np.asarray(box.size) / 2)))
